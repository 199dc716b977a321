"""Tracking of the reference by the counts: gear sign, swapped joints, delay."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.counts import hardly_asked
from plant.checkup.finding import Finding, unless
from plant.checkup.law_delay import law_delays
from plant.checkup.signals import TRACKING, Signals
from plant.checkup.torque_regression import least_squares
from plant.machine.rig import Rig

_CLOSER = 0.5  # another joint's reference is the right one if its error is smaller by this factor

# Delay [samples] to look at, and that biases viscous friction beyond use; and in standard
# deviations:
_LATE = 0.25
_VERY_LATE = 2.0

_SURE = 4.0

_DRIVEN = 5.0  # standard deviations from which on the sign of an inertia is significant

_RUBS = (
    "Viscous friction is not the rig's: the error grows with speed, and not with the jerk that late"
    " counts add."
)

# Delay [samples] that torque and motion alone cannot tell: torque is held, drives take time,
# feedback has noise.
_HELD = 2.0

_ACCELERATION = 3  # place of the reference's acceleration among the inputs of a law's step

# share of a torque's variance that its law has to explain before a delay is estimated from it
_EXPLAINED = 0.8


def reference_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about counts and reference."""
    short = "" if signals.long_enough else "too short to compare speeds"
    why = short or ("no reference" if signals.reference is None else "")
    yield from unless(why, ("swapped joints", "gear sign"), signals.each(_swapped, _sign))
    late = law_delays(signals)
    yield from unless(short, ("delay",), signals.each(lambda _, i: _late(signals, i, late[i])))


def _sign(signals, i):
    name = "gear sign"
    unit = "of the reference"
    slope = signals.tracking_slope[i]
    if not np.isfinite(slope):
        return Finding.unknown(name, i, "the reference does not move")
    if hardly_asked(signals.record)[i]:
        return Finding.unknown(name, i, "the reference hardly moves")
    if not _swapped(signals, i).ok:
        return Finding.unknown(name, i, "the counts are another joint's")
    alike = [
        unit
        for unit, factor in (("degrees", np.pi / 180), ("turns", 2 * np.pi))
        if abs(slope / factor - 1) < 0.05
    ]
    advice = (
        f"The counts move {slope:.3g} times as far as the reference: check resolution, gear and"
        " units of both"
    )
    advice += f" (as if the reference were in {alike[0]}, and read in rad)." if alike else "."
    if slope < -TRACKING:
        advice = f"The counts run against the reference{_turned(signals, i)}."
    if abs(slope - 1) <= TRACKING:
        return Finding.of(name, i, slope, unit)
    return Finding.of(name, i, slope, unit, "wrong", advice)


def _turned(signals: Signals, i: int) -> str:
    """Which column has the wrong sign where counts and reference disagree, by what the torque
    does to the counts.
    """
    counts = signals.column("counts", i)
    reference = signals.column("reference", i)
    shown = None if signals.torque is None else signals.regression(i)
    if shown is not None and shown.inertia[i] > _DRIVEN * shown.inertia_std[i]:
        return f", and along with the torque: change the sign of {reference}"
    if shown is not None and shown.inertia[i] < -_DRIVEN * shown.inertia_std[i]:
        return f", and against the torque: change the sign of {counts}, or of the gear"
    return f": change the sign of the gear, or of {counts}"


def _swapped(signals, i):
    """Relative RMS error of the counts' speed against the reference; the joint whose reference fits
    better, if any.

    Columns may be swapped as counts, or as angles that were converted to counts by each other's
    gears.
    """
    made = signals.motion[1][signals.clear]
    commanded = signals.smooth_reference[1][signals.clear]
    size = np.sqrt(np.mean(commanded**2, axis=0))
    if not size[i]:
        return Finding.unknown("swapped joints", i, "the reference does not move")
    error = np.full(signals.n, np.inf)
    angle = signals.rig.to_angle
    for own_speed, asked in ((made[:, i], commanded), (angle(made)[:, i], angle(commanded))):
        off = np.sqrt(np.mean((asked - own_speed[:, None]) ** 2, axis=0))
        error = np.fmin(error, off / np.where(size > 0, np.sqrt(np.mean(asked**2, axis=0)), np.nan))
    own = error[i]
    nearest = int(np.argmin(error))
    verdict = "fine"
    advice = ""
    if nearest != i and error[nearest] < _CLOSER * min(own, 1.0):
        other = f"{signals.joint_labels[nearest]} ({error[nearest]:.0%} off)"
        verdict = "wrong"
        advice = f"The counts follow the reference of {other}: exchange the columns."
    return Finding.of("swapped joints", i, 100 * own, "% off its reference", verdict, advice)


def _against_law(signals, i, j):
    """Regression of the logged torque of motor i on the commanded one of j: slope, delay, its std,
    explained share.

    Late counts show as torque in proportion to speed, so slope and delay (of the counts [samples])
    are found together.
    """
    error = (signals.reference - signals.counts)[:, j]
    # [N m/pulse], of a law without memory
    gain = (error @ signals.commanded[:, j]) / max(error @ error, 1e-300)
    clear, (_, speed, acceleration) = signals.clear, signals.motion
    asked, logged = (
        signals.smooth(x[:, [k]])[clear, 0]
        for x, k in ((signals.commanded, j), (signals.torque, i))
    )
    columns = np.column_stack(
        [asked, gain * speed[clear, j], gain * acceleration[clear, j], np.ones(len(asked))]
    )
    value, std = least_squares(columns, logged, signals.window)
    residual = logged - columns @ value
    slope = value[0]
    if not slope:
        return 0.0, 0.0, np.inf, 0.0
    explained = 1 - np.var(residual) / max(np.var(logged), 1e-300)
    return (
        slope,
        -value[1] / slope / signals.interval,
        abs(std[1] / slope) / signals.interval,
        explained,
    )


def law_slope(signals: Signals, i: int) -> tuple[float, float] | None:
    """Logged per commanded torque, and explained share of its variance; None where the record
    does not allow it.
    """
    if signals.commanded is None or signals.torque is None or not signals.long_enough:
        return None
    slope, _, _, explained = _against_law(signals, i, i)
    return slope, explained


def correlation(signals: Any, i: int, j: int) -> float:
    """Squared correlation of the logged torque of motor i with the commanded one of motor j."""
    logged = signals.torque[:, i]
    commanded = signals.commanded[:, j]
    if not (np.ptp(logged) and np.ptp(commanded)):
        return 0.0
    return float(np.corrcoef(logged, commanded)[0, 1] ** 2)


def _late(signals, i, by_law):
    """Delay of the counts [samples], as a law with memory tells it, or as `_delay` does where
    that is NaN.
    """
    if np.isnan(by_law):
        return _delay(signals, i)
    return _judged(i, by_law, 0.0, "The law gives the logged torque from other rows of the counts")


def _delay(signals, i):
    """Delay of the counts [samples], by the most accurate estimate that other records allow."""
    name = "delay"
    unit = "samples"
    law = signals.record.law
    rig = signals.rig
    if not signals.tracks[i]:
        return Finding.unknown(name, i, "the counts do not follow the reference")
    if signals.commanded is not None and signals.torque is not None:
        slope, late, std, explained = _against_law(signals, i, i)
        if explained < _EXPLAINED:
            return Finding.unknown(name, i, "the logged torque is not its law's")
        return _judged(i, late, std, "Counts and torque were not logged at the same time")
    if signals.commanded is not None:
        if (regression := signals.regressions[i]) is None:
            return Finding.unknown(name, i, "the motor hardly moves")
        late, std = (x[i] for x in _beyond_friction(signals))
        judged = _judged(i, late, std, "The error grows with speed, beyond stated friction")
        if judged.ok or _adds_jerk(signals):
            return judged
        return Finding.of(
            "viscous friction", i, regression.viscous, "N m s/rad of the motor", "look", _RUBS
        )
    shown = signals.regression(i)
    driven = signals.torque is not None and shown is not None
    driven = driven and shown.inertia[i] > _SURE * shown.inertia_std[i]
    leads = law is not None and _feeds_forward(law, rig)
    if signals.reference is not None and (leads or not driven):
        speed = signals.smooth_reference[1][signals.clear, i]
        error = (signals.smooth_reference[0] - signals.motion[0])[signals.clear, i]
        value, std = least_squares(
            np.column_stack([speed, np.ones(len(speed))]), error, signals.window
        )
        late = value[0] / signals.interval
        std = std[0] / signals.interval
        if not leads and abs(late) > _LATE:
            return Finding.unknown(name, i, "the law itself may lag", value=late, unit=unit)
        return _judged(i, late, std, "The counts lag behind the reference")
    if signals.torque is None:
        return Finding.unknown(name, i, "neither reference nor torque")
    if not driven:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    why = "Motion comes after the torque that made it"
    return _judged(i, shown.delay, shown.delay_std, why, look=_HELD, wrong=np.inf)


def _beyond_friction(signals):
    """Delay (n,) of the counts [samples] for which torque beyond stated friction stands, and its
    std; NaN at rest.
    """
    error = signals.reference - signals.counts
    per_pulse = signals.rig.encoder.to_angle(np.ones(signals.n))
    gain = (error * signals.commanded).sum(axis=0) / np.maximum((error**2).sum(axis=0), 1e-300)
    beyond, std = np.full((2, signals.n), np.nan)
    for i, each in enumerate(signals.regressions):
        if each is not None:
            beyond[i], std[i] = each.viscous - signals.rig.drive.viscous[i], each.viscous_std
    return beyond / (gain * signals.interval / per_pulse), std / np.abs(
        gain * signals.interval / per_pulse
    )


def _adds_jerk(signals):
    """Whether the torque changes with jerk as late counts have it, rather than not, as under
    more friction.
    """
    late, _ = _beyond_friction(signals)
    rows = [
        (x, each.delay, each.delay_std)
        for x, each in zip(late, signals.regressions, strict=True)
        if each
    ]
    x, seen, std = np.array(rows).T
    return bool((x * seen / std**2).sum() > 0.5 * (x**2 / std**2).sum())


def _feeds_forward(law: Any, rig: Rig) -> bool:
    """Whether a law feeds the acceleration of its reference forward; one that does not needs an
    error to act on.
    """
    return bool(law.block(rig).step.jac_sparsity(0, _ACCELERATION).nnz() > 0)


def _judged(i, late, std, why, look=_LATE, wrong=_VERY_LATE):
    if max(std, abs(late)) > look and abs(late) <= _SURE * std:
        return Finding.unknown(
            "delay", i, f"known to +-{std:.1f} samples only", value=late, unit="samples"
        )
    sure = f"(+-{std:.1g}) " if std else ""
    size = (
        f"{abs(late):.2g} {'sample' if abs(late) == 1 else 'samples'}"
        f" {sure}{'late' if late > 0 else 'early'}"
    )
    advice = f"{why}: the counts are {size}; shift them, or viscous friction will be wrong."
    look = max(look, _SURE * std)
    wrong = max(wrong, _SURE * std)
    return Finding.graded("delay", i, late, "samples", look=look, wrong=wrong, advice=advice)
