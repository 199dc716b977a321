"""The columns of a record as the checks need them: valid samples, evenly spaced, smoothed alike.

Everything is motor side and needs no model of the arm. Counts, reference and torque pass the same
filter, so that equations between them and their derivatives still hold.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from plant.checkup.innovation import LEAST_MOTION, Innovation, innovation, longest_line
from plant.checkup.innovation import SETTINGS as MOTION
from plant.checkup.torque_regression import TorqueRegression
from plant.laws import commanded_torque
from plant.parts import Bools, Floats

T = TypeVar("T")

TRACKING = 0.2
"""Deviation of the slope of counts over reference from 1, above which they do not track it."""


@dataclass(frozen=True, kw_only=True)
class SignalSettings:
    """Numbers of the filters of a log, chosen by hand.

    Parameters
    ----------
    window : float
        Length of the smoothing window [s].
    window_samples : int
        Least length of the smoothing window [samples].
    angles : float
        Range [counts] from which on broken numbers are scaled counts rather than angles.
    """

    window: float = 0.02
    window_samples: int = 21
    angles: float = 2000


SETTINGS = SignalSettings()


class Motion(NamedTuple):
    """Smoothed counts with their speeds and accelerations, each (G, n) [pulses, 1/s, 1/s^2]."""

    counts: Floats
    speed: Floats
    acceleration: Floats


class Signals:
    """Motor side signals of a record, and quantities derived from them.

    t (M,) [s], counts and reference (M, n) [pulses] of samples with weight; no reference where all
    of it is zero. Motor torque (M, n) [N m], logged, or from logged currents. ``interval``: median
    time between two samples [s].
    """

    def __init__(self, record, base: "Signals | None" = None) -> None:
        self.record = record
        self.rig = record.rig
        self.n = record.n
        self.joint_labels = (
            self.rig.joint_labels if record.law is None else record.law.joint_labels(self.rig)
        )
        # Rows without weight would be outliers of every check.
        self._valid = record.valid > 0
        self._all_valid = bool(self._valid.all())
        self.t = self.rows(record.t)
        # Columns that a changed record shares with its base are not computed again.
        before = base and base.record
        columns = "error_pulses", "reference_pulses", "valid"
        same = before and all(getattr(before, name) is getattr(record, name) for name in columns)
        self.counts: Floats = base.counts if base and same else self.rows(record.counts)
        same_times = before and before.t is record.t
        self._same_counts = base if same and same_times else None
        self.reference = None
        # Records without a reference have zeros there.
        if record.reference_pulses.any():
            self.reference = self.rows(record.reference_pulses)
        drive = record.rig.drive
        self.torque = None
        if record.torque is not None:
            self.torque = self.rows(drive.motor_torque(record.torque))
        elif record.current is not None:
            self.torque = self.rows(drive.motor_gain * record.current)
        self.interval = (
            float(np.median(np.diff(record.t))) if len(record) > 1 else record.rig.period
        )

    def rows(self, table):
        """Rows of a table with weight; the table itself where all have it, for it may be long."""
        return table if self._all_valid else table[self._valid]

    def per_joint(self, *checks: Callable[[Any, int], T]) -> Iterator[T]:
        """Results of these checks, one check after another, joint by joint."""
        for check in checks:
            for i in range(self.n):
                yield check(self, i)

    def even(self, values: Floats) -> Floats:
        """Values (M,) at evenly spaced times."""
        return np.interp(np.arange(self.t[0], self.t[-1], self.interval), self.t, values)

    def column(self, field: str, i: int) -> str:
        """Name of a column in messages: as in the file, if one was mapped, or "the torque"."""
        if field == "torque" and self.record.torque is None:
            field = "current"
        name = self.record.column(field, i)
        return f"the {field}" if name == field else name

    @functools.cached_property
    def tracks(self) -> Bools:
        """Whether the counts of each joint track the reference, (n,); true without a motion."""
        # A NaN slope is not above the limit, hence the negation.
        return ~(np.abs(self.tracking_slope - 1) > TRACKING)

    @functools.cached_property
    def commanded(self) -> Floats | None:
        """Motor torque (M, n) of a law without memory, with the injected one; None if unknown.

        A log whose counts do not track has a wrong column, so that its law would give a wrong
        torque.
        """
        if self.reference is None or not self.tracks.all():
            return None
        commanded = commanded_torque(self.record)
        if commanded is None:
            return None
        # A known torque that was injected beside the command acts on the motor, too.
        injected = 0.0 if self.record.injected is None else self.record.injected
        return self.rig.drive.motor_torque(commanded + injected)[self._valid]

    @functools.cached_property
    def angular(self) -> Bools:
        """Whether the counts of each joint are angles, (n,): not whole, and within two turns."""
        # Counts are whole numbers, and a motion has many turns of the motor.
        broken = (self.counts != np.round(self.counts)).any(axis=0)
        largest = np.minimum(SETTINGS.angles, 2 * self.rig.encoder.resolution)
        return broken & (np.ptp(self.counts, axis=0) < largest) & (not self.rig.encoder.smooth)

    @property
    def motor_torque(self) -> Floats | None:
        """Motor torque (M, n) as logged, or else as commanded; None without either."""
        return self.commanded if self.torque is None else self.torque

    @property
    def no_torque(self) -> str:
        """Reason why no check of torques is possible; empty where there are some."""
        if self.motor_torque is None:
            return "neither torque nor current, and none that follows from the law alone"
        return ""

    @functools.cached_property
    def window(self) -> int:
        """Samples of the smoothing window, odd so that it is centred on a sample."""
        # In slow logs a window in seconds would have too few samples for second differences.
        samples = max(SETTINGS.window_samples, round(SETTINGS.window / self.interval))
        return 2 * (samples // 2) + 1

    @property
    def long_enough(self) -> bool:
        """Whether enough rows are left to compare after smoothing."""
        return len(self.t) > 10 * self.window and self.clear.sum() > 5 * self.window

    @functools.cached_property
    def times(self) -> Floats:
        """Evenly spaced times (G,) [s]."""
        # The small addition keeps the last sample where rounding makes the span too short.
        steps = int((self.t[-1] - self.t[0]) / self.interval + 1e-6)
        return self.t[0] + np.arange(steps + 1) * self.interval

    @functools.cached_property
    def clear(self) -> Bools:
        """Rows (G,) of `smooth` and `rates` that are valid: clear of gaps and ends."""
        if self._same_counts is not None:
            return self._same_counts.clear
        times = self.times
        present = np.ones(len(times))
        # Interpolated values in a gap are no measurement.
        for i in np.flatnonzero(np.diff(self.t) > self.longest_line):
            present[(times > self.t[i]) & (times < self.t[i + 1])] = 0
        # A row is clear if its whole window is.
        share = np.convolve(present, np.ones(self.window) / self.window, mode="same")
        clear = share > 1 - 1e-9
        clear[: self.window] = False
        clear[-self.window :] = False
        return clear

    def smooth(self, values: Floats) -> Floats:
        """Values (M, n) at evenly spaced times, averaged over the window."""
        # Filters need even times.
        return self.smooth_evenly(
            np.column_stack([np.interp(self.times, self.t, column) for column in values.T])
        )

    def smooth_evenly(self, values: Floats) -> Floats:
        """Evenly spaced values (G, n), averaged over the window."""
        return np.column_stack([self.smooth_even(column) for column in values.T])

    def smooth_even(self, values: Floats) -> Floats:
        """Evenly spaced values (G,), averaged over the window."""
        # Without its two zeros the Hann window has `window` samples, as `clear` assumes.
        kernel = np.hanning(self.window + 2)[1:-1]
        return np.convolve(values, kernel / kernel.sum(), mode="same")

    def rates(self, smoothed: Floats) -> tuple[Floats, Floats]:
        """First and second derivative in time of smoothed values (G, n)."""
        rate = np.gradient(smoothed, self.interval, axis=0)
        second = np.zeros_like(smoothed)
        # The second difference is narrower than two gradients, and has no value at the ends.
        second[1:-1] = np.diff(smoothed, 2, axis=0) / self.interval**2
        return rate, second

    @functools.cached_property
    def motion(self) -> Motion:
        """Motion of the counts."""
        return self._motion(self.counts)

    @functools.cached_property
    def smooth_reference(self) -> Motion | None:
        """Motion of the reference; None without a reference."""
        return None if self.reference is None else self._motion(self.reference)

    def _motion(self, pulses):
        smoothed = self.smooth(pulses)
        return Motion(smoothed, *self.rates(smoothed))

    @functools.cached_property
    def local_speed(self) -> Floats:
        """Median speed of the counts over seven intervals, (M - 1, n) [pulses/s].

        A median is robust against single outliers among the counts.
        """
        speed = np.diff(self.counts, axis=0) / np.diff(self.t)[:, None]
        # At both ends the first, or last, speed goes on.
        padded = np.pad(speed, ((3, 3), (0, 0)), mode="edge")
        return np.median(np.lib.stride_tricks.sliding_window_view(padded, 7, axis=0), axis=2)

    @functools.cached_property
    def innovation(self) -> Innovation:
        """Innovation of the counts, with the local speed."""
        return innovation(self, self.local_speed)

    @functools.cached_property
    def full_speed(self) -> Floats:
        """Full speed of each joint (n,) [pulses/s]."""
        return np.quantile(np.abs(self.local_speed), MOTION.quantile, axis=0)

    @functools.cached_property
    def longest_line(self) -> float:
        """Interval [s] across which straight lines replace the motion."""
        return longest_line(self.t, self.counts)

    @functools.cached_property
    def tracking_slope(self) -> Floats:
        """Regression (n,) of the counts' speed on the reference's; NaN without a motion.

        It is 1 in a loop that tracks.
        """
        if self.smooth_reference is None:
            return np.full(self.n, np.nan)
        reference = self.smooth_reference.speed[self.clear]
        counts = self.motion.speed[self.clear]
        power = (reference**2).sum(axis=0)
        moves = np.sqrt(power * self.interval) > 0
        slope = (reference * counts).sum(axis=0) / np.where(moves, power, 1.0)
        return np.where(moves, slope, np.nan)

    @functools.cached_property
    def regressions(self) -> list[TorqueRegression | None]:
        """`TorqueRegression` of each motor; None for one that hardly moves, or without torque."""
        if self.motor_torque is None or not self.long_enough:
            return [None] * self.n
        # A motor at rest has no acceleration to regress on.
        still = np.ptp(self.counts, axis=0) < LEAST_MOTION * self.least_count
        unusable = still | self.angular
        torque = self.motor_torque
        return [
            None if unusable[i] else TorqueRegression.of(self, torque, i) for i in range(self.n)
        ]

    @functools.cached_property
    def noise(self) -> Floats:
        """Standard deviation (n,) of the counts where the arm is slowest [pulses].

        It is that of the residual of quartics through 9 samples; NaN in a log of fewer than ten
        such windows.
        """
        if len(self.t) < 90:
            return np.full(self.n, np.nan)
        # Orthonormal polynomials up to the fourth degree over 9 samples.
        basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, 9), 5, increasing=True))
        windows = np.lib.stride_tricks.sliding_window_view(self.counts, 9, axis=0)
        coefficients = windows @ basis
        # 9 samples less 5 coefficients are 4 degrees of freedom.
        square = ((windows - coefficients @ basis.T) ** 2).sum(axis=2) / 4
        speed = np.abs(coefficients[..., 1])
        slow = speed <= np.quantile(speed, 0.1, axis=0)
        median = [np.median(column[rows]) for column, rows in zip(square.T, slow.T, strict=True)]
        # 0.84: median of chi-squared with four degrees of freedom, divided by four
        return np.sqrt(np.array(median) / 0.84)

    @functools.cached_property
    def least_count(self) -> Floats:
        """Smallest significant difference of counts (n,) [pulses]: a pulse if they are rounded."""
        if not self.rig.encoder.smooth:
            return np.ones(self.n)
        steps = np.abs(np.diff(self.counts, axis=0))
        # The smallest steps are the resolution of numbers that are not rounded.
        smallest = [
            np.quantile(column[column > 0], 0.01) if column.any() else 1.0 for column in steps.T
        ]
        return np.maximum(smallest, 4 * np.nan_to_num(self.noise))
