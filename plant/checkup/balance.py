"""The torque of a motor explained by its motion, without a model of the arm.

Motor torque is a constant times the acceleration of each motor, plus viscous and dry friction, plus what depends on the
pose (sines and cosines of the joint angles and of their sums: all of a planar arm's gravity, most of another's). The
constants are averages over the log; their signs and sizes tell whether a log can be an arm's.
"""

from __future__ import annotations

import dataclasses

import numpy as np

__all__ = ["Balance", "least_squares"]

_SLOW = 0.05
"""Share of the usual speed below which a joint may stick, and its friction is anything."""

_SINGULAR = 1e-10
"""Relative size below which a direction of the normal equations is not known."""

_TENTHS = 10

_PER_WINDOW = 7
"""Rows taken from a smoothing window: more say the same."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """Coefficients of the torque of one motor, with standard deviations.

    Attributes
    ----------
    inertia, inertia_std : (n,) numpy.ndarray
        Of the acceleration of every motor [kg m^2].
    viscous, viscous_std : float
        Of its own speed [N m s/rad].
    dry, dry_std : float
        Of the sign of its speed [N m].
    delay, delay_std : float
        Counts behind torque [samples].
    play, play_std : float
        How far the motor runs ahead where the torque on its load changes sign [pulses].
    reversals : int
        How often that torque does.
    """

    inertia: np.ndarray
    inertia_std: np.ndarray
    viscous: float
    viscous_std: float
    dry: float
    dry_std: float
    delay: float
    delay_std: float
    play: float
    play_std: float
    reversals: int

    @classmethod
    def of(cls, signals, torque, i):
        """Fit the torque (M, n) [N m] of motor i; None where too few rows show it."""
        n, encoder = signals.n, signals.rig.encoder
        counts, speed, acceleration = signals.motion
        own = speed[:, i]
        rows = signals.clear & (np.abs(own) > _SLOW * np.sqrt(np.mean(own[signals.clear] ** 2)))
        rows = np.flatnonzero(rows)[:: max(1, signals.window // _PER_WINDOW)]
        if len(rows) < 10 * _PER_WINDOW or not np.ptp(torque[:, i]):
            return None
        angle = np.cumsum(signals.rig.cell_centre(counts), axis=1)
        dry = signals.smooth_even(np.sign(own))
        columns = np.column_stack([
            encoder.to_angle(acceleration), encoder.to_angle(speed)[:, i], dry, np.ones(len(own)), np.sin(angle),
            np.cos(angle),
        ])  # fmt: skip
        wanted = signals.smooth(torque)[:, i]

        def fitted(*more):
            return least_squares(np.column_stack([columns, *more])[rows], wanted[rows], memory=_PER_WINDOW)

        # Late counts: the torque goes with the jerk, too.
        jerk = encoder.to_angle(np.gradient(acceleration, signals.interval, axis=0))
        value, std = fitted()
        with_jerk, with_jerk_std = fitted(jerk)
        late, late_std = (x[-n + i] / with_jerk[i] / signals.interval for x in (with_jerk, with_jerk_std))
        slope = fitted(np.gradient(wanted, signals.interval))[0][-1] / signals.interval  # another way to say the same
        late_std = max(abs(late_std), abs(late - slope) / 2)
        # Play: where the torque on the load changes sign, the motor turns alone.
        alone = signals.rig.drive.motor_inertia[i]
        load = columns @ value - value[n] * columns[:, n] - value[n + 1] * dry - alone * columns[:, i]
        side = signals.smooth_even(np.sign(load))
        ahead, ahead_std = fitted(signals.rates(side[:, None])[1])
        scale = 2 / max(abs(value[i] - alone), 1e-300) / encoder.to_angle(np.ones(n))[i]
        return cls(
            inertia=value[:n], inertia_std=std[:n], viscous=value[n], viscous_std=std[n], dry=value[n + 1],
            dry_std=std[n + 1], delay=late, delay_std=abs(late_std), play=ahead[-1] * scale,
            play_std=ahead_std[-1] * scale, reversals=int(np.sum(np.diff(np.sign(load)) != 0)),
        )  # fmt: skip


def least_squares(columns, wanted, memory):
    """Values and standard deviations of a regression on rows that are neither independent nor quite of this form.

    Residuals of neighbouring rows are one piece of news per `memory` rows; and leaving out one tenth of the log after
    the other shows what averages over its poses are worth. The larger standard deviation counts.

    Parameters
    ----------
    columns : (N, k) numpy.ndarray
    wanted : (N,) numpy.ndarray
    memory : int
    """
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0] = 1.0
    columns = columns / scale
    tenths = np.array_split(np.arange(len(wanted)), _TENTHS)
    squares = np.array([columns[rows].T @ columns[rows] for rows in tenths])
    products = np.array([columns[rows].T @ wanted[rows] for rows in tenths])
    inverse = np.linalg.pinv(squares.sum(axis=0), _SINGULAR, hermitian=True)
    value = inverse @ products.sum(axis=0)
    rest = np.mean((wanted - columns @ value) ** 2)
    variance = np.diag(inverse) * rest * memory
    without = np.array([
        np.linalg.pinv(squares.sum(axis=0) - A, _SINGULAR, hermitian=True) @ (products.sum(axis=0) - b)
        for A, b in zip(squares, products, strict=True)
    ])  # fmt: skip
    scatter = (_TENTHS - 1) * np.mean((without - value) ** 2, axis=0)
    return value / scale, np.sqrt(np.maximum(variance, scatter)) / scale
