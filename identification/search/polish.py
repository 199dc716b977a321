"""Common steps of the methods: start values from the torque equation, and the prediction-error fit.

Read `torque_fit` and `start_of_fit`, then `polished`, which fits, repeats the fit where it may have
stopped early, and subtracts the bias by rounding.
"""

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np

from identification.equation_error import (
    SEGMENTS,
    SPRINGS,
    TorqueFit,
    between_samples,
    covariance_of,
    fit_torque,
    group_std,
    in_groups,
    least_squares,
    linear,
    noise_of_torque,
    over_bands,
    torque_error,
    with_possible_bodies,
)
from identification.equation_error import equation_error as fit_pulses
from identification.equation_error.torque_summary import SETTINGS as TORQUE_WARNINGS
from identification.replay import (
    RATES,
    Prediction,
    Solution,
    ended_on_bounds,
    gauss_newton,
    noise,
    over_whole_deviations,
    reweighed,
)
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem, is_long
from plant import FrictionCurve
from plant.machine import least_inertia_margin, rotors_alone
from plant.parts import Floats, dot, frozen_settings, products


@frozen_settings
class FitSettings:
    """Steps of the prediction-error fit, and the conditions under which it is repeated.

    Chosen by hand where nothing else is said; ``tests/benchmarks/identification_study.py`` measures
    the fits that result.

    Parameters
    ----------
    step : float
        Step of the central differences, in standard deviations of the torque equation's fit.
    relative_step : float
        The same of a number that the torque equation does not fit, relative to its nominal value.
    spring_step : float
        The same of a spring's number, such as an angle, whose nominal value is 0 [SI].
    range_step : float
        The same where only a range is stated, as a share of its width.
    far : float
        RMS innovation above which a fit has not reached the log [pulses]: rounding alone gives
        0.289, and the fit of log 158 of ``tests/benchmarks/healthy.py`` stopped at 0.51.
    at_bound : float
        An observer gain below this multiple of its lower bound counts as being at the bound.
    unlike_rotor : float
        Relative difference from the stated rotor inertia above which the fit is repeated from
        there: log 173 of ``tests/benchmarks/healthy.py`` needs it.
    staged_gains : tuple of float
        Observer gains of position of the successive stages where the memory of a law is unknown.
    critical : float
        Observer gain of speed over the square of that of position.
    gain_step : float
        Step of the central differences of observer gains, relative.
    fine : float
        Largest step of the central differences beside an unknown memory of a law, in standard
        deviations: with steps of 2 to 300, log 66 of ``tests/benchmarks/any_rig.py`` ended 31
        deviations from its values.
    settled : float
        Relative decrease of the RMS innovation below which no finer step is tried.
    refinements : int
        Searches with finer steps, at most.
    fine_steps : int
        Steps per sample of the integration for which the values are corrected: in log 146 of
        ``tests/benchmarks/any_rig.py`` 4 steps moved them by up to 7.9 deviations, 16 by 2.1.
    coarse, near : float
        The fit is repeated in finer integration steps where these change the innovations by more
        than `coarse` [pulses, rms] and its RMS innovation is at most `near` [pulses]. Rounding
        alone gives 0.29. Finer steps changed the innovations of logs at 1 ms by 0.02 and less, of
        logs at 5 and 10 ms by up to 1.2, and their values by 27 deviations.
    refined, finest : int
        Factor by which such a repetition multiplies the steps per sample, and steps per sample from
        which on it is not tried.
    moved : float
        A correction is not made if it changes every value by less than this [standard deviations].
    corrections : int
        Corrections at most, each at the slopes of coarse steps.
    """

    # Central differences: small against the uncertainty, large against rounding errors.
    step: float = 0.01
    relative_step: float = 0.02
    spring_step: float = 0.02
    range_step: float = 0.01
    # Conditions of a second attempt.
    far: float = 0.4
    at_bound: float = 10.0
    unlike_rotor: float = 0.5
    # Observer gains where the memory of a law is unknown.
    staged_gains: tuple[float, ...] = (0.2, 0.07, 0.025)
    critical: float = 0.285
    gain_step: float = 0.01
    fine: float = 0.1
    settled: float = 1e-5
    refinements: int = 3
    # Integration in finer steps.
    fine_steps: int = 16
    coarse: float = 0.05
    near: float = 2.0
    refined: int = 4
    finest: int = 64
    moved: float = 0.2
    corrections: int = 2


@frozen_settings
class RoundingSettings:
    """Simulated logs from which the bias by the rounding of counts is estimated.

    Both are chosen by hand; ``tests/benchmarks/intervals.py`` measures the coverage that results.

    Parameters
    ----------
    logs : int
        Simulated logs per record. Their mean has 1 / logs of the variance of one.
    quieter : float
        Share of the mean square of simulated logs by which the log must fall short for its own loop
        to be faster than the simulated one.
    """

    logs: int = 8
    quieter: float = 0.02


FIT = FitSettings()
ROUNDING = RoundingSettings()


def torque_fit(problem: Problem) -> TorqueFit:
    """Fit of the torque equation; of logged torques in the best pass band that gives a valid arm.

    Raises
    ------
    ValueError
        No band gives an arm that follows the log.
    """
    if not any(problem.replays):
        return fit_pulses(problem.dynamics, problem.records, problem.unknown, problem.known)
    # Nuisances stay at their start: only whether the arm follows the log counts.
    prediction = problem.prediction()

    def follows(fit: TorqueFit) -> bool:
        # Gauss-Newton cannot start from an arm that diverges, however well it fits the torque.
        values, _ = start_of_fit(problem, fit)
        return bool(
            np.isfinite(prediction.innovations(np.append(values, prediction.nuisances))).all()
        )

    fits = over_bands(problem.dynamics, problem.records, problem.unknown, problem.known)
    for fit in fits.values():
        if follows(fit):
            return fit
    # Impossible bodies fit the torques hardly better than the nearest possible ones. So try the
    # nearest possible bodies.
    for fit in fits.values():
        possible = with_possible_bodies(problem.dynamics, problem.records[0].rig, fit)
        if possible is not None and follows(possible):
            return possible
    raise ValueError(
        "the torque equation must give an arm that can follow the log; it does in no band. Ask"
        " record.check() for order, signs and units of torques and positions, or give ranges."
    )


def excess_of_torque(problem: Problem, values: Floats, least: Floats) -> float:
    """Error of the logged torques under values (k,) over that under least squares (k,)."""
    ours, theirs = (
        torque_error(*problem.parts(vector)[:2], problem.records).total
        for vector in (values, least)
    )
    return ours / theirs


def arm_of_torques(problem: Problem, error: ValueError) -> Outcome:
    """The arm of `fit_torque` where logged torques cannot be followed, count by count.

    Its bodies are the nearest that can be. `error`: why the log is not followed, which is raised
    where the torques do not give an arm either.
    """
    dynamics = problem.dynamics
    record = problem.records[0]
    # Numbers that the torque equation lacks have no other estimate.
    if set(linear(dynamics, record.rig, problem.unknown)) != set(problem.unknown):
        raise error
    # The friction of the other methods: it holds a joint at rest, and does not rise with speed.
    drive = record.rig.drive
    curve = drive.curve or FrictionCurve(offset=np.zeros(drive.n))
    if curve.rise is None:
        curve = replace(curve, rise=np.zeros(drive.n))
    held = replace(drive, curve=curve)
    try:
        fit = fit_torque(
            dynamics,
            [replace(log, rig=replace(log.rig, drive=held)) for log in problem.records],
            unknown=_not(problem.known, problem.unknown),
            known=dict(problem.known),
        )
    except ValueError:
        raise error from None
    fit = with_possible_bodies(dynamics, record.rig, fit) or fit
    values, _ = start_of_fit(problem, fit)
    arm, rig, _ = problem.parts(values)
    # Wrong columns, signs or units leave no arm: that error stands.
    poor = fit.relative_error > TORQUE_WARNINGS.poor or bool(fit.causes)
    if poor or not least_inertia_margin(dynamics, rig, arm.f[None])[0] > 0:
        raise error

    # Joints that the values do not explain.
    error_on = torque_error(arm, rig, problem.records)
    joints = [
        f"{share:.0%} of the torque of {label}"
        for share, label in zip(error_on.relative.tolist(), error_on.joints, strict=True)
        if share > TORQUE_WARNINGS.poor
    ]
    unexplained = f"; they leave {', '.join(joints)} unexplained" if joints else ""
    # The sentence of the error alone: its advice is for a log without torques.
    why = str(error).partition(". ")[0]
    reason = (
        "the log cannot be followed count by count; the values explain its torques to"
        f" {error_on.total:.1%}, with bodies that can be{unexplained} ({why})"
    )
    covariance = covariance_of(problem.unknown, fit.names, fit.covariance)
    solved = Fit(
        unknown=problem.unknown,
        values=values,
        candidates=values[None],
        covariance=covariance,
        fallback_reason=reason,
    )
    message = f"{fit.rows} equations, relative torque error {fit.relative_error:.1%}."
    return Outcome(fit=solved, message=message)


def _not(known, unknown):
    return [name for name in unknown if name not in known]


def start_of_fit(problem: Problem, fit: TorqueFit) -> tuple[Floats, Floats]:
    """Start values (k,) of all unknowns, and a step (k,) for the central differences of each.

    Unknowns that the torque equation lacks start from their range or from the record.
    """
    values = problem.nominal.copy()
    step = np.abs(problem.nominal) * FIT.relative_step
    # A spring that is stated as 0 needs an absolute step.
    for i, name in enumerate(problem.unknown):
        if name.startswith(SPRINGS) and not step[i]:
            step[i] = FIT.spring_step
    # A range whose ends are equal overrides the record.
    for name, value in problem.known.items():
        values[problem.unknown.index(name)] = value
    for i, name in enumerate(problem.unknown):
        if name in fit.names:
            column = fit.names.index(name)
            values[i] = fit.values[column]
            step[i] = fit.std[column]
    if problem.ranges is not None:
        low, high = problem.ranges.T
        step = np.where(step > 0, step, FIT.range_step * (high - low))
        # A step of zero keeps a number fixed.
        step = np.where(low == high, 0.0, step)
    return np.clip(values, *problem.bounds.T), step


def polished(
    problem: Problem,
    start: Floats,
    step: Floats,
    stages: dict[str, Floats],
    *,
    simulated: bool = False,
    begun: Floats | None = None,
) -> Outcome:
    """Prediction-error fit from a start (output-error fit, if simulated).

    Where the inertia D(q) of the fit is less than that of the motors alone, the values are those of
    the start. `begun` (m,): start values of zeros and of what laws remembered; by default the
    prediction's.
    """
    prediction = problem.prediction(
        simulated=simulated, zeros=problem.zeros, memories=problem.memories
    )
    # 1. Values and steps of the unknowns, followed by those of the nuisances, gains first.
    # The solution's values are the unknowns, then the gains, then zeros and memories.
    k = len(start)
    bounds = np.vstack([problem.bounds, prediction.nuisance_bounds])
    steps = np.append(FIT.step * step, prediction.nuisance_steps)
    gains = None if simulated else slice(k, k + 2 * problem.dynamics.n)

    # 2. Fit, then weigh records and joints by the innovations that the fit leaves.
    nuisances = prediction.nuisances.copy()
    if begun is not None:
        nuisances[2 * problem.dynamics.n :] = begun
    solution = _searched(problem, prediction, np.append(start, nuisances), steps, bounds, gains)
    solution = reweighed(prediction, solution, steps, bounds)
    # Where no reading determines a direction, keep the difference steps that revealed it.
    if any(problem.memories) and not len(solution.undetermined):
        solution, steps = finer(prediction, solution, steps, bounds, gains)

    if gains is not None:
        solution = from_inside(prediction, solution, steps, bounds, gains)
        if not len(solution.undetermined):
            solution = over_whole_deviations(prediction, solution, bounds)

    # Coarse integration steps add an error to the innovations that is not rounding and biases the
    # values: the fit is repeated in finer steps.
    if gains is not None and _is_coarse(problem, prediction, solution):
        finer_steps = problem.in_steps(FIT.refined * problem.steps)
        # A weight and the integral that holds it were estimated together: start from both.
        # Gains of the observer that coarse steps needed are no start: they can leave a loop that
        # finer steps follow no longer.
        return polished(
            finer_steps, solution.values[:k], step, stages, begun=solution.values[gains.stop :]
        )

    # 3. Subtract the bias by rounding where the loop of a log responded to single counts. The logs
    # that are simulated for it are integrated in finer steps, so that this bias includes the one of
    # the coarse steps.
    rounding = None
    rounding_innovation = 0.0
    if prediction.rounds:
        solution, rounding, rounding_innovation = _unbiased(
            prediction, solution, bounds, problem.seed
        )
    # Where a state at the first sample is unknown, weak directions were found with the present
    # integration steps: the values stay as they are.
    elif gains is not None and not any(problem.memories):
        solution = _in_fine_steps(problem, prediction, solution, bounds)

    # 4. No arm has less inertia than its motors: such a fit says nothing of f.
    values = solution.values[:k]
    reason = None
    arm, rig, _ = problem.parts(values)
    if not least_inertia_margin(problem.dynamics, rig, arm.f[None])[0] >= 0:
        reason = (
            "D(q) of the fit falls short of the motors' own inertia, Jm k^2; check motor_inertia,"
            " gears and motor_gain"
        )
        values = start
    outcome = outcome_of(
        problem,
        prediction,
        solution,
        solution.values,
        stages,
        values=values,
        fallback_reason=reason,
        resumptions=prediction.resumptions(
            solution.values, np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
        )
        if problem.memories
        else (),
        gains=None if gains is None else solution.values[gains],
        rounding_innovation=rounding_innovation,
    )
    outcome = with_undetermined(outcome, prediction, solution)
    told = [memory.noise for memory in problem.memories if memory is not None]
    if any(noise is not None for noise in told):
        # The law gave its torque without the noise: it adds nothing to the innovations.
        noises = [np.zeros(problem.dynamics.n) if noise is None else noise for noise in told]
        outcome = replace(outcome, fit=replace(outcome.fit, torque_noise=_rms(noises)))
    if problem.repeats_torques:
        outcome = _with_torque_noise(outcome, problem, prediction, solution)
    grouped = _grouped(prediction, solution, k) if any(map(is_long, problem.records)) else None
    return replace(outcome, rounding=rounding, grouped=grouped)


def finer(
    prediction: Any, solution: Solution, steps: Floats, bounds: Floats, gains: slice | None
) -> tuple[Solution, Floats]:
    """The solution by differences over a share of its standard deviations, and their steps.

    The weight on a slow joint and the integral of its controller lie in a narrow, curved valley of
    the sum of squares. Central differences that are wider than the valley cancel on its sides. The
    search ends there, and the wrong curvature gives too small a covariance.
    """
    for _ in range(FIT.refinements):
        std = np.sqrt(np.diag(solution.covariance))
        within = np.where(std > 0, np.fmin(steps, FIT.fine * std), 0.0)
        if gains is not None:
            within[gains] = steps[gains]
        squares = solution.rms_innovation
        steps = within
        try:
            solution = gauss_newton(prediction, solution.values, steps, bounds)
        except ValueError:  # without the wide steps unknowns are not separately identifiable
            break
        if not solution.rms_innovation < (1 - FIT.settled) * squares:
            break
    return solution, steps


def from_inside(
    prediction: Any, solution: Solution, steps: Floats, bounds: Floats, gains: slice
) -> Solution:
    """A solution whose covariance comes from observer gains (2n,) that are inside their bounds.

    A joint with a gain at its lower bound counts as followed in open loop. Its innovations are
    strongly correlated, but would be counted as thousands of independent readings.
    """
    ended = solution.values[gains] <= bounds[gains, 0]
    if not (ended & (steps[gains] > 0)).any():
        return solution
    joints = len(ended) // 2
    position = FIT.staged_gains[-1]
    inside = np.repeat([position, FIT.critical * position**2], joints)
    values = solution.values.copy()
    # Raise both gains of a joint if either one ended at its lower bound.
    ended = np.tile(ended.reshape(2, joints).any(axis=0), 2)
    values[gains] = np.where(ended, np.fmax(inside, values[gains]), values[gains])
    fixed = steps.copy()
    fixed[gains] = 0
    try:
        # No search: the slopes and the innovations at these values alone.
        wider = gauss_newton(prediction, values, fixed, bounds, rounds=0)
    except ValueError:  # with these gains unknowns are not separately identifiable
        return solution
    # What no reading determines in open loop, none determines beside corrections either.
    fewer = len(wider.undetermined) < len(solution.undetermined)
    undetermined = solution.undetermined if fewer else wider.undetermined
    return replace(solution, covariance=wider.covariance, undetermined=undetermined)


def _with_torque_noise(outcome, problem, prediction, solution):
    """An outcome with the noise of the repeated torques, and the innovations that it causes.

    These are simulated, beside other noise of the same size; between the samples of a faster loop,
    beside the error of a line between them.
    """
    random = np.random.default_rng(problem.seed)
    noises = [noise_of_torque(record) for record in problem.objective.records]
    torques = [
        noise * random.normal(size=record.counts.shape) if between is None else between
        for noise, record, between in zip(
            noises, problem.records, map(between_samples, problem.records), strict=True
        )
    ]
    beside = prediction.beside(torques).innovations(solution.values)
    change = beside * prediction.scales - solution.residual
    rms = np.sqrt(dot(change, change) / dot(prediction.weights, prediction.weights))
    # A noise that loses the log explains nothing.
    fit = replace(
        outcome.fit,
        torque_noise=_rms(noises),
        noise_innovation=float(rms) if np.isfinite(rms) else 0.0,
    )
    return replace(outcome, fit=fit)


def _rms(noises):
    """Root mean square (n,) of the noises (n,) of several records."""
    return np.sqrt(np.mean(np.square(noises), axis=0))


def with_undetermined(outcome, prediction, solution):
    """An outcome whose covariance is as wide as the directions that no reading determines.

    The expected magnitude of a state keeps the search near the log; it is no knowledge.
    """
    if not len(solution.undetermined):
        return outcome
    k = len(outcome.fit.values)
    covariance = outcome.fit.covariance.copy()
    names = []
    for wide in prediction.widest(solution.undetermined)[:, :k]:
        covariance += np.outer(wide, wide)
        # Name only unknowns that change along the direction by more than their deviation by noise.
        parts = np.abs(wide) > np.sqrt(np.diag(outcome.fit.covariance))
        names.append(
            tuple(name for name, part in zip(outcome.fit.unknown, parts, strict=True) if part)
        )
    # A direction of the state alone changes no unknown: drop it. Name equal groups only once.
    groups = tuple(dict.fromkeys(filter(None, names)))
    return replace(outcome, fit=replace(outcome.fit, covariance=covariance, undetermined=groups))


def _searched(
    problem,
    prediction,
    start,
    steps,
    bounds,
    gains,
):
    """Best of the fits from a start, from the end of that fit, and from the stated rotor inertias.

    Far from the log, with observer gains at their lower bounds, a fit no longer follows it. The
    inertia of a joint that is little more than its rotor's has a second optimum below zero.
    """
    # An unknown state of a law makes the innovations too nonlinear for free observer gains at the
    # start: they are lowered by stages. A state that a torque tells is known well enough.
    unknown_state = any(
        memory is not None and memory.usual.size and memory.noise is None
        for memory in problem.memories
    )
    staged = gains if unknown_state else None
    best = by_stages(prediction, start, steps, bounds, staged)

    def better(values, gains):
        """The better of the best fit and the fit from these values."""
        with contextlib.suppress(ValueError):  # that start diverges
            fit = by_stages(prediction, values, steps, bounds, gains)
            return min(best, fit, key=lambda fit: fit.rms_innovation)
        return best

    # 1. Start again where low gains stopped the fit far from the log.
    far = gains is not None and staged is None and best.rms_innovation > FIT.far
    if far and (best.values[gains] <= FIT.at_bound * bounds[gains, 0]).any():
        best = better(best.values, gains)

    # 2. Start again from the stated rotors where a fitted one differs much, or no arm results.
    values = best.values.copy()
    # Joint -> f that is the inertia of its rotor alone.
    rotors = rotors_alone(problem.dynamics)
    arm, rig, _ = problem.parts(values[: len(problem.unknown)])
    columns = [problem.unknown.index(problem.dynamics.names[k]) for k in rotors.values()]
    stated = rig.drive.reflected_inertia()[list(rotors)]
    values[columns] = np.where(stated > 0, stated, values[columns])
    unlike = np.abs(values - best.values)[columns] > FIT.unlike_rotor * stated
    if unlike.any() or (
        rotors and not least_inertia_margin(problem.dynamics, rig, arm.f[None])[0] >= 0
    ):
        best = better(np.clip(values, *bounds.T), staged)
    return best


def _grouped(prediction, solution, unknown):
    """Standard deviations (k,) of the leading unknowns, by their scatter between segments."""
    lengths = prediction.lengths
    count = prediction.prior.count
    # The rows of a prior of f come first; those of a law's memory come last, in no segment.
    rows = slice(count + sum(lengths))
    residual = (solution.residual / prediction.scales)[rows]
    # Fixed numbers have no deviation.
    std = np.zeros(len(solution.values))
    std[solution.varied] = group_std(
        solution.slopes[rows], residual, in_groups(lengths, count, SEGMENTS)
    )
    return std[:unknown]


def fit_of(solution: Solution, unknown: tuple[str, ...], values: Floats, **fields: Any) -> Fit:
    """`Fit` of the leading unknowns of a Gauss-Newton solution, with these values (k,).

    `fields`: further fields of the `Fit`; they replace those of the solution.
    """
    k = len(values)
    # A covariance of nuisances is not part of the result.
    fields.setdefault("covariance", solution.covariance[:k, :k])
    fields.setdefault("rms_innovation", solution.rms_innovation)
    return Fit(unknown=unknown, values=values, candidates=values[None], **fields)


def outcome_of(
    problem: Problem,
    prediction: Prediction,
    solution: Solution,
    solved: Floats,
    stages: dict[str, Floats],
    **fields: Any,
) -> Outcome:
    """`Outcome` of a fit that follows the log.

    `solved`: values of the unknowns and of the nuisances. `fields`: further fields of the `Fit`.
    """
    k = len(problem.unknown)
    zeros = prediction.zeros_in(solved) if problem.zeros else None
    fit = fit_of(solution, problem.unknown, fields.pop("values", solved[:k]), zeros=zeros, **fields)
    message = (
        f"RMS innovation of {solution.rms_innovation:.3f} pulses (rounding alone gives 0.289)."
    )
    if on_bounds := ended_on_bounds(problem.unknown, fit.values, problem.bounds, solution.varied):
        message += f" The fit ends on a bound of {', '.join(on_bounds)}."
    return Outcome(
        fit=fit,
        message=message,
        evaluations=prediction.evaluations,
        stages=stages,
        steps=problem.steps,
    )


def _in_steps(problem, prediction, count):
    """A prediction in so many steps per sample, with its scales and prior."""
    fine = problem.in_steps(count).prediction(zeros=problem.zeros, memories=problem.memories)
    fine.scales = prediction.scales
    fine.prior = prediction.prior
    return fine


def _is_coarse(problem, prediction, solution):
    """Whether finer steps of the integration change the innovations by a part of a rounding."""
    # Where the log is far from any model, finer steps are no nearer to it.
    if problem.steps >= FIT.finest or solution.rms_innovation > FIT.near:
        return False
    fine = _in_steps(problem, prediction, FIT.refined * problem.steps)
    change = fine.innovations(solution.values) * prediction.scales - solution.residual
    rms = np.sqrt(dot(change, change) / dot(prediction.weights, prediction.weights))
    return rms > FIT.coarse


def _in_fine_steps(problem, prediction, solution, bounds):
    """The solution of a model that is integrated in finer steps, by the slopes of coarse ones."""
    if problem.steps >= FIT.fine_steps:
        return solution
    fine = _in_steps(problem, prediction, FIT.fine_steps)
    # 1. Gauss-Newton steps with the slopes of the coarse integration: slopes in fine steps would
    # take as long as a search.
    names = [prediction.unknown[i] for i in solution.varied]
    coarse = solution.residual / prediction.scales
    inverse = least_squares(names, solution.slopes, coarse, dependent=prediction.dependent)[1]
    std = np.sqrt(np.diag(solution.covariance)[solution.varied])
    values = solution.values.copy()
    for _ in range(FIT.corrections):
        # The coarse innovations are subtracted: at the optimum they are orthogonal to the slopes,
        # and elsewhere they hold the step that the coarse fit would take.
        added = fine.innovations(values) - coarse
        change = -inverse @ np.einsum("mi,m->i", solution.slopes, added)
        if not np.isfinite(change).all() or (np.abs(change) < FIT.moved * std).all():
            break
        values[solution.varied] += change
        values = np.clip(values, *bounds.T)
    # 2. The values of coarse steps stay where finer ones do not follow the log more closely.
    if (values == solution.values).all():
        return solution
    innovations = fine.innovations(values)
    if not dot(innovations, innovations) < dot(coarse, coarse):
        return solution
    residual = innovations * prediction.scales
    rms = float(np.sqrt(dot(residual, residual) / dot(prediction.weights, prediction.weights)))
    return replace(solution, values=values, residual=residual, rms_innovation=rms)


def _unbiased(prediction, solution, bounds, seed):
    """Subtract from a solution its bias by rounding; estimate that from simulated, rounded logs.

    At low speeds a loop feels single counts. That moves some unknowns by as much as their standard
    deviation. The scatter of the values of these logs shows the error of the covariance as far as
    innovations are rounding; the mean of both counts, since these logs have no other noise.

    Returns the solution; the weighted mean innovations (M,) of these logs, as far as they are in
    the log; and their RMS innovation [pulses]. None and zero of no log.

    Source: C. Gourieroux, A. Monfort, E. Renault, Indirect inference, Journal of Applied
    Econometrics 8, 1993.
    """
    count = ROUNDING.logs
    values = solution.values
    random = np.random.default_rng([seed, count])
    # The phase of an encoder is uniform within a count.
    shifts = random.uniform(-0.5, 0.5, (count, *prediction.shape))
    # The innovations of the log show at which rate its loop felt counts.
    logs = _rounded(prediction, values, shifts, solution.residual / prediction.scales)
    if not logs:
        return solution, None, 0.0

    # 1. One linear step from the values to the fit of each simulated log; their mean is the bias.
    names = [prediction.unknown[i] for i in solution.varied]
    inverse = least_squares(names, solution.slopes, logs[0], dependent=prediction.dependent)[1]
    errors = [inverse @ np.einsum("mi,m->i", solution.slopes, log) for log in logs]
    bias = np.mean(errors, axis=0)
    values = values.copy()
    values[solution.varied] += bias

    # 2. Scatter of these fits over that of the covariance; 1 where the covariance is right.
    noises = np.array([noise(prediction, log) for log in logs])
    squares = (errors - bias) ** 2 / np.outer(noises, np.diag(inverse))
    ratio = squares.mean() * count / (count - 1)
    if rows := prediction.prior.count:
        # A prior narrows the covariance but does not scatter from log to log.
        ratio /= 1 - np.mean(
            np.diag(inverse @ products(solution.slopes[:rows]) @ inverse) / np.diag(inverse)
        )

    # 3. Take the mean of both covariances, as far as the noise of the log is rounding. The bias is
    # a mean of `count` fits, whose variance adds.
    share = min(1.0, noises.mean() / noise(prediction, solution.residual / prediction.scales))
    scale = (1 + 1 / count) * (1 + share * (ratio - 1) / 2)
    unbiased = replace(
        solution, values=np.clip(values, *bounds.T), covariance=scale * solution.covariance
    )
    # Where the simulated logs differ from the measured one, as at rest, their mean is not its
    # rounding error. Keep only the part of the mean that the measured log contains.
    mean = sum(logs) / len(logs) * prediction.scales
    share = dot(mean, solution.residual) / max(dot(mean, mean), 1e-300)
    innovations = np.concatenate([log * prediction.scales for log in logs])
    rms = np.sqrt(
        dot(innovations, innovations) / (count * dot(prediction.weights, prediction.weights))
    )
    return unbiased, min(max(share, 0.0), 1.0) * mean, float(rms)


def _rounded(prediction, values, shifts, residual):
    """Weighted innovations (M,) of simulated, rounded logs; none where the model diverges.

    The rate at which a loop feels single counts moves its values. Of several rates, take the one
    whose logs have the mean square of the log. Other noise only adds to a log, so a log below the
    mean square of simulated ones comes from a faster loop, and the next rate is tried.
    """
    nearest = []
    distance = np.inf
    square = dot(residual, residual)
    for steps in RATES:
        try:
            logs = prediction.of_rounded(values, shifts, steps)
        except ValueError:
            return nearest
        simulated = sum(dot(log, log) for log in logs) / len(logs)
        if not np.isfinite(simulated):
            return nearest
        if abs(simulated - square) < distance:
            nearest = logs
            distance = abs(simulated - square)
        if square > (1 - ROUNDING.quieter) * simulated:
            break
    return nearest


def by_stages(
    prediction: Any, values: Floats, steps: Floats, bounds: Floats, gains: slice | None
) -> Solution:
    """Least sum of squares with observer gains that fall by stages, then are free.

    With high gains the innovations are nearly linear in the unknown memory of a law; low gains give
    the smallest variance. Where `gains` is None, one fit is made at once.
    """
    if gains is None:
        return gauss_newton(prediction, values, steps, bounds)
    solutions = []
    # Gains of position of all joints come before those of speed.
    joints = (gains.stop - gains.start) // 2
    fixed = steps.copy()
    # A step of zero keeps the gains at the value of the stage.
    fixed[gains] = 0
    for position in FIT.staged_gains:
        values = values.copy()
        values[gains] = np.repeat([position, FIT.critical * position**2], joints)
        try:
            solutions.append(gauss_newton(prediction, values, fixed, bounds))
        except ValueError:
            # Lower gains make the fit harder: only a failure of the first stage is one of the log.
            if not solutions:
                raise
            break
        values = solutions[-1].values
    # A later stage can be worse, where lower gains let go of the log.
    best = min(solutions, key=lambda solution: solution.rms_innovation)
    fixed[gains] = FIT.gain_step * best.values[gains]
    try:
        free = gauss_newton(prediction, best.values, fixed, bounds)
    except ValueError:  # with gains this low unknowns are not separately identifiable
        return best
    return min(best, free, key=lambda solution: solution.rms_innovation)
