"""One mapped field in the units of a record, on its side of the gear: counts of angles, torques of the joints."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs.units import ANGLE, CURRENT, LENGTH, Unit, factors, on_grid, require_grid, require_limit, require_span
from plant.machine.rig import Rig
from plant.motion.reference import Reference
from plant.motion.smooth import Spline
from plant.parts.fields import Floats
from plant.parts.user_warning import warn

REFERENCE = ("reference_pulses", "reference_position", "reference_motor_position")
_EXACT = 2.0**53
_FEW, _MOST = 6, 100_000  # samples of a path
_SMOOTH = 0.5  # of a pulse: between two samples, a smooth path is as far from a straight line at most
_NEAR = 0.02  # of a pulse: a step that was meant to be one


def converted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> dict[str, Floats]:
    """One field of the record, in its units and on its side."""
    if field in ("torque", "injected"):
        limit, gear = rig.drive.torque_limit(), rig.drive.gear
        if unit == "motor N m":
            require_limit(field, value, limit / np.abs(gear), unit, {"N m": 1 / gear}, rig.joint_labels)
            return {field: rig.drive.joint_torque(value)}
        require_limit(field, rig.drive.coupling.shaft_torque(value), limit, unit, {}, rig.joint_labels)
        return {field: value}
    if field == "current":
        value, unit = value / CURRENT[str(unit)], str(unit)
        others = {other: CURRENT[unit] / per for other, per in CURRENT.items() if other != unit}
        require_limit(field, value, rig.drive.current_limit, unit, others, rig.joint_labels)
        return {"current": value}
    if field == "link_position":  # another sensor, of a resolution of its own
        absent = np.isnan(value)  # a motor that turns several joints is known by all of them
        pulses = rig.position_in_pulses(np.where(absent, 0.0, value * factors(unit)))
        return {"link_counts": np.where(rig.position_in_pulses(absent.astype(float)) != 0, np.nan, pulses)}
    name = "reference_pulses" if field in REFERENCE else "error_pulses" if field == "error_pulses" else "counts"
    if unit == "pulses":
        asked = field == "reference_position"  # between two pulses, too
        return {name: rig.encoder.quantised(value.astype(float)) if asked else _whole(field, value, rig)}
    return {name: _counted(field, value, unit, rig)}


def converted_angle(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Joint position [rad] that was asked for, without rounding."""
    if unit == "pulses":
        return rig.to_angle(value.astype(float))
    angle = value * factors(unit)
    return rig.drive.joint_angle(angle) if "motor" in field else angle


def path_through(t: Floats, q: Floats, counts: Floats, rig: Rig) -> Reference | None:
    """The path through positions (N, n) [rad] at times (N,), whose counts are these; None where they tell no more.

    That is so of positions that are whole pulses already, of motions that are not smooth from sample to sample, and of
    more samples than a path is to hold.
    """
    if not 2 * _FEW <= len(t) <= _MOST or on_grid(rig.position_in_pulses(q))[1].all():
        return None
    path = Spline(times=t - t[0], points=q, at_rest=False)
    between = (t[1:] + t[:-1]) / 2 - t[0]
    bent = np.abs(rig.position_in_pulses(path(between).q) - rig.position_in_pulses((q[1:] + q[:-1]) / 2))
    alike = np.abs(rig.counts(path(t - t[0]).q) - counts).max() == 0
    apart = np.diff(t) / np.median(np.diff(t))  # a gap in the log bends with its square
    return path if alike and (bent < _SMOOTH * apart[:, None] ** 2).all() else None


def _whole(field: str, value: NDArray[Any], rig: Rig) -> Floats:
    value = value.astype(float)
    if rig.encoder.smooth:
        return value
    broken = np.argwhere((value != np.trunc(value)) | (np.abs(value) > _EXACT))
    if len(broken):
        got = f"got {value[tuple(broken[0])]:g} in row {broken[0][0]}, {rig.joint_labels[broken[0][1]]}"
        advice = "Map angles as 'position', with their unit."
        if field == "reference_pulses":
            advice = "Map it as 'reference_position', with its unit, 'pulses' or that of an angle."
        raise ValueError(f"{field!r} must be whole pulses; {got}. {advice}")
    return value


def _counted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Counts of angles: those on a grid of whole pulses as they are, others as the rig's encoder would count them."""
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
            text = f"{field} of {rig.joint_labels[np.argmin(grid)]} is not in whole pulses of rig.encoder.resolution "
            warn(f"{text}(smallest step {step:.{6 if near else 3}g} pulses{near}); counted as that encoder would")
    shift = np.where(np.abs(shift) < 0.1, 0.0, shift)
    return rig.encoder.quantised(np.where(grid, np.round(position - shift) + shift, position))


def _smallest_step(position):
    steps = np.diff(np.unique(position))
    return float(steps[steps > 1e-6].min(initial=np.inf))
