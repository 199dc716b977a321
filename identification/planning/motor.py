"""`motor_test`: P gain from currents and tracking errors, friction from currents at constant speed.

Source: paper 4.2 for the gain, reference [14] of the paper for the friction.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import least_squares
from plant import Record
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    array,
    dot,
    frozen,
    instance,
    known_options,
    real,
)

# Share of the amplifier's limit up to which a current follows the error. Chosen by hand, a little
# below 1, so that no saturated current counts.
_BELOW_LIMIT = 0.98

# Standard deviations below which a negative number is an error of the user, and not noise. Chosen
# by hand.
_NEGATIVE = -2.0


@frozen
class MotorFit(Shown, Frozen):
    """Fitted numbers of motors with their standard deviations, motor side.

    Attributes
    ----------
    names : tuple of str
    values, std : (k,) numpy.ndarray
    """

    names: tuple[str, ...]
    values: Floats
    std: Floats

    def _rows(self) -> list[tuple[str, str, str]]:
        # The same text in the short form and in the table.
        rows = zip(self.names, self.values, self.std, strict=True)
        return [(name, f"{value:.5g}", f"+- {std:.2g}") for name, value, std in rows]

    def _short(self) -> str:
        return ", ".join(" ".join(row[:2]) for row in self._rows())

    def _shown(self) -> Iterator[Piece]:
        yield Table((), self._rows(), words=(2,))


@known_options
def motor_test(
    record: Record | None = None,
    *,
    speed: ArrayLike | None = None,
    current: ArrayLike | None = None,
    motor_gain: float | None = None,
) -> MotorFit:
    """P gains from the currents of a record, or friction of a motor from currents at its speeds.

    Currents identify the amperes per pulse. The gain is their product with the motor constant K_i:
    if K_i is wrong by a factor, the gain is wrong by the same factor.

    Parameters
    ----------
    record : Record, optional
        Log under P control, with `current`, for the gains. Left out for the friction of a motor
        without its arm, which takes the three options.
    speed : (N,) array_like
        Constant speeds of the motor, in both directions, three or more of them different [rad/s].
    current : (N,) array_like
        Current at each speed [A].
    motor_gain : float
        K_i [N m/A].

    Returns
    -------
    MotorFit
        Of a record ``law.gain[0]`` and so on [N m per pulse]; otherwise viscous [N m s/rad],
        coulomb [N m] and offset [N m], as a `Drive` and its `FrictionCurve` take them.

    Raises
    ------
    ValueError
        A record without currents, or with a motor whose errors vary by less than two pulses; speeds
        that do not separate friction and offset; a gain or a friction that is negative.

    See Also
    --------
    plant.FrictionCurve

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import motor_test
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> motor_test(record).names
    ('law.gain[0]', 'law.gain[1]')
    >>> motor_test(speed=(-100, -50, 50, 100), current=(-1.4, -1.2, 1.2, 1.4), motor_gain=0.2).names
    ('viscous', 'coulomb', 'offset')
    """
    # Two tests with disjoint arguments; a mixture is a mistake.
    at_speed = (speed, current, motor_gain)
    if record is None:
        given = sum(value is not None for value in at_speed)
        if given < len(at_speed):
            raise ValueError(
                f"speed, current and motor_gain must come together; got {given or 'none'} of them."
                " Give all three, or a record."
            )
        return _friction(*at_speed)
    if any(value is not None for value in at_speed):
        raise ValueError(
            "a record must come alone; got speed, current or motor_gain beside it. Leave them out."
        )
    return _gains(instance("record", record, Record, "Pass a log with currents."))


def _gains(record: Record) -> MotorFit:
    """P gains [N m per pulse] from currents and tracking errors."""
    # Under a law with memory, current is no function of the error.
    law = record.law
    if law is not None and law.has_memory(record.n):
        raise ValueError(
            f"the record must be one under P control; got {type(law).__name__}. It has no such"
            " gain."
        )
    if record.current is None:
        raise ValueError("the record must hold currents; it has none. Log them, or state the gain.")
    drive = record.rig.drive
    driven = drive.motor_gain * record.current
    # The currents are of all torque, also of what was injected beside the law's.
    if record.injected is not None:
        driven = driven - drive.motor_torque(record.injected)
    names = tuple(f"law.gain[{i}]" for i in range(record.n))
    gains = []
    for i in range(record.n):
        error = record.error_pulses[:, i]
        # A slope, an offset and a residual take three rows; the slope takes errors that vary.
        below = np.abs(record.current[:, i]) < _BELOW_LIMIT * drive.current_limit[i]
        rows = below & (record.valid > 0)
        if rows.sum() < 3 or np.ptp(error[rows]) < 2:
            raise ValueError(
                f"the motor of {record.rig.joint_labels[i]} must have errors that vary"
                " by two pulses below its limit; it has none. Log a motion."
            )
        # An offset of the current must not change the slope.
        columns = [error[rows], np.ones(rows.sum())]
        values, std = _line([names[i], "offset"], columns, driven[rows, i])
        if values[0] < _NEGATIVE * std[0]:
            raise ValueError(
                f"the gain of {record.rig.joint_labels[i]} must be positive; found {values[0]:.3g}."
                " Check the signs of current, error and gear."
            )
        gains.append((values[0], std[0]))
    values, std = np.array(gains).T
    return MotorFit(names=names, values=values, std=std)


def _friction(speed: Any, current: Any, motor_gain: Any) -> MotorFit:
    """Viscous and Coulomb friction and offset of one motor, from currents at constant speeds."""
    speeds = array("speed", speed, ("N",), advice="Give motor speeds [rad/s].")
    currents = array("current", current, speeds.shape, advice="Give one current per speed [A].")
    torque = real("motor_gain", motor_gain, "Give K_i [N m/A].", positive=True) * currents
    names = ("viscous", "coulomb", "offset")
    # With one sign the columns of Coulomb friction and of the offset are equal.
    if not speeds.max(initial=0) > 0 > speeds.min(initial=0):
        got = f"{speeds.min()} to {speeds.max()}" if speeds.size else "none"
        raise ValueError(f"speed must have both signs; got {got}. Turn the motor both ways.")
    # A motor at rest takes any current below its Coulomb friction.
    if not speeds.all():
        got = f"got 0 at index {(speeds != 0).argmin()}"
        raise ValueError(f"speed must not be 0; {got}. Leave out readings of a motor at rest.")
    # With one speed each way the three columns are dependent.
    count = np.unique(speeds).size
    if count < len(names):
        raise ValueError(
            f"speed must have three values or more; got {count}. Turn the motor slower and faster."
        )
    values, std = _line(names, [speeds, np.sign(speeds), np.ones(len(speeds))], torque)
    if (values[:2] < _NEGATIVE * std[:2]).any():
        raise ValueError(
            f"friction must be positive; found viscous {values[0]:.3g} and coulomb {values[1]:.3g}."
            " Check the order (speed, current) and the sign of the current: positive where the"
            " motor drives forwards."
        )
    return MotorFit(names=names, values=values, std=std)


def _line(names: Sequence[str], columns: Sequence[Floats], target: Floats) -> tuple[Floats, Floats]:
    """Least squares of a target (N,), and standard deviations from its residual."""
    rows = np.column_stack(columns)
    # Without a surplus the residual is zero, and so would be every deviation.
    if len(rows) <= len(names):
        raise ValueError(
            f"a fit of {len(names)} numbers needs more readings; got {len(rows)}. Measure more."
        )
    values, covariance, _ = least_squares(names, rows, target)
    residual = target - (rows * values).sum(axis=1)
    # The noise of the currents is unknown: the residual shows it.
    variance = dot(residual, residual) / (len(rows) - len(names))
    return values, np.sqrt(np.diag(covariance) * variance)
