"""Regressions of a motor's torque on its motion, at each sample or averaged, without a model of the
arm.

Regressors are the accelerations of all motors, the motor's speed (viscous friction) and its sign
(Coulomb friction), and sines and cosines of the joint angles and of their sums: all of a planar
arm's gravity, most of another's. The coefficients are averages over the log; their signs and sizes
tell whether a log can be an arm's.
"""

import dataclasses
from typing import Any, Self

import numpy as np

from plant.parts.fields import Floats

_SLOW = 0.05  # share of the RMS speed below which a joint may stick, and its friction is unknown

# relative eigenvalue below which a direction of the normal equations is not identifiable
_SINGULAR = 1e-10

_TENTHS = 10

# rows taken from a window, more are not independent; and rows that each unknown needs
_PER_WINDOW = 7


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
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
    def of(cls, signals: Any, torque: Floats, i: int) -> Self | None:
        """Fit the torque (M, n) [N m] of motor i; None for too few rows, or a constant torque."""
        n = signals.n
        encoder = signals.rig.encoder
        counts, speed, acceleration = signals.motion
        own = speed[:, i]
        rows = signals.clear & (np.abs(own) > _SLOW * np.sqrt(np.mean(own[signals.clear] ** 2)))
        rows = np.flatnonzero(rows)[:: max(1, signals.window // _PER_WINDOW)]
        if len(rows) < 10 * _PER_WINDOW or not np.ptp(torque[:, i]):
            return None
        angle = np.cumsum(signals.rig.cell_centre(counts), axis=1)
        direction = signals.smooth_even(np.sign(own))
        columns = np.column_stack(
            [
                encoder.to_angle(acceleration),
                encoder.to_angle(speed)[:, i],
                direction,
                np.ones(len(own)),
                np.sin(angle),
                np.cos(angle),
            ]
        )
        measured = signals.smooth(torque)[:, i]

        def fitted(*more: Floats) -> tuple[Floats, Floats]:
            return least_squares(
                np.column_stack([columns, *more])[rows], measured[rows], memory=_PER_WINDOW
            )

        # Late counts: the torque correlates with the jerk, too.
        jerk = encoder.to_angle(np.gradient(acceleration, signals.interval, axis=0))
        value, std = fitted()
        with_jerk, with_jerk_std = fitted(jerk)
        residual = measured[rows] - columns[rows] @ value
        late, late_std = (
            x[-n + i] / with_jerk[i] / signals.interval for x in (with_jerk, with_jerk_std)
        )
        # another estimate of it
        slope = fitted(np.gradient(measured, signals.interval))[0][-1] / signals.interval
        late_std = max(abs(late_std), abs(late - slope) / 2)
        # Backlash: where the load torque changes sign, the motor turns alone.
        alone = signals.rig.drive.motor_inertia[i]
        load = (
            columns @ value
            - value[n] * columns[:, n]
            - value[n + 1] * direction
            - alone * columns[:, i]
        )
        side = signals.smooth_even(np.sign(load))
        ahead, ahead_std = fitted(signals.rates(side[:, None])[1])
        scale = 2 / max(abs(value[i] - alone), 1e-300) / encoder.to_angle(np.ones(n))[i]
        return cls(
            inertia=value[:n],
            inertia_std=std[:n],
            viscous=value[n],
            viscous_std=std[n],
            coulomb=value[n + 1],
            coulomb_std=std[n + 1],
            delay=late,
            delay_std=abs(late_std),
            backlash=ahead[-1] * scale,
            backlash_std=ahead_std[-1] * scale,
            reversals=int(np.sum(np.diff(np.sign(load)) != 0)),
            unexplained=float(np.mean(residual**2) / np.var(measured[rows])),
        )


def least_squares(columns: Floats, measured: Floats, memory: int) -> tuple[Floats, Floats]:
    """Coefficients and standard deviations (k,) of a regression with correlated residuals and a
    model error.

    Residuals count as independent only every `memory` rows; a jackknife over tenths of the log
    covers what changes with the pose. The larger standard deviation counts.
    """
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0] = 1.0
    columns = columns / scale
    tenths = np.array_split(np.arange(len(measured)), _TENTHS)
    squares = np.array([columns[rows].T @ columns[rows] for rows in tenths])
    products = np.array([columns[rows].T @ measured[rows] for rows in tenths])
    inverse = np.linalg.pinv(squares.sum(axis=0), _SINGULAR, hermitian=True)
    value = inverse @ products.sum(axis=0)
    residual = np.mean((measured - columns @ value) ** 2)
    variance = np.diag(inverse) * residual * memory
    without = np.array(
        [
            np.linalg.pinv(squares.sum(axis=0) - A, _SINGULAR, hermitian=True)
            @ (products.sum(axis=0) - b)
            for A, b in zip(squares, products, strict=True)
        ]
    )
    jackknife = (_TENTHS - 1) * np.mean((without - value) ** 2, axis=0)
    return value / scale, np.sqrt(np.maximum(variance, jackknife)) / scale


# window [s] over which the equation is averaged; shorter where the log would not hold enough of
# them
_AVERAGE = 0.4


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AveragedRegression:
    """Coefficients, with standard deviations, of the equation of motion of a motor, averaged over
    much of a swing.

    An arm that swings freely needs little torque for much acceleration, less than the noise of
    twice differentiated counts; the average of the equation with all its terms holds without the
    noise.

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
    def all_of(cls, signals: Any, torque: Floats) -> list[Self] | None:
        """Fit the torques (M, n) [N m] of all motors; None where the log is too short for that
        many unknowns.
        """
        n = signals.n
        encoder = signals.rig.encoder
        interval = signals.interval
        counts, *rates = signals.motion
        speed, acceleration = (encoder.to_angle(rate) for rate in rates)
        angle = signals.rig.cell_centre(counts)
        pose = [
            column - column[signals.clear].mean()
            for turn in (np.cos, np.sin)
            for column in turn(angle[:, 1:]).T
        ]
        products = [speed[:, a] * speed[:, b] for a in range(n) for b in range(a, n)]
        absolute = np.cumsum(angle, axis=1)
        shared = [
            *acceleration.T,
            *(p * column for p in pose for column in (*acceleration.T, *products)),
            np.ones(len(angle)),
            *np.sin(absolute).T,
            *np.cos(absolute).T,
        ]
        unknown = len(shared) + 3
        length = 2 * int(min(_AVERAGE / interval, signals.clear.sum() / (unknown + 2)) / 2) + 1
        if length < signals.window:
            return None
        kernel = np.hanning(length + 2)
        clear = np.convolve(signals.clear, np.ones(length) / length, mode="same") > 1 - 1e-9
        rows = np.flatnonzero(clear)[:: max(1, length // _PER_WINDOW)]
        if len(rows) < _PER_WINDOW * unknown:
            return None

        def means(columns: Any) -> Floats:
            return np.column_stack(
                [np.convolve(x, kernel / kernel.sum(), mode="same") for x in columns]
            )

        common = means(shared)[rows]
        smooth = signals.smooth(torque)
        viscous = means(speed.T)[rows]
        dry = means([signals.smooth_even(np.sign(rate)) for rate in speed.T])[rows]
        measured, slope = means(smooth.T), means(np.gradient(smooth, interval, axis=0).T)
        found = []
        for i in range(n):
            columns = np.column_stack([common, viscous[:, i], dry[:, i]])
            torques = measured[rows, i]
            if not np.ptp(torques):
                return None
            value, std = least_squares(columns, torques, memory=_PER_WINDOW)
            # Late counts: the model gives the torque of a delay ago.
            late, late_std = least_squares(
                np.column_stack([columns, slope[rows, i]]), torques, memory=_PER_WINDOW
            )
            # Friction goes with a motor's own speed; with another's, columns are exchanged.
            cross, cross_std = least_squares(
                np.column_stack([common, viscous, dry]), torques, memory=_PER_WINDOW
            )
            found.append(
                cls(
                    inertia=value[:n],
                    inertia_std=std[:n],
                    cross_coulomb=cross[-n:],
                    cross_coulomb_std=cross_std[-n:],
                    coulomb=value[-1],
                    coulomb_std=std[-1],
                    delay=late[-1] / interval,
                    delay_std=late_std[-1] / interval,
                )
            )
        return found
