"""Do the counts follow the reference: gear sign, swapped joints, delay."""

from __future__ import annotations

import numpy as np

from plant.checkup.balance import least_squares
from plant.checkup.finding import Finding
from plant.checkup.signals import FOLLOWS

__all__ = ["law_slope", "likeness", "reference_findings"]

_CLOSER = 0.5
"""Another joint's reference is the right one if it is closer by this factor."""

_LATE, _VERY_LATE = 0.25, 2.0
"""Delay [samples] to look at, and that ruins viscous friction for certain; and in standard deviations:"""

_SURE = 4.0

_HELD = 2.0
"""Delay [samples] that torque and motion alone do not tell: torque is held, drives take time, feedback has noise."""

_ACCELERATION = 3
"""Place of the reference's acceleration among the inputs of a law's step."""

_EXPLAINED = 0.8
"""Share of a torque that its law has to explain before its delay is read off it."""


def reference_findings(signals):
    """Yield the findings about counts and reference.

    Parameters
    ----------
    signals : Signals
    """
    if not signals.long_enough:
        for name in ("gear sign", "swapped joints", "delay"):
            yield Finding.unknown(name, None, "too short to compare speeds")
        return
    for check in (_sign, _swapped):
        if signals.reference is None:
            yield Finding.unknown({_sign: "gear sign", _swapped: "swapped joints"}[check], None, "no reference")
            continue
        for i in range(signals.n):
            yield check(signals, i)
    for i in range(signals.n):
        yield _delay(signals, i)


def _sign(signals, i):
    name, unit, run = "gear sign", "of the reference", signals.run[i]
    if not np.isfinite(run):
        return Finding.unknown(name, i, "the reference does not move")
    advice = f"The counts move {run:.3g} times as far as the reference: check resolution, gear and units of both."
    if run < -FOLLOWS:
        advice = "The counts run against the reference: change the sign of the gear, or of the counts."
    verdict = "fine" if abs(run - 1) <= FOLLOWS else "wrong"
    advice *= verdict != "fine"
    return Finding(check=name, joint=i, value=float(run), unit=unit, verdict=verdict, advice=advice)


def _swapped(signals, i):
    """Distance of the counts' speed from the reference's, relative to it; of another joint's, if that is closer."""
    made, asked = signals.motion[1][signals.clear, i], signals.asked_for[1][signals.clear]
    size = np.sqrt(np.mean(asked**2, axis=0))
    if not size[i]:
        return Finding.unknown("swapped joints", i, "the reference does not move")
    distance = np.sqrt(np.mean((asked - made[:, None]) ** 2, axis=0)) / np.where(size > 0, size, np.inf)
    distance[size == 0] = np.inf
    own, nearest = distance[i], int(np.argmin(distance))
    swapped = nearest != i and distance[nearest] < _CLOSER * min(own, 1.0)
    name, value, unit = "swapped joints", float(100 * own), "% off its reference"
    if not swapped:
        return Finding(check=name, joint=i, value=value, unit=unit, verdict="fine")
    advice = f"The counts follow joint {nearest}'s reference ({distance[nearest]:.0%} off): exchange the columns."
    return Finding(check=name, joint=i, value=value, unit=unit, verdict="wrong", advice=advice)


def _against_law(signals, i, j):
    """Logged torque of motor i against what the law asked of motor j.

    Late counts show as torque that goes with the speed, so slope and delay are found together.

    Returns
    -------
    slope, delay, delay_std, explained : float
        Logged per asked torque; counts behind torque [samples]; share of the logged torque's variance, explained so.
    """
    error = (signals.reference - signals.counts)[:, j]
    gain = (error @ signals.asked[:, j]) / max(error @ error, 1e-300)  # motor torque per pulse of a law without memory
    clear, (_, speed, acceleration) = signals.clear, signals.motion
    asked, logged = (signals.smooth(x[:, [k]])[clear, 0] for x, k in ((signals.asked, j), (signals.torque, i)))
    columns = np.column_stack([asked, gain * speed[clear, j], gain * acceleration[clear, j], np.ones(len(asked))])
    value, std = least_squares(columns, logged, signals.window)
    rest = logged - columns @ value
    slope = value[0]
    if not slope:
        return 0.0, 0.0, np.inf, 0.0
    explained = 1 - np.var(rest) / max(np.var(logged), 1e-300)
    return slope, -value[1] / slope / signals.interval, abs(std[1] / slope) / signals.interval, explained


def law_slope(signals, i):
    """Slope and explained share of the logged torque against its law; None where the record does not allow it."""
    if signals.asked is None or signals.torque is None or not signals.long_enough:
        return None
    slope, _, _, explained = _against_law(signals, i, i)
    return slope, explained


def likeness(signals, i, j):
    """Squared correlation of the logged torque of motor i with what the law asked of motor j."""
    logged, asked = signals.torque[:, i], signals.asked[:, j]
    if not (np.ptp(logged) and np.ptp(asked)):
        return 0.0
    return float(np.corrcoef(logged, asked)[0, 1] ** 2)


def _delay(signals, i):
    """How many samples the counts are late, by the sharpest way that the record allows."""
    name, unit = "delay", "samples"
    law, rig = signals.record.law, signals.rig
    if not signals.follows[i]:
        return Finding.unknown(name, i, "the counts do not follow the reference")
    if signals.asked is not None and signals.torque is not None:
        slope, late, std, explained = _against_law(signals, i, i)
        if explained < _EXPLAINED:
            return Finding.unknown(name, i, "the logged torque is not its law's")
        return _judged(i, late, std, "Counts and torque were not logged at the same time")
    balance = None if signals.balances is None else signals.balances[i]
    if signals.asked is not None:
        if balance is None:
            return Finding.unknown(name, i, "the motor hardly moves")
        error = (signals.reference - signals.counts)[:, i]
        gain = (error @ signals.asked[:, i]) / max(error @ error, 1e-300)
        per_sample = gain * signals.interval / rig.encoder.to_angle(np.ones(signals.n))[i]
        late = (balance.viscous - rig.drive.viscous[i]) / per_sample
        return _judged(i, late, balance.viscous_std / per_sample, "The error grows with speed, beyond stated friction")
    shown = signals.shown(i)
    driven = signals.torque is not None and shown is not None
    driven = driven and shown.inertia[i] > _SURE * shown.inertia_std[i]
    leads = law is not None and _feeds_forward(law, rig)
    if signals.reference is not None and (leads or not driven):
        speed = signals.asked_for[1][signals.clear, i]
        error = (signals.asked_for[0] - signals.motion[0])[signals.clear, i]
        value, std = least_squares(np.column_stack([speed, np.ones(len(speed))]), error, signals.window)
        late, std = value[0] / signals.interval, std[0] / signals.interval
        if not leads and abs(late) > _LATE:
            return Finding.unknown(name, i, "the law may lag by itself", value=late, unit=unit)
        return _judged(i, late, std, "The counts lag behind the reference")
    if signals.torque is None:
        return Finding.unknown(name, i, "neither reference nor torque")
    if not driven:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    why = "Motion comes after the torque that made it"
    return _judged(i, shown.delay, shown.delay_std, why, look=_HELD, wrong=np.inf)


def _feeds_forward(law, rig):
    """Whether a law acts on the acceleration of its reference; one that does not has to fall behind before it acts."""
    return law.block(rig).step.jac_sparsity(0, _ACCELERATION).nnz() > 0


def _judged(i, late, std, why, look=_LATE, wrong=_VERY_LATE):
    if max(std, abs(late)) > look and abs(late) <= _SURE * std:
        return Finding.unknown("delay", i, f"known to +-{std:.1f} samples only", value=late, unit="samples")
    size = f"{abs(late):.2g} samples (+-{std:.1g}) {'late' if late > 0 else 'early'}"
    return Finding.graded(
        "delay", i, late, "samples", look=max(look, _SURE * std), wrong=max(wrong, _SURE * std),
        advice=f"{why}: the counts are {size}; shift them before viscous friction is believed.",
    )  # fmt: skip
