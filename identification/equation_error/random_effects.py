"""A variance that runs of one machine share: a one-way model of random effects, by restricted
maximum likelihood.

Source: H. D. Patterson, R. Thompson, Recovery of inter-block information when block sizes are
unequal, Biometrika 58, 1971.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plant.parts.fields import Floats
from plant.parts.sums import product

# Groups whose values differ in shares of their size.
RELATIVE = ("drive.viscous", "drive.coulomb", "drive.elasticity.compliance")

MANY = 1e6  # degrees of freedom of what is not compared

_TRIED = np.logspace(-6, 6, 121)  # variances between runs, in the largest that is seen

_ALIKE = 1e-12  # variance between runs over that of their noise, at most, of runs that are the same
# change of twice the log likelihood over all variances below which it says nothing of them
_FLAT = 1e-9


class Differing(NamedTuple):
    """What `BetweenRuns` says by the same names."""

    groups: dict[str, float]
    deviation: Floats
    freedom: Floats


def differing(
    names: Sequence[str], values: Floats, each: Floats, std: Floats, alike: Floats
) -> Differing:
    """How much values (R, k) of runs, each known to std (R, k; NaN where not), differ beside that
    about values (k,).

    `alike` (k, S): rows of length 1 whose products are the correlations of the values.
    """
    k = len(values)
    groups = dict[str, float]()
    deviation = np.zeros(k)
    freedom = np.full(k, MANY)
    for name, at in groups_of(names, std).items():
        size = size_of(name, values[at], std[:, at])
        known = np.isfinite(std[:, at]).astype(float)
        apart = restricted(name, each[:, at] / size, std[:, at] / size, known)
        groups[name], deviation[at] = np.sqrt(apart), np.sqrt(apart) * size
        freedom[at] = (
            (len(std) - 1)
            * len(at) ** 2
            / max((product(alike[at], alike[at].T) ** 2).sum(), len(at))
        )
    return Differing(groups, deviation, freedom)


def groups_of(names: Sequence[str], std: Floats) -> dict[str, list[int]]:
    """Places of the parameters of each group of which two runs or more tell a value."""
    found = dict[str, list[int]]()
    for i in np.flatnonzero(np.isfinite(std).sum(axis=0) > 1).tolist():
        name = names[i].partition("[")[0]
        found.setdefault(name if name.startswith(("drive.", "law.")) else "f", []).append(i)
    return found


def size_of(name: str, values: Floats, std: Floats) -> Floats:
    """In what the values (m,) of a group differ: in themselves, or their deviations (R, m)."""
    size = np.sqrt(np.nanmean(std**2, axis=0))
    return np.asarray(np.maximum(size, np.abs(values)) if name in RELATIVE else size)


def restricted(
    name: str, each: Floats, std: Floats, share: Floats, about: float | None = None
) -> float:
    """Variance of what differs between runs: each (R, m) = mean + share times that + what deviates
    by std.

    By restricted maximum likelihood; `share` is 0 where nothing is known. `about`: the mean, where
    that is known, and `each` is corrected for what the fit takes away.
    """
    from scipy.optimize import minimize_scalar

    known, each = share > 0, np.where(share > 0, each, 0.0)

    def criterion(variance: float) -> float:
        total = np.where(known, std**2 + variance * share**2, 1.0)
        weight = known / total
        mean = (weight * each).sum(axis=0) / weight.sum(axis=0) if about is None else about
        squares, taken = (
            weight * (each - mean) ** 2,
            np.log(weight.sum(axis=0)).sum() if about is None else 0.0,
        )
        return float(np.log(total).sum() + taken + squares.sum())

    largest = max(
        np.var(values[some], ddof=1) for values, some in zip(each.T, known.T, strict=True)
    )
    if largest <= _ALIKE * np.min(std[known] ** 2):
        return 0.0
    tried = _TRIED * largest
    costs = np.array([criterion(variance) for variance in tried])
    best = int(np.argmin(costs))
    if not np.isfinite(costs).all() or best == len(tried) - 1 or np.ptp(costs) < _FLAT:
        raise ValueError(
            f"the variance of {name} between runs must follow from the logs; it does not. Give a"
            " known value of what they barely excite."
        )
    around = np.log(tried[[max(best - 1, 0), best + 1]])
    found = minimize_scalar(
        lambda x: criterion(np.exp(x)), bounds=around, method="bounded", options={"xatol": 1e-10}
    )
    return 0.0 if criterion(0.0) <= found.fun else float(np.exp(found.x))
