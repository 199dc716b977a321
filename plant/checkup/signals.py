"""The columns of a record as an examination needs them: left-out samples dropped, evenly spaced, smoothed alike.

Everything is on the motor's side and needs no model of the arm. Counts, reference and torque pass the same smoothing,
so that equations between them and their derivatives stay true.
"""

from __future__ import annotations

import functools

import numpy as np

from plant.checkup.balance import Balance
from plant.checkup.swing import Swing
from plant.laws.law import commanded_torque

__all__ = ["FOLLOWS", "LEAST_MOTION", "Signals"]

_WINDOW = 0.02
"""Length of the smoothing window [s], but never less than so many samples:"""

_LEAST = 21

_SHIFTS, _SHIFT_SURE, _WILD = 2, 400.0, 5.0
"""Rows by which stamps and counts are tried to match; squared departure of the intervals [noise^2] from which on a
match is believed; and departure of a count [noise] that is no matter of time."""

FOLLOWS = 0.2
"""Departure of the counts' speed from the reference's, relative, that is no tracking any more."""

LEAST_MOTION = 20
"""Counts that a motor has to move, at least."""

_ANGLES = 2000
"""Range of counts from which on they cannot be angles."""

_MEDIAN = 0.89
"""Median of chi-squared with six degrees of freedom, divided by six."""

_GAP = 1.5
"""Median intervals from which on two samples have something missing between them."""


class Signals:
    """Views of a record.

    Attributes
    ----------
    t (M,), counts (M, n), reference (M, n) or None
        Samples with weight [s], [pulses]; no reference where all of it is zero.
    torque : (M, n) or None
        *Motor* torque [N m], logged, or from logged currents.
    interval : float
        Median time between two samples [s].
    """

    def __init__(self, record):
        self.record, self.rig, self.n = record, record.rig, record.n
        keep = record.valid > 0
        self.t, self.counts = record.t[keep], record.counts[keep]
        self.reference = record.reference_pulses[keep] if record.reference_pulses.any() else None
        drive = record.rig.drive
        torque = None
        if record.torque is not None:
            torque = drive.motor_torque(record.torque)
        elif record.current is not None:
            torque = drive.motor_gain * record.current
        self.torque = None if torque is None else torque[keep]
        self._keep = keep
        self.interval = float(np.median(np.diff(record.t))) if len(record) > 1 else record.rig.period

    @functools.cached_property
    def follows(self):
        """Whether the counts of each joint go where the reference goes, (n,); true where none moves."""
        return ~(np.abs(self.run - 1) > FOLLOWS)

    @functools.cached_property
    def asked(self):
        """Motor torque (M, n) that a law without memory asks for; None where the errors are not to be believed."""
        if self.reference is None or not self.follows.all():
            return None
        asked = commanded_torque(self.record)
        return None if asked is None else self.rig.drive.motor_torque(asked)[self._keep]

    @functools.cached_property
    def angular(self):
        """Whether the counts of each joint are angles rather than counts, (n,): not whole, and within two turns."""
        broken = (self.counts != np.round(self.counts)).any(axis=0)
        small = np.ptp(self.counts, axis=0) < np.minimum(_ANGLES, 2 * self.rig.encoder.resolution)
        return broken & small & (not self.rig.encoder.smooth)

    @property
    def drives(self):
        """Motor torque as logged, or else as the law asked; None without either."""
        return self.asked if self.torque is None else self.torque

    @functools.cached_property
    def window(self):
        """Samples of the smoothing window, odd."""
        return 2 * (max(_LEAST, round(_WINDOW / self.interval)) // 2) + 1

    @property
    def long_enough(self):
        """Whether there is anything left to compare after smoothing."""
        return len(self.t) > 10 * self.window and self.clear.sum() > 5 * self.window

    @functools.cached_property
    def _grid(self):
        """Evenly spaced times, and which of them lie clear of gaps and ends."""
        span = self.t[-1] - self.t[0]
        grid = self.t[0] + np.arange(int(span / self.interval + 1e-6) + 1) * self.interval
        clear = np.ones(len(grid))
        for i in np.flatnonzero(np.diff(self.t) > _GAP * self.interval):
            clear[(grid > self.t[i]) & (grid < self.t[i + 1])] = 0
        clear = np.convolve(clear, np.ones(self.window) / self.window, mode="same") > 1 - 1e-9
        clear[: self.window] = clear[-self.window :] = False
        return grid, clear

    @property
    def clear(self):
        """Rows (G,) of what `smooth` and `rates` give that are to be trusted."""
        return self._grid[1]

    def smooth(self, values):
        """Values (M, n) at evenly spaced times, averaged over the window."""
        grid, _ = self._grid
        return np.column_stack([self.smooth_even(np.interp(grid, self.t, column)) for column in values.T])

    def smooth_even(self, values):
        """Evenly spaced values (G,), averaged over the window."""
        kernel = np.hanning(self.window + 2)
        return np.convolve(values, kernel / kernel.sum(), mode="same")

    def rates(self, smoothed):
        """First and second derivative in time of smoothed values (G, n)."""
        rate = np.gradient(smoothed, self.interval, axis=0)
        second = np.zeros_like(smoothed)
        second[1:-1] = np.diff(smoothed, 2, axis=0) / self.interval**2
        return rate, second

    @functools.cached_property
    def motion(self):
        """Smoothed counts, their speeds and accelerations, each (G, n) [pulses, 1/s, 1/s^2]."""
        smoothed = self.smooth(self.counts)
        return smoothed, *self.rates(smoothed)

    @functools.cached_property
    def local_speed(self):
        """Median speed of the counts over seven intervals, (M - 1, n) [pulses/s]; an odd count does not move it."""
        speed = np.diff(self.counts, axis=0) / np.diff(self.t)[:, None]
        wide = np.pad(speed, ((3, 3), (0, 0)), mode="edge")
        return np.median(np.lib.stride_tricks.sliding_window_view(wide, 7, axis=0), axis=2)

    @functools.cached_property
    def row_shift(self):
        """Rows by which counts come after the time stamps, and their share (0 to 1) in what odd intervals promise.

        As intervals of other length show in a moving arm. NaN rows: the intervals are too alike to tell.
        """
        longer = (np.diff(self.t) - self.interval)[:, None]
        rest = np.diff(self.counts, axis=0) - self.local_speed * self.interval
        noise = np.maximum(np.quantile(np.abs(rest), 0.9, axis=0), 0.3 * self.grain)
        rest, expected = rest / noise, longer * self.local_speed / noise
        expected[:_SHIFTS] = expected[-_SHIFTS:] = 0
        power = np.sum(expected**2)
        if power < _SHIFT_SURE:
            return np.nan, 0.0
        rest = np.clip(rest, -_WILD - np.abs(expected).max(), _WILD + np.abs(expected).max())
        shifts = range(-_SHIFTS, _SHIFTS + 1)
        shares = [np.sum(rest * np.roll(expected, shift, axis=0)) / power for shift in shifts]
        best = int(np.argmax(shares))
        return shifts[best], float(np.clip(shares[best], 0.0, 1.0))

    @functools.cached_property
    def asked_for(self):
        """Smoothed reference and its speed, each (G, n) [pulses, 1/s]; None without a reference."""
        if self.reference is None:
            return None
        smoothed = self.smooth(self.reference)
        return smoothed, self.rates(smoothed)[0]

    @functools.cached_property
    def run(self):
        """Slope (n,) between the speeds of counts and reference: 1 in a loop that works, NaN if nothing is asked."""
        if self.reference is None:
            return np.full(self.n, np.nan)
        asked, made = self.asked_for[1][self.clear], self.motion[1][self.clear]
        power = (asked**2).sum(axis=0)
        moves = np.sqrt(power * self.interval) > 0
        return np.where(moves, (asked * made).sum(axis=0) / np.where(moves, power, 1.0), np.nan)

    @functools.cached_property
    def balances(self):
        """`Balance` of each motor (n of them, None where it cannot be had); None without any torque."""
        if self.drives is None or not self.long_enough:
            return None
        still = np.ptp(self.counts, axis=0) < LEAST_MOTION * self.grain
        return [None if still[i] or self.angular[i] else Balance.of(self, self.drives, i) for i in range(self.n)]

    @functools.cached_property
    def swings(self):
        """`Swing` of each motor where no law tells the torque; None where that cannot be had."""
        if self.torque is None or self.asked is not None or self.balances is None or None in self.balances:
            return None
        return Swing.all_of(self, self.torque)

    def shown(self, i):
        """`Balance` or `Swing` of motor i, the one that knows its inertia better; None without either."""
        if self.balances is None or self.swings is None:
            return None if self.balances is None else self.balances[i]
        return max(
            self.balances[i], self.swings[i], key=lambda fit: abs(fit.inertia[i]) / max(fit.inertia_std[i], 1e-300)
        )

    @functools.cached_property
    def noise(self):
        """Scatter (n,) of the counts about parabolas through 9 samples, in the slowest tenth of the log [pulses]."""
        if len(self.t) < 90:
            return np.full(self.n, np.nan)
        basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, 9), 3))
        window = np.lib.stride_tricks.sliding_window_view(self.counts, 9, axis=0)
        share = window @ basis
        square = ((window - share @ basis.T) ** 2).sum(axis=2) / 6
        slow = np.abs(share[..., 1]) <= np.quantile(np.abs(share[..., 1]), 0.1, axis=0)
        median = [np.median(column[rows]) for column, rows in zip(square.T, slow.T, strict=True)]
        return np.sqrt(np.array(median) / _MEDIAN)

    @functools.cached_property
    def grain(self):
        """Smallest difference of counts that means something (n,): a pulse, or of unrounded counts their own."""
        if not self.rig.encoder.smooth:
            return np.ones(self.n)
        steps = np.abs(np.diff(self.counts, axis=0))
        smallest = [np.quantile(column[column > 0], 0.01) if column.any() else 1.0 for column in steps.T]
        return np.maximum(smallest, 4 * np.nan_to_num(self.noise))
