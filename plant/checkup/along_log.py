"""A law, run along the counts of a log: the torque that it commands, and the steps of it.

The memory of a law before the log is unknown, so steps are compared, in which an integral cancels.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant.checkup.signals import Signals
from plant.checkup.stamps import another_period
from plant.laws import FAST, Resumed, block_of, commanded_torque
from plant.motion import smooth_splines
from plant.parts import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class AlongLogSettings:
    """Numbers of the run of a law along a log, chosen by hand.

    Parameters
    ----------
    samples : int
        Samples at the beginning of the log along which the law is run.
    period : float
        Largest ratio of the law's period, and of the rig's, to the interval of the log.
    """

    samples: int = 3000
    period: float = 1.01


SETTINGS = AlongLogSettings()


def steps_of_torque(
    signals: Signals, commanded: Floats, *, slow: bool = False
) -> tuple[Floats, Floats]:
    """Steps (M, n) of commanded and of logged motor torque from sample to sample of the log.

    `commanded` (K, n): joint torque of the law, as of `torque_along`. `slow`: steps over the
    smoothing window, of torques that are averaged over it.
    """
    clear, law, logged = comparable_torques(signals, commanded)
    drive = signals.rig.drive
    # The amplifier limits what the law commands, so compare limited torques.
    torques = [
        drive.motor_torque(drive.limited(drive.joint_torque(motor))) for motor in (law, logged)
    ]
    if slow:
        torques = [signals.smooth_evenly(torque) for torque in torques]
    rows = signals.window if slow else 1
    steps, measured = (torque[rows:] - torque[:-rows] for torque in torques)
    steps = np.nan_to_num(steps, nan=0.0, posinf=0.0, neginf=0.0)
    # A step begins and ends where the memory of the law is the log's.
    both = clear[rows:] & clear[:-rows]
    return steps[both], measured[both]


def comparable_torques(signals: Signals, commanded: Floats) -> tuple[Bools, Floats, Floats]:
    """Rows (K,) that can be compared, and two motor torques (K, n): of the law, and logged.

    `commanded` (K, n): joint torque of the law, as of `torque_along`. What was injected is added.
    """
    # A law that starts with the log has the right memory, and any other forgets the wrong one.
    clear = signals.clear[: len(commanded)].copy()
    clear[: signals.window] = False
    clear[-signals.window :] = False
    t = sample_times(signals, len(commanded))
    record = signals.record
    injected = 0.0 if record.injected is None else at_times(t, record.t, record.injected)
    logged = at_times(t, signals.t, np.asarray(signals.torque))
    return clear, signals.rig.drive.motor_torque(commanded + injected), logged


def torque_along(signals: Signals, stated: Any, rig: Any) -> Floats | None:
    """Joint torque (K, n) of a law that reads the log's counts, in its first samples.

    That of a law with memory is limited by the amplifiers of `rig`, any other is not. None where
    the law, or the log, does not allow it.
    """
    law = _law_along_log(signals, stated, rig)
    if law is None:
        return None
    record = signals.record
    t = sample_times(signals, len(signals.clear[: SETTINGS.samples]))
    if not stated.has_memory(signals.n):
        commanded = commanded_torque(replace(record, law=stated, rig=rig))
        return None if commanded is None else at_times(t, record.t, commanded)
    # 1. The law's own times: fast hardware has no period, and is run some steps per sample.
    period = law.period or signals.interval / FAST
    # The clock of a log may be off by a little: the law's steps are the log's, not those of a time
    # that drifts away by samples. Stamps that scatter show no such clock.
    steps = max(round(signals.interval / period), 1)
    ratio = signals.interval / (steps * period)
    alike = 1 / SETTINGS.period < ratio < SETTINGS.period
    spacing = signals.interval / steps if alike and another_period(signals, ratio) else period
    times = np.arange(t[0], t[-1] + spacing / 2, spacing)
    counts = at_times(times, record.t, law.replayed(record))
    reference = at_times(times, signals.t, np.asarray(signals.reference))
    columns = *_reference_motion(signals, law, times, t), reference, counts
    ((torque, _),) = law.steps(rig, columns, period, [law.state])
    # 2. Each sample has the torque of the last step of the law up to it.
    return torque[np.floor((t - t[0]) / spacing + 1e-6).astype(int)]


def driven(record: Any, signals: Signals, torque: Floats) -> Any:
    """A stretch of a log with this motor torque (K, n) of its beginning as the logged one."""
    times = sample_times(signals, len(torque))
    motor = at_times(record.t + times[signals.window], times, torque)
    # An integral begins at an unknown value: the amplifier's limit bounds the range of the torque.
    motor -= (motor.max(axis=0) + motor.min(axis=0)) / 2
    joint = record.rig.drive.joint_torque(motor)
    if record.injected is not None:
        joint = joint + record.injected
    return replace(record, law=None, torque=joint, current=None)


def sample_times(signals: Signals, samples: int) -> Floats:
    """Evenly spaced times (K,) of the first samples of a log [s]."""
    return signals.t[0] + signals.interval * np.arange(samples)


def _law_along_log(signals: Signals, law: Any, rig: Any) -> Any:
    """The law that reads the counts of the log; None where its torque cannot be compared."""
    if law is None or law.replays or signals.reference is None or not signals.long_enough:
        return None
    # A slower law would need the rows between those of the log.
    slower = (law.period or 0.0) > SETTINGS.period * signals.interval
    if slower or not 1 / SETTINGS.period < signals.interval / rig.period < SETTINGS.period:
        return None
    # A law that is resumed has a memory already; any other starts with its initial one.
    if not isinstance(law, Resumed):
        law = Resumed(law=law, state=law.initial_state(signals.n))
    return law.along(rig)


def _reference_motion(signals, law, times, t):
    """Position, velocity and acceleration of the reference (K, n) at the law's times."""
    record = signals.record
    if record.reference is not None:
        return record.reference(times - record.t[0])
    block = block_of(law, signals.rig)
    # Splines of a logged reference are made only for a law that reads more of it than its counts.
    if not any(block.depends(output, "q", "qd", "qdd") for output in ("asked", "following")):
        return [np.zeros((len(times), signals.n))] * 3
    encoder = signals.rig.encoder
    rows = (signals.t >= t[0]) & (signals.t <= t[-1])
    reference = signals.reference[rows]
    # Whole pulses were rounded from a smooth path: the splines may pass anywhere in the cells.
    whole = bool((reference == np.trunc(reference)).all())
    if whole:
        reference = encoder.position_in_pulses(encoder.cell_centre(reference))
    splines = smooth_splines(signals.t[rows], reference, whole, 1.0)
    return [
        signals.rig.to_angle(np.column_stack([spline(times, order) for spline in splines]))
        for order in range(3)
    ]


def at_times(times: Floats, t: Floats, columns: Floats) -> Floats:
    """Columns (N, n) at `t`, on straight lines at other times: (K, n)."""
    return np.column_stack([np.interp(times, t, column) for column in columns.T])
