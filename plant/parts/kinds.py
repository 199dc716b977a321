"""Registry of the classes that files may hold: parts and marked results, by package and name.

A description names a kind, ``plant.Rig``. It is looked up here among the classes that have been
defined, so that no file decides what is imported or called.
"""

import dataclasses
import difflib
import functools
import inspect
import re
from typing import Any, TypeVar

_HEAD = re.compile(r"^    (\w+(?:, \w+)*) : .*$")

C = TypeVar("C", bound=type)

PACKAGES = ("plant", "identification", "ctc")

PARTS: dict[str, type] = {}  # kind -> class of every `part`

_RESULTS: dict[str, type] = {}


def kind_of(cls: type) -> str:
    """Package and name of a class: ``plant.Rig``."""
    return f"{cls.__module__.split('.')[0]}.{cls.__name__}"


def kept(cls: C) -> C:
    """Class decorator: a result of named fields (dataclass, named tuple) that files may hold."""
    require_untagged(cls)
    _RESULTS[kind_of(cls)] = cls
    return cls


def require_untagged(cls: type) -> None:
    """Refuse a class with a field `kind`: a description names the class itself by this key."""
    if "kind" in _names(cls):
        raise ValueError(
            f"{cls.__name__} in a file must have no field 'kind', by which a file names the class;"
            " it has one. Rename it."
        )


def field_names(cls: type, *, compared: bool = False) -> list[str] | None:
    """Names of the fields of a part or a marked result; None of another class.

    With `compared` only those that count in a comparison.
    """
    # A class of the same name that is not the registered one must not pass.
    if cls not in (PARTS.get(kind_of(cls)), _RESULTS.get(kind_of(cls))):
        return None
    return _names(cls, compared=compared)


def _names(cls: type, *, compared: bool = False) -> list[str]:
    if not dataclasses.is_dataclass(cls):
        return list(cls._fields)  # type: ignore[attr-defined]  # a named tuple
    return [field.name for field in dataclasses.fields(cls) if field.compare or not compared]


def class_of(kind: Any) -> type:
    """The class of a kind; the refusal of an unknown one says which package to import."""
    classes = {**PARTS, **_RESULTS}
    if isinstance(kind, str) and kind in classes:
        return classes[kind]
    # A kind of an existing package is unknown only because that package is not imported yet.
    package = str(kind).split(".")[0]
    hint = f"import {package} first" if package in PACKAGES else "check the file"
    # cutoff=0: show the three most similar kinds, however different they are.
    near = difflib.get_close_matches(str(kind), classes, n=3, cutoff=0.0)
    raise ValueError(
        f"kind must be a known one, such as {', '.join(near)}; got {kind!r:.60}. Please {hint}."
    )


def require_public(cls: type) -> None:
    """Refuse a class of the user's own: a file would hold its numbers, not its equations."""
    if kind_of(cls).split(".")[0] not in PACKAGES:
        raise ValueError(
            f"a file can hold parts of the library; {cls.__name__} is a class of {cls.__module__},"
            " whose equations no file keeps. Keep its numbers (describe()) beside its code."
        )


def source_of(cls: type) -> str:
    """The text of a class of the user's own; one that was typed in has none, and is refused."""
    try:
        return inspect.getsource(cls)
    except (OSError, TypeError):
        raise ValueError(
            f"{cls.__name__} must be written in a file, so that a checkpoint can tell whether it"
            " has changed; its text is not there. Move it to a module."
        ) from None


@functools.cache
def meanings(cls: type) -> dict[str, str]:
    """Field -> its description, in one line; that of a class itself before those of its bases."""
    descriptions: dict[str, str] = {}
    names: list[str] = []
    # Bases come first, so that the text of the class itself replaces theirs.
    for line in "\n".join(base.__doc__ or "" for base in reversed(cls.__mro__)).splitlines():
        if head := _HEAD.match(line):
            names = head[1].split(", ")
            descriptions |= dict.fromkeys(names, "")
        elif line.startswith("        ") and names:
            descriptions |= {name: f"{descriptions[name]} {line.strip()}".strip() for name in names}
        # Any other line ends the description of these fields.
        elif line.strip():
            names = []
    return descriptions
