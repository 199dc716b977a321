"""What can be wrong with a log, its rig or its law, as far as no model of the arm is needed.

One row per mistake: its words, how to undo it in a record, and the odds against it (natural
logarithm). `plant.checkup.trials` scores all rows against a log, and adds a user's own rows.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from plant.checkup.counts_evidence import (
    edges_evidence,
    grid_evidence,
    period_evidence,
    radian_evidence,
    rounding_evidence,
    steps_evidence,
    time_unit_evidence,
)
from plant.checkup.delays import (
    DELAYS,
    delay_evidence,
    delay_sizes,
    reference_delay_evidence,
    reference_delays,
    torque_delays,
)
from plant.checkup.gain_units import UNITS, gain_sizes
from plant.checkup.gains_by_motion import (
    all_gains,
    all_gains_evidence,
    limit_evidence,
    single_gain_evidence,
    unit_of_gain_evidence,
)
from plant.checkup.hypothesis import Hypothesis, Joints, each_joint, pairs
from plant.checkup.integrals import lacking_integral_evidence, no_integral_evidence
from plant.checkup.law_motion import law_period_evidence, law_periods
from plant.checkup.law_parts import GAINS, other_gains
from plant.checkup.sizes import (
    command_ratios,
    friction_ratios,
    inverse_slopes,
    rated_shares,
    slopes,
    torque_ratios,
    used_limits,
)
from plant.checkup.torque_evidence import (
    gains_evidence,
    gravity_evidence,
    model_evidence,
    rate_evidence,
    viscous_evidence,
    zeros_evidence,
)
from plant.checkup.undo import (
    counted_edges,
    counted_in_steps,
    counts_in_time,
    exchanged_counts,
    exchanged_references,
    exchanged_torques,
    filter_in_hertz,
    gains_in_ampere,
    lower_limit,
    other_friction,
    other_gain,
    other_law_period,
    other_limit,
    other_period,
    other_resolution,
    other_rounding,
    other_time_unit,
    rated_torque,
    reference_in_time,
    rescaled_torque,
    scaled_both,
    scaled_counts,
    scaled_reference,
    scaled_torque,
    shifted_reference,
    signed_magnitude,
    torques_in_time,
    turned_counts,
    turned_error,
    turned_gear,
    turned_motion,
    turned_reference,
    turned_torque,
    with_counts,
    with_gravity,
    with_integral,
    with_rate,
    without_integral,
    without_model,
    without_torque,
)
from plant.checkup.zeros import median_errors, zero_evidence

# Measurements that distinguish rows which explain a log alike.
_LOAD = "Hold a known load: the torque is its weight times its lever."
_RIGHT_ANGLE = "Turn a joint by a right angle, and compare the counts."
_BLOCKED = "Block a motor at a known error: its torque is the gain times the error."
_CLOCK = "Compare the duration of the log with a clock."
_STEP = "Log a step of torque at rest: the counts move from the next sample on."


def _exchanges() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: columns of two joints that are exchanged."""
    columns = {
        "counts": exchanged_counts,
        "references": exchanged_references,
        "torques": exchanged_torques,
    }
    for name, undo in columns.items():
        yield Hypothesis(
            name=f"exchanged {name}",
            check="swapped torques" if name == "torques" else "swapped joints",
            sentence=f"The {name} of {{joint}} and {{other}} are exchanged",
            remedy="Exchange the columns.",
            undo=undo,
            measurement="Move one joint alone: its columns are those that change.",
            scope=pairs,
            # Exchanged as pulses, or as the angles of two joints whose gears differ.
            sizes=(0.0, 1.0),
            # A log usually has its torques in the order of its counts: an exchange is unlikely.
            against=8.0 if name == "torques" else 5.0,
        )


def exchanged_encoders(record: Any, joints: Joints, size: float) -> Any:
    """Exchange the counts of the encoders on motor and link of a joint."""
    links = record.link_counts
    if links is None or np.isnan(links[:, joints[0]]).any():
        raise ValueError("the record must have an encoder on this link; it has none. Map it.")
    chosen = np.isin(np.arange(record.n), joints)
    changed = with_counts(record, np.where(chosen, links, record.counts))
    return replace(changed, link_counts=np.where(chosen, record.counts, links))


def _encoders() -> Iterator[Hypothesis[Any]]:
    """Yield the row: encoders of a motor and its link that are exchanged."""
    yield Hypothesis(
        name="exchanged encoders",
        check="swapped joints",
        sentence="The encoders of motor and link of {joint} are exchanged",
        remedy="Exchange the columns.",
        undo=exchanged_encoders,
        measurement="Block the link, and move the motor: its encoder alone counts.",
        # A robot with two encoders at each joint logs both under names that are alike.
        scope=each_joint,
    )


def _turns() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: columns with the wrong sign."""
    signs = {
        "torque": ("drive sign", turned_torque),
        # Without an arm the same as a turned torque; one column is turned more often than two.
        "counts and reference": ("drive sign", turned_motion),
        "error": ("drive sign", turned_error),
        "counts": ("gear sign", turned_counts),
        "reference": ("gear sign", turned_reference),
        # The gear converts angles alone, so that its sign turns one column where the other is
        # logged in counts.
        "gear": ("gear sign", turned_gear),
    }
    for name, (check, undo) in signs.items():
        plural = " and " in name or name == "counts"
        of_all = name if plural else f"{name}s"
        verb = "have" if plural else "has"
        columns = " and ".join(f"{{{column}}}" for column in name.split(" and "))
        # Two columns are turned less often than one.
        against = 6.0 if " and " in name else 5.0
        yield Hypothesis(
            name=f"turned {name}",
            check=check,
            sentence=f"The {name} of {{joint}} {verb} the wrong sign",
            remedy=f"Change the sign of {'the gear' if name == 'gear' else columns}.",
            undo=undo,
            measurement=_LOAD,
            scope=each_joint,
            against=against,
        )
        # A driver or a reader may well change the sign of all joints at once.
        if name != "gear":
            yield Hypothesis(
                name=f"turned {name} of all joints",
                check=check,
                sentence=f"The {of_all} of all joints have the wrong sign",
                remedy=f"Change the sign of {columns} of every joint.",
                undo=undo,
                measurement=_LOAD,
                scope=several,
                against=against,
            )


def _units_of_torque() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: torques and currents in other units.

    A logged number times the factor is what the record should hold [N m of the joint, A].
    """
    units = {
        # Data sheets of small motors, and of large robots.
        "in mN m": ("torque", lambda rig: 1e-3),
        "in kN m": ("torque", lambda rig: 1e3),
        # Drives know the motor's side; a reader may convert what was converted already.
        "the motor's torque, not the joint's": ("torque", lambda rig: np.abs(rig.drive.gear)),
        "a torque that crossed the gear twice": ("torque", lambda rig: 1 / np.abs(rig.drive.gear)),
        # Most drives measure a current, and call it effort or torque.
        "a motor current in A": (
            "torque",
            lambda rig: np.abs(rig.drive.gear) * rig.drive.motor_gain,
        ),
        # Drives on a field bus scale their torques by a rated one.
        "per mille of the amplifier's limit": (
            "torque",
            lambda rig: rig.drive.torque_limit() / 1e3,
        ),
        "per cent of the amplifier's limit": (
            "torque",
            lambda rig: rig.drive.torque_limit() / 1e2,
        ),
        "in mA": ("current", lambda rig: 1e-3),
        "in A, not in mA": ("current", lambda rig: 1e3),
    }
    for unit, (column, factor) in units.items():
        # Motors are coupled to joints by what the drive states: such units are of the shafts.
        of_motors = "motor" in unit or "limit" in unit
        yield Hypothesis(
            name=f"{column} {unit}",
            check="units of torque",
            sentence=f"The {column} is {unit}",
            remedy="State its unit, or convert it.",
            undo=scaled_torque(factor, column, of_shafts=of_motors),
            measurement=_LOAD,
            # A motor's torque may have the direction of the motor.
            sizes=(1.0, -1.0) if of_motors else (1.0,),
            against=8.0,
        )


def _kinds_of_torque() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: a logged torque that is another quantity."""
    yield Hypothesis(
        name="torque without gravity",
        check="units of torque",
        sentence="The torque is one of which gravity is taken out",
        remedy="Log the torque with gravity; some drivers take it out by default.",
        undo=with_gravity,
        measurement="Log a pose at rest: the torque holds the arm.",
        evidence=gravity_evidence,
        scored=True,
        # A torque that depends on the pose explains a part of many other mistakes, too.
        against=20.0,
    )
    yield Hypothesis(
        name="torque of zeros",
        check="units of torque",
        sentence="The torque is zero throughout",
        remedy="Log it, or leave the column out.",
        # Some drivers fill a column that they do not measure.
        undo=without_torque,
        evidence=zeros_evidence,
    )
    yield Hypothesis(
        name="torque of a model",
        check="units of torque",
        sentence="The torque is not measured but of a model: it lacks the law's dry friction",
        remedy="Log what the drive measures, or leave the column out.",
        # Planners and simulators export the torque of their model.
        undo=without_model,
        measurement="Turn a joint slowly: its measured torque jumps where it turns back.",
        evidence=model_evidence,
        against=8.0,
    )
    yield Hypothesis(
        name="torque per mille of the rated one",
        check="units of torque",
        sentence="The torque is in per mille of the rated one, {value:.3g} times the limit",
        remedy="State its unit, or convert it.",
        undo=rated_torque,
        measurement=_LOAD,
        # The rated torque is no number of the rig, so its share of the limit is estimated.
        suggested=rated_shares,
        against=8.0,
    )
    yield Hypothesis(
        name="torque without sign",
        check="units of torque",
        sentence="The logged torque is a magnitude without a sign, as an RMS current is; times"
        " {value:.3g} it is that of the law",
        remedy="Log the signed torque or current.",
        undo=signed_magnitude,
        measurement=_LOAD,
        # A drive states the RMS of a phase, or the peak that its sine has.
        sizes=(1.0, 2**0.5),
        against=8.0,
    )


def _units_of_both() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: counts and reference in other units.

    A logged number divided by the factor is what the record should hold [counts].
    """
    gears = lambda rig: np.abs(rig.drive.gear)  # noqa: E731
    both = {
        # Both columns come from one reader, so that the error has the same unit.
        "in degrees, not in radians": ("units of counts", lambda rig: 180 / np.pi),
        "in turns, not in radians": ("units of counts", lambda rig: 1 / (2 * np.pi)),
        # A gear that was not applied, or twice.
        "angles of the motor": ("quantisation step", gears),
        "angles of the joint": ("units of torque", lambda rig: 1 / gears(rig)),
        # Lines of an encoder for its edges, or the reverse.
        "of a resolution four times as high": ("quantisation step", lambda rig: 4.0),
        "of a resolution a quarter as high": ("quantisation step", lambda rig: 0.25),
    }
    for name, (check, factor) in both.items():
        yield Hypothesis(
            name=f"counts {name}",
            check=check,
            sentence=f"Counts and reference are {name}",
            remedy="Correct resolution, gear or unit.",
            undo=scaled_both(factor),
            measurement=_RIGHT_ANGLE,
            sizes=(1.0, -1.0) if "motor" in name else (1.0,),
            against=8.0,
        )


def _units_of_one() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: counts or reference alone in other units."""
    # A planner and an encoder may give their angles in different units.
    columns = ("counts", "are", scaled_counts), ("reference", "is", scaled_reference)
    for name, verb, undo in columns:
        for unit, factor in (("degrees", 180 / np.pi), ("turns", 1 / (2 * np.pi))):
            yield Hypothesis(
                name=f"{name} alone in {unit}",
                check="gear sign",
                sentence=f"The {name} {verb} in {unit}, and read in radians",
                remedy="State its unit, or convert it.",
                undo=undo,
                measurement=_RIGHT_ANGLE,
                sizes=(factor,),
            )

    yield Hypothesis(
        name="zero of reference",
        check="gear sign",
        sentence="Reference and counts of {joint} have zeros that are {value:.5g} pulses apart",
        remedy="Take them off the reference, or add them to the counts. If they are few, the logged"
        " torque may have an offset instead.",
        undo=shifted_reference,
        measurement="Hold the joint at a stop, and read both.",
        # Each encoder has a zero of its own.
        scope=each_joint,
        evidence=zero_evidence,
        suggested=median_errors,
        against=5.0,
        unit="pulses",
    )


def _resolutions() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: a wrong unit or resolution of the counts."""
    yield Hypothesis(
        name="scaled counts",
        check="units of counts",
        sentence="Counts and reference are multiples of {value:.6g}",
        remedy="Divide both by it.",
        # A conversion that was stated twice leaves a step that no encoder has.
        undo=scaled_both(),
        measurement=_RIGHT_ANGLE,
        evidence=grid_evidence,
    )
    yield Hypothesis(
        name="steps of counts",
        check="quantisation step",
        sentence="The counts come in steps of {value:.4g}, and so does the law's error",
        remedy="Correct the resolution, and take counts and reference in steps.",
        # A counter without its lowest bits; the law reads the same counts.
        undo=counted_in_steps,
        measurement=_RIGHT_ANGLE,
        evidence=steps_evidence,
    )
    yield Hypothesis(
        name="resolution per radian",
        check="quantisation step",
        sentence="The resolution is in pulses per radian, not per turn",
        remedy="State pulses per turn.",
        undo=other_resolution,
        measurement=_RIGHT_ANGLE,
        evidence=radian_evidence,
        against=8.0,
    )
    # Data sheets state lines, drivers count their edges.
    for scope in (each_joint, several):
        yield Hypothesis(
            name="lines of the encoder",
            check="quantisation step",
            sentence="The encoder gives {value:g} times the stated pulses per turn",
            remedy="State counts per turn, four per line if all edges count, or correct the gear.",
            undo=counted_edges,
            measurement=_RIGHT_ANGLE,
            scope=scope,
            evidence=edges_evidence,
            # Four sizes (2, 4, 1/2, 1/4) share the prior probability.
            against=6.5,
        )


def _statements() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: times, the rounding, the rate of the error, and gains in other units."""
    yield Hypothesis(
        name="unit of time",
        check="period",
        sentence="The times are {value:.6g} times too large",
        remedy="Give seconds.",
        # Loggers stamp in milliseconds, microseconds or nanoseconds.
        undo=other_time_unit,
        measurement=_CLOCK,
        evidence=time_unit_evidence,
    )
    yield Hypothesis(
        name="period",
        check="period",
        sentence="The rows are {value:.4g} periods of the rig apart",
        remedy="Correct the rig's period.",
        undo=other_period,
        measurement=_CLOCK,
        evidence=period_evidence,
    )
    yield Hypothesis(
        name="period of the law",
        check="period",
        sentence="The period of the law is stated {value:.3g} times as long as the log shows",
        remedy="Correct it.",
        undo=other_law_period,
        measurement=_CLOCK,
        suggested=law_periods,
        evidence=law_period_evidence,
    )
    yield Hypothesis(
        name="rounding",
        check="rounding",
        sentence="The counts show {cell} at zero",
        remedy="State Encoder(rounding={rounding}) for it.",
        undo=other_rounding,
        measurement="Turn a joint slowly through zero: a wide cell is twice the others.",
        evidence=rounding_evidence,
        against=3.0,
    )
    yield Hypothesis(
        name="rate of the error",
        check="units of torque",
        sentence="The law lacks the rate of its error, of {value:.2g} s times its gain",
        remedy="State the derivative: a PD, or a PID.",
        undo=with_rate,
        measurement=_BLOCKED,
        evidence=rate_evidence,
        # Sizes for a law with memory, whose torque steps show the rate: from about a sample on.
        sizes=(0.001, 0.002, 0.004, 0.008, 0.016, 0.032),
        tolerance=0.05,
        unit="s",
    )
    yield Hypothesis(
        name="filter in Hz",
        check="units of gains",
        sentence="The filter of the law is stated in Hz",
        remedy="State it in rad/s: multiply it by 2 pi.",
        # Data sheets state the corner of a filter as a frequency.
        undo=filter_in_hertz,
        measurement=_BLOCKED,
        against=8.0,
    )
    yield Hypothesis(
        name="gains in A",
        check="units of torque",
        sentence="The gains of the law are in A per pulse",
        remedy="Multiply them by motor_gain.",
        # The loops of a drive command a current.
        undo=gains_in_ampere,
        measurement=_BLOCKED,
        evidence=gains_evidence,
    )


def _gain_units() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: a gain of the law, or all alike, in another unit."""
    for gain, (units, own) in UNITS.items():
        for unit in units:
            for scope in (each_joint, several):
                whose = "{joint}" if scope is each_joint else "all joints"
                verb = "are" if gain == "gains" else "is"
                yield Hypothesis(
                    name=f"unit of {gain}",
                    check="units of gains",
                    sentence=(
                        f"The law's {gain} of {whose} {verb} {{value:.3g}} times what the log"
                        f" shows, the factor between {unit.between}"
                    ),
                    remedy=f"State it in {own}.",
                    undo=other_gains(gain),
                    measurement=_BLOCKED,
                    scope=scope,
                    evidence=unit_of_gain_evidence(gain, unit),
                    against=8.0,
                )


def _single_gains() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: one gain of a law that has several, of one joint or of all alike."""
    for scope in (each_joint, several):
        whose = "{joint}" if scope is each_joint else "all joints"
        for gain in GAINS:
            words = gain if gain == "gain" else f"{gain} gain"
            yield Hypothesis(
                name=f"{words} alone",
                check="units of gains",
                sentence=f"The law's {words} of {whose} is {{value:.3g}} times what the log shows",
                remedy="Correct it.",
                undo=other_gains(gain),
                measurement=_BLOCKED,
                scope=scope,
                suggested=gain_sizes(gain),
                evidence=single_gain_evidence(gain),
                scored=gain == "integral",
                tolerance=0.3,
            )
        yield Hypothesis(
            name="all gains",
            check="units of gains",
            sentence=f"The law's torque of {whose} is {{value:.3g}} times what drives the motion"
            " with the stated friction",
            remedy="Correct the gains, or the stated friction.",
            undo=all_gains,
            measurement=_BLOCKED,
            scope=scope,
            evidence=all_gains_evidence,
            against=8.0,
        )
        yield Hypothesis(
            name="no integral",
            check="units of gains",
            sentence=f"The law that made the log has no integral at {whose}",
            remedy="State it without one.",
            # Drives turn their integral off while they move, or have none.
            undo=without_integral,
            measurement=_BLOCKED,
            scope=scope,
            evidence=no_integral_evidence,
            scored=True,
            against=8.0,
        )
    yield Hypothesis(
        name="lacking integral",
        check="units of gains",
        sentence="The law that made the log has an integral, of {value:.3g} 1/s of its gain",
        remedy="State a PID.",
        # The inner loop of a drive has an integral that its manual may not mention.
        undo=with_integral,
        measurement=_BLOCKED,
        evidence=lacking_integral_evidence,
        scored=True,
        tolerance=3.0,
        against=8.0,
    )


def _sizes() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: scales, of one joint or of all alike."""
    for scope in (each_joint, several):
        alone = scope is each_joint
        whose = "{joint}" if alone else "all joints"
        yield Hypothesis(
            name="gain",
            check="units of torque",
            sentence=f"The torque of {whose} is {{inverse:.3g}} times the commanded one, as of"
            " another gain",
            remedy="Check gain, motor gain and gear.",
            undo=other_gain,
            # The gain of the law and the scale of its torque differ by the logged torque alone.
            measurement=_BLOCKED,
            scope=scope,
            suggested=command_ratios,
            tolerance=0.3,
        )
        yield Hypothesis(
            name="torque scale",
            check="units of torque",
            sentence=f"The torque of {whose} is {{value:.3g}} times the commanded one",
            remedy="Check gain, motor gain and gear, or the driver's scale.",
            undo=rescaled_torque,
            measurement=_LOAD,
            scope=scope,
            suggested=torque_ratios,
            tolerance=0.3,
        )
        yield Hypothesis(
            name="scale of counts",
            check="gear sign",
            sentence=f"The counts of {whose} move {{value:.3g}} times as far as the reference",
            remedy="Check resolution, gear and units of both.",
            undo=scaled_counts,
            measurement=_RIGHT_ANGLE,
            scope=scope,
            # A gear or a resolution that is wrong by a factor scales one column.
            suggested=slopes,
            tolerance=1.0,
        )
        yield Hypothesis(
            name="scale of reference",
            check="gear sign",
            sentence=f"The reference of {whose} moves {{value:.3g}} times as far as the counts",
            remedy="Check resolution, gear and units of both.",
            undo=scaled_reference,
            measurement=_RIGHT_ANGLE,
            scope=scope,
            suggested=inverse_slopes,
            tolerance=1.0,
        )


def _delays() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: columns that are late, of one joint or of all alike."""
    for scope in (each_joint, several):
        alone = scope is each_joint
        whose = "{joint}" if alone else "all joints"
        yield Hypothesis(
            name="late counts",
            check="delay",
            sentence=f"The counts of {whose} are {{shift}}",
            remedy="Shift them.",
            # A drive exports all joints in one row, so a delay of all is likelier than that of one.
            against=5.5 if alone else 5.0,
            undo=counts_in_time,
            measurement=_STEP,
            evidence=delay_evidence,
            scored=True,
            scope=scope,
            suggested=delay_sizes(DELAYS),
            tolerance=2.0,
            unit="samples",
        )
        yield Hypothesis(
            name="late references",
            check="delay",
            sentence=f"The references of {whose} are {{shift}}",
            remedy="Shift them.",
            # Encoders and drives are late more often than what the controller itself computes.
            against=6.5 if alone else 6.0,
            undo=reference_in_time,
            measurement=_STEP,
            scope=scope,
            # A controller is late by whole rows: parts of a row are those of an encoder.
            suggested=reference_delays,
            evidence=reference_delay_evidence,
            unit="samples",
        )
        yield Hypothesis(
            name="late torques",
            check="delay",
            sentence=f"The torques of {whose} are {{shift}}",
            remedy="Shift them." if alone else "Shift them{option}.",
            against=5.5 if alone else 5.0,
            undo=torques_in_time,
            measurement=_STEP,
            scope=scope,
            suggested=torque_delays,
            tolerance=2.0,
            # An export is late by whole rows.
            whole=True,
            unit="samples",
        )


def _stated() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: numbers of the drive that the rig states."""
    yield Hypothesis(
        name="current limit",
        check="clipped torque",
        sentence="The torque of {joint} is cut off at {value:.3g} of the stated limit",
        remedy="State the limit.",
        # A drive limits its current to less than the amplifier can give.
        undo=lower_limit,
        measurement="Block a motor, and command more than its limit.",
        scope=each_joint,
        suggested=used_limits,
    )
    yield Hypothesis(
        name="limit below the torque",
        check="clipped torque",
        sentence="The motion of {joint} took {value:.3g} times the stated limit of its amplifier",
        remedy="State the limit, or correct the gains.",
        undo=other_limit,
        measurement="Block a motor, and command more than its limit.",
        scope=each_joint,
        evidence=limit_evidence,
        against=8.0,
    )
    for name in ("coulomb", "viscous"):
        title = f"{name.capitalize()} friction"
        yield Hypothesis(
            name=title,
            check="units of torque" if name == "coulomb" else "viscous friction",
            sentence=f"{title} is not the rig's at {{joint}}: it is {{value:.2g}} times the stated",
            remedy="Correct that if it was a guess.",
            undo=other_friction(name),
            measurement="Move at constant speeds: friction changes with the speed alone.",
            scope=each_joint,
            suggested=friction_ratios(name),
            tolerance=1.0,
            evidence=viscous_evidence if name == "viscous" else None,
            parameter=True,
            # A friction that is stated is often a guess.
            against=5.0 if name == "viscous" else 10.0,
        )


def several(n: int) -> Iterator[Joints]:
    """The scope of a mistake that all joints share; a robot of one joint has `each_joint` only."""
    # The empty tuple stands for all joints.
    if n > 1:
        yield ()


TABLE: tuple[Hypothesis[Any], ...] = (
    *_exchanges(),
    *_encoders(),
    *_turns(),
    *_units_of_torque(),
    *_kinds_of_torque(),
    *_units_of_both(),
    *_units_of_one(),
    *_resolutions(),
    *_statements(),
    *_gain_units(),
    *_single_gains(),
    *_sizes(),
    *_delays(),
    *_stated(),
)

SWITCHES = tuple(row for row in TABLE if row.suggested is None and row.tolerance is None)
"""Rows without a size that the motion must tell: only these suit a log with useless counts."""
