"""Differences between runs of one machine: agreement of their fits, and a variance that they share.

Friction warms up, a cable lies elsewhere: each run has values of its own, which scatter about those
of the machine. Each group of parameters (f, viscous and Coulomb friction, offsets) has one variance
between runs. It is that of a one-way model of random effects, by restricted maximum likelihood over
the parameters of the group; their scatter within a run is known from noise and blocks. Friction and
gears differ relative to their size, the rest in standard deviations of one run. For the common fit,
the model is one of the changes that each run makes to a common value: a run that hardly determines
a value hardly changes it.

Sources: W. G. Cochran, The combination of estimates from different experiments, Biometrics 10, 1954
(agreement); G. Knapp, J. Hartung, Improved tests for a random effects meta-regression, Statistics
in Medicine 22, 2003 (Student's t).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np

from identification.equation_error.least_squares import (
    NORMAL,
    at_least,
    group_std,
    run_moves,
    run_std,
    wider,
)
from identification.equation_error.random_effects import (
    MANY,
    RELATIVE,
    Differing,
    differing,
    groups_of,
    restricted,
    size_of,
)
from plant.parts import (
    Bools,
    Floats,
    Frozen,
    Integers,
    Shown,
    frozen,
    frozen_settings,
    kept,
    norm,
    product,
    products,
)


@frozen_settings
class BetweenRunsSettings:
    """How runs are compared.

    Parameters
    ----------
    shown : float
        Least information of a direction that a run determines, relative to the largest of that
        run; also the largest share of a value that may lie in the other directions. Chosen by
        hand, above rounding errors.
    disagree : float
        Probability that the intervals of a parameter are said to disagree where only noise makes
        runs differ.
    exact : float
        Least standard deviation of a value, relative to the torque: it replaces that of a log
        without noise, which would be zero. Chosen by hand.
    share : float
        Least share of a run in a common value, relative to the mean of all runs: a run with less
        does not determine the value. Chosen by hand.
    further : int
        Most further logs that are counted; chosen by hand.
    shown_difference : float
        Least difference between runs that is reported, as a share or in standard deviations; chosen
        by hand: it prints as 0.1 %.
    """

    shown: float = 1e-10
    disagree: float = 0.05
    exact: float = 1e-9
    share: float = 1e-6
    further: int = 1000
    shown_difference: float = 5e-4


SETTINGS = BetweenRunsSettings()

ONE_LOG = (
    "intervals by blocks of one log: what differs between runs is not in them; a second log would"
    " tell"
)


@kept
@frozen
class BetweenRuns(Shown, Frozen):
    """How the values of a fit differ between its logs.

    Attributes
    ----------
    values, std : (R, k) numpy.ndarray
        What each log alone says, and its standard deviation; NaN where it alone does not tell.
    compared, agree : (k,) numpy.ndarray of bool
        Whether two logs or more tell a value, and whether their intervals agree (Cochran's test at
        95 %).
    groups : dict of str to float
        Standard deviation between logs of each group: of friction and gears as a share of the
        value, of others in standard deviations of one log.
    deviation, freedom : (k,) numpy.ndarray
        Standard deviation between logs of each value, 0 where it is not compared; and degrees of
        freedom of that.
    further : int
        Number of further logs that would halve the intervals of half of the values of the common
        fit, those of `never` left out; 1000 stands for 1000 or more, 0 for no number of logs.
    never : int
        Number of values whose intervals no number of further logs would halve: what a rig may state
        wrongly makes half or more of each.
    """

    values: Floats
    std: Floats
    compared: Bools
    agree: Bools
    groups: dict[str, float]
    deviation: Floats
    freedom: Floats
    further: int
    never: int

    @classmethod
    def of(
        cls,
        estimates: Floats,
        std: Floats,
        apart: Differing,
        within: Floats,
        added: Floats,
        common: Floats,
    ) -> Self:
        """Differences from the values of each run and the variances of the common fit.

        `estimates`, `std` (R, k): of each run. `apart`: `groups`, `deviation` and `freedom`.

        `within`, `added`, `common` (k,): the parts of the variance, from the scatter within runs,
        from what differs between runs, and from what no further log reduces.
        """
        # Half of an interval is a quarter of its variance: what is left, `common`, must be less.
        reducible = np.flatnonzero(common < 0.25 * (within + added + common))
        further = 0
        if reducible.size:
            further = further_logs(
                within[reducible],
                added[reducible],
                apart.freedom[reducible],
                len(estimates),
                common[reducible],
            )
        # One run alone agrees with itself.
        compared = np.isfinite(std).sum(axis=0) > 1
        return cls(
            values=estimates,
            std=std,
            compared=compared,
            agree=compared & runs_agree(estimates, std),
            **apart._asdict(),
            further=further,
            never=len(common) - reducible.size,
        )

    @property
    def half_width(self) -> Floats:
        """Half-widths (R, k) of the 95 % intervals of each log's values.

        They include the deviation between logs.
        """
        between = self.deviation * wider(self.freedom)
        return NORMAL * np.sqrt(self.std**2 + between**2)

    @property
    def left_out(self) -> str:
        """Clause of messages on logs that are left out; "" where there are none.

        A log is left out if it alone does not determine all values.
        """
        count = int(np.isnan(self.std).all(axis=1).sum())
        return f", but for {count} that alone do{'es' * (count == 1)} not tell all" if count else ""

    def among(self, places: Integers, count: int) -> Self:
        """The same of `count` values, of which these (k,) are at `places`.

        Nothing is known of the other values.
        """
        # Values without a comparison: no estimate, no deviation, and the normal quantile.
        unknown = {"values": np.nan, "std": np.nan, "freedom": MANY}
        extended = dict[str, Any]()
        for name in ("values", "std", "compared", "agree", "deviation", "freedom"):
            field = getattr(self, name)
            extended[name] = np.full((*field.shape[:-1], count), unknown.get(name, 0), field.dtype)
            extended[name][..., places] = field
        return replace(self, **extended)

    def _short(self):
        return f"{self.agree.sum()} of {self.compared.sum()} intervals agree between runs"

    def _shown(self):
        # Differences that print as zero are left out of the sentence.
        differences = []
        for name, share in self.groups.items():
            size = (
                f"{share:.1%}" if name in RELATIVE else f"{share:.2g} standard deviations of a run"
            )
            if share > SETTINGS.shown_difference:
                differences.append(f"{name} by {size}")
        text = ", in ".join(differences) or "nothing beside noise"
        yield f"{self._short()}; they differ in {text}"
        fixed = (
            f"what a rig may state wrongly makes half or more of {self.never} of the"
            f" {len(self.agree)}"
        )
        logs = f"{self.further} further log{'s' * (self.further != 1)}"
        # More are not tried.
        if self.further == SETTINGS.further:
            logs = f"{self.further} or more further logs"
        elif not self.further:
            logs = "no number of further logs"
        yield (
            f"{logs} would halve the intervals; what differs between runs is in"
            f" them{f'; {fixed}' * bool(self.never)}"
        )


class _Runs(NamedTuple):
    """The fit of each run alone.

    `estimates`, `std` (R, k): values, NaN where a run does not determine one. `residual` (M,): of
    these fits. `share` (R, k): change of the common value per change of a run's, times R.
    """

    estimates: Floats
    std: Floats
    residual: Floats
    share: Floats


def between_runs(
    names: Sequence[str],
    values: Floats,
    noise: Floats,
    rows: Floats,
    residual: Floats,
    runs: Integers,
    blocks: Integers,
    common: Floats | float = 0.0,
) -> tuple[BetweenRuns, Floats]:
    """Differences between the logs of a weighted fit, and the covariance that includes them.

    The covariance (k, k) is that of the values of the fit.

    `values` (k,): of the fit. `noise` (k, k): their covariance by noise alone. `rows` (M, k),
    `residual` (M,): weighted. `runs`, `blocks` (M,): numbers of the log and of the block of each
    row, from 0; -1 for rows of no log. `common` (k,): variance that no further log reduces.
    """
    # 1. Each run alone, and the covariance from blocks: noise may be correlated within them.
    scale = np.sqrt((rows * rows).sum(axis=0))
    alone = _alone(values, rows, residual, runs, blocks)
    exact = SETTINGS.exact * norm(values * scale) / scale
    count, k = alone.estimates.shape
    covariance = at_least(noise, run_std(rows, alone.residual, blocks))

    # 2. Change of the common values by each run, and its variance from blocks within the run.
    moved = count * run_moves(rows, residual, runs)
    scatter = count * run_moves(rows, alone.residual, blocks)
    run_of_block = np.array([runs[np.argmax(blocks == block)] for block in range(len(scatter))])
    inside = np.stack([(scatter[run_of_block == run] ** 2).sum(axis=0) for run in range(count)])
    inside = np.maximum(np.maximum(inside, count * np.diag(noise)), exact**2)
    # Values that move together with the blocks count as one in the degrees of freedom.
    alike = (scatter / np.maximum(np.sqrt((scatter**2).sum(axis=0)), 1e-300)).T

    # 3. The variance between runs, group by group.
    std = np.maximum(alone.std, exact)
    added = np.zeros(k)
    apart = differing(names, values, alone.estimates, std, alike)
    for name, at in groups_of(names, alone.std).items():
        size = size_of(name, values[at], std[:, at])
        share = np.abs(alone.share[:, at])
        # In the other groups, a run changes a common value more by its other values than by its own
        # one. So the unit is the scatter of these changes within a run, and all runs count alike.
        if name not in RELATIVE:
            size = np.sqrt(inside[:, at].mean(axis=0))
            share = np.ones_like(share)
        variance = restricted(
            name, moved[:, at] / size, np.sqrt(inside[:, at]) / size, share, about=0.0
        )
        of_mean = (share**2).sum(axis=0) / count**2
        added[at] = variance * size**2 * of_mean * wider(apart.freedom[at]) ** 2
    within = np.diag(covariance)
    between = BetweenRuns.of(alone.estimates, std, apart, within, added, np.broadcast_to(common, k))
    return between, at_least(covariance, np.sqrt(within + added))


def _alone(values, rows, residual, runs, blocks):
    """The fit of each run alone in the directions that it shows; others stay as in `values`."""
    # Columns of one length: which directions a run shows then does not depend on units.
    scale = np.sqrt((rows * rows).sum(axis=0))
    count = int(runs.max()) + 1
    common = products(rows / scale)
    remaining = residual.copy()
    estimates, std, share = np.empty((3, count, len(values)))
    for run in range(count):
        # 1. Least squares on the residual of the common fit: the change of the values.
        in_run = runs == run
        columns = rows[in_run] / scale
        information = products(columns)
        sizes, axes = np.linalg.eigh(information)
        shown = sizes > SETTINGS.shown * sizes[-1]
        # The pseudo-inverse: along the hidden directions the run keeps the common values.
        inverse = (axes[:, shown] / sizes[shown]) @ axes[:, shown].T
        move = product(inverse, (columns * residual[in_run, None]).sum(axis=0))
        remaining[in_run] -= product(columns, move)
        estimates[run] = values + move / scale

        # 2. Its standard deviations: of white noise, or of blocks if these scatter more.
        variance = (remaining[in_run] ** 2).sum() / max(in_run.sum() - shown.sum(), 1)
        std[run] = np.sqrt(np.diag(inverse) * variance)
        if shown.all():
            # The jackknife needs blocks that are numbered from zero without gaps.
            numbers = np.unique(blocks[in_run], return_inverse=True)[1]
            scatter = group_std(columns, remaining[in_run], numbers)
            std[run] = np.where(np.isfinite(scatter), np.maximum(std[run], scatter), std[run])

        # 3. Values that lie in directions it does not show are not its own.
        hidden = (axes[:, ~shown] ** 2).sum(axis=1) > SETTINGS.shown
        # Information of this run relative to that of all rows, times the number of runs: 1 if all
        # runs are alike and every row belongs to one.
        share[run] = count * np.diag(np.linalg.solve(common, information))
        hidden |= np.abs(share[run]) < SETTINGS.share
        estimates[run, hidden] = np.nan
        std[run, hidden] = np.nan
    return _Runs(estimates, std / scale, remaining, share)


def runs_agree(estimates, std):
    """Whether the values (k,) of runs (R, k) agree within their intervals, by Cochran's Q."""
    from scipy.special import chdtri

    # A run that does not determine a value has no weight in its mean, and no degree of freedom.
    weight = np.where(np.isfinite(std), 1 / std**2, 0.0)
    mean = np.nansum(weight * estimates, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    squares = np.nansum(weight * (estimates - mean) ** 2, axis=0)
    freedom = (weight > 0).sum(axis=0) - 1
    # Under noise alone the weighted squares have a chi-square distribution.
    return squares <= chdtri(np.maximum(freedom, 1), SETTINGS.disagree)


def further_logs(within, between, freedom, count, common=0.0):
    """Number of logs beyond `count` that halve the standard deviations of half of the values.

    Further logs are taken to be like these. Where no smaller number does, `SETTINGS.further`.
    """
    # By trying: Student's quantile has no inverse in the number of logs.
    for logs in range(count + 1, count + SETTINGS.further):
        # More logs give more degrees of freedom, too, and so a smaller quantile of Student's.
        narrower = wider(freedom * (logs - 1) / (count - 1)) / wider(freedom)
        variance = (within + between * narrower**2) * count / logs + common
        if np.median(variance / (within + between + common)) <= 0.25:
            return logs - count
    return SETTINGS.further
