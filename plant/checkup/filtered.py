"""Columns of a log after one smoothing filter: value, derivatives and sign of the speed.

All columns pass the same filter, so that equations between them still hold. They are compared at
few rows, since those within one window of the filter are alike.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plant.checkup.signals import Signals
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """Numbers of the filter, chosen by hand.

    Parameters
    ----------
    rows : int
        Rows of the filtered log that are compared, at most.
    dependent : float
        Samples that count as one equation, since residuals of neighbours are alike.
    average : float
        Window [s] over which the terms of a motion that no loop holds are averaged: much of a
        swing. Real pendulums turn at 1 to 2 Hz.
    """

    rows: int = 800
    dependent: float = 7.0
    average: float = 0.25


SETTINGS = FilterSettings()


class Filtered(NamedTuple):
    """A smoothed column at the compared rows, each (M,): value, derivatives, sign of speed."""

    value: Floats
    speed: Floats
    acceleration: Floats
    jerk: Floats
    direction: Floats


class Filter:
    """Smooths columns of one log, at rows whose whole window was measured.

    `equations`: how many of the samples behind these rows are independent. `speed_noise`: variance
    of a smoothed speed that rounding to whole pulses causes.
    """

    def __init__(self, signals: Signals) -> None:
        self.t = signals.t
        self.interval = signals.interval
        window = signals.window
        self.times = signals.times
        rows = np.flatnonzero(signals.clear)
        self.stride = max(1, window // REGRESSION.per_window, -(-len(rows) // SETTINGS.rows))
        self.rows = rows[:: self.stride]
        # Samples behind each row: all of them, or those of its window where rows lie further apart.
        samples = min(self.stride, window) * len(self.rows)
        self.equations = samples / SETTINGS.dependent
        # Four samples more than the window, so that differences of smoothed values fit in.
        kernel = np.zeros(window + 4)
        kernel[2:-2] = np.hanning(window + 2)[1:-1]
        kernel /= kernel.sum()

        def rate(column):
            return (np.roll(column, 1) - np.roll(column, -1)) / (2 * self.interval)

        second = (np.roll(kernel, 1) - 2 * kernel + np.roll(kernel, -1)) / self.interval**2
        self.kernels = np.column_stack([kernel, rate(kernel), second, rate(second)])
        self.speed_noise = float((self.kernels[:, 1] ** 2).sum()) / 12

    def __call__(self, column: Floats) -> Filtered:
        """Filter a column (M,) of the log."""
        even = np.interp(self.times, self.t, column)
        value, speed, acceleration, jerk = (self._at_rows(even) @ self.kernels).T
        # The sign of the speed passes the same filter as the torque that it causes.
        rate = np.convolve(even, self.kernels[::-1, 1], mode="same")
        direction = self._at_rows(np.sign(rate)) @ self.kernels[:, 0]
        return Filtered(value, speed, acceleration, jerk, direction)

    def _at_rows(self, even):
        half = len(self.kernels) // 2
        return np.lib.stride_tricks.sliding_window_view(even, len(self.kernels))[self.rows - half]

    def average(self, table: Floats, windows: int) -> Floats:
        """Average a table (M, k) of the compared rows over `SETTINGS.average` seconds.

        A short log is averaged over less, so that it has so many windows.
        """
        rows = SETTINGS.average / (self.interval * self.stride)
        rows = min(rows, len(table) / windows)
        kernel = np.hanning(2 * int(rows / 2) + 3)[1:-1]
        return np.column_stack(
            [np.convolve(column, kernel / kernel.sum(), mode="valid") for column in table.T]
        )


def centred(columns: Floats) -> Floats:
    """Columns (M,) or (M, n) less their means; a short log may leave no rows."""
    return columns - columns.mean(axis=0) if len(columns) else columns
