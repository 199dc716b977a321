"""How far the counts of a log deviate from their motion, and how far an arm lets them.

Rounding, the usual deviations of the log, the timing of its samples and ordinary accelerations
explain a deviation. What exceeds them all is a fault of the log.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from plant.parts import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """Numbers of the deviations of counts, of a motion's acceleration, and of lines in gaps.

    Parameters
    ----------
    spike : float
        Deviation [largest one of rounding, or of nearly all rows] that neither of them causes.
    neighbours : int
        Rows to each side whose median speed is the speed of the motion, where a row is in doubt.
    mistimed : float
        Jitter [median intervals] of the instant at which a count is read. A stamp that is further
        off is late or early; a clock is uneven whose quartiles are further apart.
    in_time : float
        Share of the motion within a doubtful time up to which a count is where the motion was: at
        the even time of a stamp that is off, or behind a row that repeats. From one less this share
        on a count was read at its stamp.
    late : float
        Step [median intervals] above which a sample of an even clock is missing.
    ordinary : float
        Acceleration [rad/s^2, or m/s^2 of a joint that slides] with which any arm may start or
        stop within a sample, however calm the rest of the log is. Robots' data sheets have 5 to 20.
    quantile : float
        Share of the deviations, and of the speeds, that are the motion's; the others may be faults
        of the log.
    visible : float
        Mean square of these deviations [variances of rounding] from which on they show the motion.
    line : float
        Deviation [ranges of the joint] up to which a straight line replaces the motion. Of a
        sweep of 0.65 rad at 0.1 Hz (rms 0.5 rad/s^2) lines of 0.1 s keep within it.
    """

    spike: float = 4.0
    neighbours: int = 4
    mistimed: float = 0.2
    in_time: float = 0.3
    late: float = 1.5
    ordinary: float = 5.0
    quantile: float = 0.98
    visible: float = 8.0
    line: float = 1e-3


SETTINGS = MotionSettings()

LEAST_MOTION = 20
"""Counts that a motor has to move, at least."""


class Innovation(NamedTuple):
    """Steps of the counts beyond those of the local speed, each (M - 1, n) [pulses].

    What explains them: `noise` with the rounding, ordinary accelerations of the `arm`, and the
    `timing` of the samples.
    """

    size: Floats
    noise: Floats
    arm: Floats
    timing: Floats

    @property
    def outlier(self) -> Bools:
        """Steps (M - 1, n) that no arm makes."""
        return np.abs(self.size) > self.noise + self.arm + self.timing


def innovation(signals: Any, speed: Floats, quantile: float = SETTINGS.quantile) -> Innovation:
    """Innovation of the counts, with their speeds (M - 1, n) [pulses/s] in each interval.

    `quantile` of the innovations is no fault.
    """
    spans = np.diff(signals.t)[:, None]
    size = np.diff(signals.counts, axis=0) - speed * spans
    # At least a count: both ends of a step are rounded.
    usual = np.maximum(signals.least_count, np.quantile(np.abs(size), quantile, axis=0))
    # A stamp that is off shows in its own interval and in its neighbours.
    odd = np.abs(np.pad(spans, ((1, 1), (0, 0)), mode="edge") - signals.interval)
    odd = np.maximum(np.maximum(odd[:-2], odd[1:-1]), odd[2:])
    timing = np.abs(speed) * (SETTINGS.mistimed * signals.interval + odd)
    return Innovation(size, SETTINGS.spike * usual, stopped(signals.rig, spans), timing)


def stopped(rig: Any, seconds: Any) -> Floats:
    """Motion [pulses] of each joint that an ordinary acceleration starts or stops within a time.

    The speed is the median of seven intervals, which a short start misses by up to three intervals
    of acceleration.
    """
    pulses = np.abs(rig.drive.gear * rig.encoder.resolution) / (2 * np.pi)
    return 3 * SETTINGS.ordinary * pulses * seconds**2


def acceleration(t: Floats, counts: Floats, least: float = 1.0) -> Floats:
    """Root mean square of the acceleration of each column of counts (N, n) [counts/s^2].

    Neither rounding to `least` nor rare faults are in it.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(1000) * 1e-3
    >>> acceleration(t, np.round(400 * t**2)[:, None]).round(-1)
    array([800.])
    """
    return np.array([_acceleration(t, column, least) for column in counts.T])


def _acceleration(t, counts, least):
    # The stencil widens until the curvature of the motion exceeds the rounding.
    reach = 1
    while 8 * reach <= len(t):
        before = t[reach:-reach] - t[: -2 * reach]
        after = t[2 * reach :] - t[reach:-reach]
        share = after / (before + after)
        line = share * counts[: -2 * reach] + (1 - share) * counts[2 * reach :]
        square = (counts[reach:-reach] - line) ** 2
        rounding = least**2 / 12 * (1 + share**2 + (1 - share) ** 2)
        usual = square <= np.quantile(square, SETTINGS.quantile)
        excess = float((square - rounding)[usual].sum())
        if excess > (SETTINGS.visible - 1) * rounding[usual].sum():
            # A constant acceleration deviates by half the product of both intervals.
            return np.sqrt(excess / ((before * after)[usual] ** 2 / 4).sum())
        reach *= 2
    return 0.0


def longest_line(t: Floats, counts: Floats) -> float:
    """Interval [s] across which straight lines between counts (N, n) replace the motion.

    It is `late` median intervals where no joint moves, the log is too short to tell, or the motion
    allows less.
    """
    span = np.ptp(counts, axis=0) if len(t) > 8 else np.zeros(counts.shape[1])
    moves = span >= LEAST_MOTION
    rms = acceleration(t, counts[:, moves])
    # A line across an interval T deviates by at most a T^2 / 8.
    line = np.sqrt(8 * SETTINGS.line * span[moves] / rms).min() if len(rms) and rms.all() else 0.0
    shortest = SETTINGS.late * np.median(np.diff(t)) if len(t) > 1 else 0.0
    return float(max(line, shortest))
