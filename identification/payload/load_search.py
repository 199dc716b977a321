"""Prediction error of a known arm with an unknown load, and unknown friction beside it.

What a search of a load has in common with that of f (`identification.search`): the records' laws,
run along their logs, whose memory may be unknown; the start from the torque equation; Gauss-Newton
on the innovations. Here f is that of the known arm and a function of a few numbers of the load.
"""

import dataclasses
from typing import Any, Self

import numpy as np

from identification.equation_error.least_squares import NotIdentifiableError
from identification.equation_error.naming import each_named
from identification.equation_error.pulse_fit import pass_band, system_of
from identification.equation_error.regressor import LINEAR
from identification.equation_error.torque_fit import weighted
from identification.payload.loaded_prediction import AnyLoad, WithLoad, spoken
from identification.search.outcome import Outcome
from identification.search.polish import fit_of
from identification.search.problem import Problem
from plant import Body, Dynamics
from plant.mechanics.base_parameters import independent_columns
from plant.parts.fields import Floats

# share of its own below which what a direction does to f is a combination of what others do
_SAME = 1e-7


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class UnknownLoad:
    """Numbers of a load, and the increments of f that they are.

    `matrix` (p, 10): increments of f by the load's standard parameters. `position` (3,): centre of
    mass where it is known, or 0 where it is unknown or does not show [m]. `inertia` (6,): about the
    centre of mass [kg m^2]. `shown`: axes of the link's frame along which the place of the centre
    is unknown.
    """

    matrix: Floats
    position: Floats
    inertia: Floats
    shown: tuple[int, ...]

    @classmethod
    def of(
        cls, dynamics: Dynamics, link: int | str, position: Floats | None, inertia: Floats
    ) -> Self:
        """Of a load on a link, whose place may be unknown."""
        matrix = dynamics.load_matrix(link)
        if position is not None:
            return cls(matrix=matrix, position=position, inertia=inertia, shown=())
        shown = tuple(axis for axis in range(3) if matrix[:, 1 + axis].any())
        moments = matrix[:, [*(1 + axis for axis in shown), 0]]
        if not moments.any() or len(
            independent_columns(moments, range(len(shown) + 1), _SAME)[0]
        ) <= len(shown):
            raise ValueError(
                "mass and centre of the load must be separately identifiable; on this arm or link"
                " they are not. Give position."
            )
        return cls(matrix=matrix, position=np.zeros(3), inertia=inertia, shown=shown)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown numbers."""
        return ("mass", *(f"com[{axis}]" for axis in self.shown))

    def com(self, values: Floats) -> Floats:
        """Centre of mass (3,) [m]; 0 along axes that do not show."""
        com = self.position.copy()
        com[list(self.shown)] = values[1 : len(self.names)]
        return com

    def increments(self, values: Floats) -> Floats:
        """Of f (p,), by mass and centre (k,)."""
        unit = Body(mass=1.0, com=self.com(values)).standard_parameters
        own = np.concatenate([np.zeros(4), self.inertia]) if values[0] else np.zeros(10)
        return np.asarray(self.matrix @ (values[0] * unit + own))


_STEPS = (0.01, 0.002)  # of the central differences: of the mass [kg], and of its place [m]

_SMALL = 0.05  # the same of friction, in standard deviations of the torque equation's fit

_RELATIVE = 1e-3  # the same of f where all of it is free, relative, and of a load's increments

_LIGHT = 0.05  # mass [kg] below which its place is not looked for in the torque equation

_FAR = 0.9  # share by which friction may be off what the rig states for the search to start there

_REACH = 2.0  # how far off its frame a load is [m]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FreeArm:
    """What logs say of an arm with any f, beside the known arm with a load.

    `square`, `freedom`: chi-square, and degrees of freedom, by which any other f follows the logs
    better than every load: chance, or what arm, gears and drives have and the model lacks. NaN and
    0 where the logs do not tell all of f. `shares` (l,): what is to be added to the numbers of the
    load, as the known arm is uncertain; 0 of an exact one. `covariance` (l, l) or None: of the
    load, with that of the known arm.
    """

    square: float = np.nan
    freedom: int = 0
    shares: Floats | float = 0.0
    covariance: Floats | None = None


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LoadSearch:
    """What is known, and what is not.

    `f` (p,): of the arm without the load. `load`: or anything with its ``names`` and
    ``increments``. `mass` (2,): between which it is [kg]. `friction` (d,): as the rig states it, in
    the order of the problem's unknowns after f. `deviation` (d,): standard deviations of that; inf
    of what is unknown, 0 of what is known. `covariance` (p, p): of `f`; 0 of an exact arm.
    """

    f: Floats
    load: Any
    mass: tuple[float, float]
    friction: Floats
    deviation: Floats
    covariance: Floats

    def fitted(self, problem: Problem) -> Outcome:
        """The prediction error's fit of mass, centre and friction, as a method of identification.

        Friction that is not identifiable, such as that of a joint at rest, stays as the rig states
        it.
        """
        friction = problem.unknown[len(self.f) :]
        try:
            return self._fitted(problem)
        except NotIdentifiableError as error:
            shown = np.array([name != error.name for name in friction])
            if not (self.deviation[~shown] > 0).any():
                raise
        return dataclasses.replace(self, deviation=np.where(shown, self.deviation, 0.0)).fitted(
            problem
        )

    def _fitted(self, problem: Problem) -> Outcome:
        start, std = self.start(problem)
        view = WithLoad(
            self, problem.prediction(memories=problem.memories), problem.unknown[len(self.f) :]
        )
        k = len(start)
        loads = len(self.load.names)
        steps = np.concatenate([[_STEPS[0]], [_STEPS[1]] * (loads - 1), _SMALL * std[loads:]])
        solution = view.followed(start, steps, self.bounds(problem), bool(problem.memories))
        resumptions = (
            view.prediction.resumptions(view.whole(solution.values)) if problem.memories else ()
        )
        unknown = (*self.load.names, *problem.unknown[len(self.f) :])
        fit = fit_of(solution, unknown, solution.values[:k], resumptions=resumptions)
        stages = {"prediction error": solution.values, "steps": steps[loads:]}
        return Outcome(fit=fit, evaluations=view.prediction.evaluations, stages=stages)

    def free(self, problem: Problem, outcome: Outcome) -> FreeArm:
        """All of f, fitted beside friction: its difference from the known f, in units of the
        covariances of both.

        Generalised least squares: the load takes of the difference what it can, the rest is the
        contradiction.
        """
        fit = outcome.fit
        loads = len(self.load.names)
        p = len(self.f)
        found = fit.values[:loads]
        more = self.load.increments(fit.values)
        free = dataclasses.replace(self, load=AnyLoad(names=problem.dynamics.names))
        view = WithLoad(free, problem.prediction(memories=problem.memories), problem.unknown[p:])
        size = np.maximum(np.abs(self.f + more), 0.05 * np.abs(self.f).max())
        steps = np.append(_RELATIVE * size, outcome.stages["steps"])
        start = np.concatenate([more, outcome.stages["prediction error"][loads:]])
        limits = np.vstack([np.tile([-np.inf, np.inf], (p, 1)), self.bounds(problem)[loads:]])
        try:
            solution = view.followed(start, steps, limits, False)
            weight = np.linalg.inv(solution.covariance[:p, :p] + self.covariance)
        except (ValueError, np.linalg.LinAlgError):
            return FreeArm()
        change = _RELATIVE * np.eye(loads)
        slopes = np.column_stack(
            [
                self.load.increments(found + step) - self.load.increments(found - step)
                for step in change
            ]
        ) / (2 * _RELATIVE)
        left = solution.values[:p] - more
        covariance = np.linalg.inv(slopes.T @ weight @ slopes)
        shares = covariance @ (slopes.T @ weight @ left)
        left = left - slopes @ shares
        told: dict[str, Any] = (
            {"shares": shares, "covariance": covariance} if self.covariance.any() else {}
        )
        return FreeArm(square=float(left @ weight @ left), freedom=p - loads, **told)

    def bounds(self, problem: Problem) -> Floats:
        """Of mass, centre and friction (k, 2)."""
        return np.vstack(
            [self.mass, *[(-_REACH, _REACH)] * len(self.load.shown), problem.bounds[len(self.f) :]]
        )

    def start(self, problem: Problem) -> tuple[Floats, Floats]:
        """Values (k,) from the torque equation of the counts, and standard deviations."""
        systems = []
        p = len(self.f)
        linear = [
            name
            for name in problem.unknown
            if name in problem.dynamics.names or name.startswith(LINEAR)
        ]
        columns, offset = self._columns()
        free = self.deviation > 0
        for record, about in each_named(problem.records):
            with about:
                system = system_of(problem.dynamics, record, pass_band(record), linear)
            of_f = system.regressor[:, :, :p]
            of_friction = system.regressor[:, :, p:]
            torque = (
                system.torque
                - of_f @ (self.f + offset)
                - of_friction[:, :, ~free] @ self.friction[~free]
            )
            regressor = np.concatenate([of_f @ columns, of_friction[:, :, free]], axis=2)
            systems.append(dataclasses.replace(system, regressor=regressor, torque=torque))
        loads = len(self.load.names)
        friction = np.flatnonzero(free)
        names = (*map(spoken, self.load.names), *(linear[p + i] for i in friction))
        fit = weighted(problem.dynamics, names, systems)
        values = np.append(np.zeros(loads), self.friction)
        std = np.zeros(loads + len(free))
        places = [*range(loads), *(loads + friction)]
        values[places], std[places] = fit.values, fit.std
        heavy = abs(values[0]) > _LIGHT
        values[1:loads] = values[1:loads] / values[0] if heavy else 0.1
        near = np.abs(values[loads:] - self.friction) < np.minimum(
            self.deviation, _FAR * np.abs(self.friction)
        )
        near |= (self.friction == 0) & (np.abs(values[loads:]) < self.deviation)
        values[loads:] = np.where(near, values[loads:], self.friction)
        return np.clip(values, *self.bounds(problem).T), std

    def _columns(self) -> tuple[Floats, Floats]:
        """Increments of f (p, l) by mass and first moments, their inertia left aside; and by the
        stated inertia.
        """
        matrix = self.load.matrix
        load = self.load
        offset = matrix[:, 4:] @ load.inertia
        if not load.shown:
            return (load.increments(np.array([1.0])) - offset)[:, None], offset
        return matrix[:, [0, *(1 + axis for axis in load.shown)]], offset
