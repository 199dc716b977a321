"""Variance between runs of one machine, by restricted maximum likelihood of random effects.

Source: H. D. Patterson, R. Thompson, Recovery of inter-block information when block sizes are
unequal, Biometrika 58, 1971.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from plant.parts import Floats, product

# Groups whose values differ in shares of their size.
RELATIVE = ("drive.viscous", "drive.coulomb", "drive.elasticity.compliance")

# Degrees of freedom of a value that is not compared: its quantile is the normal one.
MANY = 1e6

# Variances between runs that are tried, relative to the largest of a group: ten per decade.
_TRIED = np.logspace(-6, 6, 121)

# Ratio of the variance between runs to that of their noise below which runs are copies of one
# another: the likelihood has rounding errors there.
_ALIKE = 1e-12

# Change of twice the log likelihood over all variances below which it determines none: rounding.
_FLAT = 1e-9


class Differing(NamedTuple):
    """Fields of `BetweenRuns`."""

    groups: dict[str, float]
    deviation: Floats
    freedom: Floats


def differing(
    names: Sequence[str], values: Floats, estimates: Floats, std: Floats, alike: Floats
) -> Differing:
    """Differences between the estimates of runs beyond noise.

    `estimates`, `std` (R, k): of each run, with NaN deviations of a value that a run does not
    determine. `values` (k,): about which they lie.

    `alike` (k, S): rows of length 1 whose products are the correlations of the values.
    """
    k = len(values)
    # Without a comparison the deviation is zero, and no quantile is widened.
    groups = dict[str, float]()
    deviation = np.zeros(k)
    freedom = np.full(k, MANY)
    for name, at in groups_of(names, std).items():
        size = size_of(name, values[at], std[:, at])
        # In its unit each value of the group varies alike: so they share one variance.
        share = np.isfinite(std[:, at]).astype(float)
        apart = restricted(name, estimates[:, at] / size, std[:, at] / size, share)
        groups[name] = np.sqrt(apart)
        deviation[at] = np.sqrt(apart) * size
        # Runs that determine a value, on average, less one for their mean.
        of_value = share.sum() / len(at) - 1
        # Correlated values of a group count as fewer: m^2 / sum of squared correlations.
        correlations = product(alike[at], alike[at].T)
        freedom[at] = of_value * len(at) ** 2 / max((correlations**2).sum(), len(at))
    return Differing(groups, deviation, freedom)


def groups_of(names: Sequence[str], std: Floats) -> dict[str, list[int]]:
    """Places of the parameters of each group that two runs or more determine."""
    groups = dict[str, list[int]]()
    for i in np.flatnonzero(np.isfinite(std).sum(axis=0) > 1).tolist():
        name = names[i].partition("[")[0]
        group = name if name.startswith(("drive.", "law.")) else "f"
        groups.setdefault(group, []).append(i)
    return groups


def size_of(name: str, values: Floats, std: Floats) -> Floats:
    """Unit (m,) of the differences in a group: values (m,), or their standard deviations (R, m)."""
    size = np.sqrt(np.nanmean(std**2, axis=0))
    return np.maximum(size, np.abs(values)) if name in RELATIVE else size


def restricted(
    name: str, estimates: Floats, std: Floats, share: Floats, about: float | None = None
) -> float:
    """Variance between runs, where estimates (R, m) = mean + share * effect + noise of std (R, m).

    By restricted maximum likelihood; `share` is 0 where nothing is known. `about`: the mean, where
    that is known, and `estimates` are corrected for the part that the fit takes away.
    """
    from scipy.optimize import minimize_scalar

    determined = share > 0
    estimates = np.where(determined, estimates, 0.0)

    def criterion(variance: float) -> float:
        """Minus twice the restricted log likelihood."""
        total = np.where(determined, std**2 + variance * share**2, 1.0)
        weight = determined / total
        if about is None:
            # The estimated mean takes a degree of freedom: the term that restricts the likelihood.
            mean: Any = (weight * estimates).sum(axis=0) / weight.sum(axis=0)
            restriction = np.log(weight.sum(axis=0)).sum()
        else:
            mean = about
            restriction = 0.0
        squares = weight * (estimates - mean) ** 2
        return float(np.log(total).sum() + restriction + squares.sum())

    largest = max(
        np.var(values[rows], ddof=1) for values, rows in zip(estimates.T, determined.T, strict=True)
    )
    if largest <= _ALIKE * np.min(std[determined] ** 2):
        return 0.0

    # A grid first, over twelve decades; then the interval about the best of it.
    tried = _TRIED * largest
    costs = np.array([criterion(variance) for variance in tried])
    best = int(np.argmin(costs))
    if not np.isfinite(costs).all() or best == len(tried) - 1 or np.ptp(costs) < _FLAT:
        raise ValueError(
            f"the variance of {name} between runs must follow from the logs; it does not. Give a"
            " known value of what they barely excite."
        )
    around = np.log(tried[[max(best - 1, 0), best + 1]])
    optimum = minimize_scalar(
        lambda x: criterion(np.exp(x)), bounds=around, method="bounded", options={"xatol": 1e-10}
    )
    # Zero is a bound, which no logarithm reaches.
    return 0.0 if criterion(0.0) <= optimum.fun else float(np.exp(optimum.x))
