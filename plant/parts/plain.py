"""Parts and results as plain data, and back: dictionaries, lists, numbers and text of JSON.

A part or a result is ``{"kind": "plant.Rig", field: ...}``; a tuple is a bare list. Arrays,
numbers of numpy, lists and dictionaries have tags: ``{"array": [...], "dtype": ..., "shape":
...}``, ``{"scalar": ..., "dtype": ...}``, ``{"list": [...]}`` and ``{"dict": [[key, value],
...]}``. An array or a number of numpy that is a field of a part has no tag, since the constructor
of the part makes arrays. No bit of a number is lost.
"""

import inspect
import math
from typing import Any

import numpy as np

from plant.parts.arguments import choice
from plant.parts.kinds import (
    PACKAGES,
    PARTS,
    class_of,
    field_names,
    kind_of,
    require_public,
    require_untagged,
    source_of,
)

_TYPES = ("bool", "uint8", "int32", "int64", "float32", "float64")
_TAGS = ("array", "scalar", "list", "dict")

# Types of the keys of a dictionary: of others, such as tuples, reading makes no keys.
_KEYS = (str, int, float)


def to_plain(value: Any, *, compared: bool = False) -> Any:
    """A part, a result or a value of a field as plain data; other types are refused.

    `compared`: for a comparison only, not for a file. Fields with ``compare=False`` are left out,
    and a part of a user's own class also holds the source text of that class.
    """
    cls = type(value)
    if value is None or cls in (bool, int, float, str):
        return value
    # Only types whose numbers JSON stores without loss.
    if isinstance(value, np.ndarray):
        if not compared:
            # An array that lies on a disk has the same numbers; a masked array would lose its mask.
            choice("class of an array in a file", cls.__name__, ("ndarray", "memmap"))
        choice("dtype of an array in a file", value.dtype.name, _TYPES)
        return {"array": value.tolist(), "dtype": value.dtype.name, "shape": list(value.shape)}
    if isinstance(value, np.generic):
        choice("type of a number in a file", value.dtype.name, _TYPES)
        return {"scalar": value.item(), "dtype": value.dtype.name}
    # Only registered classes have names of fields here. Below, tuples, lists and dictionaries are
    # described, and any other object is refused.
    names = field_names(cls, compared=compared)
    if names is not None:
        described: dict[str, Any] = {"kind": kind_of(cls)}
        # A file must be readable without the user's code, but a comparison must notice a change of
        # that code.
        if not compared:
            require_public(cls)
            require_untagged(cls)
        elif described["kind"].split(".")[0] not in PACKAGES:
            described["source"] = source_of(cls)
        is_part = PARTS.get(described["kind"]) is cls
        return described | {name: _field(getattr(value, name), is_part, compared) for name in names}
    # A bare list stands for a tuple; a list has a tag, so that both are restored as they were.
    if cls is tuple:
        return [to_plain(item, compared=compared) for item in value]
    if cls is list:
        return {"list": [to_plain(item, compared=compared) for item in value]}
    if isinstance(value, dict):
        # A comparison reads nothing back.
        if not compared:
            _require_readable(value)
        # Pairs, since the keys of a JSON object can only be text.
        pairs = [
            [to_plain(key, compared=compared), to_plain(item, compared=compared)]
            for key, item in value.items()
        ]
        return {"dict": pairs}
    require_public(cls)
    raise ValueError(f"a file cannot hold a {cls.__name__}; got {value!r:.60}. Leave it out.")


def _require_readable(value: dict[Any, Any]) -> None:
    """Refuse a dictionary that would come back as another one, or not at all."""
    # A derived class has more than its pairs, such as the default of a defaultdict.
    choice("class of a dictionary in a file", type(value).__name__, ("dict",))
    wrong = [key for key in value if not isinstance(key, _KEYS)]
    if wrong:
        raise ValueError(
            f"keys of a dictionary in a file must be text or numbers; got {wrong[0]!r:.60}. Make"
            " it text, such as str(key)."
        )


def _field(value: Any, is_part: bool, compared: bool) -> Any:
    # The constructor of a part turns lists into arrays, so arrays need no tag here: files stay
    # short and readable.
    if is_part and isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return to_plain(value, compared=compared)


def from_plain(data: Any) -> Any:
    """The value that `to_plain` described; unknown kinds and fields that do not fit are refused."""
    if isinstance(data, list):
        return tuple(from_plain(item) for item in data)
    if not isinstance(data, dict):
        return data
    # An object without any tag is taken for a kind, so that the error asks for the kind.
    if "kind" in data or not any(tag in data for tag in _TAGS):
        fields = {name: from_plain(item) for name, item in data.items() if name != "kind"}
        return _built(class_of(data.get("kind")), fields)
    # The exact set of keys is required: a surplus key means a damaged file.
    if set(data) == {"list"} and isinstance(data["list"], list):
        return [from_plain(item) for item in data["list"]]
    if set(data) == {"dict"} and isinstance(data["dict"], list):
        pairs = [from_plain(pair) for pair in data["dict"]]
        if all(
            isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[0], _KEYS)
            for pair in pairs
        ):
            return dict(pairs)
    if set(data) == {"scalar", "dtype"}:
        return _array([data["scalar"]], data["dtype"], [1])[0]
    if set(data) == {"array", "dtype", "shape"}:
        return _array(data["array"], data["dtype"], data["shape"])
    raise ValueError(
        f"an object must be a kind, array, list or dict; got the keys {sorted(data)!r:.80}."
        " Correct it."
    )


def _built(cls: type, values: dict[str, Any]) -> Any:
    if PARTS.get(kind_of(cls)) is cls:
        return cls(**values)  # a part checks its own options
    # Results have no checks of their own: verify the names of their fields here.
    names = field_names(cls) or []
    for name in values:
        choice(f"a field of {cls.__name__}", name, names)
    # Files of earlier versions lack newer fields; those have defaults.
    missing = [name for name in names if name not in values and not _has_default(cls, name)]
    if missing:
        raise ValueError(
            f"{cls.__name__} must have the field {missing[0]!r}; it is not there. Save it again."
        )
    return cls(**values)


def _has_default(cls: type, name: str) -> bool:
    """Whether a result has a default for a field that files of earlier versions lack."""
    # The constructor knows all defaults: values, factories, and those of a named tuple.
    return inspect.signature(cls).parameters[name].default is not inspect.Parameter.empty


def _array(rows: Any, dtype: Any, shape: Any) -> Any:
    choice("dtype of an array", dtype, _TYPES)
    # Read the numbers flat and apply the stored shape: empty arrays have a shape that nested lists
    # cannot show.
    flat = list(_leaves(rows))
    if (
        not isinstance(shape, list)
        or not all(type(n) is int and n >= 0 for n in shape)
        or math.prod(shape) != len(flat)
    ):
        raise ValueError(
            f"an array must have as many numbers as its shape says; got {len(flat)} of"
            f" {shape!r:.40}."
        )
    # numpy would convert texts and booleans to numbers silently.
    wrong = [x for x in flat if type(x) not in ((bool,) if dtype == "bool" else (int, float))]
    if wrong:
        raise ValueError(
            f"an array of {dtype} must hold numbers; got {wrong[0]!r:.40}. Correct it."
        )
    try:
        # numpy makes infinity of a number that is too large for float32, with a warning alone.
        with np.errstate(over="raise"):
            values = np.array(flat, dtype=dtype)
    except (ArithmeticError, ValueError):
        raise ValueError(
            f"an array of {dtype} must hold numbers within its range; it does not. Correct it."
        ) from None
    # numpy truncates 1.5 to an integer silently.
    if dtype not in ("float32", "float64") and values.tolist() != flat:
        raise ValueError(f"an array of {dtype} must hold whole numbers; it does not. Correct it.")
    values = values.reshape(shape)
    # Arrays of results are frozen, also when they come from a file.
    values.setflags(write=False)
    return values


def _leaves(rows: Any) -> Any:
    for row in rows if isinstance(rows, list) else [rows]:
        if isinstance(row, list):
            yield from _leaves(row)
        else:
            yield row
