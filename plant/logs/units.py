"""Units of logged columns, as the user states them, checked against the rig; of a wrong one, which would fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from plant.parts.arguments import choice

__all__ = ["on_grid", "require_grid", "require_limit", "require_period", "require_span", "require_units"]

TIME = {"s": 1.0, "ms": 1e3, "us": 1e6}  # of them in a second: a quotient of whole numbers is rounded once
ANGLE = {"rad": 1.0, "deg": np.pi / 180}  # radians of each
CURRENT = {"A": 1.0, "mA": 1e3}
TORQUE = ("N m", "motor N m")
UNITS = {
    "t": tuple(TIME), "position": (*ANGLE, "pulses"), "motor_position": (*ANGLE, "pulses"),
    "reference_position": tuple(ANGLE), "reference_motor_position": tuple(ANGLE), "link_position": tuple(ANGLE),
    "torque": TORQUE, "current": tuple(CURRENT), "counts": ("pulses",), "error_pulses": ("pulses",),
    "reference_pulses": ("pulses",),
}  # fmt: skip

_TURNS = 10  # a joint that turns further has its angle in degrees
_FACTOR = 10  # between the period stated and the period found
_LIMIT = 2.0  # times what the amplifier can drive; measured currents overshoot
_LEAST = 10  # pulses of motion from which a grid is no accident


def require_units(columns: Collection[str], units: Mapping[str, str]) -> None:
    """Refuse a unit that is unknown, missing, or for a column that is not mapped.

    Raises
    ------
    ValueError
    """
    for name in units:
        choice("units of a column that is mapped; the column", name, tuple(columns))
    for name in columns:
        if name in UNITS and len(UNITS[name]) > 1 and name not in units:
            offered = ", ".join(repr(unit) for unit in UNITS[name])
            raise ValueError(f"units must state that of {name!r}; got none. Give one of {offered}.")
        if name in units:
            choice(f"unit of {name!r}", units[name], UNITS.get(name, ("1",)))


def require_period(t: NDArray[np.float64], unit: str, period: float) -> None:
    """Refuse times [s] whose step is far from the rig's period.

    Raises
    ------
    ValueError
    """
    step = float(np.median(np.diff(t))) if len(t) > 1 else period
    if step <= 0 or period / _FACTOR <= step <= period * _FACTOR:
        return
    for other, per in TIME.items():
        if period / _FACTOR <= step * TIME[unit] / per <= period * _FACTOR:
            raise ValueError(
                f"t in {unit!r} has a step of {step:g} s; rig.period is {period:g} s. {other!r} would fit."
            )
    raise ValueError(f"t in {unit!r} has a step of {step:g} s; rig.period is {period:g} s. Give the rig the log's.")


def require_span(name: str, q: NDArray[np.float64], unit: str, labels: Sequence[str]) -> None:
    """Refuse joint angles [rad] that span more turns than a joint makes.

    Raises
    ------
    ValueError
    """
    span = np.ptp(q, axis=0) / (2 * np.pi)
    if not (span <= _TURNS).all():
        joint = int(np.argmax(span))
        fits = unit == "rad" and span[joint] * ANGLE["deg"] <= _TURNS
        advice = "'deg' would fit." if fits else "Correct the log; a joint that does turn so far is logged in counts."
        raise ValueError(f"{name} in {unit!r} spans {span[joint]:.3g} turns of {labels[joint]}; at most 10. {advice}")


def require_grid(name: str, unit: str, readings: Mapping[tuple[str, str], NDArray[np.float64]]) -> bool:
    """Refuse angles that are whole pulses in another unit, or on the other side of the gear, but not as stated.

    Parameters
    ----------
    readings : dict of (str, str) to (N, n) array_like
        Column and unit -> position in pulses, were they those.

    Returns
    -------
    bool
        Whether the angles as stated are whole pulses, up to one shift per joint.

    Raises
    ------
    ValueError
    """
    if not (moving := np.ptp(readings[name, unit], axis=0) > 0).any():
        return True
    if on_grid(readings[name, unit])[1].all():
        return True
    for (other, its_unit), position in readings.items():
        moved = np.ptp(position, axis=0)[moving]
        if (moved >= _LEAST).all() and on_grid(position)[1].all():
            fits = f"as {other!r} in {its_unit!r} they would be"
            raise ValueError(f"{name} in {unit!r} must be whole pulses of the rig; they are not, {fits}. State that.")
    return False


def on_grid(position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Position in pulses (N, n) -> shift (n,) from whole pulses, and whether all samples have it within a tenth.

    Zero is always on the grid: it is the middle of its quantisation cell, which is two pulses wide.
    """
    away = np.abs(position) > 0.1
    shift = np.angle((np.exp(2j * np.pi * position) * away).sum(axis=0)) / (2 * np.pi)
    off = (position - shift) * away
    return shift, np.abs(off - np.round(off)).max(axis=0) < 0.1


def require_limit(
    name: str,
    value: NDArray[np.float64],
    limit: NDArray[np.float64],
    unit: str,
    others: Mapping[str, NDArray[np.float64] | float],
    labels: Sequence[str],
) -> None:
    """Refuse torques or currents far above the amplifier's limit.

    Parameters
    ----------
    value, limit : (N, n), (n,) array_like
        In the same unit and on the same side.
    others : dict of str to (n,) array_like
        Other units -> factor between the value in that unit and the value as stated.
    labels : sequence of str
        Of the joints.

    Raises
    ------
    ValueError
    """
    most = np.abs(value).max(axis=0)
    if (most <= _LIMIT * limit).all():
        return
    joint = int(np.argmax(most / limit))
    fits = [unit for unit, factor in others.items() if (most * np.abs(factor) <= _LIMIT * limit).all()]
    advice = f"{fits[0]!r} would fit." if fits else "Correct the log, or the rig's limit."
    got = f"reaches {most[joint]:g} at {labels[joint]}; the amplifier drives {limit[joint]:g}"
    raise ValueError(f"{name} in {unit!r} {got}. {advice}")
