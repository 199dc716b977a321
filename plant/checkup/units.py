"""Unit and side of the torque: against law, amplifier limit, rotor inertia and stated friction."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from plant.checkup.finding import Check, Finding, unless
from plant.checkup.quantisation import comb
from plant.checkup.signals import Signals
from plant.checkup.tracking import correlation, law_fit


@dataclass(frozen=True, kw_only=True)
class UnitSettings:
    """Limits of the checks of the torque's unit, chosen by hand.

    ``tests/benchmarks/silent_mistakes.py`` counts the wrong gains and units that are found.

    Parameters
    ----------
    certain : float
        Standard deviations from which on an inertia is significant.
    explained : float
        Share of a torque's variance that its law explains.
    other_unit : float
        Factor between torques that means another unit, not noise.
    gain_error : float
        Relative error of a gain to look at; a tenth of it is the noise that may hide it.
    beyond : float
        Share of the amplifier's limit above which the unit is wrong.
    used : float
        Share of the amplifier's limit that a log usually reaches.
    light : float
        Least possible torque per acceleration [rotor inertias].
    usual : float
        That of a usual arm [rotor inertias].
    heavy, absurd : float
        That to look at, and above which it is wrong: no arm is geared so badly [rotor inertias].
    alike : float
        Relative difference of two factors that are one.
    friction_error : float
        Standard deviations by which Coulomb friction must differ by `other_unit`, too.
    """

    certain: float = 5.0
    explained: float = 0.9
    other_unit: float = 3.0
    gain_error: float = 0.1
    beyond: float = 1.05
    used: float = 0.3
    light: float = 0.5
    usual: float = 3.0
    heavy: float = 300.0
    absurd: float = 3000.0
    alike: float = 0.1
    friction_error: float = 2.0


SETTINGS = UnitSettings()

_NAME = "units of torque"


def unit_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about the unit of torque."""
    yield from unless(signals.no_torque, (_NAME,), signals.per_joint(_units))


def _units(signals, i):
    """Compare the torque with the first of these yardsticks that the record has."""
    check = Check(_NAME, i, "rotor inertias")
    drive = signals.rig.drive

    # 1. A logged torque cannot exceed the amplifier's limit.
    share = np.abs(signals.motor_torque[:, i]).max() / drive.motor_gain[i] / drive.current_limit[i]
    if share > SETTINGS.beyond and signals.torque is not None:
        guess = _likely_units(signals, share / SETTINGS.used, i)
        return Check(_NAME, i, "of the limit").wrong(
            share, f"The torque is beyond the amplifier: {guess}."
        )

    # 2. The commanded torque is exact where the law explains the logged one.
    fit = law_fit(signals, i)
    if fit is not None and fit.explained > SETTINGS.explained:
        return _against_law(signals, i, abs(fit.slope))

    # 3. Torque per acceleration lies between the rotor inertia and that of a badly geared arm.
    stated = drive.motor_inertia[i]
    regression = signals.regression(i)
    if regression is None:
        return check.unknown("too little motion, and no law that tells the torque")
    if abs(regression.inertia[i]) < SETTINGS.certain * regression.inertia_std[i]:
        return check.unknown(
            "no acceleration that torque explains, and no law that tells the torque"
        )
    inertia = abs(regression.inertia[i]) / stated if stated else np.nan
    friction = None
    # Noise makes the sign of the speed change at random, which hides the friction.
    if signals.noise[i] <= signals.least_count[i]:
        friction = _friction_ratio(regression, drive.coulomb[i])
    if inertia < SETTINGS.light or inertia > SETTINGS.heavy:
        return _against_rotor(signals, i, inertia, friction)

    # 4. Coulomb friction as stated; a look, since the statement is often a guess.
    if friction is not None and not _same_unit(friction):
        guess = _likely_units(signals, friction, i)
        advice = (
            f"Coulomb friction is {friction:.2g} of what the rig states: correct that if it was a"
            f" guess; of the torque, {guess}."
        )
        return Check(_NAME, i, "of the Coulomb friction").look(friction, advice)
    if not stated:
        return check.unknown("no rotor inertia stated, and no law that tells the torque")
    return check.fine(inertia)


def _same_unit(factor):
    """Whether a factor between two torques is not that of another unit."""
    return 1 / SETTINGS.other_unit < factor < SETTINGS.other_unit


def _against_law(signals, i, slope):
    """Judge the logged per commanded torque."""
    check = Check(_NAME, i, "of the law's")
    advice = f"The torque is {slope:.3g} times the commanded one: "
    if not _same_unit(slope):
        advice += f"{_likely_units(signals, slope, i)}."
        return check.wrong(slope, advice)
    # A small error of the gain counts only where noise cannot cause it.
    noise = SETTINGS.gain_error / 10
    if abs(slope - 1) > SETTINGS.gain_error and correlation(signals, i, i) > 1 - noise:
        advice += "check gain, motor gain and gear."
        return check.look(slope, advice)
    return check.fine(slope)


def _against_rotor(signals, i, inertia, friction):
    """An impossible torque per acceleration [rotor inertias]: torque or counts are wrong.

    Friction as stated shows that the torque is right.
    """
    # No motor has less inertia than its rotor.
    light = inertia < SETTINGS.light
    verdict = "look" if SETTINGS.heavy < inertia < SETTINGS.absurd else "wrong"
    size = f"{inertia:.2g} of" if light else f"{inertia:.3g} times"
    # Without a significant friction, torque and counts are both open.
    if friction is None:
        angles = "motor" if light else "joint"
        guess = (
            f"{_likely_units(signals, inertia / SETTINGS.usual, i)}, or the counts are of angles of"
            f" the {angles}"
        )
    elif _same_unit(friction):
        guess = (
            "friction is as stated, so look at the counts: resolution, and angles of motor or joint"
        )
    else:
        guess = _likely_units(signals, friction, i)
    return Check(_NAME, i, "rotor inertias").finding(
        inertia, verdict, f"Torque per acceleration is {size} the rotor inertia: {guess}."
    )


def _friction_ratio(regression, stated):
    """Estimated per stated Coulomb friction; None where it is not significant."""
    if not stated:
        return None
    ratio = abs(regression.coulomb) / stated
    error = SETTINGS.friction_error * regression.coulomb_std / stated
    # Certain enough, or beyond another unit in any case.
    above = ratio - error > SETTINGS.other_unit
    below = ratio + error < 1 / SETTINGS.other_unit
    # A ratio of zero has no logarithm in `_likely_units`.
    return max(ratio, 1e-9) if error < ratio / 2 or below or above else None


def _likely_units(signals, ratio, i):
    """The likeliest reasons for a torque of joint i that is so many times too large."""
    gain = np.log(signals.rig.drive.motor_gain[i])
    # The ratio of a torque that is the law's is that of the law, which is the larger one.
    factor = np.log(ratio) if signals.torque is not None else -np.log(ratio)
    # A coarse resolution scales the counts, and so the torque per count.
    step, clear = comb(signals.counts[:, i])
    coarse = clear and step > 1 + SETTINGS.alike and not signals.rig.encoder.smooth
    if coarse and abs(factor + np.log(step)) < SETTINGS.alike:
        return f"the counts come in steps of {step:.4g}, so correct the resolution"
    # Gains in A in place of N m differ by the motor gain.
    geared = abs(gain) > SETTINGS.alike and abs(factor - gain) < SETTINGS.alike
    if geared and signals.commanded is not None:
        return "the gains of the law may be in A per pulse: multiply them by motor_gain"

    # All reasons whose factor is as near to the ratio as the nearest, to a factor of another unit.
    gear = abs(signals.rig.drive.gear[i])
    reasons = {1e3: "it may be in mN m", 1e-3: "it may be in kN m"}
    if signals.record.torque is None:
        reasons = {1e3: "the current may be in mA", 1e-3: "the current may be in A, not in mA"}
    # A gear of 1000 replaces the unit of the same factor.
    reasons[gear] = "it may have crossed the gear twice"
    reasons[1 / gear] = "it may be the motor's torque, not the joint's"
    # Distances in logarithms: half as much is as far as twice as much.
    distance = {reason: abs(np.log(ratio / factor)) for factor, reason in reasons.items()}
    limit = min(distance.values()) + np.log(SETTINGS.other_unit)
    likely = [reason for reason in distance if distance[reason] < limit]
    return ", or ".join(sorted(likely, key=distance.__getitem__))
