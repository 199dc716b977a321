"""What methods have in common: a start from the torque equation, and the prediction-error fit at
the end.
"""

import contextlib
import dataclasses
from typing import Any

import numpy as np

from identification.equation_error.least_squares import (
    SEGMENTS,
    group_std,
    in_groups,
    least_squares,
)
from identification.equation_error.naming import first_problem
from identification.equation_error.pulse_fit import equation_error as fit_pulses
from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.regressor import SPRINGS
from identification.equation_error.torque_fit import TorqueFit
from identification.replay.experiment import RATES
from identification.replay.gauss_newton import Solution, gauss_newton, noise, reweighed
from identification.replay.prediction import Prediction
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem, is_long
from plant.machine.motor_inertia import least_inertia_margin, rotors_alone
from plant.parts.fields import Floats
from plant.parts.sums import dot, products

_SMALL = 0.01  # step of the central differences, in standard deviations of the equation error

# RMS innovation [pulses] beyond rounding's; lower bounds that a gain is at; share by which a rotor
# is another one.
_FAR = 0.4
_AT_BOUND = 10.0
_UNLIKE = 0.5

# Observer gains of position that a fit goes through; that of speed over its square; and steps of
# gains, relative.
_STAGES = (0.2, 0.07, 0.025)
_CRITICAL = 0.285
_GAIN_STEP = 0.01

# Logs by which the bias of rounding is found; share of their mean square that a log of a faster
# loop falls short of.
_ROUNDED = 8
_QUIETER = 0.02

_OF_ZERO = 0.02  # step of a spring's number, such as an angle, that is 0 in the record [SI]


def torque_fit(problem: Problem) -> TorqueFit:
    """The torque equation's fit; of logged torques, in the chosen band, or the nearest that
    gives an arm.
    """
    if not any(problem.replays):
        return fit_pulses(problem.dynamics, problem.records, problem.unknown, problem.known)
    prediction = problem.prediction()
    for fit in over_bands(
        problem.dynamics, problem.records, problem.unknown, problem.known
    ).values():
        values, _ = start_of_fit(problem, fit)
        if np.isfinite(prediction.innovations(np.append(values, prediction.nuisances))).all():
            return fit
    raise ValueError(
        "the torque equation must give an arm that can follow the log; it does in no"
        f" band.{first_problem(problem.records)} Ask record.check() for order, signs and units of"
        " torques and positions, or give ranges."
    )


def start_of_fit(problem: Problem, fit: TorqueFit) -> tuple[Floats, Floats]:
    """Values (k,) of all unknowns, those that the fit lacks as range or record have them; and a
    step for each.
    """
    values = problem.nominal.copy()
    step = np.abs(problem.nominal) * 0.02
    step[
        [i for i, name in enumerate(problem.unknown) if name.startswith(SPRINGS) and not step[i]]
    ] = _OF_ZERO
    for name, value in problem.known.items():
        values[problem.unknown.index(name)] = value
    for i, name in enumerate(problem.unknown):
        if name in fit.names:
            place = fit.names.index(name)
            values[i], step[i] = fit.values[place], fit.std[place]
    if problem.ranges is not None:
        step = np.where(step > 0, step, 0.01 * (problem.ranges[:, 1] - problem.ranges[:, 0]))
        step = np.where(problem.ranges[:, 0] == problem.ranges[:, 1], 0.0, step)
    return np.clip(values, *problem.bounds.T), step


def polished(
    problem: Problem,
    start: Floats,
    step: Floats,
    stages: dict[str, Floats],
    *,
    simulated: bool = False,
) -> Outcome:
    """The prediction error's fit from a start (the output error's, if simulated); the start where
    no arm comes of it.

    An arm is refused where D(q) leaves less than the motors' own inertia.
    """
    prediction = problem.prediction(
        simulated=simulated, zeros=problem.zeros, memories=problem.memories
    )
    k = len(start)
    bounds = np.vstack([problem.bounds, prediction.nuisance_bounds])
    steps = np.append(_SMALL * step, prediction.nuisance_steps)
    first = np.append(start, prediction.nuisances)
    gains = None if simulated else slice(k, k + 2 * problem.dynamics.n)
    solution = reweighed(
        prediction, _searched(problem, prediction, first, steps, bounds, gains), steps, bounds
    )
    rounding = None
    if prediction.rounds:
        solution, rounding = _unbiased(prediction, solution, bounds, problem.seed)
    values = solution.values[:k]
    reason = None
    arm, rig, _ = problem.parts(values)
    if not least_inertia_margin(problem.dynamics, rig, arm.f[None])[0] >= 0:
        reason = (
            "D(q) of the fit falls short of the motors' own inertia, Jm k^2; check motor_inertia,"
            " gears and motor_gain"
        )
        values = start
    resumptions = prediction.resumptions(solution.values) if problem.memories else ()
    found = None if simulated else solution.values[k : k + 2 * problem.dynamics.n]
    own = {"values": values, "fallback_reason": reason, "resumptions": resumptions, "gains": found}
    outcome = outcome_of(problem, prediction, solution, solution.values, stages, **own)
    grouped = _grouped(prediction, solution, k) if any(map(is_long, problem.records)) else None
    return dataclasses.replace(outcome, rounding=rounding, grouped=grouped)


def _searched(
    problem: Problem,
    prediction: Any,
    first: Floats,
    steps: Floats,
    bounds: Floats,
    gains: slice | None,
) -> Solution:
    """The best of the fits from a start, and from where that one ended: by stages, and with rotors
    as stated.

    Far from the log, with observer gains at their lower bounds, a fit no longer follows it. The
    inertia of a joint that is little more than its rotor's has a second optimum below zero.
    """
    staged = gains if problem.memories else None
    found = by_stages(prediction, first, steps, bounds, staged)
    far = gains is not None and staged is None and found.rms_innovation > _FAR
    if far and (found.values[gains] <= _AT_BOUND * bounds[gains, 0]).any():
        found = _better(found, prediction, found.values, steps, bounds, gains)
    values = found.values.copy()
    own = rotors_alone(problem.dynamics)
    arm, rig, _ = problem.parts(values[: len(problem.unknown)])
    places = [problem.unknown.index(problem.dynamics.names[place]) for place in own.values()]
    stated = rig.drive.reflected_inertia()[list(own)]
    values[places] = np.where(stated > 0, stated, values[places])
    unlike = np.abs(values - found.values)[places] > _UNLIKE * stated
    if unlike.any() or (
        own and not least_inertia_margin(problem.dynamics, rig, arm.f[None])[0] >= 0
    ):
        found = _better(found, prediction, np.clip(values, *bounds.T), steps, bounds, staged)
    return found


def _better(
    found: Solution, prediction: Any, values: Floats, steps: Floats, bounds: Floats, gains: Any
) -> Solution:
    """The fit, or that from these values."""
    with contextlib.suppress(ValueError):  # that start diverges
        return min(
            found,
            by_stages(prediction, values, steps, bounds, gains),
            key=lambda fit: fit.rms_innovation,
        )
    return found


def _grouped(prediction: Prediction, solution: Solution, unknown: int) -> Floats:
    """Standard deviations (k,) of the first so many unknowns, from how they differ between
    segments.
    """
    lengths = prediction.lengths
    found = np.zeros(len(solution.values))
    rows = slice(prediction.prior.count + sum(lengths))
    count = prediction.prior.count
    residual = (solution.residual / prediction.scales)[rows]
    found[solution.varied] = group_std(
        solution.slopes[rows], residual, in_groups(lengths, count, SEGMENTS)
    )
    return found[:unknown]


def fit_of(solution: Solution, unknown: tuple[str, ...], values: Floats, **more: Any) -> Fit:
    """Of the first unknowns of a Gauss-Newton, with these values (k,); `more`: further fields,
    in place of its own.
    """
    k = len(values)
    own: dict[str, Any] = {
        "covariance": solution.covariance[:k, :k],
        "rms_innovation": solution.rms_innovation,
    }
    return Fit(unknown=unknown, values=values, candidates=values[None], **own | more)


def outcome_of(
    problem: Problem,
    prediction: Prediction,
    solution: Solution,
    whole: Floats,
    stages: dict[str, Floats],
    **more: Any,
) -> Outcome:
    """Of a fit that follows the log; `whole` is what it found, nuisances too, and `more` are
    fields of the `Fit`.
    """
    k = len(problem.unknown)
    zeros = prediction.zeros_in(whole) if problem.zeros else None
    fit = fit_of(solution, problem.unknown, more.pop("values", whole[:k]), zeros=zeros, **more)
    message = (
        f"RMS innovation of {solution.rms_innovation:.3f} pulses (rounding alone gives 0.289)."
    )
    return Outcome(fit=fit, message=message, evaluations=prediction.evaluations, stages=stages)


def _unbiased(
    prediction: Prediction, solution: Solution, bounds: Floats, seed: int
) -> tuple[Solution, Floats | None]:
    """A solution less its bias by the rounding of counts, found on logs that the model makes itself
    and that round.

    At low speeds a loop feels single counts. That moves some unknowns by as much as their standard
    deviation. How far the values of these logs scatter says by how much the covariance errs, as far
    as innovations are rounding; the mean of both counts, since these logs have no other noise.

    Source: C. Gourieroux, A. Monfort, E. Renault, Indirect inference, Journal of Applied
    Econometrics 8, 1993.
    """
    values = solution.values
    random = np.random.default_rng([seed, _ROUNDED])
    shifts = random.uniform(-0.5, 0.5, (_ROUNDED, *prediction.shape))
    logs = _rounded(prediction, values, shifts, solution.residual / prediction.scales)
    if not logs:
        return solution, None
    names = [prediction.unknown[i] for i in solution.varied]
    inverse = least_squares(names, solution.slopes, logs[0], dependent=prediction.dependent)[1]
    found = [inverse @ np.einsum("mi,m->i", solution.slopes, log) for log in logs]
    values = values.copy()
    values[solution.varied] += np.mean(found, axis=0)
    noises = np.array([noise(prediction, log) for log in logs])
    squares = (found - np.mean(found, axis=0)) ** 2 / np.outer(noises, np.diag(inverse))
    ratio = squares.mean() * _ROUNDED / (_ROUNDED - 1)
    if count := prediction.prior.count:  # which does not scatter
        ratio /= 1 - np.mean(
            np.diag(inverse @ products(solution.slopes[:count]) @ inverse) / np.diag(inverse)
        )
    share = min(1.0, noises.mean() / noise(prediction, solution.residual / prediction.scales))
    scale = (1 + 1 / _ROUNDED) * (1 + share * (ratio - 1) / 2)
    covariance = scale * solution.covariance
    unbiased = dataclasses.replace(
        solution, values=np.clip(values, *bounds.T), covariance=covariance
    )
    return unbiased, sum(logs) / len(logs) * prediction.scales


def _rounded(
    prediction: Prediction, values: Floats, shifts: Floats, residual: Floats
) -> list[Floats]:
    """Weighted innovations (M,) of the logs that the model makes itself; none where it does not
    reproduce the log.

    How often a loop feels single counts moves its values. Other noise adds to a log's: where it has
    less than logs of a loop have, its own is faster.
    """
    found = list[Floats]()
    nearest = np.inf
    square = dot(residual, residual)
    for steps in RATES:
        try:
            logs = prediction.of_rounded(values, shifts, steps)
        except ValueError:
            return found
        own = sum(dot(log, log) for log in logs) / len(logs)
        if not np.isfinite(own):
            return found
        if abs(own - square) < nearest:
            found = logs
            nearest = abs(own - square)
        if square > (1 - _QUIETER) * own:
            break
    return found


def by_stages(
    prediction: Any, values: Floats, steps: Floats, bounds: Floats, gains: slice | None
) -> Solution:
    """Least sum of squares with observer gains that go down by stages, then are free; at once where
    these are None.

    With high gains the innovations are nearly linear in what is unknown of a law's memory; low ones
    tell most.
    """
    if gains is None:
        return gauss_newton(prediction, values, steps, bounds)
    found = list[Solution]()
    half = (gains.stop - gains.start) // 2
    kept = steps.copy()
    kept[gains] = 0
    for position in _STAGES:
        values = values.copy()
        values[gains] = np.repeat([position, _CRITICAL * position**2], half)
        try:
            found.append(gauss_newton(prediction, values, kept, bounds))
        except ValueError:
            if not found:
                raise
            break
        values = found[-1].values
    best = min(found, key=lambda solution: solution.rms_innovation)
    kept[gains] = _GAIN_STEP * best.values[gains]
    try:
        free = gauss_newton(prediction, best.values, kept, bounds)
    except ValueError:  # with gains this low unknowns are not separately identifiable
        return best
    return min(best, free, key=lambda solution: solution.rms_innovation)
