"""Positions and torques of logs, from records or arrays: the torque that acted at each sample."""

from dataclasses import replace
from typing import Any, cast

import numpy as np

from identification.equation_error.filters import low_pass
from identification.equation_error.naming import each_named, record_label
from plant import Dynamics, Record, Reference, Resumed, Rig
from plant.checkup import bridged, on_lines
from plant.laws import commanded_torque
from plant.parts import Floats, array, frozen, instance
from plant.simulation import Clock, LawRun, injected_beside, run_law


def torque_of(record: Record) -> Floats:
    """Joint torques (N, n) [N m] of a record: commanded by its law, or else logged.

    They are logged where the law has a memory.

    A torque that a sampled law holds counts half at both ends of its sample, and so does one that
    was injected, which is added to what the law commanded. A law along its log is run.
    """
    if isinstance(record.law, Resumed):
        return law_torque(replace(record, law=record.law.along(record.rig)))
    commanded = commanded_torque(record)
    # Without memory the law gives the torque as exactly as the counts are known: it comes before a
    # column, which has the noise of its sensor.
    if commanded is not None:
        return driven(record, record.rig.drive.limited(commanded))
    return logged_torque(record)


def measured_torque(record: Record) -> Floats:
    """Joint torques (N, n) [N m] as they were logged, or by the currents.

    They contain an injected torque.
    """
    if record.torque is not None:
        return record.torque
    if record.current is not None:
        drive = record.rig.drive
        return drive.joint_torque(drive.motor_gain * record.current)
    if record.law is None:
        raise ValueError(
            "the record must hold torques or currents; it has neither, and no law that would give"
            " them from its counts. Map a column of the log as 'torque' or 'current', or give law=."
        )
    raise ValueError(
        f"the record must hold torques or currents; the counts under {type(record.law).__name__} do"
        " not give them. Log one of them, state what the law remembered (Resumed), or use"
        " identify, which finds it."
    )


def logged_torque(record: Record) -> Floats:
    """Logged joint torques (N, n) [N m] as means around each sample.

    A torque that is held for a sample counts half at both of its ends.
    """
    law = record.law
    logged = measured_torque(record)
    # A faster law changes its torque between samples: the logged one is that of the instant.
    if law is None or law.interpolates or (is_faster(record) and not law.replays):
        return logged
    return _held(logged)


def is_faster(record: Record) -> bool:
    """Whether the law takes steps between the rows of its log, at counts that no row has."""
    law: Any = record.law
    period = law.period
    # Periods that are equal may differ by rounding.
    return period is None or period < record.rig.period * (1 - 1e-6)


def between_samples(record: Record) -> Floats | None:
    """Change (N, n) of the torques if every second one is read on a line between its neighbours.

    Of a faster loop a log has samples alone: what they do not show of one another is the size of
    what they do not show between them. None where the torque is held, or the law gives it.
    """
    law = record.law
    if law is None or law.replays == "counts" or not law.interpolates:
        return None
    torque = measured_torque(record)
    change = np.zeros_like(torque)
    change[1:-1:2] = (torque[:-2:2] + torque[2::2]) / 2 - torque[1:-1:2]
    return change


def law_torque(record: Record, run: LawRun | None = None) -> Floats:
    """Motor torque (N, n) [N m] around each sample under a law that reads its log.

    `run`: of the law.
    """
    clock = Clock.of(record)
    run = run_law(record) if run is None else run
    return driven(record, run.around(clock.t[clock.rows], record.rig.period))


def driven(record: Record, commanded: Floats) -> Floats:
    """Torque (N, n) [N m] of the motors: commanded and injected, within the amplifier's limit."""
    injected = injected_beside(record)
    if injected is None:
        return commanded
    return record.rig.drive.limited(commanded + _held(injected))


def _held(torque):
    """Mean (N, n) around each sample of a torque that is held to the next.

    Both act at a sample.
    """
    return (torque + np.vstack([torque[:1], torque[:-1]])) / 2


# Deviation of a sample's time from the even ones, in periods, from which on a record is resampled;
# chosen by hand: time stamps are rounded.
_UNEVEN = 1e-3

# Samples per second that a search of the band needs, per Hz of the cutoff; chosen by hand, at eight
# times the least that could carry the cutoff.
_FINE = 16.0

# Least samples of a thinned log, chosen by hand: the low-pass takes a part of them at its ends.
_SAMPLES = 100


@frozen
class TorqueLog:
    """One log: joint positions and torques at even times.

    `label`: its name in messages; "" of a single log. `q`, `torque` (N, n): joint side [rad, N m];
    NaN in a column of torque that was not measured. `rig`: with the log's period. `valid` (N,) or
    None: weight of each sample; rows near one without weight do not count. `counted`: whether the
    positions are counts of the rig's encoders. `path`: the reference that was followed, if known.
    `record`: of which this is the log, as it was given.
    """

    label: str
    q: Floats
    torque: Floats
    rig: Rig
    valid: Floats | None = None
    counted: bool = False
    path: Reference | None = None
    record: Record | None = None


def torque_logs(dynamics: Dynamics, q, torque, rig: Rig | None) -> list[TorqueLog]:
    """Logs of records, or of positions (N, n) and torques (N, n), one or a sequence of each."""
    # Records, or positions with torques and a rig: the first argument decides.
    records = (q,) if isinstance(q, Record) else tuple(q) if isinstance(q, (tuple, list)) else ()
    if records and all(isinstance(record, Record) for record in records):
        if torque is not None or rig is not None:
            argument = "torque" if torque is not None else "rig"
            raise ValueError(
                f"{argument} must be left out beside records, which have their own; got one. Leave"
                " it out."
            )
        return _of_records(dynamics, records)
    # Arrays have no rig of their own, which gives their period and the drive.
    rig = instance("rig", cast(Rig, rig), Rig, "Pass the rig of the log.")
    rig.require_fit(dynamics.chain)
    if torque is None:
        raise ValueError(
            "torque must be given beside positions; got None. Give (N, n) [N m], or records in"
            " their place."
        )
    if not (isinstance(q, (tuple, list)) and len(q) and np.ndim(q[0]) == 2):
        return [_of_arrays(dynamics, "", q, torque, rig)]
    several = isinstance(torque, (tuple, list))
    if not several or len(torque) != len(q):
        got = len(torque) if several else f"one of type {type(torque).__name__}"
        raise ValueError(
            f"torque must be given for each of the {len(q)} logs of q; got {got}. Give as many."
        )
    logs = []
    for k, (positions, torques) in enumerate(zip(q, torque, strict=True)):
        label = f"logs[{k}]" if len(q) > 1 else ""
        logs.append(_of_arrays(dynamics, label, positions, torques, rig))
    return logs


def _of_arrays(dynamics, label, q, torque, rig):
    about = f"{label}: " if label else ""
    q = array(
        f"{about}q",
        q,
        ("N", dynamics.n),
        advice="Give one row per sample, one column per joint [rad].",
    )
    if not len(q):
        raise ValueError(
            f"{about}q must hold samples; got none. Check that the log was written to the end."
        )
    torque = array(
        f"{about}torque",
        torque,
        q.shape,
        advice="Give one row per sample, one column per joint [N m].",
        finite=False,
    )
    # A joint without a sensor is NaN throughout; a NaN among numbers is a fault.
    wrong = ~np.isfinite(torque) & ~np.isnan(torque).all(axis=0)
    if wrong.any():
        row, joint = (int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(
            f"{about}torque must be finite; got {torque[row, joint]} at index {(row, joint)}. Give"
            " one row per sample, one column per joint [N m]; a column that was not measured is"
            " NaN throughout."
        )
    return TorqueLog(label=label, q=q, torque=torque, rig=rig)


def evened(record: Record) -> Record:
    """The record at even times."""
    # Filters need even samples. Stamps that are even but for rounding are taken as they are.
    even = record.t[0] + record.rig.period * np.arange(len(record))
    uneven = np.abs(record.t - even).max() > _UNEVEN * record.rig.period
    return record.resampled(record.rig.period) if uneven else record


def _of_records(dynamics, records):
    logs = []
    for k, (given, about) in enumerate(each_named(records)):
        with about:
            record = given
            record.rig.require_fit(dynamics.chain)
            # Lost rows are bridged first: a filter would ring at their jumps, and at those of rows
            # without weight in longer gaps.
            record = bridged(record)
            record = on_lines(record, record.valid == 0)
            # Before resampling: the law read the counts at its own samples.
            if record.torque is None and record.current is None:
                record = replace(record, torque=torque_of(record), law=None)
            record = evened(record)
            torque = logged_torque(record)
        label = record_label(records, k)
        q = record.rig.cell_centre(record.counts)
        logs.append(
            TorqueLog(
                label=label,
                q=q,
                torque=torque,
                rig=record.rig,
                valid=record.valid,
                counted=True,
                path=record.reference,
                record=given,
            )
        )
    return logs


def dead_columns(log: TorqueLog) -> dict[int, str]:
    """Joints whose torque was not measured, with the reason."""
    reasons = {}
    label = f" in {log.label}" if log.label else ""
    for joint, column in enumerate(log.torque.T):
        if np.isnan(column).all():
            reasons[joint] = f"its torque is missing{label}"
        # A sensor has noise: one constant is a column that nothing was written to.
        elif np.ptp(column) == 0:
            reasons[joint] = f"its torque is {column[0]:g} in every sample{label}"
    return reasons


def thinned(log: TorqueLog, cutoff: float) -> TorqueLog:
    """The log with no more samples than the search of a band below a cutoff [Hz] needs.

    The log itself where it has no more.
    """
    every = int(1 / (_FINE * cutoff * log.rig.period))
    # The same object tells the caller that nothing was thinned.
    if every < 2 or len(log.q) < _SAMPLES * every:
        return log
    # Below half of the new sample rate, so that faster signals do not come back as slow ones.
    period = log.rig.period
    cutoff = 0.4 / (every * period)
    q, torque = (low_pass(signal, period, cutoff)[::every] for signal in (log.q, log.torque))
    valid = log.valid
    if valid is not None:
        # A thinned sample counts as little as the worst of those that it stands for.
        valid = np.minimum.reduceat(valid, np.arange(0, len(log.q), every))
    rig = replace(log.rig, period=every * period)
    return replace(log, q=q, torque=torque, rig=rig, valid=valid)
