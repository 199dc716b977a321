"""Named columns as the fields of a `Record`: units, encoder wrap, missing cells, counts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.checkup import STEP_NOTE
from plant.logs.logfile import require_columns
from plant.logs.stated_units import Stated, StatedUnit, require_words, stated_units
from plant.logs.units import (
    CHECKS,
    NOTES,
    REFERENCE,
    TIME,
    UNITS,
    Unit,
    converted,
    converted_angle,
    factors,
    path_through,
    require_period,
)
from plant.machine import Rig
from plant.motion import Reference
from plant.parts import Floats, choice, frozen_settings, instance, real, several, warn, whole

MEASURED = ("position", "motor_position", "counts", "error_pulses")
_PATH_FIELDS = ("reference_position", "reference_motor_position")
_PARTIAL = ("link_position",)  # the mapping gives None for each joint without such a column
_FIELDS = (*UNITS, "valid")
_KELVIN = 273.15  # 0 degC [K]


@frozen_settings
class StepSettings:
    """Detection of a position step that disagrees with the rig's resolution; chosen by hand.

    Parameters
    ----------
    min_levels : int
        Number of different positions that a column must have before its step is estimated.
    level_tolerance : float
        Two neighbouring positions are one level if they differ by no more than this fraction of the
        median difference. The positions fit a step if twice the distance of each from the lowest
        one is a multiple of the step, to within this fraction of the step.
    pulse_tolerance : float
        The step confirms the rig's gear if it lies within this distance of a whole number of pulses
        [pulses]. The steps of several joints differ if they spread by more than this fraction of
        the smallest.
    max_ratio : float
        Another gear may explain a step only if step and pulse differ by less than this factor.
    decimal_tolerance : float
        The step comes from rounded decimals if its decimal logarithm lies within this distance of
        an integer, in the logged unit or after a conversion between rad and deg.
    min_normalised : float
        The positions may be percentages of a range if the largest magnitude exceeds this number.
        Positions in radians stay below it.
    """

    min_levels: int = 50
    level_tolerance: float = 0.05
    pulse_tolerance: float = 0.02
    max_ratio: float = 5.0
    decimal_tolerance: float = 1e-3
    min_normalised: float = 20.0


STEPS = StepSettings()


def mapped_names(columns: Mapping[str, Any], units: Mapping[str, Stated] | None) -> list[str]:
    """Validate a mapping and its units; return the names of the columns that it needs, in order."""
    advice = 'Give columns={"t": "time", "position": ["q1", "q2"], ...}.'
    instance("columns", columns, dict, advice)
    turned = [field for field in columns.values() if isinstance(field, str) and field in _FIELDS]
    if turned and not (UNITS.keys() - NOTES) & columns.keys():
        raise ValueError(
            f"columns must name the file's columns by what they are; got {columns!r:.80}, the other"
            f" way round. {advice}"
        )
    for field in columns:
        choice("what a column is mapped to", field, _FIELDS)
    # The error follows from exactly one measurement; a second one could contradict it.
    measured = [field for field in MEASURED if field in columns]
    if len(measured) != 1:
        raise ValueError(
            f"columns must hold exactly one of {', '.join(MEASURED)}; got {measured or 'none'}."
            f" {advice}"
        )
    commanded = [field for field in REFERENCE if field in columns]
    if len(commanded) > 1:
        raise ValueError(
            f"columns may hold one reference; got {', '.join(commanded)}. Leave out the others."
        )
    require_words(
        columns,
        {} if units is None else instance("units", units, dict, 'Give units={"t": "s", ...}.'),
    )
    # None stands for a joint without a link encoder, and is refused in all other fields.
    listed = [(field, name) for field, value in columns.items() for name in _names(value)]
    names = [name for field, name in listed if name is not None or field not in _PARTIAL]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"columns must be mapped by their names; got {names!r:.80}. {advice}")
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise ValueError(
            f"columns must map each column once; got {twice!r} twice. Give each joint its own."
        )
    return names


def record_fields(
    table: Mapping[str, ArrayLike],
    *,
    rig: Rig,
    columns: Mapping[str, Any],
    units: Mapping[str, Stated] | None,
    wrap: ArrayLike | None,
    reference: Reference | None,
    held: bool = False,
    torque_delay: int = 0,
) -> dict[str, Any]:
    """Fields of a record from a table; see `Record.from_table`."""
    names = mapped_names(columns, units)
    instance("rig", rig, Rig, "Pass rig=.")
    of_fields = stated_units(columns, units, table, rig.n)
    stated = {field: of_field.unit for field, of_field in of_fields.items()}
    require_columns(names, table)
    values = _blocks(table, columns, rig.n)
    # Notes leave the values here, so that their missing cells take no weight from a row.
    notes = {f: _note(f, values.pop(f), of_fields[f]) for f in NOTES if f in values}
    values, t = _in_time(values, of_fields.get("t"), rig)
    values |= _without_torque_delay(values, torque_delay)
    # The rows that really hold a command must be found before `_held` fills the gaps.
    path_field = next((name for name in _PATH_FIELDS if name in values), None)
    logged = None if path_field is None else ~np.isnan(values[path_field]).any(axis=1)
    values, valid = _held(values, rig.joint_labels)
    measured = next(field for field in MEASURED if field in values)
    if wrap is not None:
        values[measured] = _unwrapped(values[measured], wrap, rig.joint_labels)
        values |= _together(values, measured, of_fields, np.asarray(wrap), rig.joint_labels)
    # The wrap is stated in the logged unit, so values are unwrapped before the constants of that
    # unit are applied.
    values = {
        field: of_fields[field].converted(value) if field in of_fields else value
        for field, value in values.items()
    }
    fields = {"t": t, "valid": valid, "notes": notes}
    for field in values.keys() - {"valid"}:
        fields |= converted(field, values[field], stated[field], rig)
    # If the step of the positions is not a whole number of pulses, the log may come from another
    # gear or resolution than the rig's. A note keeps that step for the checkup.
    if measured.endswith("position") and stated[measured] != "pulses":
        notes |= _own_steps(measured, values[measured], stated[measured], rig)
    if (
        reference is None
        and path_field is not None
        and logged is not None
        and not held
        and not rig.encoder.smooth
    ):
        # Unrounded commanded positions are the path itself, which is more exact than its counts.
        angles = converted_angle(path_field, values[path_field], stated[path_field], rig)
        commanded = fields["reference_pulses"]
        fields["reference"] = path = path_through(t[logged], angles[logged], commanded[logged], rig)
        if path is not None and not logged.all():
            # Here `_held` has repeated the previous command; the path knows the true one.
            commanded[~logged] = rig.counts(path(t[~logged]).q)
    counts = fields.pop("counts", None)
    commanded = fields.get("reference_pulses")
    if commanded is None and reference is not None:
        commanded = fields["reference_pulses"] = rig.counts(reference(t).q)
    # The error is the reference minus the counts. A missing reference counts as zero.
    if counts is not None:
        fields["error_pulses"] = -counts if commanded is None else commanded - counts
    elif commanded is None:
        raise ValueError(
            "error_pulses need what was commanded; got none. Map reference_pulses, or pass"
            " reference=."
        )
    return fields


def _without_torque_delay(values, samples):
    """Torques and currents (N, n), moved up to the rows whose counts they acted on.

    The last rows have no torque or current then: they get NaN, for which `_held` removes their
    weight. A row has at most the weight of the row from which its torque comes. Without a delay
    the result is empty.
    """
    fields = [name for name in ("torque", "current") if name in values]
    whole("torque_delay", samples, "Give the samples by which the column is late.", least=0)
    if samples and not fields:
        raise ValueError(
            f"torque_delay must be that of a torque or a current; got {samples} and no such column."
            " Map it, or leave torque_delay out."
        )
    if not samples:
        return {}
    moved = {
        # Floats, since a column of whole numbers has no NaN.
        name: np.concatenate(
            [values[name][samples:], np.full_like(values[name][:samples], np.nan, dtype=float)]
        )
        for name in (*fields, "valid")
        if name in values
    }
    if "valid" in moved:
        moved["valid"] = np.minimum(values["valid"], moved["valid"])
    return moved


def _names(value):
    return value if isinstance(value, (list, tuple)) else [value]


def _blocks(table, columns, n):
    """Field -> its columns, of one length."""
    values = {field: _block(table, field, columns[field], n) for field in columns}
    N = {len(value) for value in values.values()}
    if len(N) > 1:
        lengths = ", ".join(f"{field} {len(value)}" for field, value in values.items())
        raise ValueError(
            f"columns must have one length; got {lengths}. Map columns of one sampling."
        )
    if not any(N):
        raise ValueError(
            "columns must hold samples; got none. Check that the log was written to the end."
        )
    return values


def _note(field, column, unit):
    """The one number that a record keeps of a column (N,): the mean [degC], or the first [s]."""
    if np.isnan(column).all():
        raise ValueError(f"{field!r} must hold numbers; got NaN alone. Leave it out.")
    value = unit.converted(column)
    if field == "time":
        return float(value[0] / TIME[unit.unit])
    return float(np.nanmean(value)) - (_KELVIN if unit.unit == "K" else 0.0)


def _block(table, field, value, n):
    """The columns of one field, (N, n); (N,) where there is one for all joints."""
    single = field in ("t", "valid", *NOTES)
    named = {name: _column(name, table[name]) for name in _names(value) if name is not None}
    if not named:
        raise ValueError(f"{field!r} must name a column at least; got {value!r:.80}. Leave it out.")
    # The columns of absent link encoders take their length from the named columns.
    absent = np.full((len(next(iter(named.values()))), 1), np.nan)
    parts = [named.get(name, absent) for name in _names(value)]
    if len({len(part) for part in parts}) != 1:
        raise ValueError(
            f"columns of {field!r} must have one length; got {[len(part) for part in parts]}. Check"
            " them."
        )
    block = np.concatenate(parts, axis=1)
    if block.shape[1] != (1 if single else n):
        expected = "one column" if single else f"{n} columns, one per joint"
        raise ValueError(
            f"{field!r} must have {expected}; got {block.shape[1]} ({value!r:.80}). Map as many."
        )
    # NaN marks a missing cell; an infinite number is a fault of the log.
    if np.isinf(block).any():
        raise ValueError(
            f"{field!r} must be finite, or NaN where it is missing; got inf. Mark such cells NaN."
        )
    return block[:, 0] if single else block


def _column(name, values):
    """One column of a table (N, k)."""
    column = np.asarray(values)
    if column.dtype.kind not in "biuf" or column.ndim not in (1, 2):
        raise ValueError(
            f"column {name!r} must be real numbers, (N,) or (N, n); got {column.dtype}"
            f" {column.shape}."
        )
    # A difference of two small integers can exceed their type: 64 bits hold that of any counts.
    if column.dtype.kind != "f" and column.itemsize < 8:
        column = column.astype(np.int64)
    return column[:, None] if column.ndim == 1 else column


def _in_time(values, unit, rig):
    """Times from zero [s], and the values without the rows that repeat a time."""
    if "t" not in values:
        # Without stamps the samples are one period of the controller apart.
        return values, rig.period * np.arange(len(next(iter(values.values()))))
    stamp = values.pop("t")
    if np.isnan(stamp).any():
        raise ValueError(
            f"t must be finite; got nan in row {int(np.argmax(np.isnan(stamp)))}. Drop that row."
        )
    # Of rows with one stamp only the first stays: time must increase, and a repeated row is no
    # second measurement.
    new = np.append(True, stamp[1:] != stamp[:-1])
    if not new.all():
        text = (
            f"{(~new).sum()} rows repeat the time of the row before and are left out, from row"
            f" {np.argmin(new)} on"
        )
        warn(text)
    # The difference first: that of whole numbers is exact. An offset of the unit cancels.
    elapsed = unit.converted(stamp[new] - stamp[0])
    t = (elapsed - elapsed[0]) / TIME[unit.unit]
    require_period(t, unit.unit, rig.period)
    return {field: value[new] for field, value in values.items()}, t


def _held(values, labels):
    """Values whose gaps (NaN) repeat the previous number, and the weights of all rows.

    A gap before the first number gets the first number. A row with a gap has weight zero. The
    column of a joint without a link encoder stays NaN.
    """
    weight = np.asarray(values.get("valid", np.ones(len(next(iter(values.values()))))), float)
    valid = np.where(np.isnan(weight), 0.0, weight)
    held = {}
    for field, value in values.items():
        if field == "valid":
            continue
        present = ~np.isnan(value)
        if field in _PARTIAL:
            # A joint without a link encoder is NaN throughout; its column takes no weight from a
            # row.
            present |= ~present.any(axis=0)
        if not present.any(axis=0).all():
            raise ValueError(
                f"{field!r} must hold numbers; {labels[np.argmin(present.any(axis=0))]} has none."
                " Check."
            )
        # The running maximum is the index of the latest row that holds a number, -1 before the
        # first.
        row = np.maximum.accumulate(np.where(present, np.arange(len(value))[:, None], -1), axis=0)
        row = np.where(row < 0, np.argmax(present, axis=0), row)  # before the first: the first
        held[field] = np.take_along_axis(value, row, axis=0)
        valid = valid * present.all(axis=1)
    return held, valid


def _unwrapped(value: NDArray[Any], wrap: Any, labels: Sequence[str]) -> NDArray[Any]:
    """Unwrap an encoder (N, n): add whole wraps, so that no step exceeds half a wrap."""
    n = len(labels)
    wrap = np.broadcast_to(wrap, n) if np.ndim(wrap) == 0 else np.asarray(wrap)
    if wrap.shape != (n,):
        raise ValueError(
            f"wrap must be one number, or {n}, one per joint; got shape {wrap.shape}. Give as many."
        )
    wrap = np.array(
        [
            real("wrap", w, "Give counts per wrap, or an angle.", positive=True)
            for w in wrap.tolist()
        ]
    )
    # A counter cannot span more than its wrap; 1e-9 allows for the rounding of angles.
    if (np.ptp(value, axis=0) > wrap * (1 + 1e-9)).any():
        joint = int(np.argmax(np.ptp(value, axis=0) / wrap))
        got = f"{labels[joint]} spans {np.ptp(value[:, joint]):g}"
        raise ValueError(
            f"wrap must be as large as what is logged; got {wrap[joint]:g}, but {got}. Correct it."
        )
    return _continued(value, wrap)


def _continued(value: NDArray[Any], wrap: Floats) -> NDArray[Any]:
    """Values (N, n) without steps of more than half a wrap (n,)."""
    # Integers stay exact, however many wraps are added.
    is_integer = value.dtype.kind == "i" or (value == np.round(value)).all()
    kind = np.int64 if is_integer and (wrap == np.round(wrap)).all() else float
    value = value.astype(kind)
    wrap = wrap.astype(kind)
    # A step of more than half a wrap is a passage through the wrap in the opposite direction.
    turns = -np.cumsum(np.round(np.diff(value, axis=0) / wrap).astype(np.int64), axis=0)
    return value + np.vstack([np.zeros((1, len(wrap)), np.int64), turns]) * wrap


def _together(
    values: Mapping[str, NDArray[Any]],
    measured: str,
    units: Mapping[str, StatedUnit],
    wrap: NDArray[Any],
    labels: Sequence[str],
) -> dict[str, NDArray[Any]]:
    """An unwrapped position and its reference, where they differ by whole wraps alone.

    A reference may start again as the position does, and the first position may be whole wraps off.
    The result is empty if the reference is in another unit, or is right as it is.
    """
    field = next((name for name in REFERENCE if name in values), None)
    if field is None or measured == "error_pulses":
        return {}
    # Pulses are those of the motor's shaft, whatever the field is called.
    ends = [
        (units[name].unit, units[name].unit == "pulses" or "motor" in name)
        for name in (field, measured)
    ]
    if ends[0] != ends[1] or any(units[name].factor is not None for name in (field, measured)):
        return {}
    position, logged = values[measured], values[field]
    wrap = np.broadcast_to(wrap, len(labels))
    # A reference that spans more than a wrap does not start again.
    within = np.ptp(logged, axis=0) <= wrap
    reference = np.where(within, _continued(logged, wrap), logged)
    shift = np.round((reference[0] - position[0]) / wrap).astype(np.int64) * wrap
    # An arm may lag by more than half a wrap, but then no whole wraps bring it near throughout.
    wrong = (np.abs(logged - position) > wrap / 2).any(axis=0)
    wrong &= (np.abs(reference - position - shift) <= wrap / 2).all(axis=0)
    if not wrong.any():
        return {}
    named = several(label for label, is_wrong in zip(labels, wrong, strict=True) if is_wrong)
    warn(f"{field} differs from {measured} by whole wraps at {named}; they are taken off")
    return {
        measured: position + np.where(wrong, shift, 0),
        field: np.where(wrong, reference, logged),
    }


def _own_steps(field: str, value: Floats, unit: Unit, rig: Rig) -> dict[str, float]:
    """Notes of joints whose positions (N, n) are multiples of a step other than whole pulses."""
    if rig.encoder.smooth:
        return {}
    to_pulses = rig.encoder.position_in_pulses if "motor" in field else rig.position_in_pulses
    steps = np.array([_clean_step(column) for column in value.T])
    # The step of each joint in pulses of its own motor: the logged step times the pulses per logged
    # unit.
    pulses = steps * np.abs(np.diagonal(to_pulses(np.eye(rig.n) * factors(unit))))
    # A step of 10**-k, as logged or after a conversion between rad and deg, comes from printed
    # decimals and tells nothing about the encoder.
    scales = np.array((1, np.pi / 180, 180 / np.pi))
    decimals = np.log10(np.maximum(steps, 1e-300)[:, None] * scales)
    printed = np.abs(decimals - np.round(decimals)).min(axis=1) <= STEPS.decimal_tolerance
    off = (np.abs(pulses - np.round(pulses)) > STEPS.pulse_tolerance) & ~printed
    # One wrong resolution scales all joints alike; ranges of joints differ.
    differ = off.sum() > 1 and np.ptp(pulses[off]) > STEPS.pulse_tolerance * pulses[off].min()
    if differ and STEPS.min_normalised < np.abs(value).max() <= CHECKS.max_normalised:
        warn(
            f"{field} lies within -100 to 100 and has another step for each joint, as normalised"
            ' positions do: if it is such, state {"-100 to 100 of pulses": ranges of the joints}'
        )
    geared = off & (pulses > 1 / STEPS.max_ratio) & (pulses < STEPS.max_ratio)
    return {STEP_NOTE.format(i): float(pulses[i]) for i in np.flatnonzero(geared)}


def _clean_step(value: Floats) -> float:
    """The step of values (N,): all their differences are multiples of half of it.

    The step is 0 if no step fits, or if there are fewer than `STEPS.min_levels` different values.
    """
    levels = np.unique(value[np.isfinite(value)])
    if len(levels) < STEPS.min_levels:
        return 0.0
    apart = np.diff(levels)
    # the rest is one level, written in other last digits
    apart = apart[apart > STEPS.level_tolerance * np.median(apart)]
    # An encoder that rounds towards zero (`fix`) has a cell at zero that is two steps wide, so the
    # centres of the neighbouring cells are half a step further away.
    halves = np.round(2 * apart / apart.min())
    step = float(2 * apart.sum() / halves.sum())
    # Distances are doubled, since the levels beside zero are half a step further away.
    off = 2 * (levels - levels[0])
    return step if np.abs(off / step - np.round(off / step)).max() < STEPS.level_tolerance else 0.0
