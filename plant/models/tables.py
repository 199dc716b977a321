"""Parts as tables of a robot file, and back: kinds that go without saying, keys checked against the fields."""

import dataclasses
import difflib
import functools
import re
from collections.abc import Mapping
from typing import Any

from plant.parts.kinds import PARTS, kind_of
from plant.parts.part import Part
from plant.parts.plain import from_plain

_HEAD = re.compile(r"^    (\w+(?:, \w+)*) : .*$")
_UNIT = re.compile(r"\[([^\]]*)\]")


@functools.cache
def _meanings(cls: type) -> dict[str, str]:
    """Field -> its description, in one line."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in (cls.__doc__ or "").splitlines():
        if head := _HEAD.match(line):
            names = head[1].split(", ")
            found |= dict.fromkeys(names, "")
        elif line.startswith("        ") and names:
            found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
        elif line.strip():
            names = []
    return found


def meaning_of(cls: type, field: str) -> str:
    """The first sentence of what a field means; empty where nothing is said."""
    return re.split(r"(?<=[^.])\.(?:\s|$)", _meanings(cls).get(field, ""), maxsplit=1)[0]


def unit_of(cls: type, field: str) -> str:
    """What the brackets of its description hold; empty where there are none."""
    match = _UNIT.search(_meanings(cls).get(field, ""))
    return match[1] if match else ""


_KINDS = {
    "Drive": {
        "elasticity": "plant.Elasticity", "current_lag": "plant.CurrentLag", "load_friction": "plant.LoadFriction",
    },
    "Chain": {"links": "plant.Link", "bodies": "plant.Body"},
}  # fmt: skip
"""Class -> field -> the kind of part that it holds where the file names none, beside those that are declared."""


def _kinds(cls: type[Part]) -> dict[str, str]:
    """Field -> the kind of part that it holds where the file names none."""
    declared = {field.name: field.metadata.get("kind") for field in dataclasses.fields(cls)}
    parts = {name: kind_of(kind) for name, kind in declared.items() if isinstance(kind, type)}
    return {name: kind for name, kind in parts.items() if kind in PARTS} | _KINDS.get(cls.__name__, {})


def class_of(kind: Any, where: str) -> type[Part]:
    """The class of a kind; none is imported for it."""
    if isinstance(kind, str) and kind in PARTS:
        return PARTS[kind]
    package = str(kind).split(".")[0]
    near = difflib.get_close_matches(str(kind), PARTS, n=1, cutoff=0.6)
    hint = f"Did you mean {near[0]!r}?" if near else "Write it like 'plant.P'."
    if package in ("identification", "ctc") and not any(name.startswith(f"{package}.") for name in PARTS):
        hint = f"Import {package} first."
    raise ValueError(f"kind in [{where}] must be that of a part; got {kind!r:.60}. {hint}")


def check_keys(table: Any, cls: type[Part], where: str) -> None:
    """Refuse a key that is no field, and the lack of one that has no default; with meaning and unit."""
    if not isinstance(table, Mapping):
        raise ValueError(f"[{where}] must be a table of keys; got {table!r:.60}. Write [{where}] on a line of its own.")
    fields = {field.name: field for field in dataclasses.fields(cls)}
    for key in table:
        if key not in fields and key != "kind":
            near = difflib.get_close_matches(key, fields, n=1, cutoff=0.5)
            said = f"Did you mean {near[0]!r}{_said(cls, near[0])}?" if near else f"It has {', '.join(fields)}."
            raise ValueError(f"[{where}] must have keys of {cls.__name__}; got {key!r}. {said}")
    for name, field in fields.items():
        needed = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if needed and name not in table:
            raise ValueError(f"[{where}] must have {name!r}{_said(cls, name)}; it has not. Add it.")


def _said(cls: type[Part], name: str) -> str:
    text = meaning_of(cls, name)
    return f" ({text})" if text else ""


def part_of(table: Any, kind: str, where: str, known: Mapping[str, Part] | None = None) -> Any:
    """The part that a table describes, of this kind where the table names none.

    `where` is its heading, for messages; `known` is what text in the place of a part stands for: ``"[arm]"``. Unknown,
    missing or misspelt keys, and what the part itself refuses, are refused with the heading.
    """
    cls = class_of(table.get("kind", kind) if isinstance(table, Mapping) else kind, where)
    check_keys(table, cls, where)
    kinds = _kinds(cls)

    def value_of(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return part_of(value, kinds.get(key, ""), f"{where}.{key}", known)
        if isinstance(value, list) and value and all(isinstance(each, Mapping) for each in value):
            return tuple(value_of(key, each) for each in value)
        if isinstance(value, str) and known and value in known:
            return known[value]
        return from_plain(value)

    values = {key: value_of(key, value) for key, value in table.items() if key != "kind"}
    try:
        return cls(**values)
    except ValueError as error:
        raise ValueError(f"[{where}]: {error}") from None


def table_of(part: Part, kind: str, known: Mapping[str, Part] | None = None) -> dict[str, Any]:
    """The table of a part: fields that are not their defaults, kinds that do not go without saying."""
    kinds = _kinds(type(part))

    def value_of(key: str, value: Any, plain: Any) -> Any:
        if isinstance(value, Part):
            for text, other in (known or {}).items():
                if value == other:
                    return text
            return table_of(value, kinds.get(key, ""), known)
        if isinstance(value, tuple) and value and all(isinstance(each, Part) for each in value):
            return [table_of(each, kinds.get(key, ""), known) for each in value]
        return plain

    described, own = part.describe(), kind_of(type(part))
    table: dict[str, Any] = {} if own == kind else {"kind": own}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if value is None or (field.default is not dataclasses.MISSING and _same(value, field.default)):
            continue
        table[field.name] = value_of(field.name, value, described[field.name])
    return table


def _same(value: Any, default: Any) -> bool:
    if isinstance(value, Part) or isinstance(default, Part):
        return bool(value == default)
    try:
        return type(value) is type(default) and bool(value == default)
    except ValueError:  # an array beside a default that is a tuple
        return False
