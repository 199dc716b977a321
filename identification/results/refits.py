"""Fits of a model with one more cause, which begin at the estimate of its score test.

A change of a length is taken over by f almost completely, and the rest is less than the error of a
torque along a smoothed motion. So each length needs a loop of its own.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identification.replay import Optimum, fitted
from identification.results.alternatives import (
    ArmHypothesis,
    Point,
    Sign,
    effect_of_delay,
    effect_of_length,
    linear,
)
from identification.results.assumed import longer
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class RefitSettings:
    """Limits and iterations of the fits.

    The values were chosen by hand. They are held by ``tests/benchmarks/silent_mistakes.py``: of a
    length of 0.45 for 0.35 m, an error of -20 to -24 % is reported in 10 of 10 logs (-22 % is
    right).

    Parameters
    ----------
    as_good : float
        Share of its linear estimate that a fit must explain; otherwise it begins again nearer.
    step : float
        Step of the central differences of a cause, relative to its first estimate.
    stiff, soft : float
        Resonances [Hz] between which the first estimate of a compliance is limited.
    steepness : float
        Decrease of the missing length per length that is put in, at least.
    missing : float
        Relative error of a length below which the iteration ends.
    trials : int
        Lengths that are put in, at most.
    delay : float
        Delay [samples] above which counts are not late, but something else is wrong.
    shifts : int
        Estimates of a delay, each beside the previous one.
    """

    as_good: float = 0.9
    step: float = 0.03
    stiff: float = 400.0
    soft: float = 15.0
    steepness: float = 0.5
    missing: float = 0.01
    trials: int = 3
    delay: float = 1.0
    shifts: int = 3


SETTINGS = RefitSettings()


class Refit(NamedTuple):
    """A model with one more cause, fitted: its sign, optimum, and steps (m,) of the unknowns."""

    sign: Sign
    at: Optimum
    step: Floats


def compared(
    hypothesis: ArmHypothesis, point: Point, sign: Sign, at: Optimum, step: Floats
) -> Refit:
    """A fit with the sum of squares that it explains, against the present optimum."""
    # In the sum of squares itself: the linear estimate of a score test promises more.
    explained = point.at.squares - at.squares
    # A gear with backlash moves in and out of contact: the fit may end beside its own trial.
    if hypothesis.gears:
        explained = max(explained, sign.explained)
    chi_square = explained / at.evidence_unit(at.innovations)
    sign = replace(sign, explained=explained, chi_square=chi_square)
    return Refit(sign, at, step)


def moved(
    hypothesis: ArmHypothesis, point: Point, sign: Sign, *, begin_nearer: bool = True
) -> Refit | None:
    """The model with these numbers, fitted from their estimates; None if it diverges."""
    place = point.at.model.place
    moves = np.zeros(len(point.at.values))
    step = point.step.copy()
    for name, value in sign.values.items():
        moves[place(name)] = value
        # A difference must be small against the effect, whose size the estimate gives.
        step[place(name)] = SETTINGS.step * abs(value)
    try:
        refit = _from(hypothesis, point, sign, moves, step)
    except ValueError:  # it diverges: rigid gears have made the inertias too small
        return None
    if not begin_nearer or refit.sign.explained > SETTINGS.as_good * sign.explained:
        return refit
    # The fit explains less than its linear estimate promises, as where joints stick and the
    # estimate is far too large: begin on the way to it.
    change = np.sum([value * point.effects[name] for name, value in sign.values.items()], axis=0)
    nearer = _from(hypothesis, point, sign, point.at.towards(moves, change, point.bounds), step)
    return max(refit, nearer, key=lambda refit: refit.sign.explained)


def _from(hypothesis, point, sign, moves, step):
    """The model with a cause, fitted from the present values moved by so much (m,)."""
    # Sensitivities of the present optimum can be reused if its varied unknowns come first.
    varied = np.flatnonzero(point.step)
    reusable = np.array_equal(np.flatnonzero(step)[: len(varied)], varied)
    start = point.at if reusable else None
    optimum = fitted(point.at.model, point.at.values + moves, step, point.bounds, start)
    return compared(hypothesis, point, sign, optimum, step)


def sprung(hypothesis: ArmHypothesis, point: Point, sign: Sign) -> Refit | None:
    """All gears give at once, each at least a little; failing that, those of the estimate."""
    gears = [name for name in point.at.model.extra if hypothesis.has(name)]
    for names in (gears, list(sign.values)):
        # Gears without an estimate begin at the stiff end.
        values = {
            name: float(np.clip(sign.values.get(name, 0), SETTINGS.stiff**-2, SETTINGS.soft**-2))
            for name in names
        }
        refit = moved(hypothesis, point, replace(sign, values=values), begin_nearer=False)
        if refit is not None:
            return refit._replace(sign=replace(refit.sign, values=sign.values))
    return None


def played(hypothesis: ArmHypothesis, point: Point, sign: Sign) -> Refit | None:
    """The model with backlash of the trial's width, which has no derivative, and its trial."""
    moves = np.zeros(len(point.at.values))
    step = point.step.copy()
    for name, value in sign.values.items():
        i = point.at.model.place(name)
        moves[i] = value
        step[i] = 0.0
    try:
        return _from(hypothesis, point, sign, moves, step)
    except ValueError:  # it diverges
        return None


def pushed(hypothesis: ArmHypothesis, point: Point, sign: Sign) -> Refit | None:
    """The model beside the torques of a sign, fitted; None if it diverges."""
    whole = _beside(hypothesis, point, sign, 1.0)
    if whole is not None and whole.sign.explained > SETTINGS.as_good * sign.explained:
        return whole
    # Where joints stick, the estimate is too large by about two.
    half = _beside(hypothesis, point, sign, 0.5)
    fits = [fit for fit in (whole, half) if fit is not None]
    if len(fits) == 2:
        # What is explained is a parabola of the share that is pushed, with nothing at zero.
        ends, middle = (fit.sign.explained for fit in fits)
        bend = 8 * middle - 4 * ends
        share = (4 * middle - ends) / bend if bend > 0 else 0.0
        best = _beside(hypothesis, point, sign, share) if 0 < share < 1 else None
        fits += [] if best is None else [best]
    return max(fits, key=lambda fit: fit.sign.explained, default=None)


def _beside(hypothesis, point, sign, share):
    """The model beside a share of the torques of a sign, fitted; None if it diverges."""
    sign = replace(sign, values={name: share * value for name, value in sign.values.items()})
    # The torques of a sign add up, record by record.
    scaled = [
        [value * torque for torque in point.torques[name]] for name, value in sign.values.items()
    ]
    try:
        model = point.at.model.pushed([sum(terms) for terms in zip(*scaled, strict=True)])
        optimum = fitted(model, point.at.values, point.step, point.bounds, point.at)
    except ValueError:
        return None
    return compared(hypothesis, point, sign, optimum, point.step)


def lengthened(hypothesis: ArmHypothesis, point: Point, sign: Sign) -> Refit | None:
    """The model of a chain with that length, fitted; None if it diverges.

    A length does not act linearly, so the secant method finds where nothing of it is missing: the
    missing part is estimated beside each trial.
    """
    at = point.at
    ((name, share),) = sign.values.items()
    previous = 0.0
    missing = share
    trials: list[Refit] = []
    optimum = at
    try:
        while len(trials) < SETTINGS.trials and abs(missing) > SETTINGS.missing:
            # A chain with the present estimate of the length.
            model = at.model.of(longer(at.model.dynamics, share)[name])
            optimum = fitted(model, optimum.values, point.step, point.bounds)
            trial = replace(sign, values={name: share})
            trials.append(compared(hypothesis, point, trial, optimum, point.step))
            effect = effect_of_length(optimum, name)
            still_missing = sum(
                estimate.values[name]
                for estimate in linear(hypothesis, replace(point, at=optimum), {name: effect})
            )
            # A flat secant would step far away: its slope is limited.
            slope = min((still_missing - missing) / (share - previous), -SETTINGS.steepness)
            previous = share
            missing = still_missing
            share = share - still_missing / slope
    except ValueError:
        return None
    # The secant can step away from the best one.
    return max(trials, key=lambda trial: trial.sign.explained)


def in_time(hypothesis: ArmHypothesis, point: Point, sign: Sign) -> Refit | None:
    """The model of counts that are in time, fitted; None where it does not follow them."""
    at = point.at
    delay = 0.0
    optimum = at
    estimate = sign
    start: Optimum | None = at
    # Each estimate is beside the counts that are corrected so far.
    for _ in range(SETTINGS.shifts):
        delay += estimate.values[hypothesis.name]
        if abs(delay) > SETTINGS.delay:
            return None
        try:
            model = at.model.late(-delay)
            # Late counts have moved the unknowns: after the first shift the sensitivities of the
            # optimum before it would leave the rest of the delay in them.
            optimum = fitted(model, optimum.values, point.step, point.bounds, start)
            start = None if start is at else optimum
        except ValueError:  # the model diverges beside these counts
            return None
        effect = effect_of_delay(optimum)
        if np.isfinite(effect).all():
            beside = replace(point, at=optimum)
            estimate = next(linear(hypothesis, beside, {hypothesis.name: effect}), estimate)
    return compared(
        hypothesis, point, replace(estimate, values={hypothesis.name: delay}), optimum, point.step
    )
