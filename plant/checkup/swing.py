"""The inertia matrix that a log in open loop shows, averaged over its poses.

An arm that swings freely needs little torque for much acceleration, and what little there is drowns in the noise of
twice differentiated counts. So the equation of motion of each motor is formed with all its terms (inertia and velocity
products that change with the angles between the links, friction, gravity), and then averaged over a good part of a
swing, which leaves it true and the noise behind.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from plant.checkup.balance import least_squares

__all__ = ["Swing"]

_AVERAGE = 0.4
"""Window [s] over which the equation is averaged; shorter where the log would not hold enough of them."""

_PER_WINDOW = 7
"""Rows taken from a window, and rows that each unknown needs."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Swing:
    """Coefficients of the torque of one motor, with standard deviations.

    Attributes
    ----------
    inertia, inertia_std : (n,) numpy.ndarray
        Of the acceleration of every motor, mean over the log [kg m^2].
    drag, drag_std : (n,) numpy.ndarray
        Of the sign of the speed of every motor [N m].
    dry, dry_std : float
        Of the sign of its own, the only one that should rub [N m].
    delay, delay_std : float
        Counts behind torque [samples].
    """

    inertia: np.ndarray
    inertia_std: np.ndarray
    drag: np.ndarray
    drag_std: np.ndarray
    dry: float
    dry_std: float
    delay: float
    delay_std: float

    @classmethod
    def all_of(cls, signals, torque):
        """Fit the torques (M, n) [N m] of all motors; None where the log is too short for that many unknowns."""
        n, encoder, interval = signals.n, signals.rig.encoder, signals.interval
        counts, *rates = signals.motion
        speed, acceleration = (encoder.to_angle(rate) for rate in rates)
        angle = signals.rig.cell_centre(counts)
        pose = [column - column[signals.clear].mean() for turn in (np.cos, np.sin) for column in turn(angle[:, 1:]).T]
        products = [speed[:, a] * speed[:, b] for a in range(n) for b in range(a, n)]
        absolute = np.cumsum(angle, axis=1)
        shared = [
            *acceleration.T, *(p * column for p in pose for column in (*acceleration.T, *products)),
            np.ones(len(angle)), *np.sin(absolute).T, *np.cos(absolute).T,
        ]  # fmt: skip
        unknown = len(shared) + 3
        length = 2 * int(min(_AVERAGE / interval, signals.clear.sum() / (unknown + 2)) / 2) + 1
        if length < signals.window:
            return None
        kernel = np.hanning(length + 2)
        clear = np.convolve(signals.clear, np.ones(length) / length, mode="same") > 1 - 1e-9
        rows = np.flatnonzero(clear)[:: max(1, length // _PER_WINDOW)]
        if len(rows) < _PER_WINDOW * unknown:
            return None

        def averaged(columns):
            return np.column_stack([np.convolve(x, kernel / kernel.sum(), mode="same") for x in columns])

        shared, smooth = averaged(shared)[rows], signals.smooth(torque)
        viscous, dry = averaged(speed.T)[rows], averaged([signals.smooth_even(np.sign(rate)) for rate in speed.T])[rows]
        wanted, slope = averaged(smooth.T), averaged(np.gradient(smooth, interval, axis=0).T)
        found = []
        for i in range(n):
            columns, torques = np.column_stack([shared, viscous[:, i], dry[:, i]]), wanted[rows, i]
            if not np.ptp(torques):
                return None
            value, std = least_squares(columns, torques, memory=_PER_WINDOW)
            # Late counts: the model gives the torque of that time ago.
            late, late_std = least_squares(np.column_stack([columns, slope[rows, i]]), torques, memory=_PER_WINDOW)
            # Friction is its own motor's, so another's tells of a wrong column.
            drag, drag_std = least_squares(np.column_stack([shared, viscous, dry]), torques, memory=_PER_WINDOW)
            found.append(cls(
                inertia=value[:n], inertia_std=std[:n], drag=drag[-n:], drag_std=drag_std[-n:], dry=value[-1],
                dry_std=std[-1], delay=late[-1] / interval,
                delay_std=late_std[-1] / interval,
            ))  # fmt: skip
        return found
