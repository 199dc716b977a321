"""Prediction error of a known arm with an unknown load, and unknown friction beside it.

What a search of a load has in common with that of f (`identification.search`): the records' laws, run along their logs,
whose memory may be unknown; the start from the torque equation; Gauss-Newton on the innovations. Here f is that of the
known arm and a function of a few numbers of the load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.least_squares import NotIdentifiableError
from identification.equation_error.naming import each_named
from identification.equation_error.pulse_fit import pass_band, system_of
from identification.equation_error.regressor import LINEAR
from identification.equation_error.torque_fit import weighted
from identification.payload.unknown_load import UnknownLoad
from identification.replay.gauss_newton import Solution, gauss_newton, variance_inflation
from identification.replay.prediction import Prediction
from identification.search.outcome import Fit, Outcome
from identification.search.polish import by_stages
from identification.search.problem import Problem

__all__ = ["LoadSearch"]

_STEPS = (0.01, 0.002)
"""Of the central differences: of the mass [kg], and of its place [m]."""

_SMALL = 0.05
"""The same of friction, in standard deviations of the torque equation's fit."""

_LIGHT = 0.05
"""Mass [kg] below which its place is not looked for in the torque equation."""

_FAR = 0.9
"""Share by which friction may be off what the rig states for the search to start there."""

_REACH, _ROUNDING, _WEIGHINGS = 2.0, 0.289, 2
"""How far off its frame a load is [m]; RMS of rounding [pulses]; how often records and joints are weighted anew."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LoadSearch:
    """What is known, and what is not.

    Attributes
    ----------
    f : (p,) numpy.ndarray
        Of the arm without the load.
    load : UnknownLoad
    mass : (2,) tuple of float
        Between which it is [kg].
    friction : (d,) numpy.ndarray
        As the rig states it, in the order of the problem's unknowns after f.
    deviation : (d,) numpy.ndarray
        Standard deviations of that; inf of what is unknown, 0 of what is known.
    """

    f: NDArray[np.float64]
    load: UnknownLoad
    mass: tuple[float, float]
    friction: NDArray[np.float64]
    deviation: NDArray[np.float64]

    def fitted(self, problem: Problem) -> Outcome:
        """The prediction error's fit of mass, centre and friction, as a method of identification.

        Friction that does not show, such as that of a joint at rest, stays as the rig states it.
        """
        friction = problem.unknown[len(self.f) :]
        try:
            return self._fitted(problem)
        except NotIdentifiableError as error:
            shown = np.array([name != error.name for name in friction])
            if not (self.deviation[~shown] > 0).any():
                raise
        return dataclasses.replace(self, deviation=np.where(shown, self.deviation, 0.0)).fitted(problem)

    def _fitted(self, problem: Problem) -> Outcome:
        start, std = self.start(problem)
        prediction = Prediction(problem.dynamics, problem.records, problem.unknown, memories=problem.memories,
                                **problem.options)  # fmt: skip
        view = _WithLoad(self, prediction, problem.unknown[len(self.f) :])
        k, loads = len(start), len(self.load.names)
        steps = np.concatenate([[_STEPS[0]], [_STEPS[1]] * (loads - 1), _SMALL * std[loads:]])
        steps = np.append(np.where(np.append(np.full(loads, np.inf), self.deviation) > 0, steps, 0.0),
                          prediction.nuisance_steps)  # fmt: skip
        bounds = np.vstack([self.bounds(problem), prediction.nuisance_bounds])
        first = np.append(start, prediction.nuisances)
        if problem.memories:
            solution = by_stages(view, first, steps, bounds, slice(k, k + 2 * problem.dynamics.n))
        else:
            solution = gauss_newton(view, first, steps, bounds)
        for _ in range(_WEIGHINGS):
            if not (view.reweigh(solution.values) | view.trust(solution)):
                break
            solution = gauss_newton(view, solution.values, steps, bounds)
        fit = Fit(
            unknown=(*self.load.names, *problem.unknown[len(self.f) :]),
            values=solution.values[:k],
            candidates=solution.values[None, :k],
            covariance=solution.covariance[:k, :k],
            rms_innovation=solution.rms_innovation,
            resumptions=prediction.resumptions(view.whole(solution.values)) if problem.memories else (),
        )
        return Outcome(fit=fit, evaluations=prediction.evaluations)

    def bounds(self, problem: Problem) -> NDArray[np.float64]:
        """Of mass, centre and friction (k, 2)."""
        return np.vstack([self.mass, *[(-_REACH, _REACH)] * len(self.load.shown), problem.bounds[len(self.f) :]])

    def start(self, problem: Problem) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (k,) from the torque equation of the counts, and standard deviations."""
        systems, p = [], len(self.f)
        linear = [name for name in problem.unknown if name in problem.dynamics.names or name.startswith(LINEAR)]
        columns, offset = self._columns()
        free = self.deviation > 0
        for record, about in each_named(problem.records):
            with about:
                system = system_of(problem.dynamics, record, pass_band(record), linear)
            of_f, of_friction = system.regressor[:, :, :p], system.regressor[:, :, p:]
            torque = system.torque - of_f @ (self.f + offset) - of_friction[:, :, ~free] @ self.friction[~free]
            regressor = np.concatenate([of_f @ columns, of_friction[:, :, free]], axis=2)
            systems.append(dataclasses.replace(system, regressor=regressor, torque=torque))
        loads, friction = len(self.load.names), np.flatnonzero(free)
        names = (*map(_spoken, self.load.names), *(linear[p + i] for i in friction))
        fit = weighted(problem.dynamics, names, systems)
        values, std = np.append(np.zeros(loads), self.friction), np.zeros(loads + len(free))
        places = [*range(loads), *(loads + friction)]
        values[places], std[places] = fit.values, fit.std
        heavy = abs(values[0]) > _LIGHT
        values[1:loads] = values[1:loads] / values[0] if heavy else 0.1
        near = np.abs(values[loads:] - self.friction) < np.minimum(self.deviation, _FAR * np.abs(self.friction))
        values[loads:] = np.where(near | (self.friction == 0), values[loads:], self.friction)
        return np.clip(values, *self.bounds(problem).T), std

    def _columns(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Increments of f (p, l) by mass and first moments, their inertia left aside; and by the stated inertia."""
        matrix, load = self.load.matrix, self.load
        offset = matrix[:, 4:] @ load.inertia
        if not load.shown:
            return (load.increments(np.array([1.0])) - offset)[:, None], offset
        return matrix[:, [0, *(1 + axis for axis in load.shown)]], offset


def _spoken(name: str) -> str:
    """What messages call a number of the load."""
    return f"{name} of the load"


class _WithLoad:
    """A prediction whose unknowns are those of a load, friction, and its nuisances."""

    def __init__(self, search: LoadSearch, prediction: Prediction, friction: tuple[str, ...]) -> None:
        self.search, self.prediction, p = search, prediction, len(search.f)
        self.unknown = (*map(_spoken, search.load.names), *friction, *prediction.unknown[p + len(friction) :])
        self._first = len(search.load.names)
        self._stated = np.flatnonzero(np.isfinite(search.deviation) & (search.deviation > 0))
        self._trust = _ROUNDING
        self.weights = np.append(prediction.weights, np.zeros(len(self._stated)))

    @property
    def scales(self) -> NDArray[np.float64]:
        """What each innovation is divided by."""
        return np.append(self.prediction.scales, np.ones(len(self._stated)))

    def whole(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the prediction takes, of values of this."""
        return np.append(self.search.f + self.search.load.increments(values), values[self._first :])

    def _with_stated(self, innovations: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        friction = values[self._first :][self._stated]
        off = (friction - self.search.friction[self._stated]) / self.search.deviation[self._stated]
        return np.append(innovations, self._trust * off)

    def innovations(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._with_stated(self.prediction.innovations(self.whole(values)), values)

    def all_innovations(self, many: Iterable[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        many = list(many)
        found = self.prediction.all_innovations([self.whole(values) for values in many])
        return [self._with_stated(each, values) for each, values in zip(found, many, strict=True)]

    def lost(self, values: NDArray[np.float64]) -> str:
        return self.prediction.lost(self.whole(values))

    def reweigh(self, values: NDArray[np.float64]) -> bool:
        return self.prediction.reweigh(self.whole(values))

    def trust(self, solution: Solution) -> bool:
        """Weigh stated friction by what an innovation tells in this log; whether that changes much."""
        if not len(self._stated):
            return False
        before, residual = self._trust, solution.residual
        self._trust = float(solution.rms_innovation * np.sqrt(variance_inflation(residual)))
        return abs(self._trust / before - 1) > 0.05
