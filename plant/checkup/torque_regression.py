"""Regressions of a motor's torque on its motion, without a model of the arm.

Regressors are the accelerations of all motors, the motor's speed (viscous friction) and its sign
(Coulomb friction), and sines and cosines of the joint angles and of their sums: all of a planar
arm's gravity, most of another's. The coefficients are averages over the log; their signs and sizes
show whether a log can be an arm's.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class RegressionSettings:
    """Numbers of the regressions of torque on motion, chosen by hand.

    Parameters
    ----------
    slow : float
        Share of the RMS speed below which a joint may stick, so that its friction is unknown.
    singular : float
        Relative eigenvalue below which a direction of the normal equations is not identifiable.
    segments : int
        Segments of the log, each left out once by the jackknife.
    per_window : int
        Rows taken from a filter's window: more are not independent.
    """

    slow: float = 0.05
    singular: float = 1e-10
    segments: int = 10
    per_window: int = 7


SETTINGS = RegressionSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueRegression:
    """Coefficients of the torque of one motor, with standard deviations.

    Of the acceleration of every motor (n,) [kg m^2], of its own speed [N m s/rad] and its sign [N
    m]; delay of the counts behind the torque [samples]; motion of the motor alone where the load
    torque changes sign [pulses], and the number of such reversals; share of the torque's variance
    that all this does not explain.
    """

    inertia: Floats
    inertia_std: Floats
    viscous: float
    viscous_std: float
    coulomb: float
    coulomb_std: float
    delay: float
    delay_std: float
    backlash: float
    backlash_std: float
    reversals: int
    unexplained: float

    @classmethod
    def of(cls, signals, torque: Floats, i: int) -> Self | None:
        """Fit the torque (M, n) [N m] of motor i; None for too few rows, or a constant torque."""
        # 1. Rows in which the motor moves, so that friction has a known sign.
        n = signals.n
        encoder = signals.rig.encoder
        counts, speeds, accelerations = signals.motion
        speed = speeds[:, i]
        rms_speed = np.sqrt(np.mean(speed[signals.clear] ** 2))
        rows = np.flatnonzero(signals.clear & (np.abs(speed) > SETTINGS.slow * rms_speed))
        rows = rows[:: max(1, signals.window // SETTINGS.per_window)]
        measured = signals.smooth(torque)[:, i]
        if len(rows) < 10 * SETTINGS.per_window:
            return None
        # That of a motor at its limit is constant, beside rounding.
        if np.ptp(measured[rows]) <= 1e-9 * np.abs(measured[rows]).max():
            return None

        # 2. Inertia, friction and gravity.
        # Gravity of a planar arm acts on the absolute angles of its links.
        angle = np.cumsum(signals.rig.cell_centre(counts), axis=1)
        # The sign passes the same filter as the torque.
        direction = signals.smooth_even(np.sign(speed))
        columns = np.column_stack(
            [
                encoder.to_angle(accelerations),
                encoder.to_angle(speeds)[:, i],
                direction,
                np.ones(len(speed)),
                np.sin(angle),
                np.cos(angle),
            ]
        )

        def fitted(*further_columns):
            table = np.column_stack([columns, *further_columns])
            return least_squares(table[rows], measured[rows], memory=SETTINGS.per_window)

        value, std = fitted()
        residual = measured[rows] - columns[rows] @ value

        # 3. Delay: with late counts the torque correlates with the jerk, too. A second estimate is
        # the coefficient of the torque's own slope; the standard deviation covers both.
        jerk = encoder.to_angle(np.gradient(accelerations, signals.interval, axis=0))
        with_jerk, with_jerk_std = fitted(jerk)
        delay, delay_std = (
            x[-n + i] / with_jerk[i] / signals.interval for x in (with_jerk, with_jerk_std)
        )
        with_slope, _ = fitted(np.gradient(measured, signals.interval))
        delay_by_slope = with_slope[-1] / signals.interval
        delay_std = max(abs(delay_std), abs(delay - delay_by_slope) / 2)

        # 4. Backlash: where the load torque changes sign, the motor turns alone.
        rotor = signals.rig.drive.motor_inertia[i]
        # What remains without friction and the rotor is the torque on the gear.
        load = (
            columns @ value
            - value[n] * columns[:, n]
            - value[n + 1] * direction
            - rotor * columns[:, i]
        )
        # A motor that runs ahead adds the acceleration of such a step.
        load_sign = signals.smooth_even(np.sign(load))
        ahead, ahead_std = fitted(signals.rates(load_sign[:, None])[1])
        scale = 2 / max(abs(value[i] - rotor), 1e-300) / encoder.to_angle(np.ones(n))[i]
        return cls(
            inertia=value[:n],
            inertia_std=std[:n],
            viscous=value[n],
            viscous_std=std[n],
            coulomb=value[n + 1],
            coulomb_std=std[n + 1],
            delay=delay,
            delay_std=delay_std,
            backlash=ahead[-1] * scale,
            backlash_std=ahead_std[-1] * scale,
            reversals=int(np.sum(np.diff(np.sign(load)) != 0)),
            unexplained=float(np.mean(residual**2) / np.var(measured[rows])),
        )


def least_squares(columns: Floats, measured: Floats, memory: int) -> tuple[Floats, Floats]:
    """Coefficients and standard deviations (k,) of a regression with correlated residuals.

    Residuals count as independent only every `memory` rows; a jackknife over segments of the log
    covers a model error that changes with the pose. The larger standard deviation counts.
    """
    # Columns of one size, so that the singular limit is relative.
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0] = 1.0
    columns = columns / scale
    # Each segment has normal equations of its own, so that leaving it out is a subtraction.
    segments = np.array_split(np.arange(len(measured)), SETTINGS.segments)
    squares = np.array([columns[rows].T @ columns[rows] for rows in segments])
    products = np.array([columns[rows].T @ measured[rows] for rows in segments])
    total = squares.sum(axis=0)
    target = products.sum(axis=0)
    inverse = _inverse(total)
    value = inverse @ target
    residual = np.mean((measured - columns @ value) ** 2)
    variance = np.diag(inverse) * residual * memory
    without_segment = np.array(
        [_inverse(total - A) @ (target - b) for A, b in zip(squares, products, strict=True)]
    )
    jackknife = (SETTINGS.segments - 1) * np.mean((without_segment - value) ** 2, axis=0)
    return value / scale, np.sqrt(np.maximum(variance, jackknife)) / scale


def _inverse(squares):
    """Pseudo-inverse of normal equations: columns that are alike share their coefficient."""
    return np.linalg.pinv(squares, SETTINGS.singular, hermitian=True)
