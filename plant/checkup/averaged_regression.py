"""Regression of the equation of motion averaged over time: the mean inertia matrix of a log in open loop.

An arm that swings freely needs little torque for much acceleration, less than the noise of twice differentiated counts.
So the equation of motion of each motor is formed with all its terms (inertia and velocity products that change with the
angles between the links, friction, gravity) and averaged over a good part of a swing: it holds, without the noise.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.checkup.torque_regression import least_squares

_AVERAGE = 0.4
"""Window [s] over which the equation is averaged; shorter where the log would not hold enough of them."""

_PER_WINDOW = 7
"""Rows taken from a window, and rows that each unknown needs."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AveragedRegression:
    """Coefficients of the torque of one motor, with standard deviations.

    Of the acceleration of every motor (n,), mean over the log [kg m^2]; of the sign of the speed of every motor (n,),
    if all are allowed to rub, and of its own, the only one that should [N m]; delay of the counts behind the torque
    [samples].
    """

    inertia: NDArray[np.float64]
    inertia_std: NDArray[np.float64]
    cross_coulomb: NDArray[np.float64]
    cross_coulomb_std: NDArray[np.float64]
    coulomb: float
    coulomb_std: float
    delay: float
    delay_std: float

    @classmethod
    def all_of(cls, signals: Any, torque: NDArray[np.float64]) -> list[AveragedRegression] | None:
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

        def means(columns: Any) -> NDArray[np.float64]:
            return np.column_stack([np.convolve(x, kernel / kernel.sum(), mode="same") for x in columns])

        common, smooth = means(shared)[rows], signals.smooth(torque)
        viscous, dry = means(speed.T)[rows], means([signals.smooth_even(np.sign(rate)) for rate in speed.T])[rows]
        measured, slope = means(smooth.T), means(np.gradient(smooth, interval, axis=0).T)
        found = []
        for i in range(n):
            columns, torques = np.column_stack([common, viscous[:, i], dry[:, i]]), measured[rows, i]
            if not np.ptp(torques):
                return None
            value, std = least_squares(columns, torques, memory=_PER_WINDOW)
            # Late counts: the model gives the torque of a delay ago.
            late, late_std = least_squares(np.column_stack([columns, slope[rows, i]]), torques, memory=_PER_WINDOW)
            # Friction goes with a motor's own speed; with another's, columns are exchanged.
            cross, cross_std = least_squares(np.column_stack([common, viscous, dry]), torques, memory=_PER_WINDOW)
            found.append(cls(
                inertia=value[:n], inertia_std=std[:n], cross_coulomb=cross[-n:], cross_coulomb_std=cross_std[-n:],
                coulomb=value[-1], coulomb_std=std[-1], delay=late[-1] / interval, delay_std=late_std[-1] / interval,
            ))  # fmt: skip
        return found
