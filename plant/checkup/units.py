"""Unit and side of the torque: against its law, the amplifier's limit, the rotor inertia and the
stated friction.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.finding import Finding, unless
from plant.checkup.quantisation import comb
from plant.checkup.signals import Signals
from plant.checkup.tracking import correlation, law_slope

_SURE = 5.0  # standard deviations from which on a number is significant

_EXPLAINED = 0.9  # share of a torque's variance that its law explains

# Factor between torques that means another unit, not noise; relative error of a gain to look at.
_FACTOR = 3.0
_GAIN_OFF = 0.1

# Share of the amplifier's limit above which the unit is wrong; and that a log usually reaches.
_BEYOND = 1.05
_USED = 0.3

# Torque per acceleration [rotor inertias]: the least possible; that of a usual arm; and above which
# it is to be looked at, and wrong: no arm is geared so badly.
_LIGHT = 0.5
_USUAL = 3.0
_HEAVY = 300.0
_ABSURD = 3000.0

_ALIKE = 0.1  # relative difference of two factors that are one

_RUBS = 2.0  # standard deviations by which Coulomb friction must differ by that factor, too


def unit_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about the unit of torque."""
    yield from unless(signals.no_torque, ("units of torque",), signals.each(_units))


def _units(signals, i):
    name = "units of torque"
    drive = signals.rig.drive
    share = np.abs(signals.motor_torque[:, i]).max() / drive.motor_gain[i] / drive.current_limit[i]
    if share > _BEYOND and signals.torque is not None:
        advice = f"The torque is beyond the amplifier: {_guess(signals, share / _USED, i)}."
        return Finding.of(name, i, share, "of the limit", "wrong", advice)
    law = law_slope(signals, i)
    if law is not None and law[1] > _EXPLAINED:
        slope = abs(law[0])
        verdict = "fine" if 1 / _FACTOR < slope < _FACTOR else "wrong"
        advice = f"The torque is {slope:.3g} times the commanded one: {_guess(signals, slope, i)}."
        if (
            verdict == "fine"
            and abs(slope - 1) > _GAIN_OFF
            and correlation(signals, i, i) > 1 - _GAIN_OFF / 10
        ):
            verdict = "look"
            advice = (
                f"The torque is {slope:.3g} times the commanded one: check gain, motor gain and"
                " gear."
            )
        return Finding.of(name, i, slope, "of the law's", verdict, advice * (verdict != "fine"))
    stated = drive.motor_inertia[i]
    shown = signals.regression(i)
    if shown is None:
        return Finding.unknown(name, i, "too little motion, and no law that tells the torque")
    if abs(shown.inertia[i]) < _SURE * shown.inertia_std[i]:
        return Finding.unknown(
            name, i, "no acceleration that torque explains, and no law that tells the torque"
        )
    found = abs(shown.inertia[i]) / stated if stated else np.nan
    quiet = signals.noise[i] <= signals.least_count[i]  # else chatter masks friction
    rubs = _rubs(shown, drive.coulomb[i]) if quiet else None
    if found < _LIGHT or found > _HEAVY:
        verdict = "look" if _HEAVY < found < _ABSURD else "wrong"
        size = f"{found:.2g} of" if found < _LIGHT else f"{found:.3g} times"
        guess = _guess(signals, found / _USUAL if rubs is None else rubs, i)
        if rubs is None:
            guess += ", or the counts are of angles of the " + (
                "motor" if found < _LIGHT else "joint"
            )
        elif 1 / _FACTOR < rubs < _FACTOR:
            guess = (
                "friction is as stated, so look at the counts: resolution, and angles of motor or"
                " joint"
            )
        advice = f"Torque per acceleration is {size} the rotor inertia: {guess}."
        return Finding.of(name, i, found, "rotor inertias", verdict, advice)
    if rubs is not None and not 1 / _FACTOR < rubs < _FACTOR:
        guess = f"correct that if it was a guess; of the torque, {_guess(signals, rubs, i)}"
        advice = f"Coulomb friction is {rubs:.2g} of what the rig states: {guess}."
        return Finding.of(name, i, rubs, "of the Coulomb friction", "look", advice)
    if not stated:
        return Finding.unknown(name, i, "no rotor inertia stated, and no law that tells the torque")
    return Finding.of(name, i, found, "rotor inertias")


def _rubs(shown: Any, stated: float) -> float | None:
    """Coulomb friction found per stated; None where it is not significant."""
    if not stated:
        return None
    ratio = abs(shown.coulomb) / stated
    std = _RUBS * shown.coulomb_std / stated
    surely = std < ratio / 2 or ratio + std < 1 / _FACTOR or ratio - std > _FACTOR
    return max(ratio, 1e-9) if surely else None


def _guess(signals: Any, ratio: float, i: int) -> str:
    """The likeliest reasons for a wrong factor of joint i."""
    gain = np.log(signals.rig.drive.motor_gain[i])
    # a torque by the law is the larger one
    factor = np.log(ratio) if signals.torque is not None else -np.log(ratio)
    step, clear = comb(signals.counts[:, i])
    if (
        clear
        and step > 1 + _ALIKE
        and abs(factor + np.log(step)) < _ALIKE
        and not signals.rig.encoder.smooth
    ):
        return f"the counts come in steps of {step:.4g}, so correct the resolution"
    if abs(gain) > _ALIKE and abs(factor - gain) < _ALIKE and signals.commanded is not None:
        return "the gains of the law may be in A per pulse: multiply them by motor_gain"
    gear = abs(signals.rig.drive.gear[i])
    of_current = signals.record.torque is None
    reasons = {1e3: "it may be in mN m", 1e-3: "it may be in kN m"}
    if of_current:
        reasons = {1e3: "the current may be in mA", 1e-3: "the current may be in A, not in mA"}
    reasons |= {
        gear: "it may have crossed the gear twice",
        1 / gear: "it may be the motor's torque, not the joint's",
    }
    off = {reason: abs(np.log(ratio / factor)) for factor, reason in reasons.items()}
    near = sorted(
        (reason for reason in off if off[reason] < min(off.values()) + np.log(_FACTOR)),
        key=off.__getitem__,
    )
    return ", or ".join(near)
