"""Parts as tables of a robot file, and back: kinds that go without saying, checked keys, and
TOML text.
"""

import dataclasses
import difflib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from plant.parts.arguments import near
from plant.parts.kinds import PARTS, kind_of, meanings
from plant.parts.part import Part
from plant.parts.plain import from_plain

_UNIT = re.compile(r"\[([^\]]*)\]")


def meaning_of(cls: type, field: str) -> str:
    """The first sentence of what a field means; empty where nothing is said."""
    return re.split(r"(?<=[^.])\.(?:\s|$)", meanings(cls).get(field, ""), maxsplit=1)[0]


def unit_of(cls: type, field: str) -> str:
    """What the brackets of its description hold; empty where there are none."""
    match = _UNIT.search(meanings(cls).get(field, ""))
    return match[1] if match else ""


# Class -> field -> the kind of part that it holds where the file names none, beside those that are
# declared.
_KINDS = {
    "Drive": {
        "elasticity": "plant.Elasticity",
        "current_lag": "plant.CurrentLag",
        "load_friction": "plant.LoadFriction",
    },
    "Chain": {"links": "plant.Link", "bodies": "plant.Body"},
}


def _kinds(cls: type[Part]) -> dict[str, str]:
    """Field -> the kind of part that it holds where the file names none."""
    declared = {field.name: field.metadata.get("kind") for field in dataclasses.fields(cls)}
    parts = {name: kind_of(kind) for name, kind in declared.items() if isinstance(kind, type)}
    return {name: kind for name, kind in parts.items() if kind in PARTS} | _KINDS.get(
        cls.__name__, {}
    )


def class_of(kind: Any, where: str) -> type[Part]:
    """The class of a kind; none is imported for it."""
    if isinstance(kind, str) and kind in PARTS:
        return PARTS[kind]
    package = str(kind).split(".")[0]
    hint = near(kind, PARTS, "Write it like 'plant.P'.", cutoff=0.6)
    if package in ("identification", "ctc") and not any(
        name.startswith(f"{package}.") for name in PARTS
    ):
        hint = f"Import {package} first."
    raise ValueError(f"kind in [{where}] must be that of a part; got {kind!r:.60}. {hint}")


def check_keys(table: Any, cls: type[Part], where: str) -> None:
    """Refuse a key that is no field, and the lack of one that has no default; with meaning and
    unit.
    """
    if not isinstance(table, Mapping):
        raise ValueError(
            f"[{where}] must be a table of keys; got {table!r:.60}. Write [{where}] on a line of"
            " its own."
        )
    fields = {field.name: field for field in dataclasses.fields(cls)}
    for key in table:
        if key not in fields and key != "kind":
            close = difflib.get_close_matches(key, fields, n=1, cutoff=0.5)
            said = (
                f"Did you mean {close[0]!r}{_said(cls, close[0])}?"
                if close
                else f"It has {', '.join(fields)}."
            )
            raise ValueError(f"[{where}] must have keys of {cls.__name__}; got {key!r}. {said}")
    for name, field in fields.items():
        needed = (
            field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        )
        if needed and name not in table:
            raise ValueError(f"[{where}] must have {name!r}{_said(cls, name)}; it has not. Add it.")


def _said(cls: type[Part], name: str) -> str:
    text = meaning_of(cls, name)
    return f" ({text})" if text else ""


def part_of(table: Any, kind: str, where: str, known: Mapping[str, Part] | None = None) -> Any:
    """The part that a table describes, of this kind where the table names none.

    `where` is its heading, for messages; `known` is what text in the place of a part stands for:
    ``"[arm]"``. Unknown, missing or misspelt keys, and what the part itself refuses, are refused
    with the heading.
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
    """The table of a part: fields that are not their defaults, kinds that do not go without
    saying.
    """
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

    described = part.describe()
    own = kind_of(type(part))
    table: dict[str, Any] = {} if own == kind else {"kind": own}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if value is None or (
            field.default is not dataclasses.MISSING and _same(value, field.default)
        ):
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


_BARE = re.compile(r"[A-Za-z0-9_-]+")
_WIDE = 110  # characters above which the entries of a list get lines of their own


def toml_lines(
    table: Mapping[str, Any],
    path: tuple[str, ...] = (),
    comment: Callable[..., str] = lambda *_: "",
) -> Iterator[str]:
    """Lines of a table: plain values first, then the tables and lists of tables within it; `path`
    leads to the table.

    ``comment(path, key)`` is what stands behind a value. What TOML cannot hold is refused.
    """
    nested = {
        key: value
        for key, value in table.items()
        if _is_table(value) and not (path and _is_short(value))
    }
    for key, value in table.items():
        if key not in nested:
            text = comment(path, key)
            yield f"{_key(key)} = {_value(value)}{f'  # {text}' if text else ''}"
    for key, value in nested.items():
        name = (*path, key)
        several = isinstance(value, (list, tuple))
        for each in value if several else (value,):
            label = ".".join(map(_key, name))
            yield from ("", f"[[{label}]]" if several else f"[{label}]")
            yield from toml_lines(each, name, comment)


def _is_table(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return bool(value) and all(isinstance(each, Mapping) for each in value)
    return isinstance(value, Mapping)


def _is_short(value: Any) -> bool:
    """Whether a table is a few words and numbers, written in one line."""
    plain = isinstance(value, Mapping) and not any(
        isinstance(each, (Mapping, list, tuple)) for each in value.values()
    )
    return plain and len(_value(value)) < _WIDE


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(value: str | int) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, (bool, int, str)):
        return _text(value)
    if isinstance(value, float):
        if math.isnan(value):
            raise ValueError("a robot file must hold numbers; got NaN. Give its value.")
        return repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        texts = [_value(each) for each in value]
        line = f"[{', '.join(texts)}]"
        rows = bool(value) and isinstance(value[0], (list, tuple))
        return (
            line if len(line) < _WIDE and not rows else "[\n    " + ",\n    ".join(texts) + ",\n]"
        )
    raise ValueError(
        f"a robot file must hold numbers, text and flags; got a {type(value).__name__}. Leave it"
        " out."
    )
