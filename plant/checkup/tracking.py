"""Tracking of the reference by the counts: gear sign, swapped joints, delay."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plant.checkup.counts import hardly_asked
from plant.checkup.finding import Check, Finding, unless
from plant.checkup.law_delay import law_delays
from plant.checkup.signals import TRACKING, Signals
from plant.checkup.torque_regression import least_squares


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Limits of the checks of counts against reference, chosen by hand.

    ``tests/plant/checkup/test_examine.py`` holds them against twenty right logs and spoiled ones.

    Parameters
    ----------
    closer : float
        Error against another joint's reference [own error] below which that reference is the right
        one.
    unit : float
        Relative difference of the slope from that of another unit of angles.
    late, very_late : float
        Delay [samples] to look at, and above which viscous friction is biased beyond use.
    late_by_torque : float
        Delay [samples] that torque and motion alone cannot show: torque is held between samples,
        drives take time, feedback has noise.
    certain : float
        Standard deviations from which on a delay, or an inertia beside it, is significant.
    driven : float
        Standard deviations from which on the sign of an inertia shows which column is wrong.
    explained : float
        Share of a torque's variance that its law has to explain before a delay is estimated.
    """

    closer: float = 0.5
    unit: float = 0.05
    late: float = 0.25
    very_late: float = 2.0
    late_by_torque: float = 2.0
    certain: float = 4.0
    driven: float = 5.0
    explained: float = 0.8


SETTINGS = TrackingSettings()


def reference_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about counts and reference."""
    # Without a reference a delay may still show in torque and motion, so its reason is another one.
    short = "" if signals.long_enough else "too short to compare speeds"
    reason = short or ("no reference" if signals.reference is None else "")
    names = "swapped joints", "gear sign"
    yield from unless(reason, names, signals.per_joint(_swapped, _gear_sign))
    by_law = law_delays(signals)
    delays = (_delay(signals, i, by_law[i]) for i in range(signals.n))
    yield from unless(short, ("delay",), delays)


def _gear_sign(signals, i):
    """Slope of the counts' speed over the reference's: 1 of right columns."""
    check = Check("gear sign", i, "of the reference")
    slope = signals.tracking_slope[i]
    if not np.isfinite(slope):
        return check.unknown("the reference does not move")
    # Friction may hold the joint, and then its slope is that of noise.
    if hardly_asked(signals.record)[i]:
        return check.unknown("the reference hardly moves")
    # The slope against another joint's reference has no meaning.
    if not _swapped(signals, i).ok:
        return check.unknown("the counts are another joint's")
    if abs(slope - 1) <= TRACKING:
        return check.fine(slope)
    # A negative slope is a sign; any other wrong slope is a unit, a gear or a resolution.
    if slope < -TRACKING:
        hint, column = _turned_column(signals, i)
        cause = f"The counts run against the reference{hint}"
        return check.wrong_sign(slope, cause, column)
    advice = (
        f"The counts move {slope:.3g} times as far as the reference: check resolution, gear and"
        " units of both"
    )
    for angle, radians in (("degrees", np.pi / 180), ("turns", 2 * np.pi)):
        if abs(slope / radians - 1) < SETTINGS.unit:
            advice += f" (as if the reference were in {angle}, and read in rad)"
    return check.wrong(slope, f"{advice}.")


def _turned_column(signals, i):
    """What the torque does to the counts, as a clause, and the column whose sign must be wrong."""
    counts = signals.column("counts", i)
    regression = None if signals.torque is None else signals.regression(i)
    if regression is not None:
        inertia = regression.inertia[i]
        least = SETTINGS.driven * regression.inertia_std[i]
        # Torque accelerates the counts forwards: both are right, and the reference is not.
        if inertia > least:
            return ", and along with the torque", signals.column("reference", i)
        if inertia < -least:
            return ", and against the torque", f"{counts}, or of the gear"
    # Without a torque nothing separates the reference from the counts.
    return "", f"the gear, or of {counts}"


def _swapped(signals, i):
    """Relative RMS error of the counts' speed, and whether another joint's reference fits better.

    Columns may be swapped as counts, or as angles that each other's gears converted to counts.
    """
    check = Check("swapped joints", i, "% off its reference")
    counts = signals.motion.speed[signals.clear]
    reference = signals.smooth_reference.speed[signals.clear]
    size = np.sqrt(np.mean(reference**2, axis=0))
    if not size[i]:
        return check.unknown("the reference does not move")
    error = np.full(signals.n, np.inf)
    angle = signals.rig.to_angle
    # Speeds in pulses, and then as angles of the joints.
    pairs = (counts, reference), (angle(counts), angle(reference))
    for speed, references in pairs:
        off = np.sqrt(np.mean((references - speed[:, i][:, None]) ** 2, axis=0))
        rms = np.sqrt(np.mean(references**2, axis=0))
        # fmin leaves out the NaN of a reference at rest.
        error = np.fmin(error, off / np.where(size > 0, rms, np.nan))
    percent = 100 * error[i]
    nearest = int(np.argmin(error))
    # An error above 1 is worse than no motion at all: do not compare with it.
    if nearest == i or error[nearest] >= SETTINGS.closer * min(error[i], 1.0):
        return check.fine(percent)
    joint = f"{signals.joint_labels[nearest]} ({error[nearest]:.0%} off)"
    return check.wrong(
        percent, f"The counts follow the reference of {joint}: exchange the columns."
    )


class LawFit(NamedTuple):
    """Regression of the logged torque of a motor on the commanded one.

    `slope`: logged per commanded torque. `delay`, `delay_std`: of the counts [samples].
    `explained`: share of the logged torque's variance.
    """

    slope: float
    delay: float
    delay_std: float
    explained: float


def law_fit(signals: Signals, i: int) -> LawFit | None:
    """Fit the logged torque of motor i by that of its law; None without both.

    Late counts show as torque in proportion to speed, so slope and delay are found together.
    """
    if signals.commanded is None or signals.torque is None or not signals.long_enough:
        return None
    # The gain [N m/pulse] of a law without memory turns a shift of the counts into torque.
    error = (np.asarray(signals.reference) - signals.counts)[:, i]
    gain = (error @ signals.commanded[:, i]) / max(error @ error, 1e-300)
    clear = signals.clear
    # The same filter on both sides, so that it cancels.
    commanded = signals.smooth(signals.commanded[:, [i]])[clear, 0]
    logged = signals.smooth(signals.torque[:, [i]])[clear, 0]
    speed = gain * signals.motion.speed[clear, i]
    acceleration = gain * signals.motion.acceleration[clear, i]
    # Delay d: counts(t - d) = counts - d speed + d^2/2 acceleration; the last column is an offset.
    columns = np.column_stack([commanded, speed, acceleration, np.ones(len(commanded))])
    value, std = least_squares(columns, logged, signals.window)
    slope = value[0]
    if not slope:
        return LawFit(0.0, 0.0, np.inf, 0.0)
    residual = logged - columns @ value
    return LawFit(
        slope=slope,
        delay=-value[1] / slope / signals.interval,
        delay_std=abs(std[1] / slope) / signals.interval,
        explained=1 - np.var(residual) / max(np.var(logged), 1e-300),
    )


def correlation(signals, i: int, j: int) -> float:
    """Squared correlation of the logged torque of motor i with the commanded one of motor j."""
    logged = signals.torque[:, i]
    commanded = signals.commanded[:, j]
    # A constant column has no correlation.
    if not (np.ptp(logged) and np.ptp(commanded)):
        return 0.0
    return float(np.corrcoef(logged, commanded)[0, 1] ** 2)


def _delay(signals, i, by_law):
    """Delay of the counts [samples] by the most accurate estimate that the record allows."""
    # A law with memory was run along the log, which shows whole samples without an error.
    if not np.isnan(by_law):
        return _judged(
            i, by_law, 0.0, "The law gives the logged torque from other rows of the counts"
        )
    if not signals.tracks[i]:
        return Check("delay", i).unknown("the counts do not follow the reference")
    # Each estimate that the record does not allow is None; the last one always gives a finding.
    estimates = _delay_of_torque, _delay_of_error, _delay_of_reference, _delay_of_motion
    findings = (estimate(signals, i) for estimate in estimates)
    return next(finding for finding in findings if finding is not None)


def _delay_of_torque(signals, i):
    """Delay by logged and commanded torque: the best estimate, to a hundredth of a sample."""
    fit = law_fit(signals, i)
    if fit is None:
        return None
    if fit.explained < SETTINGS.explained:
        return Check("delay", i).unknown("the logged torque is not its law's")
    return _judged(
        i, fit.delay, fit.delay_std, "Counts and torque were not logged at the same time"
    )


def _delay_of_error(signals, i):
    """Delay by the commanded torque alone: error that grows with speed, beyond stated friction."""
    if signals.commanded is None:
        return None
    regression = signals.regressions[i]
    if regression is None:
        return Check("delay", i).unknown("the motor hardly moves")
    delay, std = _delay_beyond_friction(signals)
    finding = _judged(i, delay[i], std[i], "The error grows with speed, beyond stated friction")
    # Late counts and viscous friction both add torque in proportion to speed; the jerk separates
    # them.
    if finding.ok or _jerk_shows_delay(signals):
        return finding
    advice = (
        "Viscous friction is not the rig's: the error grows with speed, and not with the jerk that"
        " late counts add."
    )
    return Check("viscous friction", i, "N m s/rad of the motor").look(regression.viscous, advice)


def _delay_of_reference(signals, i):
    """Delay behind the reference, under a law that feeds its acceleration forward.

    Other laws lag by themselves: they say something only where the torque does not.
    """
    if signals.reference is None or signals.smooth_reference is None:
        return None
    law = signals.record.law
    leads = law is not None and _feeds_forward(law, signals.rig)
    # The torque gives a better estimate.
    if not leads and _is_driven(signals, i):
        return None
    clear = signals.clear
    speed = signals.smooth_reference.speed[clear, i]
    error = (signals.smooth_reference.counts - signals.motion.counts)[clear, i]
    columns = np.column_stack([speed, np.ones(len(speed))])
    # A delay d is an error d times the speed.
    value, std = least_squares(columns, error, signals.window)
    delay = value[0] / signals.interval
    # Only a small lag is informative under such a law: then the counts are in time.
    if not leads and abs(delay) > SETTINGS.late:
        return Check("delay", i, "samples").unknown("the law itself may lag", delay)
    return _judged(i, delay, std[0] / signals.interval, "The counts lag behind the reference")


def _delay_of_motion(signals, i):
    """Delay by torque and motion alone: a rough estimate, and the last."""
    check = Check("delay", i)
    if signals.torque is None:
        return check.unknown("neither reference nor torque")
    if not _is_driven(signals, i):
        return check.unknown("no acceleration that torque explains")
    fit = signals.regression(i)
    evidence = "Motion comes after the torque that made it"
    # This estimate has a bias of its own, so it never says "wrong".
    look = SETTINGS.late_by_torque
    return _judged(i, fit.delay, fit.delay_std, evidence, look=look, wrong=np.inf)


def _is_driven(signals, i):
    """Whether the logged torque accelerates the motor, significantly."""
    fit = None if signals.torque is None else signals.regression(i)
    return fit is not None and fit.inertia[i] > SETTINGS.certain * fit.inertia_std[i]


def _delay_beyond_friction(signals):
    """Delay (n,) [samples] that torque beyond stated friction means, and its std; NaN at rest."""
    error = signals.reference - signals.counts
    angle_per_pulse = signals.rig.encoder.to_angle(np.ones(signals.n))
    gain = (error * signals.commanded).sum(axis=0) / np.maximum((error**2).sum(axis=0), 1e-300)
    # Viscous friction [N m s/rad] that looks like a delay of one sample.
    per_sample = gain * signals.interval / angle_per_pulse
    beyond = np.full(signals.n, np.nan)
    std = np.full(signals.n, np.nan)
    for i, regression in enumerate(signals.regressions):
        if regression is not None:
            beyond[i] = regression.viscous - signals.rig.drive.viscous[i]
            std[i] = regression.viscous_std
    return beyond / per_sample, std / np.abs(per_sample)


def _jerk_shows_delay(signals):
    """Whether the torque changes with the jerk, as of late counts, rather than with speed alone.

    Over all joints, the delay by the jerk is regressed on the delay by friction: 1 of late counts,
    0 of more friction.
    """
    by_friction, _ = _delay_beyond_friction(signals)
    rows = [
        (delay, regression.delay, regression.delay_std)
        for delay, regression in zip(by_friction, signals.regressions, strict=True)
        if regression
    ]
    delay, by_jerk, std = np.array(rows).T
    return bool((delay * by_jerk / std**2).sum() > 0.5 * (delay**2 / std**2).sum())


def _feeds_forward(law, rig):
    """Whether a law feeds the reference's acceleration forward; others need an error to act."""
    # Input 3 of a law's step is the reference's acceleration, output 0 the torque.
    return bool(law.block(rig).step.jac_sparsity(0, 3).nnz() > 0)


def _judged(i, delay, std, evidence, look=SETTINGS.late, wrong=SETTINGS.very_late):
    """Judge a delay [samples] with its standard deviation."""
    check = Check("delay", i, "samples")
    # A delay that matters, or may matter, but is not significant.
    if max(std, abs(delay)) > look and abs(delay) <= SETTINGS.certain * std:
        return check.unknown(f"known to +-{std:.1f} samples only", delay)
    # A delay in whole samples has no standard deviation.
    within = f"(+-{std:.1g}) " if std else ""
    samples = "sample" if abs(delay) == 1 else "samples"
    direction = "late" if delay > 0 else "early"
    cause = f"{evidence}: the counts are {abs(delay):.2g} {samples} {within}{direction}"
    return check.graded(
        delay,
        f"{cause}; shift them, or viscous friction will be wrong.",
        look=max(look, SETTINGS.certain * std),
        wrong=max(wrong, SETTINGS.certain * std),
        cause=cause,
    )
