"""Elastic gears: stiffness and damping as unknowns beside f, found together.

Start: the torque equation behind elastic gears, fitted in several pass bands over a grid of
resonances (`identification.equation_error.gear_fit`). From the best of these, Gauss-Newton on the
prediction error in coordinates of resonances (`identification.replay.resonances`). Intervals: the
profile likelihood of each resonance, which also decides whether the log tells a gear from a rigid
one.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from identification.equation_error.gear_fit import GearFit, fit_deflection, fit_gears
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.pulse_fit import NO_BAND
from identification.replay.gauss_newton import Solution, gauss_newton, reweighed, slopes
from identification.replay.profile_likelihood import Profile
from identification.replay.resonances import INFLATION, STIFFNESS, Resonances, Start, link_inertia
from identification.search.outcome import GearResonance, Outcome
from identification.search.polish import outcome_of, start_of_fit
from identification.search.problem import Problem
from plant.machine.motor_inertia import LEAST_MOTOR_INERTIA, least_inertia_margin
from plant.parts.fields import Floats
from plant.parts.sums import dot
from plant.simulation.followed_path import path_of, start_of

# Twice the rise of the log-likelihood at the ends of an interval, at a bound, and up to which a
# gear may be rigid.
_TWO_SIDED = 3.84
_ONE_SIDED = 2.71
_LIKE_RIGID = 3.84


class Intervals:
    """What a log says of each resonance.

    `solution`: the best fit. `start`: its steps and bounds. `final`: give intervals even where a
    better fit is met.

    Attributes: `better` (k,) or None: coordinates of a better fit, if one was met; unless `final`,
    there are no intervals then.
    """

    def __init__(self, view: Resonances, solution: Solution, start: Start, *, final: bool) -> None:
        self._view = view
        self._solution = solution
        self._start = start
        self._unit = view.settle(solution.values)
        n = len(view.inertia(solution.values))
        self._periods, self._rigid = np.zeros((n, 2)), np.zeros(n, bool)
        self.better: Floats | None = None
        steps = start.steps.copy()
        varied = np.flatnonzero(steps) if view.stiffness else np.empty(0, int)
        change = slopes(view, solution.values, steps, varied, view.innovations(solution.values))
        for i, place in view.stiffness.items():
            profile = Profile(
                view, solution.values, change, steps, start.bounds, place, final=final
            )
            self._periods[i], self._rigid[i] = self._of(profile, place)
            if profile.better is not None and not final:
                self.better = profile.better
                break

    def _of(self, profile: Profile, place: int) -> tuple[tuple[float, float], bool]:
        """Least and largest squared period [s^2], and whether the gear may be rigid."""
        unit, best, (low, high) = (
            self._unit,
            self._solution.values[place],
            self._start.bounds[place],
        )
        std = self._std(place)
        if best <= low or profile.rise(low, _LIKE_RIGID * unit) < _LIKE_RIGID * unit:
            return (low, profile.end(NORMAL * std, _ONE_SIDED * unit, high)), True
        level = _TWO_SIDED * unit
        return (
            profile.end(NORMAL * std, level, low),
            profile.end(NORMAL * std, level, high),
        ), False

    def _std(self, place: int) -> float:
        return float(np.sqrt(INFLATION * self._solution.covariance[place, place]))

    def covariance(self) -> Floats:
        """Of the values (k, k); zero for stiffness and damping of a gear that may be rigid."""
        change = self._view.slopes(self._solution.values)
        for places in (self._view.stiffness, self._view.damping):
            change[[place for i, place in places.items() if self._rigid[i]]] = 0.0
        return INFLATION * change @ self._solution.covariance @ change.T

    def resonance(self, joints: Sequence[str], pose: Floats) -> GearResonance:
        """The table of what was found."""
        view = self._view
        solution = self._solution
        hz, ratio = view.resonances(solution.values)
        low = hz.copy()
        high = hz.copy()
        ratio_low = ratio.copy()
        ratio_high = ratio.copy()
        searched = np.array([i in view.stiffness for i in range(len(hz))])
        with np.errstate(divide="ignore"):
            high[searched], low[searched] = 1 / (2 * np.pi * np.sqrt(self._periods[searched].T))
        high[self._rigid] = hz[self._rigid] = np.inf
        for i, place in view.damping.items():
            ratio_low[i], ratio_high[i] = ratio[i] * np.exp(
                NORMAL * self._std(place) * np.array([-1, 1])
            )
        return GearResonance(
            joints=tuple(joints),
            pose=pose,
            hz=hz,
            low=low,
            high=high,
            damping_ratio=ratio,
            damping_low=ratio_low,
            damping_high=ratio_high,
            searched=searched,
        )


_GRID = np.geomspace(8.0, 400.0, 15)  # resonances of the first search [Hz]

# Starts that are followed beside a rigid one, and for how many rounds, before the best goes on
# alone.
_STARTS = 2
_FIRST = 4

_RIGID = 1e-12  # compliance of a gear that is as good as rigid [rad/(N m)]

# step of the central differences of f, in standard deviations of the torque equation's fit
_SMALL = 0.01

_MIDDLE = 2  # of the bands, that of the rigid fit

_LEAST_SHARE = 0.1  # share of D_ii that a link has at least, for the first grid

_BETTER = 3  # how often, at most, a better fit that a profile meets is taken up


def pose_of(problem: Problem) -> Floats:
    """Where the motors of the first record begin (n,) [rad]."""
    return np.asarray(start_of(problem.records[0], path_of(problem.records[0]))[0], dtype=float)


def gear_fits(problem: Problem, seen: GearFit | None = None) -> list[GearFit]:
    """Fits of the torque equation: with rigid gears first, then with the best of a grid of
    resonances in each band.

    Gears that are known, or `seen` by two sensors, stay as they are.
    """
    dynamics = problem.dynamics
    records = problem.records
    rig = problem.records[0].rig
    slope, rotors = link_inertia(dynamics, rig, pose_of(problem))
    stiff = np.full((1, dynamics.n), _RIGID)
    rigid = fit_gears(dynamics, records, problem.unknown, problem.known, stiff)
    if not rigid:
        raise ValueError(NO_BAND)
    first = rigid[min(len(rigid) - 1, _MIDDLE)]
    fit = first.torque
    values = dict(zip(fit.names, fit.values, strict=True)) | problem.known
    whole = np.maximum(slope @ [values[name] for name in dynamics.names], rotors)
    links = np.maximum(whole - rotors, _LEAST_SHARE * whole)
    grid = 1 / (links * (2 * np.pi * _GRID[:, None]) ** 2)
    for i, stiffness in enumerate(rig.drive.elasticity.stiffness):
        name = f"{STIFFNESS}[{i}]"
        if name not in problem.unknown or name in problem.known:
            grid[:, i] = 1 / problem.known.get(name, stiffness)
        elif seen is not None and np.isfinite(seen.compliance[i]):
            grid[:, i] = max(seen.compliance[i], _RIGID)
    return [first, *fit_gears(dynamics, records, problem.unknown, problem.known, grid)]


def elastic(problem: Problem, *, simulated: bool = False) -> Outcome:
    """Prediction error (output error, if simulated) of an arm on elastic gears, with what is
    unknown of them.
    """
    prediction = problem.prediction(simulated=simulated, zeros=problem.zeros, steady=True)
    seen = _deflection(problem)
    view = Resonances(
        prediction,
        problem.dynamics,
        problem.records[0].rig,
        pose_of(problem),
        problem.known,
        None if seen is None or seen.std is None else (seen.compliance, seen.std),
    )
    whole = seen is not None and np.isfinite(seen.compliance).all()
    starts = _starts(
        problem, view, [seen] if seen is not None and whole else gear_fits(problem, seen)
    )
    stages = {"equation error": view.values(starts[0].coordinates)[: len(problem.unknown)]}
    start, solution = _followed(view, starts)
    solution = reweighed(view, solution, start.steps, start.bounds)
    for left in reversed(range(_BETTER + 1)):
        intervals = Intervals(view, solution, start, final=not left)
        if intervals.better is None:
            break
        solution = gauss_newton(view, intervals.better, start.steps, start.bounds)
    return _outcome(problem, view, solution, intervals, stages)


def _deflection(problem: Problem) -> GearFit | None:
    """What link sensors show, if some gear is unknown and there are such sensors."""
    seen = [record for record in problem.records if record.link_counts is not None]
    unknown = any(
        name.startswith(STIFFNESS) and name not in problem.known for name in problem.unknown
    )
    return (
        fit_deflection(problem.dynamics, seen, problem.unknown, problem.known)
        if seen and unknown
        else None
    )


def _starts(problem: Problem, view: Resonances, fits: Sequence[GearFit]) -> list[Start]:
    """Starts of the search that follow the log: the best of the later fits, and the first; of known
    gears, the best.

    Raises a ValueError where none does.
    """
    nuisances = view.prediction.nuisances
    found = []
    steps = view.prediction.nuisance_steps
    bounds = np.vstack([problem.bounds, view.prediction.nuisance_bounds])
    for fit in fits:
        values, step = start_of_fit(problem, fit.torque)
        for i, place in view.stiffness.items():
            values[place] = 1 / max(fit.compliance[i], _RIGID)
        found.append(
            view.start(np.append(values, nuisances), np.append(_SMALL * step, steps), bounds)
        )
    results = view.all_innovations([start.coordinates for start in found])
    costs = np.array(
        [dot(result, result) if np.isfinite(result).all() else np.inf for result in results]
    )
    order = [i for i in np.argsort(costs, kind="stable") if np.isfinite(costs[i])]
    if not order:
        raise ValueError(
            "the search must start from an arm that follows the log; no fit of the torque equation"
            " does. Check signs, units and the order of joints."
        )
    if not view.stiffness:
        return [found[order[0]]]
    best = [i for i in order if i][:_STARTS]
    return [found[i] for i in [*best, *([0] if 0 in order else [])]]


def _followed(view: Resonances, starts: list[Start]) -> tuple[Start, Solution]:
    """The least sum of squares from the best starts: for some rounds each, then the best alone."""
    solutions = []
    for start in starts:
        try:
            solutions.append((start, gauss_newton(view, *start, rounds=_FIRST)))
        except ValueError as error:  # a change of some unknown loses the log, or none shows there
            failed = error
    if not solutions:
        raise failed
    start, first = min(solutions, key=lambda pair: dot(pair[1].residual, pair[1].residual))
    view.settle(first.values)
    return start, gauss_newton(view, first.values, start.steps, start.bounds)


def _outcome(
    problem: Problem,
    view: Resonances,
    solution: Solution,
    intervals: Intervals,
    stages: dict[str, Floats],
) -> Outcome:
    k = len(problem.unknown)
    values = view.values(solution.values)
    arm, rig, _ = problem.parts(values[:k])
    reason = None
    drive = dataclasses.replace(
        rig.drive, motor_inertia=rig.drive.motor_inertia / LEAST_MOTOR_INERTIA
    )
    if (
        not least_inertia_margin(
            problem.dynamics, dataclasses.replace(rig, drive=drive), arm.f[None]
        )[0]
        >= 0
    ):
        reason = (
            "D(q) of the fit less the motors' own inertia, Jm k^2, leaves no sound link behind some"
            " gear; check motor_inertia and gears, or log longer"
        )
    resonance = intervals.resonance(problem.dynamics.chain.joint_labels, pose_of(problem))
    own = {
        "covariance": intervals.covariance()[:k, :k],
        "fallback_reason": reason,
        "resonance": resonance,
    }
    return outcome_of(problem, view.prediction, solution, values, stages, **own)
