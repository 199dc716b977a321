"""What can be wrong with a log, its rig or its law, as far as no model of the arm is needed.

One row per mistake: its words, how to undo it in a record, and the odds against it. `candidates`
scores all rows against a log; a row of a user's own joins the table there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.hypothesis import (
    Candidate,
    Hypothesis,
    Joints,
    each_joint,
    pairs,
)
from plant.checkup.quantisation import STEP_NOTE, grid
from plant.checkup.rounding import rounding_log_odds
from plant.checkup.score import Experiment
from plant.checkup.stamps import chance_of_period
from plant.checkup.torque_regression import TorqueRegression, least_squares
from plant.laws.law import block_of
from plant.parts.fields import Floats


# -- changes of a record ---------------------------------------------------------------------------
def with_counts(record: Any, counts: Floats) -> Any:
    """The record with other counts (N, n)."""
    return replace(record, error_pulses=record.reference_pulses - counts)


def with_reference(record: Any, pulses: Floats) -> Any:
    """The record with another reference (N, n) [pulses]; its counts stay."""
    # A stated `reference` would contradict the changed column.
    return replace(
        record, reference=None, reference_pulses=pulses, error_pulses=pulses - record.counts
    )


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


def with_drive(record: Any, **changes: Any) -> Any:
    """The record with another drive in its rig."""
    return replace(record, rig=replace(record.rig, drive=replace(record.rig.drive, **changes)))


def _needs_reference(record):
    if not record.reference_pulses.any():
        raise ValueError("the record must have a reference; it has none. Map reference_pulses.")


def _mapped(record, *fields):
    """Whether a file's columns of one of these fields were mapped."""
    return bool(set(record.columns or ()) & set(fields))


def _factors(record, joints, value):
    """Factors (n,): `value` for these joints, or for all where there are none; otherwise 1."""
    factors = np.ones(record.n)
    chosen = list(joints) or slice(None)
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
def scaled_torque(factor: Callable[[Any], Any], name: str = "torque") -> Callable[..., Any]:
    """Multiply the column `torque` or `current` by a factor that the rig gives."""

    def undo(record, joints, size):
        column = getattr(record, name)
        # A logged torque goes before the current.
        if column is None or (name == "current" and record.torque is not None):
            raise ValueError(f"the record must have the column {name}. Map it.")
        factors = _factors(record, joints, factor(record.rig))
        # The motor's torque may have the direction of the motor, or that of the joint.
        if size < 0:
            factors = factors * np.sign(record.rig.drive.gear)
        return replace(record, **{name: column * factors})

    return undo


def rescaled_torque(record: Any, joints: Joints, size: float) -> Any:
    """Divide torques by a factor."""
    factors = _factors(record, joints, size)
    return with_torques(record, lambda torque: torque / factors)


def with_gravity(record: Any, joints: Joints, size: float) -> Any:
    """Add to the logged torque what it lacks of the commanded one and depends on the pose."""
    experiment = Experiment(record)
    commanded, logged = experiment.commanded, experiment.signals.torque
    if commanded is None or logged is None:
        raise ValueError("the record must have a torque and a law without memory. Log both.")
    angle = np.cumsum(record.rig.cell_centre(experiment.signals.counts), axis=1)
    pose = np.column_stack([np.ones(len(angle)), np.sin(angle), np.cos(angle)])
    coefficients = np.linalg.lstsq(pose, commanded - logged, rcond=None)[0]
    angle = np.cumsum(record.rig.cell_centre(record.counts), axis=1)
    pose = np.column_stack([np.ones(len(angle)), np.sin(angle), np.cos(angle)])
    drive = record.rig.drive
    torque = drive.motor_torque(record.torque) if record.torque is not None else None
    if torque is None:
        torque = drive.motor_gain * record.current
    gravity = drive.joint_torque(torque + pose @ coefficients)
    return replace(record, torque=gravity, current=None)


def scaled_counts(record: Any, joints: Joints, size: float) -> Any:
    """Divide the counts by a factor."""
    _needs_reference(record)
    encoder = record.rig.encoder
    counts = encoder.quantised(record.counts / _factors(record, joints, size))
    return with_counts(record, counts)


def scaled_reference(record: Any, joints: Joints, size: float) -> Any:
    """Divide the reference by a factor."""
    _needs_reference(record)
    pulses = np.round(record.reference_pulses / _factors(record, joints, size))
    return with_reference(record, pulses)


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
        counts = np.where(np.abs(counts - nearest) < _SLACK, nearest, rounded)
        reference = np.round(reference)
        return replace(
            record, reference=None, reference_pulses=reference, error_pulses=reference - counts
        )

    return undo


# A multiple of a step, divided by it, may lie this far from a whole number [counts].
_SLACK = 1e-3


def counted_in_steps(record: Any, joints: Joints, size: float) -> Any:
    """Count in steps of so many pulses of the stated resolution."""
    encoder = record.rig.encoder
    encoder = replace(encoder, resolution=encoder.resolution / size)
    undone = scaled_both()(record, joints, size)
    return replace(undone, rig=replace(undone.rig, encoder=encoder))


def _gains(law):
    """Names of the numbers that make torque of errors; a law without such names is refused."""
    names = [name for name in ("gain", "integral", "derivative") if hasattr(law, name)]
    if "gain" not in names:
        raise ValueError(f"the law must have a gain; got {type(law).__name__}.")
    return names


def other_gain(record: Any, joints: Joints, size: float) -> Any:
    """Divide the gains of the law by a factor."""
    factors = 1 / _factors(record, joints, size)
    law = record.law
    changes = {name: factors * np.array(getattr(law, name)) for name in _gains(law)}
    return replace(record, law=replace(law, **changes))


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
    counts = encoder.quantised(_moved(centres, joints, samples))
    chosen = list(joints) or list(range(record.n))
    table = np.array(record.counts)
    table[:, chosen] = counts[:, chosen]
    return with_counts(record, table)


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


def other_rounding(record: Any, joints: Joints, size: float) -> Any:
    """The other convention of rounding the counts."""
    # "round" and "floor" differ by a shift of the zero alone, so "floor" stands for both.
    rounding = "floor" if record.rig.encoder.rounding == "fix" else "fix"
    encoder = replace(record.rig.encoder, rounding=rounding)
    return replace(record, rig=replace(record.rig, encoder=encoder))


# -- what the rig states ---------------------------------------------------------------------------
def lower_limit(record: Any, joints: Joints, size: float) -> Any:
    """Lower the amplifier's limit to a share of the stated one."""
    if record.torque is None and record.current is None:
        raise ValueError("the record must have a torque; it has none. Log one.")
    limit = record.rig.drive.current_limit * _factors(record, joints, size)
    return with_drive(record, current_limit=limit)


def other_friction(name: str) -> Callable[..., Any]:
    """Multiply a stated friction, "coulomb" or "viscous", by a factor."""

    def undo(record, joints, size):
        friction = getattr(record.rig.drive, name)
        return with_drive(record, **{name: friction * _factors(record, joints, size)})

    return undo


# -- sizes that the log itself suggests ------------------------------------------------------------
def _ratios(numerator, denominator):
    """Regression (n,) of one table of columns on another; 1 where there is nothing."""
    power = (denominator**2).sum(axis=0)
    ratio = (numerator * denominator).sum(axis=0) / np.where(power > 0, power, 1.0)
    return np.where((power > 0) & (ratio != 0), ratio, 1.0)


def _centred(column):
    return column - column.mean() if len(column) else column


def _speeds(experiment, name):
    table = getattr(experiment.signals, name)
    return np.column_stack([experiment.filtered(name, table, i).speed for i in range(experiment.n)])


def slopes(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Speed of the counts over that of the reference: of a joint, or the median of all."""
    if experiment.signals.reference is None:
        return ()
    ratio = _ratios(_speeds(experiment, "counts"), _speeds(experiment, "reference"))
    return _positive(np.median(ratio[list(joints) or slice(None)]))


def inverse_slopes(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Speed of the reference over that of the counts."""
    return tuple(1 / slope for slope in slopes(experiment, joints))


def torque_ratios(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Logged over commanded torque: of a joint, or the median of all."""
    law = experiment.record.law
    # The unknown memory of a law makes its steps another size.
    commanded, logged = experiment.commanded, experiment.signals.torque
    if commanded is None or logged is None or law is None or law.has_memory(experiment.n):
        return ()
    drive = experiment.record.rig.drive
    limit = drive.motor_gain * drive.current_limit
    # An amplifier at its limit shows its limit, and no gain.
    limited = np.abs(np.abs(logged) / limit - 1) < _AT_LIMIT
    ratio = np.array(
        [
            _ratios(_centred(logged[rows, i]), _centred(commanded[rows, i]))
            for i, rows in enumerate(~limited.T)
        ]
    )
    return _positive(np.median(ratio[list(joints) or slice(None)]))


def command_ratios(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Commanded over logged torque."""
    return tuple(1 / ratio for ratio in torque_ratios(experiment, joints))


def common_step(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Step of the counts of all joints, where it is one number of pulses above 1."""
    steps = [grid(column) for column in experiment.signals.counts.T]
    return (steps[0],) if min(steps) > 1 and np.ptp(steps) < _SLACK * steps[0] else ()


def used_limits(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Largest logged torque of a joint as a share of the amplifier's limit."""
    drive = experiment.record.rig.drive
    torque = experiment.signals.torque
    i = joints[0]
    if torque is None or not np.isfinite(drive.current_limit[i]):
        return ()
    share = float(np.abs(torque[:, i]).max() / drive.motor_gain[i] / drive.current_limit[i])
    return (share,) if share < 1 - _RELEVANT else ()


def friction_ratios(name: str) -> Callable[..., tuple[float, ...]]:
    """Estimated over stated friction of a joint."""

    def sizes(experiment, joints):
        stated = getattr(experiment.record.rig.drive, name)[joints[0]]
        if experiment.motions is None or not stated:
            return ()
        return _positive(getattr(experiment.motions[joints[0]], name) / stated)

    return sizes


def _positive(ratio):
    # A factor of one changes nothing, and signs have rows of their own.
    return (float(ratio),) if ratio > 0 and abs(ratio - 1) > _RELEVANT else ()


# Relative distance from the amplifier's limit within which a torque is limited.
_AT_LIMIT = 0.02

# A factor nearer to one is within what rounding and an imperfect undo cause.
_RELEVANT = 0.03


DELAYS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
"""Samples by which counts may be late; the best is refined."""

TORQUE_DELAYS = (-1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)
"""The same of torques, which no cause makes early by much."""


def delay_sizes(sizes: tuple[float, ...]) -> Callable[..., tuple[float, ...]]:
    """Delays that are tried: those that torque and motion alone can show, where no law helps."""

    def tried(experiment, joints):
        if experiment.torques_of_law is not None or experiment.signals.torque is None:
            return sizes
        # Torque is held between samples, drives take time, and feedback has noise.
        return tuple(size for size in sizes if size > _UNSEEN)

    return tried


# Samples of delay that torque and motion alone do not show.
_UNSEEN = 2.5


# -- evidence of other kinds -----------------------------------------------------------------------
def rounding_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of the convention that is not stated, by the width of the cell at zero."""
    encoder, notes = experiment.record.rig.encoder, experiment.record.notes or {}
    # Positions that were no whole pulses were rounded by the reader, not by a counter.
    if encoder.smooth or any(STEP_NOTE.format(i) in notes for i in range(experiment.n)):
        return
    odds = rounding_log_odds(experiment.signals)
    if odds is not None:
        yield 1.0, -odds if encoder.rounding == "fix" else odds


class Delay(NamedTuple):
    """Estimates of a delay [samples] with their standard deviations, joint by joint (n,).

    `by_jerk`: of the torque that grows with the jerk of late counts. `by_speed`: of the torque that
    grows with their speed, beyond the stated viscous friction, which may be another by a factor.
    """

    by_jerk: Floats
    jerk_std: Floats
    by_speed: Floats
    speed_std: Floats


def delays(experiment: Experiment) -> Delay | None:
    """Delays that the torque of a law without memory shows, where no torque is logged."""
    signals = experiment.signals
    if signals.torque is not None or experiment.commanded is None or not signals.long_enough:
        return None
    # The gain [N m/pulse] of a law without memory turns a shift of the counts into torque.
    error = signals.reference - signals.counts
    gain = (error * experiment.commanded).sum(axis=0) / np.maximum((error**2).sum(axis=0), 1e-300)
    angle = experiment.record.rig.encoder.to_angle(np.ones(experiment.n))
    # Viscous friction [N m s/rad] that looks like a delay of one sample.
    per_sample = np.abs(gain * signals.interval / angle)
    columns = np.full((4, experiment.n), np.nan)
    stated = experiment.record.rig.drive.viscous
    for i in range(experiment.n):
        fit = TorqueRegression.of(signals, experiment.commanded, i)
        if fit is not None and per_sample[i]:
            spread = np.hypot(fit.viscous_std, _VISCOUS_SPREAD * stated[i])
            speed = (fit.viscous - stated[i]) / per_sample[i]
            columns[:, i] = fit.delay, fit.delay_std, speed, spread / per_sample[i]
    return Delay(*columns)


# Viscous friction as a rig states it, relative: it doubles with the temperature of the grease.
_VISCOUS_SPREAD = 0.5


def delay_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of late counts without a logged torque; None with one: the score has it then."""
    logged = experiment.signals.torque is not None
    if experiment.signals.reference is None:
        return None if logged else ()
    law = experiment.record.law
    if law is not None and law.has_memory(experiment.n):
        return _lag_evidence(experiment, joints) or (None if logged else ())
    if logged:
        return None
    delay = experiment.once("delay", delays)
    if delay is None:
        return ()
    chosen = list(joints) or slice(None)
    jerk, jerk_std = delay.by_jerk[chosen], delay.jerk_std[chosen]
    values = np.concatenate([jerk, delay.by_speed[chosen]])
    stds = np.concatenate([jerk_std, delay.speed_std[chosen]])
    for value, gain in _common(values, stds):
        # Torque that grows with the speed but not with the jerk is friction.
        if np.nansum((jerk**2 - (jerk - value) ** 2) / jerk_std**2) > 0:
            return ((value, gain),)
    return ()


def _common(values, stds):
    """The value that several estimates share, with its log odds against zero."""
    weight = np.nan_to_num(1 / np.maximum(stds, 1e-9) ** 2)
    if not weight.sum():
        return ()
    value = float(np.nansum(weight * values) / weight.sum())
    gain = float(np.nansum(weight * (values**2 - (values - value) ** 2)) / 2)
    return ((value, gain),)


def _lag_evidence(experiment, joints):
    """Log odds of counts behind the reference, under a law that feeds its acceleration forward."""
    law = experiment.record.law
    # Any other law needs an error to act, and lags by itself. Input 3 of a law's step is the
    # reference's acceleration, output 0 the torque.
    if law is None or not block_of(law, experiment.record.rig).step.jac_sparsity(0, 3).nnz():
        return ()
    values, stds = np.array(
        [lag(experiment, i, friction=True) for i in joints or range(experiment.n)]
    ).T
    # What a law leaves of friction looks like a small lag.
    if np.abs(values).max() < _LEAST_LAG or np.ptp(values) > _LEAST_LAG:
        return ()
    return _common(values, stds)


# Samples of lag that a law leaves by what its model lacks.
_LEAST_LAG = 0.2


def lag(experiment: Experiment, i: int, *, friction: bool = False) -> tuple[float, float]:
    """Samples by which the counts of joint i lag behind the reference, and standard deviation."""
    signals = experiment.signals
    reference = experiment.filtered("reference", np.asarray(signals.reference), i)
    counts = experiment.filtered("counts", signals.counts, i)
    columns = [reference.speed, np.ones(len(counts.value))]
    # Friction that the law lacks is an error with the sign of the speed.
    if friction:
        columns.append(reference.direction)
    value, std = least_squares(
        np.column_stack(columns), reference.value - counts.value, signals.window
    )
    return value[0] / signals.interval, std[0] / signals.interval


def gains_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of gains in A where no torque is logged: friction is as stated with the others."""
    delay = experiment.once("delay", delays)
    if delay is None or not hasattr(experiment.record.law, "gain"):
        return None
    changed = experiment.changed(gains_in_ampere(experiment.record, joints, 1.0))
    after = delays(changed)
    gain = changed.score - experiment.score
    # Viscous friction alone is a parameter; gains change inertia and Coulomb friction, too.
    if after is not None and gain > 0:
        friction = (each.by_speed / each.speed_std for each in (delay, after))
        gain += float(np.subtract(*(np.nansum(ratio**2) / 2 for ratio in friction)))
    return ((1.0, gain),)


def viscous_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of another viscous friction, which adds torque with the speed but not the jerk."""
    if experiment.signals.torque is not None:
        return None
    delay = experiment.once("delay", delays)
    i = joints[0]
    stated = experiment.record.rig.drive.viscous[i]
    if delay is None or not stated or not np.isfinite(delay.speed_std[i]):
        return ()
    size = friction_ratios("viscous")(experiment, joints)
    return ((size[0], (delay.by_speed[i] / delay.speed_std[i]) ** 2 / 2),) if size else ()


def grid_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of counts that are multiples of one step: free counts would use the cells between.

    A broken step is a factor of units; a whole one is a coarser encoder, of which no log knows
    whether the rig or the counts are to change.
    """
    for step in common_step(experiment, joints):
        if step % 1:
            levels = len(np.unique(experiment.signals.counts[:, 0]))
            yield step, levels * float(np.log(step))


def steps_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """How much likelier the log is where law and rig count in whole steps."""
    for step in common_step(experiment, joints):
        changed = experiment.changed(counted_in_steps(experiment.record, joints, step))
        yield step, changed.score - experiment.score


def _interval_ratio(experiment):
    return experiment.signals.interval / experiment.record.rig.period


def time_unit_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of times in milliseconds or microseconds, by the rig's period."""
    factor = 1e3 ** np.round(np.log10(_interval_ratio(experiment)) / 3)
    if factor != 1:
        yield float(factor), abs(float(np.log(factor))) * _PER_E_FOLD


def period_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of another period of the rig, by the median interval of the stamps."""
    ratio = _interval_ratio(experiment)
    if 1e-3 + chance_of_period(experiment.signals) < abs(np.log(ratio)) < 3:
        yield float(ratio), abs(float(np.log(ratio))) * 1e3 * _PER_E_FOLD


# Stamps and period come from one clock: a thousandth is 3 standard deviations of what is usual.
_PER_E_FOLD = 10.0


# -- the table -------------------------------------------------------------------------------------
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
            scope=pairs,
            sizes=(0.0, 1.0),
            # Torques come in the order of their counts.
            against=8.0 if name == "torques" else 5.0,
        )


def _turns() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: columns with the wrong sign."""
    signs = {
        "torque": ("drive sign", turned_torque),
        "error": ("drive sign", turned_error),
        "counts": ("gear sign", turned_counts),
        "reference": ("gear sign", turned_reference),
        "gear": ("gear sign", turned_gear),
    }
    for name, (check, undo) in signs.items():
        yield Hypothesis(
            name=f"turned {name}",
            check=check,
            sentence=f"The {name} of {{joint}} has the wrong sign",
            remedy="Change the sign of " + ("the gear." if name == "gear" else f"{{{name}}}."),
            undo=undo,
            scope=each_joint,
        )
        # A driver, or a reader, that turns the sign of one joint turns those of all.
        if name != "gear":
            yield Hypothesis(
                name=f"turned {name} of all joints",
                check=check,
                sentence=f"The {name} of all joints has the wrong sign",
                remedy=f"Change the sign of {{{name}}} of every joint.",
                undo=undo,
                scope=several,
            )


def _units() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: columns, times and gains in other units."""
    units = {
        "in mN m": ("torque", lambda rig: 1e-3),
        "in kN m": ("torque", lambda rig: 1e3),
        "the motor's torque, not the joint's": ("torque", lambda rig: np.abs(rig.drive.gear)),
        "a torque that crossed the gear twice": ("torque", lambda rig: 1 / np.abs(rig.drive.gear)),
        "a motor current in A": (
            "torque",
            lambda rig: np.abs(rig.drive.gear) * rig.drive.motor_gain,
        ),
        "per mille of the amplifier's limit": (
            "torque",
            lambda rig: rig.drive.torque_limit() / 1e3,
        ),
        "in mA": ("current", lambda rig: 1e-3),
        "in A, not in mA": ("current", lambda rig: 1e3),
    }
    for unit, (column, factor) in units.items():
        yield Hypothesis(
            name=f"{column} {unit}",
            check="units of torque",
            sentence=f"The {column} may be {unit}",
            remedy="State its unit, or convert it.",
            undo=scaled_torque(factor, column),
            sizes=(1.0, -1.0) if "motor" in unit else (1.0,),
            against=8.0,
        )
    yield Hypothesis(
        name="torque without gravity",
        check="units of torque",
        sentence="The torque is one of which gravity is taken out",
        remedy="Log the torque with gravity; some drivers take it out by default.",
        undo=with_gravity,
        against=20.0,
    )
    gears = lambda rig: np.abs(rig.drive.gear)  # noqa: E731
    both = {
        "in degrees, not in radians": ("units of counts", lambda rig: 180 / np.pi),
        "in turns, not in radians": ("units of counts", lambda rig: 1 / (2 * np.pi)),
        "angles of the motor": ("quantisation step", gears),
        "angles of the joint": ("units of torque", lambda rig: 1 / gears(rig)),
        "of a resolution four times as high": ("quantisation step", lambda rig: 4.0),
        "of a resolution a quarter as high": ("quantisation step", lambda rig: 0.25),
    }
    for name, (check, factor) in both.items():
        yield Hypothesis(
            name=f"counts {name}",
            check=check,
            sentence=f"Counts and reference may be {name}",
            remedy="Correct resolution, gear or unit.",
            undo=scaled_both(factor),
            sizes=(1.0, -1.0) if "motor" in name else (1.0,),
            against=8.0,
        )


def _units_of_one() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: counts or reference alone in other units."""
    for name, undo in (("counts", scaled_counts), ("reference", scaled_reference)):
        for unit, factor in (("degrees", 180 / np.pi), ("turns", 1 / (2 * np.pi))):
            yield Hypothesis(
                name=f"{name} alone in {unit}",
                check="gear sign",
                sentence=f"The {name} may be in {unit}, and read in radians",
                remedy="State its unit, or convert it.",
                undo=undo,
                sizes=(factor,),
            )


def _statements() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: units of counts and times, the rounding, and gains in other units."""
    yield Hypothesis(
        name="scaled counts",
        check="units of counts",
        sentence="Counts and reference are multiples of {value:.6g}",
        remedy="Divide both by it.",
        undo=scaled_both(),
        evidence=grid_evidence,
    )
    yield Hypothesis(
        name="steps of counts",
        check="quantisation step",
        sentence="The counts come in steps of {value:.4g}, and so does the law's error",
        remedy="Correct the resolution, and take counts and reference in steps.",
        undo=counted_in_steps,
        evidence=steps_evidence,
    )
    yield Hypothesis(
        name="unit of time",
        check="period",
        sentence="The times are {value:.6g} times too large",
        remedy="Give seconds.",
        undo=other_time_unit,
        evidence=time_unit_evidence,
    )
    yield Hypothesis(
        name="period",
        check="period",
        sentence="The rows are {value:.4g} periods of the rig apart",
        remedy="Correct the rig's period.",
        undo=other_period,
        evidence=period_evidence,
    )
    yield Hypothesis(
        name="rounding",
        check="rounding",
        sentence="The counts show {cell} at zero",
        remedy="State Encoder(rounding={rounding}) for it.",
        undo=other_rounding,
        evidence=rounding_evidence,
        against=3.0,
    )
    yield Hypothesis(
        name="gains in A",
        check="units of torque",
        sentence="The gains of the law may be in A per pulse",
        remedy="Multiply them by motor_gain.",
        undo=gains_in_ampere,
        evidence=gains_evidence,
    )


def _sizes() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: scales and delays, of one joint or of all alike."""
    for scope in (each_joint, several):
        yield Hypothesis(
            name="gain",
            check="units of torque",
            sentence="The torque is {inverse:.3g} times the commanded one, as of another gain",
            remedy="Check gain, motor gain and gear.",
            undo=other_gain,
            scope=scope,
            suggested=command_ratios,
            tolerance=0.3,
        )
        yield Hypothesis(
            name="torque scale",
            check="units of torque",
            sentence="The torque is {value:.3g} times the commanded one",
            remedy="Check gain, motor gain and gear, or the driver's scale.",
            undo=rescaled_torque,
            scope=scope,
            suggested=torque_ratios,
            tolerance=0.3,
        )
        yield Hypothesis(
            name="scale of counts",
            check="gear sign",
            sentence="The counts move {value:.3g} times as far as the reference",
            remedy="Check resolution, gear and units of both.",
            undo=scaled_counts,
            scope=scope,
            suggested=slopes,
            tolerance=1.0,
        )
        yield Hypothesis(
            name="scale of reference",
            check="gear sign",
            sentence="The reference moves {value:.3g} times as far as the counts",
            remedy="Check resolution, gear and units of both.",
            undo=scaled_reference,
            scope=scope,
            suggested=inverse_slopes,
            tolerance=1.0,
        )
        yield Hypothesis(
            name="late counts",
            check="delay",
            sentence="The counts are {value:+.2g} samples late",
            remedy="Shift them.",
            undo=counts_in_time,
            evidence=delay_evidence,
            scored=True,
            scope=scope,
            suggested=delay_sizes(DELAYS),
            tolerance=2.0,
            unit="samples",
        )
        yield Hypothesis(
            name="late torques",
            check="delay",
            sentence="The torques are {value:+.2g} samples late",
            remedy="Shift them.",
            undo=torques_in_time,
            scope=scope,
            suggested=delay_sizes(TORQUE_DELAYS),
            tolerance=2.0,
            unit="samples",
        )


def _stated() -> Iterator[Hypothesis[Any]]:
    """Yield the rows: numbers of the drive that the rig states."""
    yield Hypothesis(
        name="current limit",
        check="clipped torque",
        sentence="The torque of {joint} is cut off at {value:.3g} of the stated limit",
        remedy="State the limit.",
        undo=lower_limit,
        scope=each_joint,
        suggested=used_limits,
    )
    for name in ("coulomb", "viscous"):
        title = f"{name.capitalize()} friction"
        yield Hypothesis(
            name=title,
            check="units of torque" if name == "coulomb" else "viscous friction",
            sentence=f"{title} is not the rig's, but {{value:.2g}} times the stated one",
            remedy="Correct that if it was a guess.",
            undo=other_friction(name),
            scope=each_joint,
            suggested=friction_ratios(name),
            tolerance=1.0,
            evidence=viscous_evidence if name == "viscous" else None,
            parameter=True,
            # A friction that is stated is often a guess.
            against=5.0 if name == "viscous" else 10.0,
        )


def several(n: int) -> Iterator[Joints]:
    """The scope of a mistake of all joints alike, of more than one."""
    if n > 1:
        yield ()


TABLE: tuple[Hypothesis[Any], ...] = (
    *_exchanges(),
    *_turns(),
    *_units(),
    *_units_of_one(),
    *_statements(),
    *_sizes(),
    *_stated(),
)

SWITCHES = tuple(row for row in TABLE if row.suggested is None and row.tolerance is None)
"""Rows without a size that is estimated: a log whose counts are spoiled shows these alone."""


# Share of its evidence by which a refined size must be better.
_RUGGED = 0.03


# -- the evidence ----------------------------------------------------------------------------------
@dataclass
class Trials:
    """Tries every row of a table on a log."""

    table: Sequence[Hypothesis[Any]] = TABLE
    failed: dict[str, str] = field(default_factory=dict)

    def __call__(self, experiment: Experiment) -> Iterator[Candidate]:
        """Candidates of all rows, each with its likeliest size."""
        for hypothesis in self.table:
            for joints in hypothesis.scope(experiment.n):
                try:
                    yield from self._candidates(experiment, hypothesis, joints)
                except ValueError as error:
                    self._name(hypothesis, f"cannot be undone in this log: {error}")
                except Exception as error:  # of a user's own function
                    if hypothesis in TABLE:
                        raise
                    self._name(hypothesis, f"failed: {error!r}")

    def _name(self, hypothesis, reason):
        """Name a user's own hypothesis that is left out; built-in ones do not concern every log."""
        if hypothesis not in TABLE:
            self.failed[hypothesis.name] = reason

    def _candidates(self, experiment, hypothesis, joints):
        def changed(size):
            record = hypothesis.undo(experiment.record, joints, size)
            if record == experiment.record:
                self._name(hypothesis, "changes nothing in this log")
            return experiment.changed(record)

        evidence = hypothesis.evidence and hypothesis.evidence(experiment, joints)
        if evidence is None:
            evidence = self._scored(experiment, hypothesis, joints, changed)
        names = _column_names(experiment, joints)
        for size, gain in evidence:
            if hypothesis.evidence is not None:
                # A mistake that cannot be undone here is none of this log's.
                undone = changed(size)
                # Evidence of its own joins that of the score, which sees more of a large mistake.
                if hypothesis.scored:
                    gain = max(gain, undone.score - experiment.score)
            odds = gain - hypothesis.against
            words = {**names, "inverse": 1 / size if size else np.inf}
            yield Candidate(hypothesis, joints, size, odds, partial(changed, size), words)

    def _scored(self, experiment, hypothesis, joints, changed):
        """The likeliest size, and how much likelier the log is without a mistake of that size."""
        # Here, since it is slow to import.
        from scipy.optimize import minimize_scalar

        sizes = hypothesis.sizes
        if hypothesis.suggested is not None:
            sizes = hypothesis.suggested(experiment, joints)
        if not sizes:
            return []

        def gain(size):
            return changed(float(size)).score - experiment.score

        gains = [gain(size) for size in sizes]
        best = int(np.argmax(gains))
        size, most = float(sizes[best]), gains[best]
        # A delay of one joint shows in that joint, and not in others alone.
        if hypothesis.check == "delay" and joints and most > hypothesis.against:
            after = changed(size).terms
            if (
                sum(after[name][i] - experiment.terms[name][i] for name in after for i in joints)
                < 0
            ):
                return []
        tolerance = hypothesis.tolerance
        if tolerance is None or most <= hypothesis.against:
            return [(size, most)]
        # Where nothing but the motion tells, a log that gets better and better is none of a delay.
        if (
            hypothesis.check == "delay"
            and experiment.torques_of_law is None
            and best == len(sizes) - 1
        ):
            return []
        grid_of_sizes = len(sizes) > 1
        if grid_of_sizes:
            ends = sizes[max(best - 1, 0)], sizes[min(best + 1, len(sizes) - 1)]
            options = {"xatol": 1e-3 * tolerance, "maxiter": 14}
            result = minimize_scalar(
                lambda size: -gain(size), bounds=ends, method="bounded", options=options
            )
            # Rounding makes the score rugged: a size of the grid stays unless another is clearly
            # better.
            if -result.fun > (1 + _RUGGED) * most:
                size, most = float(result.x), -float(result.fun)
        # Occam: a size that the log determines well was unlikely to be just that.
        step = 0.02 * tolerance * (1.0 if grid_of_sizes else size)
        curvature = (2 * most - gain(size + step) - gain(size - step)) / step**2
        tolerance *= 1.0 if grid_of_sizes else size
        return [(size, most - np.log1p(tolerance**2 * max(curvature, 0.0)) / 2)]


def _column_names(experiment, joints):
    """Names of the columns of the first joint in messages."""
    signals = experiment.signals
    joint = joints[0] if joints else 0
    names = {
        name: signals.column(name, joint) for name in ("torque", "counts", "reference", "error")
    }
    # The sign of the gear decides which direction of the joint a current drives.
    if experiment.record.torque is None:
        names["torque"] += ", or of the gear"
    if signals.reference is None:
        names["torque"] += ", of the counts or of the gear"
    # The convention that is not stated.
    if experiment.record.rig.encoder.rounding == "fix":
        return names | {"cell": "no wide cell", "rounding": '"floor"'}
    return names | {"cell": "a cell two pulses wide", "rounding": '"fix"'}
