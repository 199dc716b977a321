"""Prediction-error fit of a load on a known arm, with unknown friction beside it.

Like the fit of f (`identification.search`), it runs the laws along their logs from a state that may
be unknown, starts from the torque equation, and applies Gauss-Newton to the innovations. Here f is
that of the known arm plus increments, which are functions of a few numbers of the load.
"""

from dataclasses import replace
from typing import Any, Self

import numpy as np

from identification.equation_error import (
    IDENTIFIABLE,
    LINEAR,
    ROUNDING,
    NotIdentifiableError,
    each_named,
    pass_band,
    system_of,
    weighted,
)
from identification.replay import (
    Prediction,
    Reparametrised,
    Solution,
    WithPrior,
    reweighed,
    variance_inflation,
)
from identification.search import Outcome, Problem, by_stages, fit_of
from plant import Body, Dynamics
from plant.checkup import on_lines
from plant.mechanics import independent_columns
from plant.parts import Floats, frozen, frozen_settings

# Relative change of the noise above which the priors of friction are weighed anew, and the fit is
# repeated. Chosen by hand.
_CHANGED = 0.05


@frozen
class AnyLoad:
    """Free increments of f, in place of those of a load."""

    names: tuple[str, ...]

    def increments(self, values: Floats) -> Floats:
        """Increments (p,) of f: the leading values."""
        return values[: len(self.names)]


def spoken(name: str) -> str:
    """Name of a number of the load in messages."""
    return f"{name} of the load"


class WithLoad(WithPrior):
    """Residual whose unknowns are numbers of a load, friction, and the nuisances of a prediction.

    `search`: the `LoadSearch` with the known arm, its load and the priors of friction, whose rows
    come behind the innovations. `friction`: names of the friction, in the order of the search.
    """

    def __init__(self, search: Any, prediction: Prediction, friction: tuple[str, ...]) -> None:
        self.search = search
        self.prediction = prediction
        self._loads = len(search.load.names)
        # The prediction orders its numbers: f, friction, nuisances.
        nuisances = prediction.unknown[len(search.f) + len(friction) :]
        unknown = (*map(spoken, search.load.names), *friction, *nuisances)
        self._gains = sum("correction." in name for name in unknown)
        # Friction with an infinite deviation has no prior; friction with a deviation of 0 is fixed.
        self._priors = np.flatnonzero(np.isfinite(search.deviation) & (search.deviation > 0))
        # The fit sees few numbers of a load; the prediction goes on to see all of f.
        residual = Reparametrised(prediction, unknown, self.whole)
        # Rounding is the noise until a fit shows more.
        super().__init__(residual, self._deviations, len(self._priors), ROUNDING)

    def whole(self, values: Floats) -> Floats:
        """Values of the prediction: f of the arm with its load, friction and nuisances."""
        return np.append(self.search.f + self.search.load.increments(values), values[self._loads :])

    def _deviations(self, values):
        """Differences of the friction from its priors, in their standard deviations."""
        friction = values[self._loads :][self._priors]
        deviation = self.search.deviation[self._priors]
        return (friction - self.search.friction[self._priors]) / deviation

    def followed(self, start: Floats, steps: Floats, bounds: Floats, by_stage: bool) -> Solution:
        """Least sum of squares from a start of the unknowns, with or without the nuisances."""
        # A start with nuisances comes from an earlier fit of the same logs.
        k = len(steps)
        prediction = self.prediction
        begin = np.append(start, prediction.nuisances) if len(start) == k else start
        steps = np.append(steps, prediction.nuisance_steps)
        bounds = np.vstack([bounds, prediction.nuisance_bounds])
        gains = slice(k, k + self._gains) if by_stage else None
        solution = by_stages(self, begin, steps, bounds, gains)

        def reweigh(solution):
            # Weigh the innovations first, then the priors. Every round needs both, so `or` must not
            # skip `trust`.
            changed = self.reweigh(solution.values)
            return self.trust(solution) or changed

        return reweighed(self, solution, steps, bounds, reweigh)

    def trust(self, solution: Solution) -> bool:
        """Weigh the priors by the noise of the innovations; whether that changed much.

        A prior weighs like one independent reading, so autocorrelation inflates the noise.
        """
        if not len(self._priors):
            return False
        # The noise of the innovations scales the priors: noisy logs give them more weight.
        previous = self.noise
        inflation = variance_inflation(solution.residual)
        self.noise = float(solution.rms_innovation * np.sqrt(inflation))
        return abs(self.noise / previous - 1) > _CHANGED


@frozen_settings
class LoadSearchSettings:
    """Steps and limits of the fit of a load.

    Chosen by hand; ``tests/benchmarks/find_load.py`` measures errors and coverage of the masses.

    Parameters
    ----------
    mass_step : float
        Step of the central differences of the mass [kg].
    centre_step : float
        The same of a coordinate of the centre of mass [m].
    friction_step : float
        The same of friction, in standard deviations of the torque equation's fit.
    relative_step : float
        Step of f where all of it is free, relative to its size. It is also the absolute step
        [kg, m] of the load's numbers for the slopes of its increments.
    least_size : float
        Size of an f, relative to the largest, below which its step does not shrink further.
    light : float
        Mass below which the torque equation gives no start for the centre [kg].
    centre_start : float
        Coordinates of the centre at the start of the fit of such a load [m].
    friction_error : float
        Largest difference from the stated friction, relative to it, at which the torque equation
        still gives the start.
    reach : float
        Largest coordinate of the centre of mass in the link's frame [m].
    """

    # Steps of central differences: small against the uncertainty of a load.
    mass_step: float = 0.01
    centre_step: float = 0.002
    friction_step: float = 0.05
    relative_step: float = 1e-3
    least_size: float = 0.05
    # Start and limits.
    light: float = 0.05
    centre_start: float = 0.1
    friction_error: float = 0.9
    reach: float = 2.0


SETTINGS = LoadSearchSettings()


@frozen
class UnknownLoad:
    """Unknown mass and centre of a load, and the increments of f that they cause.

    `matrix` (p, 10): increments of f by the load's standard parameters. `position` (3,): centre of
    mass [m] where it is known; 0 along axes where it is unknown or has no effect. `inertia` (6,):
    about the centre of mass [kg m^2]. `shown`: axes of the link's frame along which the centre is
    unknown and has an effect.
    """

    matrix: Floats
    position: Floats
    inertia: Floats
    shown: tuple[int, ...]

    @classmethod
    def of(
        cls, dynamics: Dynamics, link: int | str, position: Floats | None, inertia: Floats
    ) -> Self:
        """A load on a link, with a known or unknown centre of mass.

        Raises
        ------
        ValueError
            Mass and centre are not separately identifiable.
        """
        matrix = dynamics.load_matrix(link)
        if position is not None:
            return cls(matrix=matrix, position=position, inertia=inertia, shown=())
        # On a planar arm, for instance, the coordinate along the axes has no effect.
        shown = tuple(axis for axis in range(3) if matrix[:, 1 + axis].any())
        # Without its inertia a load changes f linearly, by its first moments and its mass.
        # Mass last: it is the number that dependent moments would hide.
        moments = matrix[:, [*(1 + axis for axis in shown), 0]]
        count = 0
        if moments.any():
            columns = range(len(shown) + 1)
            count = len(independent_columns(moments, columns, IDENTIFIABLE.smooth)[0])
        if count <= len(shown):
            raise ValueError(
                "mass and centre of the load must be separately identifiable; on this arm or link"
                " they are not. Give position."
            )
        return cls(matrix=matrix, position=np.zeros(3), inertia=inertia, shown=shown)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown numbers, mass first."""
        return ("mass", *(f"com[{axis}]" for axis in self.shown))

    def com(self, values: Floats) -> Floats:
        """Centre of mass (3,) [m]; 0 along axes where it has no effect."""
        com = self.position.copy()
        com[list(self.shown)] = values[1 : len(self.names)]
        return com

    def increments(self, values: Floats) -> Floats:
        """Increments (p,) of f, by mass and centre (k,)."""
        # Standard parameters of a point mass are linear in the mass.
        unit = Body(mass=1.0, com=self.com(values)).standard_parameters
        # The stated inertia does not scale with the mass, but a load of no mass is no load.
        inertia = np.concatenate([np.zeros(4), self.inertia]) if values[0] else np.zeros(10)
        return self.matrix @ (values[0] * unit + inertia)


@frozen
class FreeArm:
    """Comparison of the known arm and its load with an arm of free f.

    `square`, `freedom`: chi-square by which a free f follows the logs better than any load, and its
    degrees of freedom. `square` exceeds `freedom` where arm, gears or drives differ from the model;
    they are NaN and 0 where the logs do not determine all of f. `shares` (l,): correction of the
    load's numbers for the uncertainty of the known arm; 0 if that arm is exact. `covariance`
    (l, l): of the load's numbers, with the uncertainty of the known arm; None without `shares`.
    """

    square: float = np.nan
    freedom: int = 0
    shares: Floats | float = 0.0
    covariance: Floats | None = None


@frozen
class LoadSearch:
    """Known arm, unknown load, and prior of friction: the fit of a load.

    `f` (p,): of the arm without the load. `load`: an `UnknownLoad`; `free` replaces it by an
    `AnyLoad`, which serves the residual alone. `mass` (2,): range of the mass [kg]. `friction`
    (d,): values of the rig, in the order of the problem's unknowns after f. `deviation` (d,): their
    standard deviations; inf if unknown, 0 if exact. `covariance` (p, p): of `f`; 0 if f is exact.
    """

    f: Floats
    load: Any
    mass: tuple[float, float]
    friction: Floats
    deviation: Floats
    covariance: Floats

    def fitted(self, problem: Problem) -> Outcome:
        """Prediction-error fit of mass, centre and friction, as a method of identification.

        Friction that is not identifiable, such as that of a joint at rest, keeps the value of the
        rig.
        """
        friction = problem.unknown[len(self.f) :]
        try:
            return self._fitted(problem)
        except NotIdentifiableError as error:
            # The error carries the name of the number that the log does not show.
            shown = np.array([name != error.name for name in friction])
            # The number of the error is no unknown friction: the load is not identifiable.
            if not (self.deviation[~shown] > 0).any():
                raise
        # Fix that number, and fit again; another one may be the next.
        fixed = replace(self, deviation=np.where(shown, self.deviation, 0.0))
        return fixed.fitted(problem)

    def _fitted(self, problem):
        """One fit, in which every friction with a deviation must be identifiable."""
        start, std = self.start(problem)
        friction = problem.unknown[len(self.f) :]
        # Gauss-Newton sees the numbers of the load and friction in place of f.
        view = WithLoad(self, problem.prediction(memories=problem.memories), friction)
        loads = len(self.load.names)
        centre = [SETTINGS.centre_step] * (loads - 1)
        # Fixed friction has a deviation of zero, and so a step of zero.
        steps = np.concatenate([[SETTINGS.mass_step], centre, SETTINGS.friction_step * std[loads:]])
        solution = view.followed(start, steps, self.bounds(problem), bool(problem.memories))
        solved = view.whole(solution.values)
        resumptions = view.prediction.resumptions(solved) if problem.memories else ()
        unknown = (*self.load.names, *friction)
        fit = fit_of(solution, unknown, solution.values[: len(start)], resumptions=resumptions)
        stages = {"prediction error": solution.values, "steps": steps[loads:]}
        return Outcome(fit=fit, evaluations=view.prediction.evaluations, stages=stages)

    def free(self, problem: Problem, outcome: Outcome) -> FreeArm:
        """Fit all of f beside friction, and compare it with the known f and a load.

        Generalised least squares, weighted by the covariances of both f: the load explains as much
        of the difference as it can, and the rest is the contradiction.
        """
        # 1. Fit free increments of f, from those of the load.
        fit = outcome.fit
        loads = len(self.load.names)
        p = len(self.f)
        load = fit.values[:loads]
        increments = self.load.increments(fit.values)
        # The same residual, with all of f as the load.
        free = replace(self, load=AnyLoad(names=problem.dynamics.names))
        view = WithLoad(free, problem.prediction(memories=problem.memories), problem.unknown[p:])
        size = np.maximum(np.abs(self.f + increments), SETTINGS.least_size * np.abs(self.f).max())
        steps = np.append(SETTINGS.relative_step * size, outcome.stages["steps"])
        start = np.concatenate([increments, outcome.stages["prediction error"][loads:]])
        # Free increments need not be those of a body.
        limits = np.vstack([np.tile([-np.inf, np.inf], (p, 1)), self.bounds(problem)[loads:]])
        try:
            # Not by stages: the start is an optimum already, up to what a free f adds.
            solution = view.followed(start, steps, limits, False)
            weight = np.linalg.inv(solution.covariance[:p, :p] + self.covariance)
        except (ValueError, np.linalg.LinAlgError):  # the logs do not determine all of f
            return FreeArm()

        # 2. Split the difference into the part along the columns of the load, and the rest.
        slopes = np.column_stack(
            [
                self.load.increments(load + step) - self.load.increments(load - step)
                for step in SETTINGS.relative_step * np.eye(loads)
            ]
        ) / (2 * SETTINGS.relative_step)
        difference = solution.values[:p] - increments
        covariance: Any = np.linalg.inv(slopes.T @ weight @ slopes)
        shares = covariance @ (slopes.T @ weight @ difference)
        rest = difference - slopes @ shares
        comparison = FreeArm(square=float(rest @ weight @ rest), freedom=p - loads)
        if not self.covariance.any():
            # The numbers of the load's own fit hold for an exact arm.
            return comparison
        return replace(comparison, shares=shares, covariance=covariance)

    def bounds(self, problem: Problem) -> Floats:
        """Bounds (k, 2) of mass, centre and friction."""
        # A centre farther out than any arm reaches comes from a singular fit.
        centre = [(-SETTINGS.reach, SETTINGS.reach)] * len(self.load.shown)
        return np.vstack([self.mass, *centre, problem.bounds[len(self.f) :]])

    def start(self, problem: Problem) -> tuple[Floats, Floats]:
        """Values (k,) by the torque equation of the counts, and their standard deviations (k,)."""
        # 1. Subtract the known arm and the fixed friction from the torque of each record.
        systems = []
        p = len(self.f)
        # The torque equation only contains f and friction that enters it linearly.
        linear = [
            name
            for name in problem.unknown
            if name in problem.dynamics.names or name.startswith(LINEAR)
        ]
        of_load, offset = self._columns()
        # Friction without a deviation is exact and goes to the known torque.
        free = self.deviation > 0
        for logged, about in each_named(problem.records):
            # Filters would spread rows without weight, which may hold anything.
            record = on_lines(logged, logged.valid == 0)
            with about:
                system = system_of(problem.dynamics, record, pass_band(record), linear)
            of_f = system.regressor[:, :, :p]
            of_friction = system.regressor[:, :, p:]
            torque = (
                system.torque
                - of_f @ (self.f + offset)
                - of_friction[:, :, ~free] @ self.friction[~free]
            )
            regressor = np.concatenate([of_f @ of_load, of_friction[:, :, free]], axis=2)
            # Mass and first moments in place of f: few numbers are well determined, p are not.
            systems.append(replace(system, regressor=regressor, torque=torque))

        # 2. Least squares of mass, first moments and unknown friction.
        loads = len(self.load.names)
        friction = np.flatnonzero(free)
        names = (*map(spoken, self.load.names), *(linear[p + i] for i in friction))
        fit = weighted(problem.dynamics, names, systems)
        values = np.append(np.zeros(loads), self.friction)
        # Fixed friction keeps a deviation of zero.
        std = np.zeros(loads + len(free))
        columns = [*range(loads), *(loads + friction)]
        values[columns] = fit.values
        std[columns] = fit.std

        # 3. The centre is the first moment over the mass; a light load has none that is sure.
        heavy = abs(values[0]) > SETTINGS.light
        values[1:loads] = values[1:loads] / values[0] if heavy else SETTINGS.centre_start

        # 4. Friction that contradicts the rig comes from poor data: start from the rig there.
        errors = np.abs(values[loads:] - self.friction)
        tolerance = np.minimum(self.deviation, SETTINGS.friction_error * np.abs(self.friction))
        plausible = errors < tolerance
        # Stated friction of 0 has no relative error: its deviation alone is the tolerance.
        plausible |= (self.friction == 0) & (np.abs(values[loads:]) < self.deviation)
        values[loads:] = np.where(plausible, values[loads:], self.friction)
        return np.clip(values, *self.bounds(problem).T), std

    def _columns(self):
        """Increments (p, l) of f by mass and first moments, and (p,) by the stated inertia.

        Where the centre is unknown, its contribution to the inertia about the link's frame is
        neglected: that contribution is quadratic in the centre.
        """
        load = self.load
        matrix = load.matrix
        offset = matrix[:, 4:] @ load.inertia
        if not load.shown:
            return (load.increments(np.array([1.0])) - offset)[:, None], offset
        return matrix[:, [0, *(1 + axis for axis in load.shown)]], offset
