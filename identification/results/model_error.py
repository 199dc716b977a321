"""The covariance of what was found, with what the model may lack: noise, and the bias by all that
the rig states.

Numbers that are taken as stated (gears, friction, offsets, timing) are right within tolerances
only. They are unknowns, too, whose prior standard deviations are these; the log says more of some.
What the unknowns would change by, if they were fitted together, is a bias: its square is added to
the covariance that they would have then.

Source: S. F. Schmidt, Application of state-space methods to navigation problems, Advances in
Control Systems 3, 1966 (consider covariance); G. J. Bierman, Factorization methods for discrete
sequential estimation, 1977, ch. 8.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from identification.equation_error.between_runs import BetweenRuns, between_runs
from identification.equation_error.least_squares import (
    SEGMENTS,
    along,
    directions,
    group_std,
    in_groups,
)
from identification.replay.optimum import Optimum
from identification.results.assumed import moved
from identification.search.problem import Tolerances
from plant.parts.fields import Floats
from plant.parts.sums import products

_ASSUMED = ("gear", "motor_gain", "law.")  # numbers whose changes by 1 % are told

_AT_ONCE = 1 << 15  # rows of the innovations that are taken at once

# tolerance of each kind of number, where it has another name
_BY_KIND = {"viscous": "friction", "coulomb": "friction"}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Doubt:
    """Where the innovations are least, and what is known of the model there.

    `at`, `first`: with what was named, and before. `step` (m,): of the values; zero for one that is
    not varied. `keep`: which of the unknowns its first values are. `unknown`: number of the
    unknowns. `searched`: number of the innovations of the records that were searched, the first.
    `effects`: change of the innovations (M,) with each of what the rig leaves out, or may have
    wrong. `efforts` (2, n): torque [N m] and speed [rad/s] of each motor (rms). `share`: of the
    samples that were fitted, how many these are: those that stand for a long log.
    """

    at: Optimum
    first: Optimum
    step: Floats
    keep: Sequence[int]
    unknown: int
    searched: int
    effects: Mapping[str, Floats]
    efforts: Floats
    share: float = 1.0

    def assumed(self) -> dict[str, Floats]:
        """Change (k,) of the unknowns if a gear, a motor's gain or a gain of the law is 1 %
        larger, by its name.
        """
        names = [name for name in self.effects if name.startswith(_ASSUMED)]
        changes = moved(self.at.rates[:, : self.searched], self.effects, names).items()
        called = {name: name if name.startswith("law.") else f"drive.{name}" for name in names}
        return {called[name]: 0.01 * self._of_unknowns(change) for name, change in changes}

    @property
    def _unit(self) -> float:
        """Variance of the innovations; less where each stands for many."""
        return self.at.unit(self.at.innovations) * self.share

    def _of_unknowns(self, steps: Floats) -> Floats:
        """What is known of the varied numbers, in their steps, of all unknowns (k,); 0 of those
        that are not varied.
        """
        varied = np.flatnonzero(self.step)
        whole = np.zeros(self.unknown)
        some = varied < len(self.keep)
        whole[np.array(self.keep)[varied[some]]] = (steps * self.step[varied])[some]
        return whole

    def added(self, tolerances: Tolerances, rounding: Floats | None) -> Floats:
        """What is added to the covariance (k, k) of the unknowns, by tolerances and by what was
        named.

        Of what was named nothing is known beforehand; what the unknowns change by, if it is fitted,
        is a bias.
        """
        at = self.at
        known = len(self.keep)
        varied = np.flatnonzero(self.step)
        residual = at.innovations[: self.searched] - (
            0.0 if rounding is None else rounding[: self.searched]
        )
        effects = dict(self.effects)
        named = dict[str, float]()
        for i, name in ((i, at.model.unknown[place]) for i, place in enumerate(varied)):
            if name in at.model.extra:
                effects[name], named[name] = at.rates[i] / self.step[varied[i]], np.inf
        own = [i for i, place in enumerate(varied) if at.model.unknown[place] not in at.model.extra]
        prior = {**priors(tolerances, list(effects), self.efforts), **named}
        change, more, _ = consider(at.rates[own], residual, prior, effects, self._unit)
        bias = at.values[:known] - self.first.values[:known]
        total = np.zeros((known, known))
        some = np.array([i for i, j in enumerate(own) if varied[j] < known], dtype=int)
        places = varied[own][some]
        bias[places] += change[some] * self.step[places]
        total[np.ix_(places, places)] = more[np.ix_(some, some)] * np.outer(
            self.step[places], self.step[places]
        )
        whole = np.zeros((self.unknown, self.unknown))
        whole[np.ix_(self.keep, self.keep)] = total + np.outer(bias, bias)
        return whole

    def friction(self, tolerances: Tolerances) -> dict[str, float]:
        """Standard deviations of friction that is not unknown, if it is fitted with all else, by
        its name.
        """
        own = self.at.rates
        residual = self.at.innovations[: self.searched]
        names = [name for name in self.effects if name.partition("[")[0] in _BY_KIND]
        prior = priors(tolerances, list(self.effects), self.efforts) | dict.fromkeys(names, np.inf)
        std = consider(own, residual, prior, self.effects, self._unit)[2]
        return {name: std[name] for name in names if std.get(name, 0.0) > 0}

    def grouped(
        self, names: Sequence[str], noise: Floats, doubt: Floats
    ) -> tuple[Floats, BetweenRuns | None]:
        """Standard deviations (k,) of the unknowns of these names, from how they differ between
        segments, and records.

        `noise`, `doubt` (k, k): covariance by noise, and what is added to it whatever is logged. Of
        two records or more they count all that, and how these differ is told. What else is fitted,
        of all records, is taken out of rates.
        """
        at = self.at
        rates = self.at.rates[:, : self.searched]
        residual = self.at.innovations[: self.searched]
        lengths = [rows.stop - rows.start for rows in at.model.runs() if rows.stop <= self.searched]
        logs = len(lengths)
        before = at.model.prior.count
        segments = in_groups(lengths, before, SEGMENTS * logs)
        if logs == 1:
            return self._of_unknowns(group_std(rates.T, residual, segments)), None
        varied = np.flatnonzero(self.step)
        own = varied < len(self.keep)
        made = directions(rates)
        places = np.array(self.keep)[varied[own]]
        size = self.step[varied[own], None]
        others = directions(rates[~own])
        move = along(made, rates, residual)
        bare = (
            np.array([rate - along(others, rates[~own], rate) @ rates[~own] for rate in rates[own]])
            / size
        )
        found, covariance = between_runs(
            [names[i] for i in places],
            at.values[varied[own]] - move[own] * size[:, 0],
            noise[np.ix_(places, places)],
            -bare.T,
            residual - move @ rates,
            in_groups(lengths, before, 1),
            segments,
            np.diag(doubt)[places],
        )
        whole = np.zeros(self.unknown)
        whole[places] = np.sqrt(np.diag(covariance) + np.diag(doubt)[places])
        return whole, found.among(places, self.unknown)


def priors(tolerances: Tolerances, names: Iterable[str], efforts: Floats) -> dict[str, float]:
    """Standard deviation of each of these numbers of `Extended` before the log; none of what has no
    tolerance.

    `efforts` (2, n): torque [N m] and speed [rad/s] of each motor (rms).
    """
    torque, speed = efforts
    scales = {"offset": torque, "coulomb": torque, "viscous": torque / speed}
    found = {}
    for name in names:
        kind, _, joint = name.rstrip("]").partition("[")
        share = getattr(tolerances, _BY_KIND.get(kind, kind), 0.0)
        size = share * (scales[kind][int(joint)] if kind in scales else 1.0)
        if size > 0:
            found[name] = float(size)
    return found


def consider(
    rates: Floats,
    residual: Floats,
    prior: Mapping[str, float],
    effects: Mapping[str, Floats],
    unit: float,
) -> tuple[Floats, Floats, dict[str, float]]:
    """What comes of fitting what is in `prior` too.

    Returns the change (v,) of the unknowns, what is added to their covariance (v, v), and the
    standard deviations of what is in `prior`.

    `rates` (v, M): change of the innovations with each unknown. `residual` (M',): innovations of
    the first M' rows, those that were fitted. `prior`: standard deviations, by name; inf of what
    has none. `effects`: change of the innovations (M,) with each. `unit`: variance of the
    innovations.
    """
    own = rates[:, : len(residual)].T
    count = len(rates)
    names = [name for name in prior if np.isfinite(effects[name]).all()]
    sizes = np.array([prior[name] for name in names])
    scale = np.where(np.isfinite(sizes), sizes, 1.0)
    information = np.zeros((count + len(names),) * 2)
    slope = np.zeros(count + len(names))
    for start in range(0, len(residual), _AT_ONCE):
        some = slice(start, min(start + _AT_ONCE, len(residual)))
        rows = np.column_stack(
            [own[some], *(effects[name][some] * by for name, by in zip(names, scale, strict=True))]
        )
        information += products(rows) / unit
        slope += (rows * residual[some, None]).sum(axis=0) / unit
    places = np.arange(count, len(information))
    information[places, places] += np.isfinite(sizes)
    inverse = _inverse(information)
    alone = _inverse(information[:count, :count])
    std = dict(
        zip(
            names,
            (scale * np.sqrt(np.maximum(np.diag(inverse)[count:], 0.0))).tolist(),
            strict=True,
        )
    )
    return alone @ slope[:count] - inverse[:count] @ slope, inverse[:count, :count] - alone, std


def _inverse(matrix: Floats) -> Floats:
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    return np.asarray(
        np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    )
