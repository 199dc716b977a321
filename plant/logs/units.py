"""Units of logged columns, as the user states them, checked against the rig; of a wrong one, which
would fit.

Fields in the units of a record, on its side of the gear: counts of angles, torques of the joints.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from plant.machine.rig import Rig
from plant.machine.unlikely import SLOWEST
from plant.motion.reference import Reference
from plant.motion.smooth import Spline
from plant.parts.arguments import choice
from plant.parts.fields import Floats
from plant.parts.messages import warn

# Of a field: one unit, or one per joint where some joints turn and others slide.
Unit: TypeAlias = str | tuple[str, ...]

# of them in a second: a quotient of whole numbers is rounded once
TIME = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
ANGLE = {"rad": 1.0, "deg": np.pi / 180}  # radians of each
LENGTH = {"m": 1.0, "mm": 1e-3}  # metres of each
CURRENT = {"A": 1.0, "mA": 1e3}
TORQUE = ("N m", "N", "motor N m")
UNITS = {
    "t": tuple(TIME),
    "position": (*ANGLE, *LENGTH, "pulses"),
    "motor_position": (*ANGLE, "pulses"),
    "reference_position": (*ANGLE, *LENGTH, "pulses"),
    "reference_motor_position": tuple(ANGLE),
    "link_position": (*ANGLE, *LENGTH),
    "torque": TORQUE,
    "injected": TORQUE,
    "current": tuple(CURRENT),
    "counts": ("pulses",),
    "error_pulses": ("pulses",),
    "reference_pulses": ("pulses",),
}

_PER_JOINT = {*ANGLE, *LENGTH, "N m", "N"}
_TURNS = 10  # a joint that turns further has its angle in degrees
_METRES = 50.0  # a joint that slides further has its position in millimetres
_FACTOR = 10  # between the period stated and the period found
_LIMIT = 2.0  # times what the amplifier can drive; measured currents overshoot
_LEAST = 10  # pulses of motion from which a grid is no accident


def factors(unit: Unit) -> float | Floats:
    """Radians or metres of a unit of position, or (n,) of one unit per joint."""
    scale = ANGLE | LENGTH
    return scale[unit] if isinstance(unit, str) else np.array([scale[each] for each in unit])


def require_units(columns: Collection[str], units: Mapping[str, Unit]) -> None:
    """Refuse a unit that is unknown, missing, or for a column that is not mapped."""
    for name in units:
        choice("units of a column that is mapped; the column", name, tuple(columns))
    for name in columns:
        known = UNITS.get(name, ("1",))
        if name not in units:
            if len(known) > 1:
                offered = ", ".join(map(repr, known))
                raise ValueError(
                    f"units must state that of {name!r}; got none. Give one of {offered}."
                )
            continue
        given = units[name]
        for each in given if isinstance(given, (tuple, list)) else (given,):
            choice(f"unit of {name!r}", each, known)
        if isinstance(given, (tuple, list)) and not _PER_JOINT.issuperset(given):
            among = ", ".join(repr(unit) for unit in known if unit in _PER_JOINT) or "none"
            got = f"got {given!r:.60}"
            raise ValueError(
                f"units of {name!r} may differ between joints among {among}; {got}. State one."
            )


def require_period(t: Floats, unit: str, period: float) -> None:
    """Refuse times [s] whose step is far from the rig's period."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else period
    if step <= 0 or period / _FACTOR <= step <= period * _FACTOR:
        return
    if period > SLOWEST:
        got = f"it is {period:g} s, and t steps by {step:g} s"
        raise ValueError(f"rig.period must be in seconds, such as 0.001; {got}.")
    fits = [
        name
        for name, per in TIME.items()
        if period / _FACTOR <= step * TIME[unit] / per <= period * _FACTOR
    ]
    advice = f"{fits[0]!r} would fit." if fits else "Give the rig the log's."
    raise ValueError(
        f"t in {unit!r} has a step of {step:g} s; rig.period is {period:g} s. {advice}"
    )


def require_span(name: str, q: Floats, unit: Unit, labels: Sequence[str]) -> None:
    """Refuse joint angles [rad] that span more turns than a joint makes, and positions [m] that
    span a hall.
    """
    of_joints = [unit] * len(labels) if isinstance(unit, str) else list(unit)
    for joint, (span, own) in enumerate(zip(np.ptp(q, axis=0), of_joints, strict=True)):
        most, size, per = (_METRES, "m", 1.0) if own in LENGTH else (_TURNS, "turns", 2 * np.pi)
        if span / per <= most:
            continue
        other = {"rad": "deg", "m": "mm"}.get(own)
        fits = other is not None and span / per * (ANGLE | LENGTH)[other] <= most
        counts = "Are they counts ('pulses')? A joint that does turn so far is logged in counts."
        advice = f"{other!r} would fit." if fits else counts
        got = f"spans {span / per:.3g} {size} of {labels[joint]}; at most {most:g}"
        raise ValueError(f"{name} in {own!r} {got}. {advice}")


def require_grid(name: str, unit: Unit, readings: Mapping[tuple[str, Unit], Floats]) -> bool:
    """Whether angles as stated are whole pulses, up to one shift per joint; refused if those of
    another unit are.

    `readings` are positions in pulses (N, n) by column and unit, were they those.
    """
    if not (moving := np.ptp(readings[name, unit], axis=0) > 0).any():
        return True
    if on_grid(readings[name, unit])[1].all():
        return True
    for (other, its_unit), position in readings.items():
        moved = np.ptp(position, axis=0)[moving]
        if (moved >= _LEAST).all() and on_grid(position)[1].all():
            fits = f"as {other!r} in {its_unit!r} they would be"
            raise ValueError(
                f"{name} in {unit!r} must be whole pulses of the rig; they are not, {fits}. State"
                " that."
            )
    return False


def on_grid(position: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Position in pulses (N, n) -> shift (n,) from whole pulses, and whether all samples have it
    within a tenth.

    Zero is always on the grid: it is the middle of its quantisation cell, which is two pulses wide.
    """
    away = np.abs(position) > 0.1
    shift = np.angle((np.exp(2j * np.pi * position) * away).sum(axis=0)) / (2 * np.pi)
    off = (position - shift) * away
    return shift, np.abs(off - np.round(off)).max(axis=0) < 0.1


def require_limit(
    name: str,
    value: Floats,
    limit: Floats,
    unit: Unit,
    others: Mapping[str, Floats | float],
    labels: Sequence[str],
) -> None:
    """Refuse torques or currents (N, n) far above the amplifier's limit (n,), in the same unit and
    on the same side.

    `others` are factors (n,) between the value in other units and the value as stated.
    """
    most = np.abs(value).max(axis=0)
    if (most <= _LIMIT * limit).all():
        return
    joint = int(np.argmax(most / limit))
    fits = [
        unit for unit, factor in others.items() if (most * np.abs(factor) <= _LIMIT * limit).all()
    ]
    advice = f"{fits[0]!r} would fit." if fits else "Correct the log, or the rig's limit."
    got = f"reaches {most[joint]:g} at {labels[joint]}; the amplifier drives {limit[joint]:g}"
    raise ValueError(f"{name} in {unit!r} {got}. {advice}")


REFERENCE = ("reference_pulses", "reference_position", "reference_motor_position")
_EXACT = 2.0**53
# samples of a path
_FEW = 6
_MOST = 100_000
# of a pulse: between two samples, a smooth path is as far from a straight line at most
_SMOOTH = 0.5
_NEAR = 0.02  # of a pulse: a step that was meant to be one


def converted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> dict[str, Floats]:
    """One field of the record, in its units and on its side."""
    if field in ("torque", "injected"):
        limit = rig.drive.torque_limit()
        gear = rig.drive.gear
        if unit == "motor N m":
            require_limit(
                field, value, limit / np.abs(gear), unit, {"N m": 1 / gear}, rig.joint_labels
            )
            return {field: rig.drive.joint_torque(value)}
        require_limit(
            field, rig.drive.coupling.shaft_torque(value), limit, unit, {}, rig.joint_labels
        )
        return {field: value}
    if field == "current":
        value = value / CURRENT[str(unit)]
        unit = str(unit)
        others = {other: CURRENT[unit] / per for other, per in CURRENT.items() if other != unit}
        require_limit(field, value, rig.drive.current_limit, unit, others, rig.joint_labels)
        return {"current": value}
    if field == "link_position":  # another sensor, of a resolution of its own
        absent = np.isnan(value)  # a motor that turns several joints is known by all of them
        pulses = rig.position_in_pulses(np.where(absent, 0.0, value * factors(unit)))
        return {
            "link_counts": np.where(
                rig.position_in_pulses(absent.astype(float)) != 0, np.nan, pulses
            )
        }
    name = (
        "reference_pulses"
        if field in REFERENCE
        else "error_pulses"
        if field == "error_pulses"
        else "counts"
    )
    if unit == "pulses":
        asked = field == "reference_position"  # between two pulses, too
        return {
            name: rig.encoder.quantised(value.astype(float)) if asked else _whole(field, value, rig)
        }
    return {name: _counted(field, value, unit, rig)}


def converted_angle(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Joint position [rad] that was asked for, without rounding."""
    if unit == "pulses":
        return rig.to_angle(value.astype(float))
    angle = value * factors(unit)
    return rig.drive.joint_angle(angle) if "motor" in field else angle


def path_through(t: Floats, q: Floats, counts: Floats, rig: Rig) -> Reference | None:
    """The path through positions (N, n) [rad] at times (N,), whose counts are these; None where
    they tell no more.

    That is so of positions that are whole pulses already, of motions that are not smooth from
    sample to sample, and of more samples than a path is to hold.
    """
    if not 2 * _FEW <= len(t) <= _MOST or on_grid(rig.position_in_pulses(q))[1].all():
        return None
    path = Spline(times=t - t[0], points=q, at_rest=False)
    between = (t[1:] + t[:-1]) / 2 - t[0]
    bent = np.abs(
        rig.position_in_pulses(path(between).q) - rig.position_in_pulses((q[1:] + q[:-1]) / 2)
    )
    alike = np.abs(rig.counts(path(t - t[0]).q) - counts).max() == 0
    apart = np.diff(t) / np.median(np.diff(t))  # a gap in the log bends with its square
    return path if alike and (bent < _SMOOTH * apart[:, None] ** 2).all() else None


def _whole(field: str, value: NDArray[Any], rig: Rig) -> Floats:
    value = value.astype(float)
    if rig.encoder.smooth:
        return value
    broken = np.argwhere((value != np.trunc(value)) | (np.abs(value) > _EXACT))
    if len(broken):
        got = (
            f"got {value[tuple(broken[0])]:g} in row {broken[0][0]},"
            f" {rig.joint_labels[broken[0][1]]}"
        )
        advice = "Map angles as 'position', with their unit."
        if field == "reference_pulses":
            advice = "Map it as 'reference_position', with its unit, 'pulses' or that of an angle."
        raise ValueError(f"{field!r} must be whole pulses; {got}. {advice}")
    return value


def _counted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Counts of angles: those on a grid of whole pulses as they are, others as the rig's encoder
    would count them.
    """
    motor = "motor" in field
    angle = value * factors(unit)
    require_span(field, rig.drive.joint_angle(angle) if motor else angle, unit, rig.joint_labels)
    place = {False: rig.position_in_pulses, True: rig.encoder.position_in_pulses}
    position = place[motor](angle)
    if rig.encoder.smooth:
        return position
    shift, grid = on_grid(position)
    if field not in REFERENCE:
        names = {False: field.replace("motor_", ""), True: "motor_position"}
        readings: dict[tuple[str, Unit], Any] = {(field, unit): position}
        if unit in ANGLE:
            readings |= {(names[m], u): place[m](value * ANGLE[u]) for m in place for u in ANGLE}
        elif unit in LENGTH:
            readings |= {(field, u): place[motor](value * LENGTH[u]) for u in LENGTH}
        whole = require_grid(field, unit, readings)
        if not whole:
            step = _smallest_step(position[:, np.argmin(grid)])
            near = ": state the resolution more exactly" if abs(step - 1) < _NEAR else ""
            text = (
                f"{field} of {rig.joint_labels[np.argmin(grid)]} is not in whole pulses of"
                " rig.encoder.resolution "
            )
            warn(
                f"{text}(smallest step {step:.{6 if near else 3}g} pulses{near}); counted as that"
                " encoder would"
            )
    shift = np.where(np.abs(shift) < 0.1, 0.0, shift)
    return rig.encoder.quantised(np.where(grid, np.round(position - shift) + shift, position))


def _smallest_step(position):
    steps = np.diff(np.unique(position))
    return float(steps[steps > 1e-6].min(initial=np.inf))
