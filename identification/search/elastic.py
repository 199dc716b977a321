"""Elastic gears: prediction-error fit of stiffness and damping beside f.

Read `elastic`. The start values come from the torque equation behind elastic gears, fitted in
several pass bands over a grid of resonances (`identification.equation_error.gear_fit`). From the
best of them, Gauss-Newton minimises the prediction error in coordinates of resonances
(`identification.replay.resonances`). The intervals are profile likelihoods of each resonance, which
also decide whether the log distinguishes a gear from a rigid one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error import NO_BAND, NORMAL, GearFit, fit_deflection, fit_gears
from identification.replay import (
    INFLATION,
    STIFFNESS,
    Profile,
    Resonances,
    Solution,
    Start,
    gauss_newton,
    link_inertia,
    reweighed,
    slopes,
)
from identification.search.outcome import GearResonance, Outcome
from identification.search.polish import outcome_of, start_of_fit
from identification.search.problem import Problem
from plant.machine import LEAST_MOTOR_INERTIA, least_inertia_margin
from plant.parts import Floats, dot, frozen_settings
from plant.simulation import path_of, start_of


@frozen_settings
class ElasticSettings:
    """Grid, starts and confidence levels of the fit of elastic gears.

    Chosen by hand where nothing else is said; ``tests/benchmarks/elastic_identification.py``
    measures errors and intervals of the resonances.

    Parameters
    ----------
    grid : tuple of (float, float, int)
        Lowest and highest resonance of the grid of the torque equation [Hz], and its number of
        points, evenly spaced in the logarithm.
    least_share : float
        Share of D_ii that a link has at least, when the grid turns resonances into compliance: a
        poor rigid fit can leave less than nothing.
    rigid : float
        Compliance that stands for a rigid gear [rad/(N m)].
    middle_band : int
        Number of the pass band, from the lowest, whose rigid fit is the start.
    starts : int
        Elastic starts that are followed beside the rigid one.
    trial_rounds : int
        Gauss-Newton rounds of each start, before the best goes on alone.
    step : float
        Step of the central differences of f, in standard deviations of the torque equation's fit.
    retries : int
        How often at most a better fit that a profile meets becomes the new best fit.
    two_sided, one_sided : float
        Twice the rise of the log-likelihood at the ends of a 95 % interval, and at a 95 % bound:
        quantiles of chi-square with one degree of freedom, at 95 % and 90 %.
    like_rigid : float
        The same up to which a gear may be rigid: the 95 % quantile.
    """

    grid: tuple[float, float, int] = (8.0, 400.0, 15)
    least_share: float = 0.1
    rigid: float = 1e-12
    middle_band: int = 2
    starts: int = 2
    trial_rounds: int = 4
    step: float = 0.01
    retries: int = 3
    two_sided: float = 3.84
    one_sided: float = 2.71
    like_rigid: float = 3.84


ELASTIC = ElasticSettings()


class Intervals:
    """95 % intervals of the resonances by profile likelihood.

    `solution`: the best fit. `start`: its steps and bounds. `final`: compute all intervals even if
    a profile meets a better fit.

    Attributes: `better` (k,) or None: coordinates of a better fit that a profile met; unless
    `final`, there are no intervals then.
    """

    def __init__(self, view: Resonances, solution: Solution, start: Start, *, final: bool) -> None:
        self._view = view
        self._solution = solution
        self._start = start
        # Variance of an innovation as it counts for coordinates: the unit of all levels.
        self._unit = view.settle(solution.values)
        n = len(view.inertia(solution.values))
        # Squared periods, the coordinates of stiffness: rigid gears are at their zero.
        self._periods, self._rigid = np.zeros((n, 2)), np.zeros(n, bool)
        self.better: Floats | None = None
        steps = start.steps.copy()
        # Sensitivities are the same for all profiles; compute them once.
        varied = np.flatnonzero(steps) if view.stiffness else np.empty(0, int)
        innovations = view.innovations(solution.values)
        change = slopes(view, solution.values, steps, varied, innovations, start.bounds)
        for i, place in view.stiffness.items():
            profile = Profile(
                view, solution.values, change, steps, start.bounds, place, final=final
            )
            self._periods[i], self._rigid[i] = self._of(profile, place)
            # The intervals of a local optimum would be wrong: stop, and search on.
            if profile.better is not None and not final:
                self.better = profile.better
                break

    def _of(self, profile, place):
        """Least and largest squared period [s^2], and whether the gear may be rigid."""
        unit = self._unit
        low, high = self._start.bounds[place]
        # An approximate end, from which the profile searches the exact one.
        width = NORMAL * self._std(place)
        rigid_level = ELASTIC.like_rigid * unit
        # The lowest period is that of a gear as good as rigid.
        if self._solution.values[place] <= low or profile.rise(low, rigid_level) < rigid_level:
            return (low, profile.end(width, ELASTIC.one_sided * unit, high)), True
        level = ELASTIC.two_sided * unit
        return (profile.end(width, level, low), profile.end(width, level, high)), False

    def _std(self, place):
        # Rounding is no white noise, see INFLATION.
        return float(np.sqrt(INFLATION * self._solution.covariance[place, place]))

    def covariance(self) -> Floats:
        """Covariance (k, k) of the values; zero of stiffness and damping of a possibly rigid gear.

        Such a gear has a lower bound of stiffness, and no variance.
        """
        change = self._view.slopes(self._solution.values)
        for places in (self._view.stiffness, self._view.damping):
            change[[place for i, place in places.items() if self._rigid[i]]] = 0.0
        return INFLATION * change @ self._solution.covariance @ change.T

    def resonance(self, joints: Sequence[str], pose: Floats) -> GearResonance:
        """Table of the resonances with their intervals."""
        view = self._view
        solution = self._solution
        hz, ratio = view.resonances(solution.values)
        low = hz.copy()
        high = hz.copy()
        ratio_low = ratio.copy()
        ratio_high = ratio.copy()
        # Stated stiffness has no interval.
        searched = np.array([i in view.stiffness for i in range(len(hz))])
        # The longest period belongs to the lowest resonance; a period of zero is a rigid gear.
        with np.errstate(divide="ignore"):
            high[searched], low[searched] = 1 / (2 * np.pi * np.sqrt(self._periods[searched].T))
        high[self._rigid] = np.inf
        hz[self._rigid] = np.inf
        for i, place in view.damping.items():
            # The coordinate is the logarithm of the damping ratio.
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


def pose_of(problem: Problem) -> Floats:
    """Joint angles (n,) at the beginning of the first record [rad]."""
    record = problem.records[0]
    # All intervals refer to the inertia at this pose.
    return np.asarray(start_of(record, path_of(record))[0], dtype=float)


def gear_fits(problem: Problem, deflection: GearFit | None = None) -> list[GearFit]:
    """Fits of the torque equation: with rigid gears, then the best of a grid for each pass band.

    Gears that a range fixes, or whose `deflection` link sensors show, keep their stiffness.
    """
    dynamics = problem.dynamics
    records = problem.records
    rig = problem.records[0].rig
    # 1. Rigid gears, in the middle one of the pass bands.
    slope, rotors = link_inertia(dynamics, rig, pose_of(problem))
    stiff = np.full((1, dynamics.n), ELASTIC.rigid)
    rigid = fit_gears(dynamics, records, problem.unknown, problem.known, stiff)
    # The logs leave no pass band for the torque equation.
    if not rigid:
        raise ValueError(NO_BAND)
    middle = rigid[min(len(rigid) - 1, ELASTIC.middle_band)]
    fit = middle.torque
    values = dict(zip(fit.names, fit.values, strict=True)) | problem.known

    # 2. Compliance 1 / (inertia omega^2) of each resonance of the grid, by the links of that fit.
    inertia = np.maximum(slope @ [values[name] for name in dynamics.names], rotors)
    links = np.maximum(inertia - rotors, ELASTIC.least_share * inertia)
    low, high, count = ELASTIC.grid
    grid = 1 / (links * (2 * np.pi * np.geomspace(low, high, count)[:, None]) ** 2)

    # 3. Gears whose stiffness needs no search.
    for i, stiffness in enumerate(rig.drive.elasticity.stiffness):
        name = f"{STIFFNESS}[{i}]"
        if name not in problem.unknown or name in problem.known:
            grid[:, i] = 1 / problem.known.get(name, stiffness)
        elif deflection is not None and np.isfinite(deflection.compliance[i]):
            grid[:, i] = max(deflection.compliance[i], ELASTIC.rigid)
    # `_starts` relies on the rigid fit being the leading one.
    return [middle, *fit_gears(dynamics, records, problem.unknown, problem.known, grid)]


def elastic(problem: Problem, *, simulated: bool = False) -> Outcome:
    """Prediction-error fit (output-error fit, if simulated) of an arm on elastic gears."""
    prediction = problem.prediction(simulated=simulated, zeros=problem.zeros, steady=True)

    # 1. Start values, in coordinates of resonances.
    deflection = _deflection(problem)
    view = Resonances(
        prediction,
        problem.dynamics,
        problem.records[0].rig,
        pose_of(problem),
        problem.known,
        None
        if deflection is None or deflection.std is None
        else (deflection.compliance, deflection.std),
    )
    if deflection is not None and np.isfinite(deflection.compliance).all():
        fits = [deflection]
    else:
        fits = gear_fits(problem, deflection)
    starts = _starts(problem, view, fits)
    # The leading start is the best elastic one.
    stages = {"equation error": view.values(starts[0].coordinates)[: len(problem.unknown)]}

    # 2. Least sum of squares.
    start, solution = _followed(view, starts)
    solution = reweighed(view, solution, start.steps, start.bounds)

    # 3. Intervals; a profile that meets a better fit starts the search anew from there.
    for retries in reversed(range(ELASTIC.retries + 1)):
        intervals = Intervals(view, solution, start, final=not retries)
        if intervals.better is None:
            break
        solution = gauss_newton(view, intervals.better, start.steps, start.bounds)
    return _outcome(problem, view, solution, intervals, stages)


def _deflection(problem):
    """Fit of the deflection that link sensors show; None without such sensors or unknown gears."""
    records = [record for record in problem.records if record.link_counts is not None]
    unknown = any(
        name.startswith(STIFFNESS) and name not in problem.known for name in problem.unknown
    )
    # Without unknown gears a measured deflection has no use.
    if not records or not unknown:
        return None
    return fit_deflection(problem.dynamics, records, problem.unknown, problem.known)


def _starts(problem, view, fits):
    """Starts that follow the log: the best elastic fits, then the rigid one.

    With known gears it is the best start alone.

    Raises
    ------
    ValueError
        No start follows the log, or has resonances in the range of a stiffness.
    """
    nuisances = view.prediction.nuisances
    starts = dict[int, Start]()
    steps = view.prediction.nuisance_steps
    bounds = np.vstack([problem.bounds, view.prediction.nuisance_bounds])
    # Stiffness comes from the grid, all other values from the torque equation.
    for k, fit in enumerate(fits):
        values, step = start_of_fit(problem, fit.torque)
        for i, place in view.stiffness.items():
            values[place] = 1 / max(fit.compliance[i], ELASTIC.rigid)
        try:
            starts[k] = view.start(
                np.append(values, nuisances), np.append(ELASTIC.step * step, steps), bounds
            )
        except ValueError as error:  # a range beyond the resonances, with the links of this fit
            failure = error
    if not starts:
        raise failure
    costs = {
        k: dot(innovations, innovations) if np.isfinite(innovations).all() else np.inf
        for k, innovations in zip(
            starts,
            view.all_innovations([start.coordinates for start in starts.values()]),
            strict=True,
        )
    }
    order = [k for k in sorted(costs, key=lambda k: costs[k]) if np.isfinite(costs[k])]
    if not order:
        raise ValueError(
            "the search must start from an arm that follows the log; no fit of the torque equation"
            " does. Check signs, units and the order of joints."
        )
    # Nothing distinguishes the starts but f, where one start suffices.
    if not view.stiffness:
        return [starts[order[0]]]
    # Start 0 has rigid gears. It is followed whatever its cost, since the gears may be rigid.
    best = [starts[i] for i in order if i][: ELASTIC.starts]
    return [*best, starts[0]] if 0 in order else best


def _followed(view, starts):
    """Least sum of squares from the starts: some rounds of each, then the best alone."""
    solutions = []
    for start in starts:
        try:
            solutions.append((start, gauss_newton(view, *start, rounds=ELASTIC.trial_rounds)))
        except ValueError as error:  # a change of some unknown loses the log, or none shows there
            failure = error
    if not solutions:
        raise failure
    start, trial = min(solutions, key=lambda pair: dot(pair[1].residual, pair[1].residual))
    # The prior of damping weighs as one reading of the noise, which is now better known.
    view.settle(trial.values)
    return start, gauss_newton(view, trial.values, start.steps, start.bounds)


def _outcome(
    problem,
    view,
    solution,
    intervals,
    stages,
):
    """Outcome of a fit; its values are a fallback where a link behind a gear has no inertia."""
    k = len(problem.unknown)
    values = view.values(solution.values)
    arm, rig, _ = problem.parts(values[:k])
    reason = None
    # The margin counts a share of the stated rotors. Behind elastic gears the links need an inertia
    # of their own, so that all of the rotors must fit into D.
    drive = replace(rig.drive, motor_inertia=rig.drive.motor_inertia / LEAST_MOTOR_INERTIA)
    rig = replace(rig, drive=drive)
    if not least_inertia_margin(problem.dynamics, rig, arm.f[None])[0] >= 0:
        reason = (
            "D(q) of the fit less the motors' own inertia, Jm k^2, leaves no sound link behind some"
            " gear; check motor_inertia and gears, or log longer"
        )
    return outcome_of(
        problem,
        view.prediction,
        solution,
        values,
        stages,
        covariance=intervals.covariance()[:k, :k],
        fallback_reason=reason,
        resonance=intervals.resonance(problem.dynamics.chain.joint_labels, pose_of(problem)),
    )
