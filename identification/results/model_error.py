"""Covariance of identified values: noise, and the bias by numbers that the rig states wrongly.

Numbers that are taken as stated (gears, friction, offsets, timing) are right within tolerances
only. They are unknowns, too, whose prior standard deviations are these tolerances; the log
determines some of them better. The change of the unknowns if all were fitted together is a bias:
its square is added to the covariance that they would have then.

Source: S. F. Schmidt, Application of state-space methods to navigation problems, Advances in
Control Systems 3, 1966 (consider covariance); G. J. Bierman, Factorization methods for discrete
sequential estimation, 1977, ch. 8.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from identification.equation_error import (
    SEGMENTS,
    BetweenRuns,
    along,
    between_runs,
    directions,
    group_std,
    in_groups,
)
from identification.replay import Optimum, kind_of
from identification.results.assumed import moved
from identification.results.with_arm import NUMBERS
from identification.search import Tolerances
from plant.parts import Floats, frozen, products

# Rows of the innovations that are multiplied at once, which bounds the memory of a copy of them.
_AT_ONCE = 1 << 15

_KINDS = {number.name: number for number in NUMBERS}


@frozen
class Doubt:
    """The optimum of a model, and the effects of numbers that may be wrong.

    `at`, `initial`: the optimum with the reported causes, and without. `step` (m,): of its values;
    zero of one that is not varied. `keep`: place among the unknowns of each of the leading values.
    `unknown`: number of the unknowns. `searched`: number of innovations of the records that were
    searched, which come first. `effects`: change of the innovations (M,) with each number that the
    rig leaves out, or may have wrong. `efforts` (2, n): torque [N m] and speed [rad/s] of each
    motor (rms). `share`: share of the samples of a long log that these parts of it are.
    """

    at: Optimum
    initial: Optimum
    step: Floats
    keep: Sequence[int]
    unknown: int
    searched: int
    effects: Mapping[str, Floats]
    efforts: Floats
    share: float = 1.0

    def assumed(self) -> dict[str, Floats]:
        """Change (k,) of the unknowns if a gear, motor gain or gain of the law is 1 % larger."""
        names = [
            name
            for name in self.effects
            if kind_of(name) in _KINDS and _KINDS[kind_of(name)].relative
        ]
        # Of the records that were searched, as the fit.
        changes = moved(self.at.rates[:, : self.searched], self.effects, names)
        return {
            name if name.startswith("law.") else f"drive.{name}": 0.01 * self._of_unknowns(change)
            for name, change in changes.items()
        }

    @property
    def _unit(self):
        """Variance of the innovations; less where each stands for many."""
        return self.at.unit(self.at.innovations) * self.share

    @property
    def _residual(self):
        """Innovations of the records that were searched."""
        return self.at.innovations[: self.searched]

    def _of_unknowns(self, steps):
        """Changes of the varied values, in their steps, as changes of all unknowns (k,)."""
        varied = np.flatnonzero(self.step)
        is_unknown = varied < len(self.keep)  # observer gains and reported causes come after
        places = np.array(self.keep)[varied[is_unknown]]
        result = np.zeros(self.unknown)
        result[places] = (steps * self.step[varied])[is_unknown]
        return result

    def added(self, tolerances: Tolerances) -> Floats:
        """Covariance (k, k) by tolerances and reported causes, to be added to that of noise.

        The size of a reported cause is unknown before the log; the change of the unknowns when it
        is fitted is a bias.
        """
        at = self.at
        count = len(self.keep)
        varied = np.flatnonzero(self.step)

        # 1. A reported cause is an effect without a prior, no longer one of the unknowns.
        effects = dict(self.effects)
        unlimited = {}
        fitted = []
        for i, value in enumerate(varied):
            name = at.model.unknown[value]
            if name in at.model.extra:
                effects[name] = at.rates[i] / self.step[value]
                unlimited[name] = np.inf
            else:
                fitted.append(i)
        prior = {**priors(tolerances, list(effects), self.efforts), **unlimited}
        change, covariance, _ = consider(
            at.rates[fitted], self._residual, prior, effects, self._unit
        )

        # 2. From steps of the varied values to the unknowns among them.
        rows = np.array([i for i, j in enumerate(fitted) if varied[j] < count], dtype=int)
        places = varied[fitted][rows]
        steps = self.step[places]
        bias = at.values[:count] - self.initial.values[:count]
        bias[places] += change[rows] * steps
        total = np.zeros((count, count))
        total[np.ix_(places, places)] = covariance[np.ix_(rows, rows)] * np.outer(steps, steps)
        result = np.zeros((self.unknown, self.unknown))
        result[np.ix_(self.keep, self.keep)] = total + np.outer(bias, bias)
        return result

    def friction(self, tolerances: Tolerances, unknown: Collection[str]) -> dict[str, float]:
        """Standard deviations of friction that is not `unknown`, if it were fitted, too."""
        names = [
            name
            for name in self.effects
            if kind_of(name) in _KINDS
            and _KINDS[kind_of(name)].removable
            # What is unknown has its own deviation; its effect beside itself is a rounding error.
            and f"drive.{name}" not in unknown
        ]
        # Friction itself without a prior, as if it were unknown.
        prior = priors(tolerances, list(self.effects), self.efforts) | dict.fromkeys(names, np.inf)
        _, _, std = consider(self.at.rates, self._residual, prior, self.effects, self._unit)
        return {name: std[name] for name in names if std.get(name, 0.0) > 0}

    def grouped(
        self, names: Sequence[str], noise: Floats, doubt: Floats
    ) -> tuple[Floats, BetweenRuns | None]:
        """Standard deviations (k,) of the unknowns from their scatter between segments and records.

        `noise`, `doubt` (k, k): covariance by noise, and the covariance that is added to it for any
        log. With two records or more the result includes both, and the scatter between records is
        returned as well. Values that are no unknowns (observer gains, reported causes) are the same
        in all records: they are projected out of the rates.
        """
        at = self.at
        rates = at.rates[:, : self.searched]
        residual = self._residual
        lengths = [rows.stop - rows.start for rows in at.model.runs() if rows.stop <= self.searched]
        prior_rows = at.model.prior.count
        # The scatter between segments shows errors that are correlated in time.
        segments = in_groups(lengths, prior_rows, SEGMENTS * len(lengths))
        if len(lengths) == 1:
            return self._of_unknowns(group_std(rates.T, residual, segments)), None

        # 1. One more step of Gauss-Newton, so that values and residual are those of an optimum.
        varied = np.flatnonzero(self.step)
        is_unknown = varied < len(self.keep)
        places = np.array(self.keep)[varied[is_unknown]]
        size = self.step[varied[is_unknown], None]
        move = along(directions(rates), rates, residual)
        values = at.values[varied[is_unknown]] - move[is_unknown] * size[:, 0]

        # 2. Sensitivities per unit of the unknowns, beside the common values.
        common = rates[~is_unknown]
        basis = directions(common)
        projected = [rate - along(basis, common, rate) @ common for rate in rates[is_unknown]]
        sensitivities = np.array(projected) / size

        # 3. The scatter between records, and within them.
        scatter, covariance = between_runs(
            [names[i] for i in places],
            values,
            noise[np.ix_(places, places)],
            -sensitivities.T,
            residual - move @ rates,
            in_groups(lengths, prior_rows, 1),
            segments,
            np.diag(doubt)[places],
        )
        result = np.zeros(self.unknown)
        result[places] = np.sqrt(np.diag(covariance) + np.diag(doubt)[places])
        return result, scatter.among(places, self.unknown)


def priors(tolerances: Tolerances, names: Iterable[str], efforts: Floats) -> dict[str, float]:
    """Standard deviation of each of these numbers of `Extended` before the log, by name.

    Numbers without a tolerance are left out. `efforts` (2, n): torque [N m] and speed [rad/s] of
    each motor (rms).
    """
    result = {}
    for name in names:
        number = _KINDS.get(kind_of(name))
        # Torques along the log, and lengths, have no tolerance.
        share = getattr(tolerances, number.tolerance, 0.0) if number else 0.0
        if number and share > 0:
            result[name] = number.size(share, name, efforts)
    return result


def consider(
    rates: Floats,
    residual: Floats,
    prior: Mapping[str, float],
    effects: Mapping[str, Floats],
    unit: float,
) -> tuple[Floats, Floats, dict[str, float]]:
    """Fit the unknowns together with the numbers of a prior.

    Parameters
    ----------
    rates : (v, M) numpy.ndarray
        Change of the innovations with each unknown.
    residual : (M',) numpy.ndarray
        Innovations of the first M' rows, those that were fitted.
    prior : mapping of str to float
        Standard deviations, by name; inf of a number without one.
    effects : mapping of str to (M,) numpy.ndarray
        Change of the innovations with each number.
    unit : float
        Variance of the innovations.

    Returns
    -------
    change : (v,) numpy.ndarray
        Of the unknowns.
    covariance : (v, v) numpy.ndarray
        Its increase.
    std : dict
        Standard deviations of the numbers of the prior.
    """
    columns = rates[:, : len(residual)].T
    count = len(rates)
    # An effect that diverges cannot be fitted.
    names = [name for name in prior if np.isfinite(effects[name]).all()]
    sizes = np.array([prior[name] for name in names])
    # In units of its prior, the information of a prior is 1; a number without one counts as it is.
    scale = np.where(np.isfinite(sizes), sizes, 1.0)
    information = np.zeros((count + len(names),) * 2)
    slope = np.zeros(count + len(names))
    for start in range(0, len(residual), _AT_ONCE):
        block = slice(start, min(start + _AT_ONCE, len(residual)))
        scaled = [effects[name][block] * size for name, size in zip(names, scale, strict=True)]
        rows = np.column_stack([columns[block], *scaled])
        information += products(rows) / unit
        slope += (rows * residual[block, None]).sum(axis=0) / unit
    places = np.arange(count, len(information))
    # A prior counts like one more reading of its number.
    information[places, places] += np.isfinite(sizes)
    # With all numbers, and with the unknowns alone: the differences are those of the prior.
    inverse = _inverse(information)
    alone = _inverse(information[:count, :count])
    variance = np.maximum(np.diag(inverse)[count:], 0.0)  # rounding can make it negative
    std = dict(zip(names, (scale * np.sqrt(variance)).tolist(), strict=True))
    change = alone @ slope[:count] - inverse[:count] @ slope
    return change, inverse[:count, :count] - alone, std


def _inverse(matrix):
    """Pseudo-inverse of a matrix that is scaled to a diagonal of ones."""
    # A relative cut-off is fair only between numbers in comparable units.
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    return np.asarray(
        np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    )
