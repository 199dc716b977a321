"""Regressions of a motor's torque on its motion, without a model of the arm.

Regressors are the accelerations of all motors, the motor's speed (viscous friction) and its sign
(Coulomb friction), and sines and cosines of the joint angles and of their sums: all of a planar
arm's gravity, most of another's. The coefficients are averages over the log; their signs and sizes
show whether a log can be an arm's. `TorqueRegression` holds at each sample, `AveragedRegression` on
average over much of a swing.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from plant.parts.fields import Floats


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
        Rows taken from a filter's window: more are not independent. Also the rows per unknown that
        an averaged regression needs.
    average : float
        Window [s] of the averaged regression, shorter where the log has too few of them.
    """

    slow: float = 0.05
    singular: float = 1e-10
    segments: int = 10
    per_window: int = 7
    average: float = 0.4


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
        if len(rows) < 10 * SETTINGS.per_window or not np.ptp(torque[:, i]):
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
        measured = signals.smooth(torque)[:, i]

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


@dataclass(frozen=True, kw_only=True, eq=False)
class AveragedRegression:
    """Coefficients, with standard deviations, of a motor's equation of motion, averaged.

    An arm that swings freely needs little torque for much acceleration, less than the noise of
    twice differentiated counts; the average of the equation with all its terms, over much of a
    swing, holds without the noise.

    Of the acceleration of every motor (n,), mean over the log [kg m^2]; of the sign of the speed of
    every motor (n,), if all are allowed to rub, and of its own, the only one that should [N m];
    delay of the counts behind the torque [samples].
    """

    inertia: Floats
    inertia_std: Floats
    cross_coulomb: Floats
    cross_coulomb_std: Floats
    coulomb: float
    coulomb_std: float
    delay: float
    delay_std: float

    @classmethod
    def all_of(cls, signals, torque: Floats) -> list[Self] | None:
        """Fit the torques (M, n) [N m] of all motors; None for a log too short for the unknowns."""
        # 1. Terms that all motors share: inertia that depends on the pose, the Coriolis terms that
        # belong to it, and gravity. The first joint's angle does not change the inertia.
        n = signals.n
        encoder = signals.rig.encoder
        interval = signals.interval
        speed = encoder.to_angle(signals.motion.speed)
        acceleration = encoder.to_angle(signals.motion.acceleration)
        angle = signals.rig.cell_centre(signals.motion.counts)
        pose = []
        for function in (np.cos, np.sin):
            for column in function(angle[:, 1:]).T:
                # Without its mean the coefficient of the acceleration alone is a mean over the log.
                pose.append(column - column[signals.clear].mean())
        products = [speed[:, a] * speed[:, b] for a in range(n) for b in range(a, n)]
        # Absolute angles of the links, for gravity.
        absolute = np.cumsum(angle, axis=1)
        shared = [
            *acceleration.T,
            *(p * column for p in pose for column in (*acceleration.T, *products)),
            np.ones(len(angle)),
            *np.sin(absolute).T,
            *np.cos(absolute).T,
        ]

        # 2. The longest window of which the log holds enough.
        unknowns = len(shared) + 3
        windows = signals.clear.sum() / (unknowns + 2)
        length = 2 * int(min(SETTINGS.average / interval, windows) / 2) + 1
        if length < signals.window:
            return None
        # A smooth window averages the noise of twice differentiated counts.
        kernel = np.hanning(length + 2)
        clear = np.convolve(signals.clear, np.ones(length) / length, mode="same") > 1 - 1e-9
        rows = np.flatnonzero(clear)[:: max(1, length // SETTINGS.per_window)]
        if len(rows) < SETTINGS.per_window * unknowns:
            return None

        def averages(columns):
            averaged = [
                np.convolve(column, kernel / kernel.sum(), mode="same") for column in columns
            ]
            return np.column_stack(averaged)[rows]

        # 3. Each motor's friction joins the shared terms.
        common = averages(shared)
        smooth = signals.smooth(torque)
        viscous = averages(speed.T)
        dry = averages([signals.smooth_even(np.sign(rate)) for rate in speed.T])
        measured = averages(smooth.T)
        slope = averages(np.gradient(smooth, interval, axis=0).T)
        fits = []
        for i in range(n):
            columns = np.column_stack([common, viscous[:, i], dry[:, i]])
            torques = measured[:, i]
            if not np.ptp(torques):
                return None
            value, std = least_squares(columns, torques, memory=SETTINGS.per_window)
            # Late counts: the model gives the torque of a delay ago.
            with_slope, with_slope_std = least_squares(
                np.column_stack([columns, slope[:, i]]), torques, memory=SETTINGS.per_window
            )
            # Friction goes with a motor's own speed; with another's, columns are exchanged.
            cross, cross_std = least_squares(
                np.column_stack([common, viscous, dry]), torques, memory=SETTINGS.per_window
            )
            fits.append(
                cls(
                    inertia=value[:n],
                    inertia_std=std[:n],
                    cross_coulomb=cross[-n:],
                    cross_coulomb_std=cross_std[-n:],
                    coulomb=value[-1],
                    coulomb_std=std[-1],
                    delay=with_slope[-1] / interval,
                    delay_std=with_slope_std[-1] / interval,
                )
            )
        return fits
