"""The equation of motion of one motor, and the regression of its torque on it.

A motor's torque accelerates its inertia and overcomes friction and gravity. Inertia and friction
are not negative. The regression replaces a model of the arm by the accelerations of the other
motors, sines and cosines of the angles and, for few joints, inertias that depend on the pose.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from plant.checkup.filtered import Filter, Filtered, centred
from plant.checkup.signals import Signals
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class EquationSettings:
    """Numbers of the equation of motion, chosen by hand.

    Parameters
    ----------
    coupled : int
        Joints up to which the equation has inertias that depend on the pose.
    windows : int
        Least number of averaging windows in excess of the unknown coefficients. A short log has
        shorter windows.
    """

    coupled: int = 3
    windows: int = 2


SETTINGS = EquationSettings()

# Relative ridge that keeps normal equations solvable if columns are nearly dependent. It exceeds
# the rounding errors of a sum of 2000 products.
RIDGE = 1e-9


class Equation(NamedTuple):
    """Columns of a motor's equation of motion at the compared rows.

    `own` (M, 3): acceleration, speed and its sign. `free` (M, f): accelerations of the other
    motors, then a constant, gravity and inertias that depend on the pose. `torque` (M,) [N m].
    """

    own: Floats
    free: Floats
    torque: Floats


class Columns:
    """Columns of the equations of all motors; a torque makes an `Equation` of them.

    `counts`: filtered counts of the encoders, one per joint. `swings`: whether no loop holds the
    arm. Torques are then small beside the noise of the accelerations, so all columns are averaged
    over windows.
    """

    def __init__(
        self, signals: Signals, log_filter: Filter, counts: tuple[Filtered, ...], swings: bool
    ) -> None:
        self.filter = log_filter
        self.swings = swings
        n, rig = signals.n, signals.rig
        # The derivatives of a joint at rest are rounding errors, which would feign a relation to a
        # constant torque: they are set to zero.
        moves = np.ptp(signals.counts, axis=0) > 0
        per_pulse = np.broadcast_to(rig.encoder.to_angle(np.ones(n)), (n,)) * moves
        self.acceleration = np.column_stack([column.acceleration for column in counts]) * per_pulse
        self.speed = np.column_stack([column.speed for column in counts]) * per_pulse
        self.direction = np.column_stack([column.direction for column in counts])
        angle = rig.cell_centre(np.column_stack([column.value for column in counts]))
        # Links in one plane: gravity depends on sums of joint angles. With three joints or
        # more the first axis may be vertical: then the sums have no first angle.
        absolute = np.cumsum(angle, axis=1)
        angles = [absolute] if n < 3 else [absolute, absolute[:, 1:] - angle[:, :1]]
        gravity = [function(pose) for pose in angles for function in (np.sin, np.cos)]
        # A log of many joints has too many inertias that depend on the pose.
        coupling = self._coupling(angle) if n <= SETTINGS.coupled else ()
        self.shared = np.column_stack([np.ones(len(angle)), *gravity, *coupling])

    def _coupling(self, angle: Floats) -> Iterator[Floats]:
        """Yield the terms of an inertia that depends on the pose, and its Coriolis torques."""
        pairs = itertools.combinations_with_replacement(self.speed.T, 2)
        products = [first * second for first, second in pairs]
        # The first joint's angle does not change the inertia.
        for function in (np.cos, np.sin):
            for column in function(angle[:, 1:]).T:
                # The mean is removed, so that the acceleration's coefficient is the mean inertia.
                pose = column - column.mean()
                yield from (pose * term for term in (*self.acceleration.T, *products))

    def equation(self, i: int, torque: Filtered) -> Equation:
        """The equation of motion of motor i with its filtered torque."""
        own = np.column_stack([self.acceleration[:, i], self.speed[:, i], self.direction[:, i]])
        free = np.column_stack([np.delete(self.acceleration, i, axis=1), self.shared])
        if not self.swings:
            return Equation(own, free, torque.value)
        windows = SETTINGS.windows + own.shape[1] + free.shape[1]
        tables = own, free, torque.value[:, None]
        own, free, averaged = (self.filter.average(table, windows) for table in tables)
        return Equation(own, free, averaged[:, 0])


class Motion(NamedTuple):
    """Regression of the torque of one motor on the motion, with standard deviations.

    Inertia [kg m^2], viscous [N m s/rad] and Coulomb friction [N m], none negative; `coupling`
    (n - 1,): inertias of the other motors' accelerations [kg m^2], of either sign. `beside_speed`:
    share (0 to 1) of the torque's variance that the speed alone does not explain; `unexplained`:
    share of that variance that the whole equation does not explain.
    """

    inertia: float
    inertia_std: float
    viscous: float
    viscous_std: float
    coulomb: float
    coulomb_std: float
    unexplained: float
    beside_speed: float
    coupling: Floats
    coupling_std: Floats

    @classmethod
    def of(cls, equation: Equation, independent: float, others: int, closed: bool) -> Self:
        """Fit the coefficients of an equation; `independent` is its number of independent rows.

        The first `others` of the free columns are the other motors' accelerations. `closed`:
        whether a loop turns a delay of the counts into torque.
        """
        own, free, torque = equation
        unknown = np.full((2, others), np.inf)
        nothing = cls(0.0, np.inf, 0.0, np.inf, 0.0, np.inf, 1.0, 1.0, *unknown)
        if not len(torque):
            return nothing
        torque = centred(torque)
        speed = own[:, 1]
        # In a closed loop slow rows are left out, because the sign of their friction is uncertain.
        # Without a loop all rows that move are kept.
        slowest = REGRESSION.slow * np.sqrt(np.mean(speed**2)) if closed else 0.0
        rows = np.abs(speed) > slowest
        size = float(np.mean(torque[rows] ** 2)) if rows.sum() > free.shape[1] + 3 else 0.0
        if not size:
            return nothing
        # 1. Normal equations of columns of one size; what the free ones explain is taken out.
        columns = np.column_stack([own, free])[rows]
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scale[scale == 0] = 1.0
        table = np.column_stack([columns / scale, torque[rows]])
        squares = table.T @ table / len(table)
        k = own.shape[1]
        own_and_torque = [*range(k), -1]
        across = squares[k:-1][:, own_and_torque]
        by_free = np.linalg.solve(squares[k:-1, k:-1] + RIDGE * np.eye(free.shape[1]), across)
        reduced = squares[np.ix_(own_and_torque, own_and_torque)] - across.T @ by_free
        # 2. The likeliest coefficients that are not negative.
        value, residual = _not_negative(reduced)
        # Late counts in a loop add torque in proportion to speed. The part that speed explains is
        # left out of the variance that a hypothesis about the rig has to explain.
        by_speed = squares[1, -1] ** 2 / max(squares[1, 1], RIDGE) if closed else 0.0
        variance = max(squares[-1, -1] - by_speed, RIDGE * size)
        # 3. The coefficients of the other accelerations, given those, and all standard deviations.
        coupling = (by_free[:, -1] - by_free[:, :k] @ value)[:others]
        std = _deviations(squares, table, residual / independent)
        value, std = (x / scale[: k + others] for x in (np.r_[value, coupling], std[: k + others]))
        inertia, viscous, coulomb = zip(value[:k], std[:k], strict=True)
        return cls(
            *inertia,
            *viscous,
            *coulomb,
            unexplained=min(max(residual, 0.0) / variance, 1.0),
            beside_speed=variance / squares[-1, -1],
            coupling=value[k:],
            coupling_std=std[k:],
        )


def _not_negative(squares):
    """Least squares with coefficients that are not negative; what it leaves unexplained.

    squares (k + 1, k + 1): normal equations, the measured column last.
    """
    k = len(squares) - 1
    value, least = np.zeros(k), squares[-1, -1]
    # The solution is the ordinary fit of those columns whose coefficients are positive. Among all
    # sets of columns whose fit has no negative coefficient, it leaves the least residual.
    for count in range(k, 0, -1):
        for columns in map(list, itertools.combinations(range(k), count)):
            inner = squares[np.ix_(columns, columns)] + RIDGE * np.eye(count)
            target = squares[columns, -1]
            coefficients = np.linalg.solve(inner, target)
            residual = squares[-1, -1] - target @ coefficients
            if (coefficients >= 0).all() and residual < least:
                value, least = np.zeros(k), residual
                value[columns] = coefficients
        if count == k and value.any():
            return value, least  # all columns leave the least
    return value, least


def _deviations(squares, table, variance):
    """Standard deviations (k,) of a least-squares fit; `variance` is the variance of unit weight.

    `squares`: normal equations of the table (M, k + 1), its measured column last. A jackknife over
    segments of the log covers the model errors, which change with the pose.
    """
    length = len(table) // REGRESSION.segments
    parts = table[: length * REGRESSION.segments].reshape(REGRESSION.segments, length, -1)
    without = squares - parts.transpose(0, 2, 1) @ parts / len(table)
    ridge = RIDGE * np.eye(len(squares) - 1)
    inverse = np.linalg.inv(squares[:-1, :-1] + ridge)
    values = np.linalg.solve(without[:, :-1, :-1] + ridge, without[:, :-1, -1:])[..., 0]
    moved = values - inverse @ squares[:-1, -1]
    jackknife = (REGRESSION.segments - 1) * np.mean(moved**2, axis=0)
    return np.sqrt(np.maximum(np.diag(inverse) * max(variance, 0.0), jackknife))
