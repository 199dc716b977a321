"""Mistakes undone: changes of a record, of its rig or of its law.

Each function takes a record, the joints that the mistake concerns (none: all), and its size, and
gives the record without the mistake; a ValueError says that the record does not allow that.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from plant.checkup.along_log import at_times, comparable_torques, sample_times
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.score import Experiment
from plant.checkup.signals import Signals
from plant.laws import PD, PID, P, commanded_torque
from plant.parts import Floats


def with_counts(record: Any, counts: Floats) -> Any:
    """The record with other counts (N, n)."""
    return replace(record, error_pulses=record.reference_pulses - counts)


def with_reference(record: Any, pulses: Floats, path: Any = None) -> Any:
    """The record with another reference (N, n) [pulses], of that path; its counts stay."""
    # The stated `reference` would contradict the changed column.
    return replace(
        record, reference=path, reference_pulses=pulses, error_pulses=pulses - record.counts
    )


def _path_moved(record, signs, offset):
    """The path of a record in other coordinates; None where its reference has only pulses."""
    return None if record.reference is None else record.reference.moved(signs, offset)


def with_torques(record: Any, change: Callable[[Floats], Floats]) -> Any:
    """The record with logged torques and currents changed alike."""
    # Torque and current of a record are one signal.
    columns = {
        name: change(getattr(record, name))
        for name in ("torque", "current")
        if getattr(record, name) is not None
    }
    if not columns:
        raise ValueError("the record must have a torque or a current; it has none. Log one.")
    return replace(record, **columns)


def without_torque(record: Any, joints: Joints, size: float) -> Any:
    """Leave the logged torque out."""
    return replace(record, torque=None, current=None)


def with_drive(record: Any, **changes: Any) -> Any:
    """The record with another drive in its rig."""
    return replace(record, rig=replace(record.rig, drive=replace(record.rig.drive, **changes)))


def with_encoder(record: Any, **changes: Any) -> Any:
    """The record with another encoder in its rig."""
    encoder = replace(record.rig.encoder, **changes)
    return replace(record, rig=replace(record.rig, encoder=encoder))


def _needs_reference(record):
    if not record.reference_pulses.any():
        raise ValueError("the record must have a reference; it has none. Map reference_pulses.")


def _mapped(record, *fields):
    """Whether a file's columns of one of these fields were mapped."""
    return bool(set(record.columns or ()) & set(fields))


def _factors(record, joints, value):
    """Factors (n,): `value` for these joints, or for all where there are none; otherwise 1."""
    factors = np.ones(record.n)
    chosen = columns_of(joints)
    factors[chosen] = np.broadcast_to(value, (record.n,))[chosen]
    return factors


def _order(record, joints):
    order = np.arange(record.n)
    order[list(joints)] = order[list(joints)[::-1]]
    return order


# -- order of columns ------------------------------------------------------------------------------
def _reordered(record, pulses, joints, as_angles):
    """Pulses (N, n) with two columns exchanged: as pulses, or as the angles that they were."""
    order = _order(record, joints)
    if not as_angles:
        return pulses[:, order]
    rig = record.rig
    return rig.counts(rig.cell_centre(pulses)[:, order])


def exchanged_counts(record: Any, joints: Joints, as_angles: float) -> Any:
    """Exchange the counts of two joints."""
    # Without a reference it is the exchange of the torques that shows.
    _needs_reference(record)
    return with_counts(record, _reordered(record, record.counts, joints, as_angles))


def exchanged_references(record: Any, joints: Joints, as_angles: float) -> Any:
    """Exchange the references of two joints."""
    _needs_reference(record)
    return with_reference(record, _reordered(record, record.reference_pulses, joints, as_angles))


def exchanged_torques(record: Any, joints: Joints, as_motor: float) -> Any:
    """Exchange the torques of two joints, on the joints' or on the motors' side."""
    order = _order(record, joints)
    drive = record.rig.drive
    current = None if record.current is None else record.current[:, order]
    if record.torque is None:
        # Currents are on the motors' side.
        if current is None:
            raise ValueError("the record must have a torque; it has none. Log one.")
        return replace(record, current=current)
    torque = record.torque[:, order]
    if as_motor:
        torque = drive.joint_torque(drive.motor_torque(record.torque)[:, order])
    return replace(record, torque=torque, current=current)


# -- signs -----------------------------------------------------------------------------------------
def _signs(record, joints):
    return _factors(record, joints, -1.0)


def _turned(record, pulses, joints, angles):
    """Pulses (N, n) with the sign of these joints changed; angles as the encoder counts them."""
    turned = record.rig.counts(-record.rig.cell_centre(pulses)) if angles else -pulses
    return np.where(_signs(record, joints) < 0, turned, pulses)


def turned_counts(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of counts."""
    # Without a reference, counts of the wrong sign look like a torque of the wrong sign.
    _needs_reference(record)
    angles = _mapped(record, "position")
    return with_counts(record, _turned(record, record.counts, joints, angles))


def turned_reference(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of a reference."""
    _needs_reference(record)
    angles = _mapped(record, "reference_position")
    return with_reference(record, _turned(record, record.reference_pulses, joints, angles))


def turned_motion(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of counts and reference alike."""
    # Without a reference, counts of the wrong sign look like a torque of the wrong sign.
    _needs_reference(record)
    # The law's torque turns with both columns: only an arm shows a joint that is turned as a whole.
    if record.torque is None and record.current is None:
        raise ValueError("the record must have a torque or a current; it has none. Log one.")
    return _turned_motion(record, joints)


def _turned_motion(record, joints):
    pulses = _turned(record, record.reference_pulses, joints, _mapped(record, "reference_position"))
    counts = _turned(record, record.counts, joints, _mapped(record, "position"))
    path = _path_moved(record, _signs(record, joints), np.zeros(record.n))
    return with_counts(with_reference(record, pulses, path), counts)


def turned_joint(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of counts, reference and torque alike."""
    turned = _turned_motion(record, joints)
    logged = record.torque is not None or record.current is not None
    return turned_torque(turned, joints, size) if logged else turned


def turned_gear(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of the gear, and of the columns that it converted from angles."""
    positions = _mapped(record, "position")
    references = _mapped(record, "reference_position")
    # A gear that converted both columns, or none, leaves them in step.
    if positions == references:
        raise ValueError("one of counts and reference must be an angle. Change a sign instead.")
    turned = turned_counts if positions else turned_reference
    gear = _signs(record, joints) * record.rig.drive.gear
    return with_drive(turned(record, joints, size), gear=gear)


def zero_shifted(record: Any, angles: Floats) -> Any:
    """Subtract angles (n,) [rad] from the positions of counts and reference."""
    rig = record.rig
    pulses = np.round(rig.position_in_pulses(angles) - rig.position_in_pulses(0 * angles))
    offset = rig.to_angle(0 * pulses) - rig.to_angle(pulses)
    path = _path_moved(record, np.ones(record.n), offset)
    moved = with_reference(record, record.reference_pulses - pulses, path)
    return with_counts(moved, record.counts - pulses)


def turned_torque(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of a torque, or of a current."""
    signs = _signs(record, joints)
    return with_torques(record, lambda torque: signs * torque)


def turned_error(record: Any, joints: Joints, size: float) -> Any:
    """Change the sign of an error, logged as counts less reference."""
    _needs_reference(record)
    if _mapped(record, "counts", "position", "motor_position"):
        raise ValueError("the error must be a column; it was computed from the counts.")
    return replace(record, error_pulses=_signs(record, joints) * record.error_pulses)


# -- units -----------------------------------------------------------------------------------------
def scaled_torque(
    factor: Callable[[Any], Any], name: str = "torque", *, of_shafts: bool = False
) -> Callable[..., Any]:
    """Multiply the column `torque` or `current` by a factor that the rig gives.

    `of_shafts`: the product is a torque of the gears' shafts, which a coupling takes to the joints.
    """

    def undo(record, joints, size):
        column = getattr(record, name)
        # A logged torque goes before the current.
        if column is None or (name == "current" and record.torque is not None):
            raise ValueError(f"the record must have the column {name}. Map it.")
        factors = _factors(record, joints, factor(record.rig))
        if not np.isfinite(factors).all():
            raise ValueError("the drive must have a current limit; it has none. State it.")
        # The motor's torque may have the direction of the motor, or that of the joint.
        if size < 0:
            factors = factors * np.sign(record.rig.drive.gear)
        scaled = column * factors
        if of_shafts:
            scaled = record.rig.drive.coupling.joint_torque(scaled)
        return replace(record, **{name: scaled})

    return undo


def rescaled_torque(record: Any, joints: Joints, size: float) -> Any:
    """Divide torques by a factor."""
    factors = _factors(record, joints, size)
    return with_torques(record, lambda torque: torque / factors)


def with_gravity(record: Any, joints: Joints, size: float) -> Any:
    """Add gravity to the logged torque: that of the arm that the law knows.

    Of another law, what the torque lacks of the commanded one and depends on the pose.
    """
    if record.torque is None and record.current is None:
        raise ValueError("the record must have a torque or a current; it has none. Log one.")
    drive = record.rig.drive
    if record.torque is None:
        torque = drive.motor_gain * record.current
    else:
        torque = drive.motor_torque(record.torque)
    arm = getattr(record.law, "arm", None)
    if arm is None:
        gravity = _gravity_by_pose(record)
    else:
        still = np.zeros(record.n)
        angles = record.rig.cell_centre(record.counts)
        gravity = drive.motor_torque(np.array([arm.inverse(q, still, still) for q in angles]))
    return replace(record, torque=drive.joint_torque(torque + gravity), current=None)


def _gravity_by_pose(record):
    """Motor torque (N, n) that depends on the pose, and that the logged one lacks of the law's."""
    experiment = Experiment(record)
    signals = experiment.signals
    if experiment.torque_along is None:
        raise ValueError("the record must have a law that reads its counts. State it.")

    def pose(counts):
        angle = np.cumsum(record.rig.cell_centre(counts), axis=1)
        return np.column_stack([np.ones(len(angle)), np.sin(angle), np.cos(angle)])

    # The law reads the log at even times, so compare at these.
    t = sample_times(signals, len(experiment.torque_along))
    counts = at_times(t, signals.t, signals.counts)
    _, commanded, logged = comparable_torques(signals, experiment.torque_along)
    lacking = commanded - logged
    coefficients = np.linalg.lstsq(pose(counts), lacking, rcond=None)[0]
    # A constant may come from what a law with memory did before the log.
    if experiment.has_memory:
        coefficients[0] = 0.0
    return pose(record.counts) @ coefficients


def without_model(record: Any, joints: Joints, size: float) -> Any:
    """Take the torque of the law in place of a model's; leave it out where the law has memory."""
    memory = record.law is not None and record.law.has_memory(record.n)
    return (without_torque if memory else as_commanded)(record, joints, size)


def as_commanded(record: Any, joints: Joints, size: float) -> Any:
    """Take the torque of the law in place of the logged one."""
    commanded = commanded_torque(record)
    if commanded is None or not record.reference_pulses.any():
        raise ValueError("the record must have a law without memory, and a reference. Map both.")
    return replace(record, torque=record.rig.drive.limited(commanded), current=None)


def rated_torque(record: Any, joints: Joints, size: float) -> Any:
    """Convert a torque or current from per mille of a rated one, which is so much of the limit."""
    if record.torque is None:
        undo = scaled_torque(lambda rig: size * rig.drive.current_limit / 1e3, "current")
    else:
        undo = scaled_torque(lambda rig: size * rig.drive.torque_limit() / 1e3, of_shafts=True)
    return undo(record, joints, 1.0)


def signed_magnitude(record: Any, joints: Joints, size: float) -> Any:
    """Give magnitudes of torque and current the sign of the law's, and multiply them."""
    commanded = as_commanded(record, joints, size).torque
    # The motor turns against the joint where the gear is negative, and so does its current.
    signs = {"torque": commanded, "current": record.rig.drive.motor_torque(commanded)}
    logged = {name: getattr(record, name) for name in signs if getattr(record, name) is not None}
    if not logged or any((column < 0).any() for column in logged.values()):
        raise ValueError("the record must have torques without a negative value. Log magnitudes.")
    return replace(
        record, **{name: size * np.sign(signs[name]) * column for name, column in logged.items()}
    )


def with_rate(record: Any, joints: Joints, size: float) -> Any:
    """Give a law that lacks the rate of its error that rate, of so many seconds of its gain."""
    law = record.law
    if isinstance(law, P):
        # The pole of the rate is not known; a log shows nothing faster than its samples.
        law = PD(gain=law.gain, derivative=0 * np.array(law.gain), filter=1 / record.rig.period)
    if not isinstance(law, PD) or np.any(law.derivative):
        raise ValueError(f"the law must be P, or lack its derivative; got {type(law).__name__}.")
    return replace(record, law=replace(law, derivative=size * np.array(law.gain)))


def without_integral(record: Any, joints: Joints, size: float) -> Any:
    """Take the integral of a law for zero."""
    gains = np.array(record.law.integral, dtype=float)
    gains[columns_of(joints)] = 0.0
    return replace(record, law=replace(record.law, integral=gains))


def with_integral(record: Any, joints: Joints, size: float) -> Any:
    """Give a PD an integral of so many 1/s of its gain."""
    law = record.law
    if type(law) is not PD:
        raise ValueError(f"the law must be PD; got {type(law).__name__}.")
    factors = np.zeros(record.n)
    factors[columns_of(joints)] = size
    numbers = {field.name: getattr(law, field.name) for field in fields(law) if field.init}
    return replace(record, law=PID(**numbers, integral=factors * np.array(law.gain)))


def scaled_counts(record: Any, joints: Joints, size: float) -> Any:
    """Divide the counts by a factor."""
    _needs_reference(record)
    encoder = record.rig.encoder
    counts = encoder.quantised(record.counts / _factors(record, joints, size))
    return with_counts(record, counts)


def scaled_reference(record: Any, joints: Joints, size: float) -> Any:
    """Divide the reference by a factor."""
    _needs_reference(record)
    factors = _factors(record, joints, size)
    pulses = np.round(record.reference_pulses / factors)
    if record.reference is not None:
        # The path behind the counts is rounded once, as the controller did; counts that are rounded
        # again are a count off in many rows, which a tight loop feels.
        path = record.rig.position_in_pulses(record.reference(record.t - record.t[0]).q)
        once = record.rig.encoder.quantised(path / factors)
        pulses = once if np.abs(once - pulses).max() <= 1 else pulses
    return with_reference(record, pulses)


def shifted_reference(record: Any, joints: Joints, pulses: float) -> Any:
    """Take so many pulses off the references of some joints."""
    _needs_reference(record)
    shift = np.zeros(record.n)
    shift[columns_of(joints)] = np.rint(pulses)
    path = _path_moved(record, np.ones(record.n), -record.rig.to_angle(shift))
    return with_reference(record, record.reference_pulses - shift, path)


def scaled_both(factor: Callable[[Any], Any] | None = None) -> Callable[..., Any]:
    """Divide counts and reference by a factor of the rig, or by the size."""

    def undo(record, joints, size):
        factors = _factors(record, joints, size if factor is None else factor(record.rig))
        # The motor's angle may have the direction of the motor, or that of the joint.
        if factor is not None and size < 0:
            factors = factors * np.sign(record.rig.drive.gear)
        counts, reference = record.counts / factors, record.reference_pulses / factors
        # Multiples of a step become whole again; anything else is rounded as counts are.
        nearest = np.round(counts)
        rounded = record.rig.encoder.quantised(counts)
        counts = np.where(np.abs(counts - nearest) < SLACK, nearest, rounded)
        reference = np.round(reference)
        return replace(
            record, reference=None, reference_pulses=reference, error_pulses=reference - counts
        )

    return undo


# A multiple of a step, divided by it, may lie this far from a whole number [counts].
SLACK = 1e-3


def other_resolution(record: Any, joints: Joints, size: float) -> Any:
    """Multiply the stated resolution, and with it the counts of a given path."""
    # A stated `reference` would contradict the column that was counted.
    record = replace(record, reference=None)
    return with_encoder(record, resolution=record.rig.encoder.resolution * size)


def counted_edges(record: Any, joints: Joints, size: float) -> Any:
    """Multiply the stated resolution, and with it a reference that the rig made of angles.

    Counts and torques stay; a reference that the counts follow as it is was counted, too.
    """
    factors = _factors(record, joints, size)
    follows = Signals(record).tracks[columns_of(joints)].all()
    pulses = np.round(record.reference_pulses * (1.0 if follows else factors))
    record = with_reference(record, pulses)
    return with_encoder(record, resolution=record.rig.encoder.resolution * factors)


def counted_in_steps(record: Any, joints: Joints, size: float) -> Any:
    """Count in steps of so many pulses of the stated resolution."""
    undone = scaled_both()(record, joints, size)
    return with_encoder(undone, resolution=record.rig.encoder.resolution / size)


def other_gain(record: Any, joints: Joints, size: float) -> Any:
    """Divide the gains of the law by a factor."""
    law = record.law
    if not hasattr(law, "gain"):
        raise ValueError(f"the law must have a gain; got {type(law).__name__}.")
    factors = 1 / _factors(record, joints, size)
    # The numbers that make torque of errors.
    names = [name for name in ("gain", "integral", "derivative") if hasattr(law, name)]
    changes = {name: factors * np.array(getattr(law, name)) for name in names}
    return replace(record, law=replace(law, **changes))


def filter_in_hertz(record: Any, joints: Joints, size: float) -> Any:
    """Take the filter of the law as a frequency in Hz."""
    law = record.law
    if getattr(law, "filter", None) is None:
        raise ValueError("the law must have a filter; it has none.")
    return replace(record, law=replace(law, filter=2 * np.pi * law.filter))


def gains_in_ampere(record: Any, joints: Joints, size: float) -> Any:
    """Take the gains of the law as amperes per pulse."""
    return other_gain(record, joints, 1 / record.rig.drive.motor_gain)


# -- timing ----------------------------------------------------------------------------------------
def _moved(table, joints, samples):
    """A table (N, n) read so many samples later."""
    rows = np.arange(len(table))
    moved = np.array(table)
    for i in joints or range(table.shape[1]):
        moved[:, i] = np.interp(rows + samples, rows, table[:, i])
    return moved


def counts_in_time(record: Any, joints: Joints, samples: float) -> Any:
    """Read the counts so many samples later, as the encoder would count them there."""
    encoder = record.rig.encoder
    centres = encoder.position_in_pulses(encoder.cell_centre(record.counts))
    moved = _moved(centres, joints, samples)
    # Rows that were never counted: a joint in motion moves on, or it would seem to have stopped.
    ends = (0, 1) if samples < 0 else (-1, -2)
    missing = np.minimum(int(np.ceil(abs(samples))), len(moved) // 4)
    step = centres[ends[0]] - centres[ends[1]]
    for row in range(missing):
        away = abs(samples) - row
        moved[row if samples < 0 else -1 - row] = centres[ends[0]] + away * step
    counts = encoder.quantised(moved)
    chosen = columns_of(joints)
    table = np.array(record.counts)
    table[:, chosen] = counts[:, chosen]
    return with_counts(record, table)


def reference_in_time(record: Any, joints: Joints, samples: float) -> Any:
    """Read the references so many samples later."""
    _needs_reference(record)
    return with_reference(record, _moved(record.reference_pulses, joints, samples))


def torques_in_time(record: Any, joints: Joints, samples: float) -> Any:
    """Read the torques so many samples later."""
    return with_torques(record, lambda torque: _moved(torque, joints, samples))


def other_time_unit(record: Any, joints: Joints, size: float) -> Any:
    """Divide the times by a factor."""
    return replace(record, t=record.t / size)


def other_period(record: Any, joints: Joints, size: float) -> Any:
    """Multiply the rig's period, where no law runs at a period of its own."""
    if getattr(record.law, "period", None) is not None:
        raise ValueError("the law must have no period of its own. Correct both periods.")
    return replace(record, rig=replace(record.rig, period=record.rig.period * size))


def other_law_period(record: Any, joints: Joints, size: float) -> Any:
    """Divide the period of the law by a factor."""
    period = getattr(record.law, "period", None)
    if not period:
        raise ValueError("the law must have a period of its own; it has none. State it.")
    return replace(record, law=replace(record.law, period=period / size))


def other_rounding(record: Any, joints: Joints, size: float) -> Any:
    """The other convention of rounding the counts."""
    # "round" and "floor" differ by a shift of the zero alone, so "floor" stands for both.
    rounding = "floor" if record.rig.encoder.rounding == "fix" else "fix"
    return with_encoder(record, rounding=rounding)


# -- what the rig states ---------------------------------------------------------------------------
def lower_limit(record: Any, joints: Joints, size: float) -> Any:
    """Lower the amplifier's limit to a share of the stated one."""
    if record.torque is None and record.current is None:
        raise ValueError("the record must have a torque; it has none. Log one.")
    return other_limit(record, joints, size)


def other_limit(record: Any, joints: Joints, size: float) -> Any:
    """Multiply the amplifier's stated limit."""
    limit = record.rig.drive.current_limit * _factors(record, joints, size)
    return with_drive(record, current_limit=limit)


def other_friction(name: str) -> Callable[..., Any]:
    """Multiply a stated friction, "coulomb" or "viscous", by a factor."""

    def undo(record, joints, size):
        friction = getattr(record.rig.drive, name)
        return with_drive(record, **{name: friction * _factors(record, joints, size)})

    return undo
