"""How the counts of a log may change: the acceleration of its motion, apart from their rounding."""

from dataclasses import dataclass

import numpy as np

from plant.parts.fields import Floats


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """Numbers of the estimate of a motion's acceleration, and of the lines that replace samples.

    Parameters
    ----------
    quantile : float
        Share of the deviations that are the motion's; the others may be faults of the log.
    visible : float
        Mean square of these deviations [variances of rounding] from which on they show the motion.
    moving : float
        Range [least counts] from which on a joint moves.
    line : float
        Deviation [ranges of the joint] up to which a straight line replaces the motion. Of a
        sweep of 0.65 rad at 0.1 Hz (rms 0.5 rad/s^2) lines of 0.1 s keep within it.
    """

    quantile: float = 0.98
    visible: float = 8.0
    moving: float = 20.0
    line: float = 1e-3


SETTINGS = MotionSettings()


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

    Zero where no joint moves, or the log is too short to tell.
    """
    span = np.ptp(counts, axis=0)
    moves = span >= SETTINGS.moving
    if not moves.any():
        return 0.0
    # A line across an interval T deviates by at most a T^2 / 8.
    square = 8 * SETTINGS.line * span[moves]
    rms = acceleration(t, counts[:, moves])
    return float(np.sqrt(square / rms).min()) if rms.all() else 0.0
