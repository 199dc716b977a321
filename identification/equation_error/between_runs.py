"""What differs between runs of one machine: whether their own fits agree, and a variance that they
share.

Friction warms up, a cable lies elsewhere: each run has values of its own, about those of the
machine. Of each group of parameters (f, viscous and Coulomb friction, offsets) the variance between
runs is that of a one-way model of random effects, by restricted maximum likelihood over the
parameters of the group, whose scatter within a run is known from noise and blocks. Friction and
gears differ relative to their size, the rest in standard deviations of one run. Of the common fit
it is what each run moves the values by: what a run hardly tells, it hardly moves.

Sources: W. G. Cochran, The combination of estimates from different experiments, Biometrics 10, 1954
(agreement); G. Knapp, J. Hartung, Improved tests for a random effects meta-regression, Statistics
in Medicine 22, 2003 (Student's t).
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

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
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown
from plant.parts.sums import norm, product, products

# share of the largest direction from which on a run shows one, and of it that a value may lack
_SHOWN = 1e-10

# chance that the intervals of a parameter are called apart, where only noise makes runs differ
_AGREE = 0.05

# standard deviation at least, in the torque; and share of a run that counts as one
_EXACT = 1e-9
_HEARD = 1e-6

# logs that are counted; and share, or deviations, that is told
_MOST = 1000
_TOLD = 5e-4

ONE_LOG = (
    "intervals by blocks of one log: what differs between runs is not in them; a second log would"
    " tell"
)


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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
        Further logs that would halve the intervals of the common fit (of half of its values).
    never : int
        Values that are left out of this, since what a rig may state wrongly makes half or more of
        their intervals.
    """

    values: Floats
    std: Floats
    compared: NDArray[np.bool_]
    agree: NDArray[np.bool_]
    groups: dict[str, float]
    deviation: Floats
    freedom: Floats
    further: int
    never: int

    @classmethod
    def of(
        cls,
        each: Floats,
        std: Floats,
        apart: Differing,
        within: Floats,
        added: Floats,
        common: Floats,
    ) -> Self:
        """Of values (R, k) and their standard deviations; `within`, `added`, `common` (k,): the
        variance of their mean.

        That of each run alone, what differs between runs, and what no further log reduces.
        """
        some = np.flatnonzero(common < 0.25 * (within + added + common))
        of_some = within[some], added[some], apart.freedom[some], len(each), common[some]
        compared = np.isfinite(std).sum(axis=0) > 1
        return cls(
            values=each,
            std=std,
            compared=compared,
            agree=compared & _agree(each, std),
            **apart._asdict(),
            further=_further(*of_some) if some.size else 0,
            never=len(common) - some.size,
        )

    @property
    def half_width(self) -> Floats:
        """Of the 95 % intervals (R, k) of what each log says, with what differs between logs."""
        return np.asarray(
            NORMAL * np.sqrt(self.std**2 + (self.deviation * wider(self.freedom)) ** 2)
        )

    @property
    def left_out(self) -> str:
        """What to say of logs that alone tell nothing: "" where there are none."""
        count = int(np.isnan(self.std).all(axis=1).sum())
        return f", but for {count} that alone do{'es' * (count == 1)} not tell all" if count else ""

    def among(self, places: NDArray[np.intp], count: int) -> Self:
        """The same of so many values, of which these (k,) are at places; of the others nothing
        is known.
        """
        rest = {"values": np.nan, "std": np.nan, "freedom": MANY}
        whole = dict[str, Any]()
        for name in ("values", "std", "compared", "agree", "deviation", "freedom"):
            own = getattr(self, name)
            whole[name] = np.full((*own.shape[:-1], count), rest.get(name, 0), own.dtype)
            whole[name][..., places] = own
        return dataclasses.replace(self, **whole)

    def _short(self) -> str:
        return f"{self.agree.sum()} of {self.compared.sum()} intervals agree between runs"

    def _shown(self) -> Iterator[Piece]:
        said = [
            (
                f"{name} by {share:.1%}"
                if name in RELATIVE
                else f"{name} by {share:.2g} standard deviations of a run"
            )
            for name, share in self.groups.items()
            if share > _TOLD
        ]
        yield f"{self._short()}; they differ in {', in '.join(said) or 'nothing beside noise'}"
        fixed = (
            f"what a rig may state wrongly makes half or more of {self.never} of the"
            f" {len(self.agree)}"
        )
        logs = f"{self.further} further log{'s' * (self.further != 1)}"
        logs = "no number of further logs" if self.never == len(self.agree) else logs
        yield (
            f"{logs} would halve the intervals; what differs between runs is in"
            f" them{f'; {fixed}' * bool(self.never)}"
        )


class _Runs(NamedTuple):
    """What each run alone says.

    `each`, `std` (R, k): values, NaN where it does not tell. `left` (M,): residual of these fits.
    `share` (R, k): how far a run moves the common value if its own is larger by one, times R.
    """

    each: Floats
    std: Floats
    left: Floats
    share: Floats


def between_runs(
    names: Sequence[str],
    values: Floats,
    noise: Floats,
    rows: Floats,
    residual: Floats,
    runs: NDArray[np.intp],
    blocks: NDArray[np.intp],
    common: Floats | float = 0.0,
) -> tuple[BetweenRuns, Floats]:
    """How two logs or more of a weighted fit differ, and the covariance (k, k) of its values with
    that.

    `values` (k,), `noise` (k, k): of the fit, and covariance by noise alone. `rows` (M, k),
    `residual` (M,): weighted. `runs`, `blocks` (M,): log, and block of a log, of each row, from 0;
    -1 of what no log says. `common` (k,): variance that no further log reduces.
    """
    scale = np.sqrt((rows * rows).sum(axis=0))
    alone = _alone(values, rows, residual, runs, blocks)
    exact = _EXACT * norm(values * scale) / scale
    count, k = alone.each.shape
    covariance = at_least(noise, run_std(rows, alone.left, blocks))
    moved = count * run_moves(rows, residual, runs)
    scatter = count * run_moves(rows, alone.left, blocks)
    owner = np.array([runs[np.argmax(blocks == block)] for block in range(len(scatter))])
    inside = np.stack([(scatter[owner == run] ** 2).sum(axis=0) for run in range(count)])
    inside = np.maximum(np.maximum(inside, count * np.diag(noise)), exact**2)
    alike = (scatter / np.maximum(np.sqrt((scatter**2).sum(axis=0)), 1e-300)).T
    std = np.maximum(alone.std, exact)
    added = np.zeros(k)
    apart = differing(names, values, alone.each, std, alike)
    for name, at in groups_of(names, alone.std).items():
        size = size_of(name, values[at], std[:, at])
        share = np.abs(alone.share[:, at])
        # what moves it is hardly a change of itself: it is as large as what moves it within
        if name not in RELATIVE:
            size = np.sqrt(inside[:, at].mean(axis=0))
            share = np.ones_like(share)
        variance = restricted(
            name, moved[:, at] / size, np.sqrt(inside[:, at]) / size, share, about=0.0
        )
        added[at] = (
            variance * size**2 * (share**2).sum(axis=0) / count**2 * wider(apart.freedom[at]) ** 2
        )
    within = np.diag(covariance)
    found = BetweenRuns.of(alone.each, std, apart, within, added, np.broadcast_to(common, k))
    return found, at_least(covariance, np.sqrt(within + added))


def _alone(
    values: Floats, rows: Floats, residual: Floats, runs: NDArray[np.intp], blocks: NDArray[np.intp]
) -> _Runs:
    scale = np.sqrt((rows * rows).sum(axis=0))
    count = int(runs.max()) + 1
    whole = products(rows / scale)
    left = residual.copy()
    each, std, share = np.empty((3, count, len(values)))
    for run in range(count):
        some = runs == run
        own = rows[some] / scale
        information = products(own)
        sizes, axes = np.linalg.eigh(information)
        seen = sizes > _SHOWN * sizes[-1]
        inverse = (axes[:, seen] / sizes[seen]) @ axes[:, seen].T
        move = product(inverse, (own * residual[some, None]).sum(axis=0))
        left[some] -= product(own, move)
        each[run], square = (
            values + move / scale,
            (left[some] ** 2).sum() / max(some.sum() - seen.sum(), 1),
        )
        std[run] = np.sqrt(np.diag(inverse) * square)
        if seen.all():
            scatter = group_std(own, left[some], np.unique(blocks[some], return_inverse=True)[1])
            std[run] = np.where(np.isfinite(scatter), np.maximum(std[run], scatter), std[run])
        hidden = (axes[:, ~seen] ** 2).sum(axis=1) > _SHOWN
        share[run] = count * np.diag(np.linalg.solve(whole, information))
        hidden |= np.abs(share[run]) < _HEARD
        each[run, hidden] = std[run, hidden] = np.nan
    return _Runs(each, std / scale, left, share)


def _agree(each: Floats, std: Floats) -> NDArray[np.bool_]:
    """Which values (k,) of runs (R, k) differ by no more than their intervals allow."""
    from scipy.special import chdtri

    weight = np.where(np.isfinite(std), 1 / std**2, 0.0)
    mean = np.nansum(weight * each, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    squares = np.nansum(weight * (each - mean) ** 2, axis=0)
    freedom = (weight > 0).sum(axis=0) - 1
    return np.asarray(squares <= chdtri(np.maximum(freedom, 1), _AGREE))


def _further(
    within: Floats, between: Floats, freedom: Floats, count: int, common: Floats | float = 0.0
) -> int:
    """Logs beside so many that halve the standard deviations of half of the values, if they are
    alike.
    """
    for logs in range(count + 1, count + _MOST):
        narrower = wider(freedom * (logs - 1) / (count - 1)) / wider(freedom)
        left = (within + between * narrower**2) * count / logs + common
        if np.median(left / (within + between + common)) <= 0.25:
            return logs - count
    return _MOST
