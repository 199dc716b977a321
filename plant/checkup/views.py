"""Findings of the checks that the table of hypotheses covers: causes, and what is measured."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.counts import hardly_asked
from plant.checkup.delays import delays, feeds_forward, lag
from plant.checkup.finding import Check, Finding, unless
from plant.checkup.hypothesis import SELECTION, Cause, Ranking
from plant.checkup.innovation import LEAST_MOTION
from plant.checkup.score import SETTINGS, Experiment
from plant.checkup.signals import TRACKING, Signals
from plant.checkup.trials import Trials
from plant.checkup.undo import counts_in_time
from plant.checkup.without_arm import SWITCHES

CAUSES = "swapped joints", "gear sign", "delay", "drive sign", "swapped torques", "units of torque"
"""Checks that every table lists: by their causes, else by what `measured_findings` measures."""

# A delay of which viscous friction is biased beyond use [samples], and one to look at.
_VERY_LATE, _LATE = 2.0, 0.25

# Factor between torques that means another unit, not a number of the machine.
_OTHER_UNIT = 3.0

# Standard deviations from which on an inertia, or a friction, is significant.
_CERTAIN = 5.0


def cause_findings(ranking: Ranking[Experiment]) -> Iterator[Finding]:
    """Yield a finding of each cause and joint that it concerns, the likeliest cause first."""
    for k, cause in enumerate(ranking.causes):
        # The log before this cause is undone, and after it.
        before = ranking.experiments[k]
        after = ranking.experiments[k + 1]
        joints: Any = cause.joints or range(before.n)
        # Encoders and clock belong to the rig: one finding, not one per joint.
        if cause.check in ("rounding", "period"):
            joints = (None,)
        # Both joints of an exchange have a finding, with the same advice.
        for i in joints:
            value, unit = _measured(cause, before, after, i)
            check = Check(cause.check, i, unit)
            judge = check.look if _harmless(cause) else check.wrong
            yield judge(value, cause.line)


def _harmless(cause: Cause) -> bool:
    """Whether a cause is to be looked at: a parameter, or a small error that an arm may have."""
    # Friction is a number that an identification finds; a wrong guess of it is no mistake of a log.
    if not cause.certain or cause.name.endswith("friction"):
        return True
    if cause.check == "delay":
        return abs(cause.size) <= _VERY_LATE
    return cause.name in ("gain", "torque scale") and 1 / _OTHER_UNIT < cause.size < _OTHER_UNIT


def _measured(cause, before, after, i):
    """The measured value of a cause at joint i, and its unit."""
    if cause.check == "swapped joints":
        # `tracking` is a share of the variance: its root is the share that a plot shows.
        return 100 * np.sqrt(before.tracking[i]), "% off its reference"
    if cause.check == "gear sign":
        return before.signals.tracking_slope[i], "of the reference"
    if cause.check == "drive sign":
        if before.torques_of_law is not None:
            return _law_slope(before, i), "of the law's"
        # With the right sign the inertia is certain to be positive; as logged it is its negative.
        return -after.motions[i].inertia if after.motions else None, "kg m^2"
    if cause.check == "swapped torques":
        # How much of the torque the joint's own motion explains, before the exchange.
        return 100 * (1 - before.motions[i].unexplained) if before.motions else None, "% explained"
    if cause.check == "units of torque":
        if cause.name == "Coulomb friction":
            return cause.size, "of the Coulomb friction"
        if before.torques_of_law is not None:
            return abs(_law_slope(before, i)), "of the law's"
        return _rotor_inertias(before, i), "rotor inertias"
    # 1 and -1 are no factors but the direction; the factor that was forgotten is the gear.
    if cause.check in ("units of counts", "quantisation step") and cause.size in (1.0, -1.0):
        return abs(before.record.rig.drive.gear[i]) if "motor" in cause.name else None, ""
    if cause.check == "viscous friction":
        return before.motions[i].viscous, "N m s/rad of the motor"
    return cause.size, cause.unit


def _law_slope(experiment, i):
    """Logged over commanded torque of a joint."""
    commanded, logged = (table[:, i] for table in experiment.torques_of_law)
    # Least squares through zero: an amplifier that is off by a factor has no offset.
    return float(commanded @ logged / max(commanded @ commanded, 1e-300))


def _rotor_inertias(experiment, i):
    rotor = experiment.record.rig.drive.motor_inertia[i]
    if experiment.motions is None or not rotor:
        return None
    return experiment.motions[i].inertia / rotor


# -- joints without a cause ------------------------------------------------------------------------
def measured_findings(experiment: Experiment, caused: set[tuple[str, Any]]) -> Iterator[Finding]:
    """Yield the findings of checks and joints without a cause, by what is measured.

    `caused`: checks and joints that have a finding.
    """
    signals = experiment.signals
    short = "" if signals.long_enough else "too short to compare speeds"
    reference = short or ("no reference" if signals.reference is None else "")
    # Every check has its line in the table, with a reason where it could not be made.
    reasons = {
        "swapped joints": (reference, _tracking),
        "gear sign": (reference, _slope),
        "delay": (short, _delay),
        "drive sign": (signals.no_torque, _inertia),
        "swapped torques": (signals.no_torque, _explained),
        "units of torque": (signals.no_torque, _units),
        "saturation": (signals.no_torque, _saturated),
    }
    for name, (reason, judge) in reasons.items():
        joints = [i for i in range(experiment.n) if (name, i) not in caused]
        if joints:
            yield from unless(reason, (name,), (judge(experiment, i) for i in joints))


def _tracking(experiment, i):
    check = Check("swapped joints", i, "% off its reference")
    if not np.isfinite(experiment.signals.tracking_slope[i]):
        return check.unknown("the reference does not move")
    return check.fine(100 * np.sqrt(experiment.tracking[i]))


def _slope(experiment, i):
    check = Check("gear sign", i, "of the reference")
    slope = experiment.signals.tracking_slope[i]
    if not np.isfinite(slope):
        return check.unknown("the reference does not move")
    # Friction may hold the joint, and then its slope is that of noise.
    if hardly_asked(experiment.record)[i]:
        return check.unknown("the reference hardly moves")
    if abs(slope - 1) <= TRACKING:
        return check.fine(slope)
    cause = "of no known cause"
    if (limited := _at_limit(experiment, i)) > _LIMITED:
        cause = (
            f"with the amplifier at its limit in {limited:.3g}% of the samples: the path asks"
            " for more than the motor gives. Check its unit, since degrees are 57.3 times radians"
        )
    return check.look(slope, f"The counts move {slope:.3g} times as far as the reference, {cause}.")


def _saturated(experiment, i):
    """Share of samples at the amplifier's limit [%]."""
    drive = experiment.record.rig.drive
    limit = drive.current_limit[i]
    # An infinite limit means that the rig states none.
    if not np.isfinite(limit):
        return Check("saturation", i, "%").unknown("no current limit stated")
    torque = experiment.signals.torque
    if torque is not None:
        largest = float(np.abs(torque[:, i]).max() / drive.motor_gain[i])
        if largest > BEYOND_LIMIT * limit:
            return Check("saturation", i, "%").wrong(
                _at_limit(experiment, i),
                f"The logged torque takes {largest:.3g} A, beyond the stated limit of {limit:g} A:"
                " correct current_limit, or the unit of the torque.",
            )
    return Check("saturation", i, "%").graded(
        _at_limit(experiment, i),
        f"The amplifier is at its limit of {limit:g} A: slow the motion down, or lower the gains.",
        look=_SATURATED,
        wrong=_LIMITED,
    )


def _at_limit(experiment, i):
    """Share of the samples in which the torque is at the amplifier's limit [%]."""
    if experiment.torque is None:
        return 0.0
    drive = experiment.record.rig.drive
    current = np.abs(experiment.torque[:, i]) / drive.motor_gain[i]
    return 100 * float(np.mean(current >= AT_LIMIT * drive.current_limit[i]))


# Share of the amplifier's limit from which on it is saturated.
AT_LIMIT = 0.999

# Share of the amplifier's limit above which a logged torque shows another limit, and no noise of a
# sensor.
BEYOND_LIMIT = 1.2

# Saturated samples [%] to look at, and from which on the log shows the limit alone.
_SATURATED, _LIMITED = 1.0, 50.0


def _delay(experiment, i):
    check = Check("delay", i, "samples")
    signals = experiment.signals
    # A delay against a motion that was not asked for has no meaning. Without a reference `tracks`
    # is true of every joint, and the torque decides.
    if not signals.tracks[i]:
        return Check("delay", i).unknown("the counts do not follow the reference")
    if experiment.torques_of_law is not None or (
        signals.torque is not None and experiment.motions is not None
    ):
        # With a torque the score sees the phase of counts and torque, which is the sharpest
        # measure.
        value, std = _delay_by_score(experiment, i)
    elif not experiment.has_memory and (delay := experiment.once(delays)) is not None:
        if (ratio := _friction(experiment, i, "viscous")) is not None and ratio > _OTHER_UNIT:
            return _other_viscous(experiment, i, ratio)
        value, std = delay.by_jerk[i], delay.jerk_std[i]
    elif signals.reference is None:
        return Check("delay", i).unknown("neither reference nor torque")
    else:
        value, std = lag(experiment, i)
        if not feeds_forward(experiment) and abs(value) > _LATE:
            return check.unknown("the law itself may lag", value)
    if not np.isfinite(value):
        return Check("delay", i).unknown("the motor hardly moves")
    if not np.isfinite(std):
        return Check("delay", i).unknown("no delay fits the log best")
    if max(std, abs(value)) > _LATE:
        return check.unknown(f"known to +-{max(std, abs(value)):.1f} samples only", value)
    return check.fine(value)


def _delay_by_score(experiment, i):
    """The likeliest delay and its standard deviation: the vertex of the score's parabola."""
    # Three scores make a parabola: half a sample to both sides, where it is still one.
    early, late = (
        experiment.changed(counts_in_time(experiment.record, (i,), step)).score - experiment.score
        for step in (-0.5, 0.5)
    )
    curvature = -(early + late) / 0.5**2
    if curvature <= 0:
        return 0.0, np.inf
    return float(np.clip((late - early) / curvature, -9, 9)), float(curvature**-0.5)


def _inertia(experiment, i):
    check = Check("drive sign", i, "kg m^2")
    if experiment.motions is None or not np.isfinite(experiment.motions[i].inertia_std):
        return check.unknown("too little motion")
    motion = experiment.motions[i]
    # A wrong sign makes this inertia negative; one that may be zero shows no sign.
    if motion.inertia < _CERTAIN * motion.inertia_std:
        return check.unknown("no acceleration that torque explains", motion.inertia)
    return check.fine(motion.inertia)


def _explained(experiment, i):
    check = Check("swapped torques", i, "% explained")
    # A single joint has no other one with which its torque could be exchanged.
    if experiment.n == 1:
        return check.unknown("one joint")
    if experiment.motions is None or not np.isfinite(experiment.motions[i].inertia_std):
        return check.unknown("too little motion")
    return check.fine(100 * (1 - experiment.motions[i].unexplained))


def _units(experiment, i):
    check = Check("units of torque", i, "rotor inertias")
    # Steps of a current from sample to sample are noise, which longer steps exceed.
    unexplained = experiment.command
    if experiment.slow_command is not None:
        unexplained = np.minimum(unexplained, experiment.slow_command)
    if unexplained is not None and unexplained[i] < SETTINGS.like:
        return Check("units of torque", i, "of the law's").fine(abs(_law_slope(experiment, i)))
    size = _rotor_inertias(experiment, i)
    if size is None:
        return check.unknown("no rotor inertia stated, and no law that tells the torque")
    if not size > 0:
        told = "no law that tells the torque"
        if experiment.command is not None:
            told = "the stated law does not give the logged torque"
        return check.unknown(f"no acceleration that torque explains, and {told}")
    motion = experiment.motions[i]
    # A motor that others move tells neither its inertia nor its friction.
    significant = motion.inertia > _CERTAIN * motion.inertia_std
    if significant and size > _HEAVY:
        return check.look(
            size,
            f"Torque per acceleration is {size:.3g} times the rotor inertia:"
            f" {_likely_units(experiment)}.",
        )
    friction = _friction(experiment, i, "coulomb") if significant else None
    if friction is not None and not 1 / _OTHER_UNIT < friction < _OTHER_UNIT:
        return Check("units of torque", i, "of the Coulomb friction").look(
            friction,
            f"Coulomb friction is {friction:.2g} of what the rig states: correct that if it"
            f" was a guess, or {_likely_units(experiment)}.",
        )
    # Noise of a current hides the torque of a law as well as a wrong gain does.
    if experiment.command is not None:
        return check.unknown(
            "a plausible inertia, but the stated law does not give the logged torque", size
        )
    return check.fine(size)


# Torque per acceleration [rotor inertias] to look at: no arm is geared so badly.
_HEAVY = 300.0


def _friction(experiment, i, name):
    """Friction of a joint over the stated one; None where it is not significant."""
    motion = experiment.motions[i]
    stated, value = getattr(experiment.record.rig.drive, name)[i], getattr(motion, name)
    if not stated or value < _CERTAIN * getattr(motion, f"{name}_std"):
        return None
    return float(value / stated)


def _other_viscous(experiment, i, ratio):
    """A viscous friction that is not the rig's, by the torque of the law."""
    return Check("viscous friction", i, "N m s/rad of the motor").look(
        experiment.motions[i].viscous,
        f"Viscous friction is {ratio:.2g} times the stated one: correct that if it was a guess.",
    )


def _likely_units(experiment):
    """Mistakes of units that the score prefers to what is stated, the likeliest first."""
    return experiment.once(_units_by_score) or "check the units of the torque"


def _units_by_score(experiment):
    # Switches alone: a factor of any size would always explain the torque best.
    trials = Trials([row for row in SWITCHES if row.check in _UNITS])
    ranked = sorted(trials(experiment), key=lambda candidate: -candidate.log_odds)
    # Without the odds against each: the torque is known to be odd, and only the reason is asked.
    gains = [candidate.log_odds + candidate.hypothesis.against for candidate in ranked]
    likely = [
        f"{candidate.hypothesis.sentence[0].lower()}{candidate.hypothesis.sentence[1:]}"
        for candidate, gain in zip(ranked, gains, strict=True)
        if gain > max(gains[0] - SELECTION.undecided, 0.0)
    ]
    return ", or ".join(dict.fromkeys(likely))


_UNITS = "units of torque", "units of counts", "quantisation step"


# -- one column mapped to two joints ---------------------------------------------------------------
def copied_columns(signals: Signals, i: int) -> Finding:
    """Whether an earlier joint has the same columns, as they are or as angles."""
    check = Check("copied columns", i)
    # Earlier joints only, so that one of the two keeps its column.
    for j in range(i):
        remedy = f"as {signals.joint_labels[j]}: one column was mapped to both."
        if _same_counts(signals, j, i):
            return check.wrong(None, f"The same counts {remedy}")
        if _same_torque(signals, j, i):
            return check.look(None, f"The same torque {remedy}")
    return check.fine()


def _same_counts(signals, i, j):
    """Whether two joints move alike, to a pulse, although their references differ."""
    moved = signals.counts - signals.counts[0]
    # Two joints at rest are alike for another reason.
    if np.ptp(moved[:, i]) < LEAST_MOTION * signals.least_count[i]:
        return False
    # One column mapped twice differs by its rounding in the two gears.
    pulse = np.abs(np.diag(signals.rig.to_angle(np.eye(signals.n))))

    def alike(pulses):
        # Magnitudes, since the gears of the two joints may have different signs.
        angle = np.abs(signals.rig.to_angle(pulses))
        return bool(np.abs(angle[:, i] - angle[:, j]).max() <= pulse[i] + pulse[j])

    if signals.reference is not None:
        # Joints that were asked for the same motion may well make it.
        commanded = signals.reference - signals.reference[0]
        if alike(commanded):
            return False
    return bool((moved[:, i] == moved[:, j]).all()) or alike(moved)


def _same_torque(signals, i, j):
    for table in (signals.record.torque, signals.record.current):
        # Constant columns are alike in any log of a joint without a load.
        if table is not None and np.ptp(table[:, i]) and (table[:, i] == table[:, j]).all():
            return True
    return False
