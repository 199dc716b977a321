"""A table of named columns as the fields of a `Record`: units, encoder wrap, missing cells, angles into counts."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.logs.logfile import require_columns
from plant.logs.units import (
    ANGLE,
    CURRENT,
    TIME,
    UNITS,
    on_grid,
    require_grid,
    require_limit,
    require_period,
    require_span,
    require_units,
)
from plant.machine.rig import Rig
from plant.motion.reference import Reference
from plant.parts.arguments import choice, instance, real

__all__ = ["mapped_names", "record_fields"]

_MEASURED = ("position", "motor_position", "counts", "error_pulses")
_REFERENCE = ("reference_pulses", "reference_position", "reference_motor_position")
_KNOWN = (*UNITS, "valid")
_EXACT = 2.0**53
_NEAR = 0.02  # of a pulse: a step that was meant to be one


def mapped_names(columns: Mapping[str, Any], units: Mapping[str, str] | None) -> list[str]:
    """Names of the table's columns that a mapping needs, in order; the mapping and its units are validated.

    Raises
    ------
    ValueError
    """
    advice = 'Give columns={"t": "time", "position": ["q1", "q2"], ...}.'
    instance("columns", columns, dict, advice)
    for field in columns:
        choice("what a column is mapped to", field, _KNOWN)
    measured = [field for field in _MEASURED if field in columns]
    if len(measured) != 1:
        raise ValueError(f"columns must hold exactly one of {', '.join(_MEASURED)}; got {measured or 'none'}. {advice}")
    commanded = [field for field in _REFERENCE if field in columns]
    if len(commanded) > 1:
        raise ValueError(f"columns may hold one reference; got {', '.join(commanded)}. Leave out the others.")
    require_units(columns, {} if units is None else instance("units", units, dict, 'Give units={"t": "s", ...}.'))
    names = [name for value in columns.values() for name in _names(value)]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"columns must be mapped by their names; got {names!r:.80}. {advice}")
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise ValueError(f"columns must map each column once; got {twice!r} twice. Give each joint its own.")
    return names


def record_fields(
    table: Mapping[str, ArrayLike],
    *,
    rig: Rig,
    columns: Mapping[str, Any],
    units: Mapping[str, str] | None,
    wrap: ArrayLike | None,
    reference: Reference | None,
) -> dict[str, Any]:
    """Fields of a record from a table; see `Record.from_table`.

    Raises
    ------
    ValueError
    """
    names = mapped_names(columns, units)
    instance("rig", rig, Rig, "Pass rig=.")
    units = {field: (units or {}).get(field, UNITS[field][0]) for field in columns if field in UNITS}
    require_columns(names, table)
    values = {field: _block(table, field, columns[field], rig.n) for field in columns}
    N = {len(value) for value in values.values()}
    if len(N) > 1:
        lengths = ", ".join(f"{field} {len(value)}" for field, value in values.items())
        raise ValueError(f"columns must have one length; got {lengths}. Map columns of one sampling.")
    values, t = _in_time(values, units, rig)
    values, valid = _held(values, rig.joint_labels)
    measured = next(field for field in _MEASURED if field in values)
    if wrap is not None:
        values[measured] = _unwrapped(values[measured], wrap, rig.joint_labels)
    fields = {"t": t, "valid": valid}
    for field in values.keys() - {"valid"}:
        fields |= _converted(field, values[field], units[field], rig)
    counts, commanded = fields.pop("counts", None), fields.get("reference_pulses")
    if commanded is None and reference is not None:
        commanded = fields["reference_pulses"] = rig.counts(reference(t).q)
    if counts is not None:
        fields["error_pulses"] = -counts if commanded is None else commanded - counts
    elif commanded is None:
        raise ValueError("error_pulses need what was commanded; got none. Map reference_pulses, or pass reference=.")
    return fields


def _warn(text: str) -> None:
    """Warn at the user's line that called this package, through whichever reader."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "plant":
        frame, level = frame.f_back, level + 1
    warnings.warn(text, stacklevel=level)


def _names(value):
    return value if isinstance(value, (list, tuple)) else [value]


def _block(table, field, value, n):
    """The columns of one field, (N, n); (N,) where there is one for all joints."""
    single = field in ("t", "valid")
    parts = []
    for name in _names(value):
        part = np.asarray(table[name])
        if part.dtype.kind not in "biuf" or part.ndim not in (1, 2):
            raise ValueError(f"column {name!r} must be real numbers, (N,) or (N, n); got {part.dtype} {part.shape}.")
        parts.append(part[:, None] if part.ndim == 1 else part)
    if len({len(part) for part in parts}) != 1:
        raise ValueError(f"columns of {field!r} must have one length; got {[len(part) for part in parts]}. Check them.")
    block = np.concatenate(parts, axis=1)
    if block.shape[1] != (1 if single else n):
        expected = "one column" if single else f"{n} columns, one per joint"
        raise ValueError(f"{field!r} must have {expected}; got {block.shape[1]} ({value!r:.80}). Map as many.")
    if np.isinf(block).any():
        raise ValueError(f"{field!r} must be finite, or NaN where it is missing; got inf. Mark such cells NaN.")
    return block[:, 0] if single else block


def _in_time(values, units, rig):
    """Times from zero [s], and the values without the rows that repeat a time."""
    if "t" not in values:
        return values, rig.period * np.arange(len(next(iter(values.values()))))
    stamp = values.pop("t")
    if np.isnan(stamp).any():
        raise ValueError(f"t must be finite; got nan in row {int(np.argmax(np.isnan(stamp)))}. Drop that row.")
    new = np.append(True, stamp[1:] != stamp[:-1])
    if not new.all():
        text = f"{(~new).sum()} rows repeat the time of the row before and are left out, from row {np.argmin(new)} on"
        _warn(text)
    t = (stamp[new] - stamp[0]) / TIME[units["t"]]
    require_period(t, units["t"], rig.period)
    return {field: value[new] for field, value in values.items()}, t


def _held(values, labels):
    """Values with the last known one in place of every NaN, and weights that are zero in such rows."""
    weight = np.asarray(values.get("valid", np.ones(len(next(iter(values.values()))))), float)
    valid = np.where(np.isnan(weight), 0.0, weight)
    held = {}
    for field, value in values.items():
        if field == "valid":
            continue
        known = ~np.isnan(value)
        if not known.any(axis=0).all():
            raise ValueError(f"{field!r} must hold numbers; {labels[np.argmin(known.any(axis=0))]} has none. Check.")
        row = np.maximum.accumulate(np.where(known, np.arange(len(value))[:, None], -1), axis=0)
        row = np.where(row < 0, np.argmax(known, axis=0), row)  # before the first: the first
        held[field] = np.take_along_axis(value, row, axis=0)
        valid = valid * known.all(axis=1)
    return held, valid


def _unwrapped(value: NDArray[Any], wrap: Any, labels: Sequence[str]) -> NDArray[Any]:
    """Values whose steps are never more than half a wrap: whole wraps, counted in integers, are added."""
    n = len(labels)
    wrap = np.broadcast_to(wrap, n) if np.ndim(wrap) == 0 else np.asarray(wrap)
    if wrap.shape != (n,):
        raise ValueError(f"wrap must be one number, or {n}, one per joint; got shape {wrap.shape}. Give as many.")
    wrap = np.array([real("wrap", w, "Give counts per wrap, or an angle.", positive=True) for w in wrap.tolist()])
    if (np.ptp(value, axis=0) > wrap * (1 + 1e-9)).any():
        joint = int(np.argmax(np.ptp(value, axis=0) / wrap))
        got = f"{labels[joint]} spans {np.ptp(value[:, joint]):g}"
        raise ValueError(f"wrap must be as large as what is logged; got {wrap[joint]:g}, but {got}. Correct it.")
    whole = value.dtype.kind == "i" or (value == np.round(value)).all()
    kind = np.int64 if whole and (wrap == np.round(wrap)).all() else float
    value, wrap = value.astype(kind), wrap.astype(kind)
    turns = -np.cumsum(np.round(np.diff(value, axis=0) / wrap).astype(np.int64), axis=0)
    return value + np.vstack([np.zeros((1, n), np.int64), turns]) * wrap


def _converted(field, value, unit, rig):
    """One field of the record, in its units and on its side."""
    if field == "torque":
        limit, gear = rig.drive.torque_limit(), rig.drive.gear
        if unit == "motor N m":
            require_limit(field, value, limit / np.abs(gear), unit, {"N m": 1 / gear}, rig.joint_labels)
            return {"torque": rig.drive.joint_torque(value)}
        require_limit(field, rig.drive.coupling.shaft_torque(value), limit, unit, {}, rig.joint_labels)
        return {"torque": value}
    if field == "current":
        value = value / CURRENT[unit]
        others = {other: CURRENT[unit] / per for other, per in CURRENT.items() if other != unit}
        require_limit(field, value, rig.drive.current_limit, unit, others, rig.joint_labels)
        return {"current": value}
    if field == "link_position":  # another sensor, of a resolution of its own
        return {"link_counts": rig.position_in_pulses(value * ANGLE[unit])}
    name = "reference_pulses" if field in _REFERENCE else "error_pulses" if field == "error_pulses" else "counts"
    if unit == "pulses":
        return {name: _whole(field, value, rig.joint_labels)}
    return {name: _counted(field, value, unit, rig)}


def _whole(field: str, value: NDArray[Any], labels: Sequence[str]) -> NDArray[np.float64]:
    value = value.astype(float)
    broken = np.argwhere((value != np.trunc(value)) | (np.abs(value) > _EXACT))
    if len(broken):
        got = f"got {value[tuple(broken[0])]:g} in row {broken[0][0]}, {labels[broken[0][1]]}"
        raise ValueError(f"{field!r} must be whole pulses; {got}. Map angles as 'position', with their unit.")
    return value


def _counted(field, value, unit, rig):
    """Counts of angles: those on a grid of whole pulses as they are, others as the rig's encoder would count them."""
    motor = "motor" in field
    angle = value * ANGLE[unit]
    require_span(field, rig.drive.joint_angle(angle) if motor else angle, unit, rig.joint_labels)
    place = {False: rig.position_in_pulses, True: rig.encoder.position_in_pulses}
    position = place[motor](angle)
    if rig.encoder.smooth:
        return position
    shift, grid = on_grid(position)
    if field not in _REFERENCE:
        names = {False: field.replace("motor_", ""), True: "motor_position"}
        readings = {(field, unit): position}
        readings |= {(names[m], u): place[m](value * ANGLE[u]) for m in place for u in ANGLE}
        whole = require_grid(field, unit, readings)
        if not whole:
            step = _smallest_step(position[:, np.argmin(grid)])
            near = ": state the resolution more exactly" if abs(step - 1) < _NEAR else ""
            text = f"{field} of {rig.joint_labels[np.argmin(grid)]} is not in whole pulses of rig.encoder.resolution "
            _warn(f"{text}(smallest step {step:.{6 if near else 3}g} pulses{near}); counted as that encoder would")
    shift = np.where(np.abs(shift) < 0.1, 0.0, shift)
    return rig.encoder.quantised(np.where(grid, np.round(position - shift) + shift, position))


def _smallest_step(position):
    steps = np.diff(np.unique(position))
    return float(steps[steps > 1e-6].min(initial=np.inf))
