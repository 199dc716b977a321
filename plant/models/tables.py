"""Parts as tables of a robot file, and back: implied kinds, checked keys, and TOML text."""

import dataclasses
import difflib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from plant.parts import PARTS, Part, from_plain, kind_of, meanings, near

_UNIT = re.compile(r"\[([^\]]*)\]")


def meaning_of(cls: type, field: str) -> str:
    """The first sentence of the description of a field; empty without one."""
    # A sentence ends with a single full stop before a blank: not "3.5", and not "...".
    return re.split(r"(?<=[^.])\.(?:\s|$)", meanings(cls).get(field, ""), maxsplit=1)[0]


def unit_of(cls: type, field: str) -> str:
    """The unit of a field, from the brackets of its description; empty without any."""
    match = _UNIT.search(meanings(cls).get(field, ""))
    return match[1] if match else ""


# Class -> field -> the kind of its part where the file has no kind, beside the declared kinds.
_KINDS = {
    "Drive": {
        "elasticity": "plant.Elasticity",
        "current_lag": "plant.CurrentLag",
        "load_friction": "plant.LoadFriction",
    },
    "Chain": {"links": "plant.Link", "bodies": "plant.Body"},
}


def _kinds(cls):
    """Field -> the kind of its part where the file has no kind."""
    kinds = {}
    for field in dataclasses.fields(cls):
        declared = field.metadata.get("kind")
        if isinstance(declared, type) and kind_of(declared) in PARTS:
            kinds[field.name] = kind_of(declared)
    return kinds | _KINDS.get(cls.__name__, {})


def class_of(kind, heading: str) -> type[Part]:
    """The class of a kind; a file imports no package.

    `heading` of its table is for messages.
    """
    if isinstance(kind, str) and kind in PARTS:
        return PARTS[kind]
    # A law of a package that is not imported is unknown, however well it is spelt.
    package = str(kind).split(".")[0]
    hint = near(kind, PARTS, "Write it like 'plant.P'.", cutoff=0.6)
    imported = any(name.startswith(f"{package}.") for name in PARTS)
    if package in ("identification", "ctc") and not imported:
        hint = f"Import {package} first."
    raise ValueError(f"kind in [{heading}] must be that of a part; got {kind!r:.60}. {hint}")


def require_table(table, heading: str) -> None:
    """Refuse a value that stands where a table should."""
    if not isinstance(table, Mapping):
        raise ValueError(
            f"[{heading}] must be a table of keys; got {table!r:.60}. Write [{heading}] on a line"
            " of its own."
        )


def check_keys(table, cls: type[Part], heading: str) -> None:
    """Refuse what is no table, a key that is no field, and the lack of a field without default."""
    require_table(table, heading)
    fields = {field.name: field for field in dataclasses.fields(cls)}
    for key in table:
        # The nearest field with its meaning, or all of them.
        if key not in fields and key != "kind":
            hint = f"It has {', '.join(fields)}."
            close = difflib.get_close_matches(key, fields, n=1, cutoff=0.5)
            if close:
                hint = f"Did you mean {close[0]!r}{_in_brackets(cls, close[0])}?"
            raise ValueError(f"[{heading}] must have keys of {cls.__name__}; got {key!r}. {hint}")
    for name, field in fields.items():
        has_default = (
            field.default is not dataclasses.MISSING
            or field.default_factory is not dataclasses.MISSING
        )
        if name not in table and not has_default:
            meaning = _in_brackets(cls, name)
            raise ValueError(f"[{heading}] must have {name!r}{meaning}; it has not. Add it.")


def _in_brackets(cls, name):
    text = meaning_of(cls, name)
    return f" ({text})" if text else ""


def part_of(table, kind: str, heading: str, parts: Mapping[str, Part] | None = None) -> Any:
    """The part that a table describes, of this kind where the table has no kind.

    `heading` of the table is for messages. Where the table has a text such as ``"[arm]"`` in place
    of a part, the part is the one in `parts` with this heading. Raises a ValueError with the
    heading for unknown, missing or misspelt keys, and for values that the part itself refuses.
    """
    require_table(table, heading)
    cls = class_of(table.get("kind", kind), heading)
    check_keys(table, cls, heading)
    kinds = _kinds(cls)

    def value_of(key: str, value, index: str = "") -> Any:
        if isinstance(value, Mapping):
            return part_of(value, kinds.get(key, ""), f"{heading}.{key}{index}", parts)
        if isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
            return tuple(value_of(key, row, f"[{i}]") for i, row in enumerate(value))
        if isinstance(value, str) and parts and value in parts:
            return parts[value]
        return from_plain(value)

    # The kind has chosen the class, and is no field.
    values = {key: value_of(key, value) for key, value in table.items() if key != "kind"}
    try:
        # The part checks its own numbers; the heading says where they stand.
        return cls(**values)
    except ValueError as error:
        raise ValueError(f"[{heading}]: {error}") from None


def table_of(part: Part, kind: str, parts: Mapping[str, Part] | None = None) -> dict[str, Any]:
    """The table of a part: its fields, and its kind if it is not implied.

    Fields at their defaults are left out, except arrays. A part among `parts` is written as its
    heading.
    """
    kinds = _kinds(type(part))

    def value_of(key: str, value, plain) -> Any:
        if isinstance(value, Part):
            # The same rig or arm is written once, and referred to by its heading.
            for heading, named_part in (parts or {}).items():
                if value == named_part:
                    return heading
            return table_of(value, kinds.get(key, ""), parts)
        if isinstance(value, tuple) and value and all(isinstance(row, Part) for row in value):
            return [table_of(row, kinds.get(key, ""), parts) for row in value]
        return plain

    # Plain numbers and lists of each field, as in all files of the library.
    described = part.describe()
    part_kind = kind_of(type(part))
    # An implied kind is left out.
    table: dict[str, Any] = {} if part_kind == kind else {"kind": part_kind}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        is_default = field.default is not dataclasses.MISSING and _same(value, field.default)
        if value is not None and not is_default:
            table[field.name] = value_of(field.name, value, described[field.name])
    return table


def _same(value, default):
    if isinstance(value, Part) or isinstance(default, Part):
        return bool(value == default)
    # 1 and True are equal to 1.0, but not the same text.
    try:
        return type(value) is type(default) and bool(value == default)
    except ValueError:  # arrays have no single truth
        return False


# Keys that TOML reads without quotes.
_BARE = re.compile(r"[A-Za-z0-9_-]+")
# From this number of characters on, the entries of a list get lines of their own. It is part of the
# format: another number would change each robot file that is written again.
_WIDE = 110


def toml_lines(
    table: Mapping[str, Any],
    path: tuple[str, ...] = (),
    comment: Callable[..., str] = lambda *_: "",
) -> Iterator[str]:
    """Lines of a table at this path: plain values first, then its tables and lists of tables.

    ``comment(path, key)`` is the comment behind a value. Raises a ValueError for values that TOML
    cannot hold.
    """
    nested = {}
    for key, value in table.items():
        # Values behind a nested table would belong to it, so tables come last.
        if _is_table(value) and not (path and _is_short(value)):
            nested[key] = value
            continue
        text = comment(path, key)
        yield f"{_key(key)} = {_value(value)}{f'  # {text}' if text else ''}"
    for key, value in nested.items():
        nested_path = (*path, key)
        heading = ".".join(map(_key, nested_path))
        # A list of tables has double brackets, and a heading per row.
        several = isinstance(value, (list, tuple))
        for row in value if several else (value,):
            yield ""
            yield f"[[{heading}]]" if several else f"[{heading}]"
            yield from toml_lines(row, nested_path, comment)


def _is_table(value):
    if isinstance(value, (list, tuple)):
        return bool(value) and all(isinstance(row, Mapping) for row in value)
    return isinstance(value, Mapping)


def _is_short(value):
    """Whether a table is a few words and numbers, written in one line."""
    if not isinstance(value, Mapping):
        return False
    plain = not any(isinstance(entry, (Mapping, list, tuple)) for entry in value.values())
    return plain and len(_value(value)) < _WIDE


def _key(key):
    return key if _BARE.fullmatch(key) else _text(key)


def _text(value):
    # TOML forbids the delete character, which JSON allows; all else is the same.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value):
    # The text of a number of numpy is no number of TOML.
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    # JSON and TOML write these alike; floats keep all their digits.
    if isinstance(value, (bool, int, str)):
        return _text(value)
    if isinstance(value, float):
        # TOML has nan, but no number of a robot is one.
        if math.isnan(value):
            raise ValueError("a robot file must hold numbers; got NaN. Give its value.")
        return repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(v)}" for key, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        texts = [_value(entry) for entry in value]
        line = f"[{', '.join(texts)}]"
        # A matrix has a line per row.
        rows = bool(value) and isinstance(value[0], (list, tuple))
        if len(line) < _WIDE and not rows:
            return line
        return "[\n    " + ",\n    ".join(texts) + ",\n]"
    raise ValueError(
        f"a robot file must hold numbers, text and flags; got a {type(value).__name__}. Leave it"
        " out."
    )
