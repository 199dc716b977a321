"""TOML text of nested tables; `tomllib` reads it back to the same bits."""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_WIDE = 110
"""Characters above which the entries of a list get lines of their own."""


def toml_lines(
    table: Mapping[str, Any], path: tuple[str, ...] = (), comment: Callable[..., str] = lambda *_: ""
) -> Iterator[str]:
    """Lines of a table: plain values first, then the tables and lists of tables within it; `path` leads to the table.

    ``comment(path, key)`` is what stands behind a value. What TOML cannot hold is refused.
    """
    nested = {key: value for key, value in table.items() if _is_table(value) and not (path and _is_short(value))}
    for key, value in table.items():
        if key not in nested:
            text = comment(path, key)
            yield f"{_key(key)} = {_value(value)}{f'  # {text}' if text else ''}"
    for key, value in nested.items():
        name, several = (*path, key), isinstance(value, (list, tuple))
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
    plain = isinstance(value, Mapping) and not any(isinstance(each, (Mapping, list, tuple)) for each in value.values())
    return plain and len(_value(value)) < _WIDE


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isnan(value):
            raise ValueError("a robot file must hold numbers; got NaN. Give its value.")
        return repr(value)
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        texts = [_value(each) for each in value]
        line = f"[{', '.join(texts)}]"
        rows = bool(value) and isinstance(value[0], (list, tuple))
        return line if len(line) < _WIDE and not rows else "[\n    " + ",\n    ".join(texts) + ",\n]"
    raise ValueError(f"a robot file must hold numbers, text and flags; got a {type(value).__name__}. Leave it out.")
