"""Units of logged columns, as a user or a heading states them, with their constants.

A unit is a word, one word per joint, or a word with its constants: ``{"per mille of motor N m":
rated}``, ``{"N m per A": constant}``, ``{"-100 to 100 of deg": ranges}``.
"""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from plant.logs.unit_words import unit_named, without_unit
from plant.logs.units import NOTES, UNITS, Unit, require_unit
from plant.parts import Floats, near, warn

# What a user may state of one field.
Stated: TypeAlias = str | tuple[str, ...] | list[str] | Mapping[str, Any]

_SHARES = {"per mille": 1e-3, "per cent": 1e-2}
# Three patterns for three kinds of constants: a rated value, a range, a factor.
_SHARE = re.compile(r"(per mille|per cent) of (.+)")
_RANGE = re.compile(r"(-?\d{1,9}(?:\.\d{1,9})?) to (-?\d{1,9}(?:\.\d{1,9})?) of (.+)")
_FACTOR = re.compile(r"(.+?) per (.+)")
# Converted numbers within this distance of whole pulses [pulses] are rounded to them: in single
# precision a turn of 2**20 pulses is exact to 0.06.
_NEAR = 0.1


@dataclasses.dataclass(frozen=True, kw_only=True)
class StatedUnit:
    """A unit of the library, and how a logged number becomes one in it.

    Parameters
    ----------
    unit : str or tuple of str
        One, or one per joint.
    factor, offset : (n,) array
        The value in `unit` is `factor` times the logged one plus `offset`.
    """

    unit: Unit
    factor: Floats | None = None
    offset: Floats | float = 0.0

    def converted(self, value: NDArray[Any]) -> NDArray[Any]:
        """The logged numbers (N, n) in `unit`."""
        # Integers stay integers, and bits stay bits, where nothing is to be converted.
        if self.factor is None:
            return value
        # One line serves scales and ranges: a scale has an offset of zero.
        result = value * self.factor + self.offset
        rounded = np.round(result)
        # A log of single precision holds scaled counts with an error of rounding.
        is_whole = self.unit == "pulses" and np.nanmax(np.abs(result - rounded), initial=0) < _NEAR
        return rounded if is_whole else result


def stated_units(
    columns: Mapping[str, Any], units: Mapping[str, Stated] | None, table: Mapping[str, Any], n: int
) -> dict[str, StatedUnit]:
    """The unit of each mapped field: as stated, as the heading says, or the usual one."""
    stated = dict(units or {})
    headings = {field: unit for field in columns if (unit := _heading_unit(field, columns, table))}
    # The user knows more than the heading: an exporter may convert and keep the old name.
    stated = headings | stated
    result = {}
    for field in columns:
        allowed = UNITS.get(field)
        if allowed is None:
            continue
        # A field with a single possible unit, such as counts, needs no statement; a note neither.
        if field not in stated and len(allowed) > 1 and field not in NOTES:
            offered = ", ".join(map(repr, allowed))
            raise ValueError(
                f"units must state that of {field!r}; got none. Give one of {offered}."
            )
        # All joints have the same times and notes.
        size = 1 if field in ("t", *NOTES) else n
        used = _stated(field, stated.get(field, allowed[0]), size)
        heading = headings.get(field, used.unit)
        # A unit with constants is one that no heading can say.
        if used.factor is None and used.unit != heading:
            warn(
                f"units state {used.unit!r} of {field!r}, its heading says {heading!r};"
                f" {used.unit!r} is used"
            )
        result[field] = used
    return result


def require_words(columns: Mapping[str, Any], units: Mapping[str, Stated]) -> None:
    """Refuse a unit that is unknown, or that is stated of a column that is not mapped."""
    # A misspelt key in units would otherwise show up as the missing unit of the column that it was
    # meant for.
    for field, unit in units.items():
        if field not in columns:
            advice = near(field, columns, "Map it as well, or leave out its unit.", cutoff=0.7)
            raise ValueError(
                f"units must be of columns that are mapped, {', '.join(columns)}; got"
                f" {field!r:.40}. {advice}"
            )
        _word(field, unit)


def _heading_unit(field: str, columns: Mapping[str, Any], table: Mapping[str, Any]) -> Unit | None:
    """The unit that a table states of all columns of a field; None where it states none."""
    names = columns[field] if isinstance(columns[field], (list, tuple)) else [columns[field]]
    of_table = getattr(table, "units", {})
    # A joint without a second encoder has no column there.
    named = [name for name in names if name is not None]
    units = {x: unit for x in named if (unit := of_table.get(x) or without_unit(x)[1]) is not None}
    # Counts, which have a single unit, may be called numbers.
    counted = len(UNITS.get(field, ())) < 2 and "1" in units.values()
    if field not in UNITS or counted or not units or len(units) < len(named):
        return None
    # Any unit will do for the absent column of a joint.
    words = tuple(units.get(x, units[named[0]]) for x in names)
    return words[0] if len(set(words)) == 1 else words


def _word(field: str, stated: Stated) -> str | tuple[str, ...] | tuple[re.Match[str], Any]:
    """What is stated, in words of the library; a unit with constants as its match and constants."""
    allowed = UNITS.get(field, ("1",))
    if isinstance(stated, Mapping):
        return _with_constants(field, stated, allowed)
    if not isinstance(stated, (tuple, list)):
        return _one_word(field, stated, allowed)
    # Each word alone first, so that the message names the one that is wrong.
    words = tuple(_one_word(field, word, allowed) for word in stated)
    require_unit(field, words)
    return words


def _one_word(field: str, word: Any, allowed: tuple[str, ...]) -> str:
    if not isinstance(word, str):
        raise ValueError(
            f"unit of {field!r} must be a word; got {_in_one_line(word)}. Give a word, one per"
            " joint, or {word: constants} of all joints."
        )
    name = unit_named(word) or word
    if name in allowed:
        return str(name)
    # A number alone cannot be read in these; say what makes it one.
    if name in _SHARES and ("A" in allowed or "N m" in allowed):
        base = "A" if "A" in allowed else "motor N m"
        rated = "current" if base == "A" else "torque"
        raise ValueError(
            f"unit {word!r} of {field!r} must state the rated {rated}; got none. Give"
            f' {{"{name} of {base}": rated}}.'
        )
    # Many drivers publish currents as efforts: the commonest wrong unit has its own advice.
    if name in ("A", "mA") and "N m" in allowed:
        raise ValueError(
            f"unit of {field!r} must be one of torque, or have a torque constant; got {word!r}. Map"
            f" the column as 'current', or give {{\"N m per {name}\": constant}}."
        )
    # Normalised positions have no unit at all; their ranges stand in the calibration.
    normalised = name in ("per cent", "-100 to 100", "0 to 100", "normalized", "normalised")
    if normalised and "rad" in allowed:
        raise ValueError(
            f"unit {word!r} of {field!r} must state the ranges of the joints; got none. Give"
            ' {"-100 to 100 of deg": [(least, most), ...]}.'
        )
    if word.lower() == "grad" and "gon" in allowed:
        raise ValueError(
            f"unit of {field!r} must be 'deg' or 'gon'; got {word!r}, which is used for both. State"
            " which one it is."
        )
    # The nearest of these is no advice: "N mm" is near "N m", and 1000 times smaller.
    raise ValueError(
        f"unit of {field!r} must be one of {', '.join(map(repr, allowed))}; got {word!r:.40}."
        f' Convert the column, or give {{"{allowed[0]} per {word}": constant}}.'
    )


def _with_constants(
    field: str, stated: Mapping[str, Any], allowed: tuple[str, ...]
) -> tuple[re.Match[str], Any]:
    """The pattern that a unit with constants follows, and the constants."""
    advice = 'Give {"per mille of motor N m": rated}, {"N m per A": constant} or such.'
    if len(stated) != 1:
        raise ValueError(
            f"unit of {field!r} must be one word with its constants; got {len(stated)}. {advice}"
        )
    ((text, constants),) = stated.items()
    spelt = " ".join(str(text).split())
    match = _SHARE.fullmatch(spelt) or _RANGE.fullmatch(spelt) or _FACTOR.fullmatch(spelt)
    if match is None:
        raise ValueError(
            f"unit of {field!r} must say what its constants mean; got {text!r:.60}. {advice}"
        )
    # The constants are in a unit of the library; what they multiply may be anything.
    if _base(match) not in allowed:
        raise ValueError(
            f"unit of {field!r} must be one of {', '.join(map(repr, allowed))}; got"
            f" {_base(match)!r:.40}. Give the constants in one of these."
        )
    return match, constants


def _base(match: re.Match[str]) -> str:
    """The unit of the library in which the constants are."""
    text = match[1] if match.re is _FACTOR else match[match.re.groups]
    return unit_named(text) or text


def _stated(field: str, stated: Stated, n: int) -> StatedUnit:
    word = _word(field, stated)
    if isinstance(word, str):
        return StatedUnit(unit=word)
    if isinstance(word[0], str):
        if len(word) != n:
            raise ValueError(
                f"units of {field!r} must be one, or {n}, one per joint; got {len(word)}. State as"
                " many."
            )
        units = tuple(map(str, word))
        return StatedUnit(unit=units[0] if len(set(units)) == 1 else units)
    match, constants = word
    # A range has an offset as well, so it needs both ends of every joint.
    if match.re is _RANGE:
        # The two ends of the logged range, which the user's pair says in `unit`.
        low, high = float(match[1]), float(match[2])
        if low >= high:
            raise ValueError(
                f"range in the unit of {field!r} must rise; got {match[0]!r:.60}. Write its lower"
                " end first."
            )
        ranges = _constants(field, constants, (n, 2), "a pair (least, most) per joint")
        if (ranges[:, 0] == ranges[:, 1]).any():
            raise ValueError(
                f"ranges of {field!r} must have two ends; got {_in_one_line(constants)}. Give"
                f" the position at {match[1]} and that at {match[2]}."
            )
        factor = (ranges[:, 1] - ranges[:, 0]) / (high - low)
        return StatedUnit(unit=_base(match), factor=factor, offset=ranges[:, 0] - factor * low)
    factor = _constants(field, constants, (n,), "one number, or one per joint")
    if (factor == 0).any():
        raise ValueError(
            f"constants of {field!r} must not be zero; got {_in_one_line(constants)}. Correct them."
        )
    return StatedUnit(unit=_base(match), factor=factor * _SHARES.get(match[1], 1.0))


def _constants(field: str, value: Any, shape: tuple[int, ...], expected: str) -> Floats:
    """Constants of all joints, given once or per joint."""
    try:
        # Robot files give lists, scripts arrays; one number stands for all joints.
        numbers = np.asarray(value, float)
        constants = np.broadcast_to(numbers, shape)
    except (TypeError, ValueError):
        constants = np.full(shape, np.nan)
    if not np.isfinite(constants).all():
        raise ValueError(
            f"constants of {field!r} must be {expected}; got {_in_one_line(value)}. Give finite"
            " numbers."
        )
    return constants


def _in_one_line(value: Any) -> str:
    """The text of a value for a message: numpy breaks that of a matrix into lines."""
    return " ".join(repr(value).split())[:60]
