"""The columns of a record as the checks need them: samples without weight dropped, evenly spaced,
smoothed alike.

Everything is motor side and needs no model of the arm. Counts, reference and torque pass the same
filter, so that equations between them and their derivatives still hold.
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from plant.checkup.torque_regression import AveragedRegression, TorqueRegression
from plant.laws.replayed import commanded_torque
from plant.parts.fields import Floats

T = TypeVar("T")

# length of the smoothing window [s], but never less than so many samples
_WINDOW = 0.02
_LEAST = 21

# Rows by which stamps and counts may be shifted; squared deviation of the intervals [noise^2] from
# which on a shift is significant; and deviation of a count [noise] that is not one of timing.
_SHIFTS = 2
_SHIFT_SURE = 400.0
_WILD = 5.0

# relative deviation of the counts' speed from the reference's above which they do not track it
TRACKING = 0.2

LEAST_MOTION = 20  # counts that a motor has to move, at least

_ANGLES = 2000  # range of counts above which they cannot be angles

_MEDIAN = 0.84  # median of chi-squared with four degrees of freedom, divided by four

_GAP = 1.5  # median intervals above which samples are missing


class Signals:
    """Motor side signals of a record, and what is derived of them.

    t (M,) [s], counts and reference (M, n) [pulses] of samples with weight; no reference where all
    of it is zero. Motor torque (M, n) [N m], logged, or from logged currents. ``interval``: median
    time between two samples [s].
    """

    def __init__(self, record: Any) -> None:
        self.record = record
        self.rig = record.rig
        self.n = record.n
        self.joint_labels = (
            self.rig.joint_labels if record.law is None else record.law.joint_labels(self.rig)
        )
        self._keep = keep = record.valid > 0
        self.t = record.t[keep]
        self.counts = record.counts[keep]
        self.reference = record.reference_pulses[keep] if record.reference_pulses.any() else None
        drive = record.rig.drive
        torque = None
        if record.torque is not None:
            torque = drive.motor_torque(record.torque)
        elif record.current is not None:
            torque = drive.motor_gain * record.current
        self.torque = None if torque is None else torque[keep]
        self.interval = (
            float(np.median(np.diff(record.t))) if len(record) > 1 else record.rig.period
        )

    def each(self, *checks: Callable[[Any, int], T]) -> Iterator[T]:
        """What these checks find, one after another, joint by joint."""
        for check in checks:
            yield from (check(self, i) for i in range(self.n))

    def even(self, values: Floats) -> Floats:
        """Values (M,) at evenly spaced times."""
        return np.interp(np.arange(self.t[0], self.t[-1], self.interval), self.t, values)

    def column(self, field: str, i: int) -> str:
        """What messages call a column: its name in the file, if one was mapped; "the torque"
        otherwise.
        """
        field = "current" if field == "torque" and self.record.torque is None else field
        name = self.record.column(field, i)
        return f"the {field}" if name == field else name

    @functools.cached_property
    def tracks(self) -> NDArray[np.bool_]:
        """Whether the counts of each joint track the reference, (n,); true where none moves."""
        return ~(np.abs(self.tracking_slope - 1) > TRACKING)

    @functools.cached_property
    def commanded(self) -> Floats | None:
        """Motor torque (M, n) of a law without memory, and what was injected; None where the
        counts do not track.
        """
        tracked = self.reference is not None and self.tracks.all()
        commanded = commanded_torque(self.record) if tracked else None
        if commanded is None:
            return None
        injected = 0.0 if self.record.injected is None else self.record.injected
        return self.rig.drive.motor_torque(commanded + injected)[self._keep]

    @functools.cached_property
    def angular(self) -> NDArray[np.bool_]:
        """Whether the counts of each joint are angles rather than counts, (n,): not whole, and
        within two turns.
        """
        broken = (self.counts != np.round(self.counts)).any(axis=0)
        small = np.ptp(self.counts, axis=0) < np.minimum(_ANGLES, 2 * self.rig.encoder.resolution)
        return broken & small & (not self.rig.encoder.smooth)

    @property
    def motor_torque(self) -> Floats | None:
        """Motor torque (M, n) as logged, or else as commanded; None without either."""
        return self.commanded if self.torque is None else self.torque

    @property
    def no_torque(self) -> str:
        """Why nothing can be said of torques; empty where there are some."""
        return (
            "neither torque nor current, and no law that tells it"
            if self.motor_torque is None
            else ""
        )

    @functools.cached_property
    def window(self) -> int:
        """Samples of the smoothing window, odd."""
        return 2 * (max(_LEAST, round(_WINDOW / self.interval)) // 2) + 1

    @property
    def long_enough(self) -> bool:
        """Whether enough rows are left to compare after smoothing."""
        return len(self.t) > 10 * self.window and self.clear.sum() > 5 * self.window

    @functools.cached_property
    def _grid(self):
        """Evenly spaced times, and which of them are clear of gaps and ends."""
        span = self.t[-1] - self.t[0]
        grid = self.t[0] + np.arange(int(span / self.interval + 1e-6) + 1) * self.interval
        clear = np.ones(len(grid))
        for i in np.flatnonzero(np.diff(self.t) > _GAP * self.interval):
            clear[(grid > self.t[i]) & (grid < self.t[i + 1])] = 0
        clear = np.convolve(clear, np.ones(self.window) / self.window, mode="same") > 1 - 1e-9
        clear[: self.window] = clear[-self.window :] = False
        return grid, clear

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Rows (G,) of `smooth` and `rates` that are valid: clear of gaps and ends."""
        return self._grid[1]

    def smooth(self, values: Floats) -> Floats:
        """Values (M, n) at evenly spaced times, averaged over the window."""
        grid, _ = self._grid
        return np.column_stack(
            [self.smooth_even(np.interp(grid, self.t, column)) for column in values.T]
        )

    def smooth_even(self, values: Floats) -> Floats:
        """Evenly spaced values (G,), averaged over the window."""
        # as long as the window of `_grid`, in short logs too
        kernel = np.hanning(self.window + 2)[1:-1]
        return np.convolve(values, kernel / kernel.sum(), mode="same")

    def rates(self, smoothed: Floats) -> tuple[Floats, Floats]:
        """First and second derivative in time of smoothed values (G, n)."""
        rate = np.gradient(smoothed, self.interval, axis=0)
        second = np.zeros_like(smoothed)
        second[1:-1] = np.diff(smoothed, 2, axis=0) / self.interval**2
        return rate, second

    @functools.cached_property
    def motion(self) -> tuple[Floats, Floats, Floats]:
        """Smoothed counts, their speeds and accelerations, each (G, n) [pulses, 1/s, 1/s^2]."""
        smoothed = self.smooth(self.counts)
        return smoothed, *self.rates(smoothed)

    @functools.cached_property
    def local_speed(self) -> Floats:
        """Median speed of the counts over seven intervals, (M - 1, n) [pulses/s]: robust against
        single odd counts.
        """
        speed = np.diff(self.counts, axis=0) / np.diff(self.t)[:, None]
        wide = np.pad(speed, ((3, 3), (0, 0)), mode="edge")
        return np.median(np.lib.stride_tricks.sliding_window_view(wide, 7, axis=0), axis=2)

    @functools.cached_property
    def row_shift(self) -> tuple[float, float]:
        """Rows by which counts lag behind their time stamps, and the regression coefficient (0 to
        1) there.

        Regression of the counts' steps, beyond the mean speed, on those that intervals of odd
        length predict. NaN rows: the intervals are too alike to tell.
        """
        longer = (np.diff(self.t) - self.interval)[:, None]
        rest = np.diff(self.counts, axis=0) - self.local_speed * self.interval
        noise = np.maximum(np.quantile(np.abs(rest), 0.9, axis=0), 0.3 * self.least_count)
        rest = rest / noise
        expected = longer * self.local_speed / noise
        expected[:_SHIFTS] = expected[-_SHIFTS:] = 0
        power = np.sum(expected**2)
        if power < _SHIFT_SURE:
            return np.nan, 0.0
        rest = np.clip(rest, -_WILD - np.abs(expected).max(), _WILD + np.abs(expected).max())
        shifts = range(-_SHIFTS, _SHIFTS + 1)
        slopes = [np.sum(rest * np.roll(expected, shift, axis=0)) / power for shift in shifts]
        best = int(np.argmax(slopes))
        return shifts[best], float(np.clip(slopes[best], 0.0, 1.0))

    @functools.cached_property
    def smooth_reference(self) -> tuple[Floats, Floats] | None:
        """Smoothed reference and its speed, each (G, n) [pulses, 1/s]; None without a reference."""
        if self.reference is None:
            return None
        smoothed = self.smooth(self.reference)
        return smoothed, self.rates(smoothed)[0]

    @functools.cached_property
    def tracking_slope(self) -> Floats:
        """Regression (n,) of the counts' speed on the reference's: 1 in a loop that tracks, NaN
        without a motion.
        """
        if self.smooth_reference is None:
            return np.full(self.n, np.nan)
        commanded = self.smooth_reference[1][self.clear]
        made = self.motion[1][self.clear]
        power = (commanded**2).sum(axis=0)
        moves = np.sqrt(power * self.interval) > 0
        return np.where(moves, (commanded * made).sum(axis=0) / np.where(moves, power, 1.0), np.nan)

    @functools.cached_property
    def regressions(self) -> list[TorqueRegression | None]:
        """`TorqueRegression` of each motor, None for one that hardly moves; None without torque,
        or for a short log.
        """
        if self.motor_torque is None or not self.long_enough:
            return [None] * self.n
        still = np.ptp(self.counts, axis=0) < LEAST_MOTION * self.least_count
        of = TorqueRegression.of
        torque = self.motor_torque
        return [None if still[i] or self.angular[i] else of(self, torque, i) for i in range(self.n)]

    @functools.cached_property
    def averaged(self) -> list[AveragedRegression] | None:
        """`AveragedRegression` of each motor; None where the law gives the torque, or the log is
        too short.
        """
        if self.torque is None or self.commanded is not None or None in self.regressions:
            return None
        return AveragedRegression.all_of(self, self.torque)

    def regression(self, i: int) -> Any:
        """The regression of motor i that knows its inertia better; None without any."""
        if self.averaged is None:
            return self.regressions[i]
        fits: tuple[Any, ...] = self.regressions[i], self.averaged[i]
        return max(fits, key=lambda fit: abs(fit.inertia[i]) / max(fit.inertia_std[i], 1e-300))

    @functools.cached_property
    def noise(self) -> Floats:
        """Standard deviation (n,) of the counts from quartics of 9 samples, where the arm is
        slowest [pulses].
        """
        if len(self.t) < 90:
            return np.full(self.n, np.nan)
        basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, 9), 5, increasing=True))
        window = np.lib.stride_tricks.sliding_window_view(self.counts, 9, axis=0)
        share = window @ basis
        square = ((window - share @ basis.T) ** 2).sum(axis=2) / 4
        slow = np.abs(share[..., 1]) <= np.quantile(np.abs(share[..., 1]), 0.1, axis=0)
        median = [np.median(column[rows]) for column, rows in zip(square.T, slow.T, strict=True)]
        return np.sqrt(np.array(median) / _MEDIAN)

    @functools.cached_property
    def least_count(self) -> Floats:
        """Smallest significant difference of counts (n,) [pulses]: a pulse, or of unrounded
        counts their own.
        """
        if not self.rig.encoder.smooth:
            return np.ones(self.n)
        steps = np.abs(np.diff(self.counts, axis=0))
        smallest = [
            np.quantile(column[column > 0], 0.01) if column.any() else 1.0 for column in steps.T
        ]
        return np.maximum(smallest, 4 * np.nan_to_num(self.noise))
