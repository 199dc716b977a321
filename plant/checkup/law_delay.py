"""Delay of the counts under a law with memory: run along its log, it gives the logged torque from
the right rows alone.

Its memory before the log need not be known: the steps of torques are compared, from which an
integral is away, and smoothed torques without their mean.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.checkup.signals import Signals
from plant.laws.resumed import FAST, AlongLog, Resumed
from plant.motion.smooth_splines import smooth_splines
from plant.parts.fields import Floats

# Samples by which counts may be late; and trials, since a joint's torque may depend on another's
# late counts.
_SHIFTS = np.arange(-2, 4)
_ROUNDS = 3

# What the right rows leave of the torque, relative to what any others leave, at most; and relative
# to the torque.
_BETTER = 0.25
_SAME = 1e-4

# Samples along which the law is run; and its period, and the rig's, relative to the log's, at most.
_MOST = 5000
_PERIODS = 1.01


def law_delays(signals: Signals) -> Floats:
    """Samples (n,) by which the counts of each joint are late; NaN where law and logged torque do
    not tell.

    Smoothed torques alone, which fast hardware leaves, do not tell that nothing is late: a law lags
    by itself.
    """
    late = np.zeros(signals.n, int)
    unknown = np.full(signals.n, np.nan)
    if (law := _along(signals)) is None:
        return unknown
    rows = _Rows(signals, law)
    for _ in range(_ROUNDS):
        left = np.stack([rows.left(late + shift) for shift in _SHIFTS], axis=1)  # (2, shifts, n)
        (best, other), (least, following) = (
            left.argmin(axis=1),
            np.moveaxis(np.sort(left, axis=1)[:, :2], 1, 0),
        )
        by_steps, smoothed = least + _SAME < _BETTER * following
        moved = np.where(by_steps | (best == other), _SHIFTS[best], 0)
        if not moved.any():
            return np.where(by_steps | (smoothed & (best == other) & (late != 0)), late, unknown)
        late += moved
    return unknown


def _along(signals: Signals) -> AlongLog | None:
    """The law, reading the log's counts; None where it has no memory, or what it gives cannot be
    compared.
    """
    law = signals.record.law
    rig = signals.rig
    interval = signals.interval
    if law is None or law.replays or not law.has_memory(signals.n) or signals.reference is None:
        return None
    if signals.torque is None or not (signals.long_enough and signals.tracks.all()):
        return None
    if (
        law.period or 0.0
    ) > _PERIODS * interval or not 1 / _PERIODS < interval / rig.period < _PERIODS:
        return None
    return (
        law if isinstance(law, Resumed) else Resumed(law=law, state=law.initial_state(signals.n))
    ).along(rig)


class _Rows:
    """Rows in the middle of a log, on even times, along which its law is run."""

    def __init__(self, signals: Signals, law: AlongLog) -> None:
        self.signals = signals
        self.law = law
        record = signals.record
        rig = signals.rig
        first = max(0, (len(signals.clear) - _MOST) // 2)
        self.clear = signals.clear[first : first + _MOST].copy()
        self.clear[: signals.window] = self.clear[-signals.window :] = False
        self.t = signals.t[0] + signals.interval * (first + np.arange(len(self.clear)))
        self.period = law.period or signals.interval / FAST
        self.steps = np.arange(self.t[0], self.t[-1] + self.period / 2, self.period)
        self.counts, self.reference = (
            law.replayed(record),
            _lines(self.steps, signals.t, signals.reference),
        )
        self.motion = [np.zeros_like(self.reference)] * 3
        step = law.block(rig).step
        if record.reference is not None:
            self.motion = record.reference(self.steps - record.t[0])
        elif any(step.jac_sparsity(out, of).nnz() for out in (0, 1) for of in (1, 2, 3)):
            self.motion = self._smooth_motion()
        self.injected = (
            0.0 if record.injected is None else _lines(self.t, record.t, record.injected)
        )
        self.logged = self._limited(
            rig.drive.joint_torque(_lines(self.t, signals.t, signals.torque))
        )

    def _smooth_motion(self) -> list[Floats]:
        """Position, velocity and acceleration of the logged reference."""
        signals = self.signals
        rig = self.signals.rig
        rows = (signals.t >= self.t[0]) & (signals.t <= self.t[-1])
        asked = np.asarray(signals.reference)[rows]
        encoder = rig.encoder
        if whole := bool((asked == np.trunc(asked)).all()):
            asked = encoder.position_in_pulses(encoder.cell_centre(asked))
        splines = smooth_splines(signals.t[rows], asked, whole, 1.0)
        return [
            rig.to_angle(np.column_stack([each(self.steps, nu) for each in splines]))
            for nu in range(3)
        ]

    def left(self, late: NDArray[np.int_]) -> Floats:
        """What is left (2, n) of the logged torque with counts so late, relative to it: of its
        steps, and smoothed.
        """
        signals = self.signals
        t = self.signals.record.t
        read = [
            np.interp(self.steps + k * signals.interval, t, x)
            for k, x in zip(late, self.counts.T, strict=True)
        ]
        columns = *self.motion, self.reference, np.column_stack(read)
        ((given, _),) = self.law.steps(signals.rig, columns, self.period, [self.law.state])
        held = np.floor((self.t - self.t[0]) / self.period + 1e-6).astype(int)
        off = self._limited(given[held] + self.injected) - self.logged
        return np.array(
            [
                seen(off) / np.maximum(seen(self.logged), 1e-300)
                for seen in (self._steps, self._smoothed)
            ]
        )

    def _steps(self, torque: Floats) -> Floats:
        return np.asarray(np.abs(np.diff(torque, axis=0))[self.clear[1:]].mean(axis=0))

    def _smoothed(self, torque: Floats) -> Floats:
        smooth = np.column_stack([self.signals.smooth_even(column) for column in torque.T])[
            self.clear
        ]
        return np.asarray(np.abs(smooth - smooth.mean(axis=0)).mean(axis=0))

    def _limited(self, torque: Floats) -> Floats:
        """Motor torques of joint torques (M, n), within the amplifier's limit."""
        drive = self.signals.rig.drive
        return np.asarray(drive.motor_torque(drive.limited(torque)))


def _lines(at: Floats, t: Floats, columns: Any) -> Floats:
    return np.column_stack([np.interp(at, t, column) for column in columns.T])
