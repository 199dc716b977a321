"""Files of parts and results: JSON with kind, format, versions and provenance, without loss.

``{"onepulse": version, "format": 1, "kind": ..., "provenance": {...}, "content": {...}}``. Nothing
in a file is executed, and it names no module to import.
"""

import hashlib
import json
import math
import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import casadi as ca
import numpy as np

from plant.parts.arguments import choice
from plant.parts.files import path_of, read_bounded, require_new, write_whole
from plant.parts.kinds import class_of, kind_of
from plant.parts.plain import from_plain, to_plain
from plant.version import __version__

FORMAT = 1  # of the files that this version writes, and the only one that it reads

MOST = 1 << 30  # bytes of a file that is read

_KEYS = ("onepulse", "format", "kind", "provenance", "content")


def versions() -> dict[str, str]:
    """Versions of the libraries that compute results."""
    return {
        "onepulse": __version__,
        "numpy": np.__version__,
        "casadi": ca.__version__,
        "numba": version("numba"),
        "python": platform.python_version(),
    }


def fingerprint(value: Any) -> str:
    """SHA-256 of a part, a record or a setting; a class of the user counts with its source text."""
    text = json.dumps(to_plain(value, compared=True), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class Saved:
    """Base of what can be saved to a file and loaded from it."""

    def save(self, path: str | Path, *, overwrite: bool = True) -> None:
        """Write a JSON file that `load` reads back without loss of a bit.

        After an error the previous file is unchanged. A part of the user's own class is refused,
        since the file cannot hold its equations; so is a file that is there, without `overwrite`.
        """
        require_new(path, overwrite)
        try:
            content = to_plain(self)
        except ValueError as error:
            raise ValueError(f"{type(self).__name__} cannot be saved: {error}") from None
        # The head comes first in the file, so that a person reads it without the content.
        provenance = {"versions": versions()} | self.provenance()
        head = {
            "onepulse": __version__,
            "format": FORMAT,
            "kind": kind_of(type(self)),
            "provenance": provenance,
        }
        # The whole text is made before the file is opened, so errors leave the previous file.
        write_whole(path, (*written(head | {"content": content}), "\n"))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`; a base class (``Law.load``) reads every class derived from it.

        A missing or spoilt file, or one of another kind or format, is refused by its name.
        """
        path_of("path", path)
        try:
            return _read(cls, path)
        except FileNotFoundError:
            raise ValueError(f"{path} must be a file; there is none. Check the path.") from None
        except (
            OSError,
            ValueError,
            TypeError,
            AttributeError,
            LookupError,
            ArithmeticError,
            RecursionError,
        ) as error:
            message = " ".join(str(error).split())
            if not isinstance(error, ValueError):
                message = f"cannot be read: {message:.200}"
            raise ValueError(f"{path} {message}") from None

    def provenance(self) -> dict[str, Any]:
        """Origin of the content that the file records beside the versions of the libraries."""
        return {}

    def _restored(self, provenance: dict[str, Any]) -> None:
        """Take over from a file what takes long to compute again; by default nothing."""


def _read(cls: Any, path: str | Path) -> Any:
    data = parsed(read_bounded(path, MOST))
    if not isinstance(data, dict) or "onepulse" not in data:
        raise ValueError(
            "must be a file of this library; it has no key 'onepulse'. Give what save() wrote."
        )
    # True == 1 in Python, so a boolean has to be refused separately.
    if data.get("format") != FORMAT or isinstance(data["format"], bool):
        # A newer file needs a newer version; an older one has to be made again.
        newer = isinstance(data.get("format"), int) and data["format"] > FORMAT
        advice = (
            f"Use version {data['onepulse']!r:.20} or later"
            if newer
            else "Save it again with this version"
        )
        raise ValueError(f"must be of format {FORMAT}; got {data.get('format')!r:.40}. {advice}.")
    for key in data:
        choice("a key", key, _KEYS)
    # All keys are required; the first missing one is enough for a message.
    missing = [key for key in _KEYS if key not in data]
    if missing:
        raise ValueError(f"must have the key {missing[0]!r}; it has not. Save it again.")
    # By the name of its kind alone: a file never names code to be run.
    cls_of_file = class_of(data["kind"])
    # A class may list in `_read_by` unrelated classes whose `load` reads its files, too.
    if not issubclass(cls_of_file, cls) and cls not in getattr(cls_of_file, "_read_by", ()):
        raise ValueError(
            f"must hold a {cls.__name__}; it holds a {data['kind']!r:.60}. Use"
            f" {cls_of_file.__name__}.load."
        )
    content = data["content"]
    # Two places state the kind; a file that was put together by hand may differ in them.
    if not isinstance(content, dict) or content.get("kind") != data["kind"]:
        raise ValueError(
            f"must hold what its head says, a {data['kind']:.60}; it does not. Save it again."
        )
    result = from_plain(content)
    provenance = data["provenance"] if isinstance(data["provenance"], dict) else {}
    # Compare the provenance of the content with the stored one: it differs after an edit by hand.
    result._restored(provenance)
    expected = result.provenance()
    differs = [key for key in expected if provenance.get(key) != expected[key]]
    if differs:
        raise ValueError(
            f"must have the {differs[0]} that its head says; it has been changed. Save it again."
        )
    return result


_SPECIAL = ("inf", "-inf", "nan", "-nan")


def written(data: Any, indent: str = "") -> Iterator[str]:
    """The text of plain data, in pieces."""
    deeper = indent + " "
    if isinstance(data, dict) and data:
        for i, (key, value) in enumerate(data.items()):
            yield f"{',' if i else '{'}\n{deeper}{json.dumps(key)}: "
            yield from written(value, deeper)
        yield f"\n{indent}}}"
    # Lists of numbers stay on one line; nested ones are indented, so that a file can be compared
    # line by line.
    elif isinstance(data, list) and any(isinstance(item, (list, dict)) for item in data):
        for i, value in enumerate(data):
            yield f"{',' if i else '['}\n{deeper}"
            yield from written(value, deeper)
        yield f"\n{indent}]"
    elif isinstance(data, list):
        try:
            # The fast way first; only a list with NaN or infinity is written number by number.
            yield json.dumps(data, allow_nan=False)
        except ValueError:
            yield f"[{', '.join(map(_scalar, data))}]"
    else:
        yield _scalar(data)


def _scalar(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        # JSON has no infinity and no NaN; they become an object with their text. The sign of NaN is
        # one of the bits.
        sign = "-" if math.copysign(1.0, value) < 0 else ""
        return json.dumps({"float": f"{sign}{'nan' if math.isnan(value) else 'inf'}"})
    return json.dumps(value)


def parsed(data: bytes) -> Any:
    """Plain data of a JSON text; errors (no JSON, a key twice, too deep) do not name the path."""
    try:
        return json.loads(data.decode("utf-8"), object_pairs_hook=_object, parse_constant=_refused)
    except RecursionError:
        raise ValueError("must be JSON; it is nested too deep. Save it again.") from None
    except json.JSONDecodeError as error:
        # The commonest wrong file is a log: its first line tells which.
        begins = error.doc[:20]
        # An error at the very end of the text means that writing was interrupted.
        cut = error.pos >= len(error.doc.rstrip())
        if error.doc.strip() and not begins.startswith("{"):
            why = (
                f"it begins with {begins!r}. Give what a command or save() wrote; a log is to be"
                " identified first"
            )
            raise ValueError(f"must be JSON; {why}.") from None
        raise ValueError(
            f"must be JSON; {'it ends too early' if cut else error.msg} at line {error.lineno}."
            " Save it again."
        ) from None
    except UnicodeDecodeError:
        raise ValueError("must be JSON in UTF-8; it is not. Save it again.") from None


def _object(pairs: list[tuple[str, Any]]) -> Any:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        # Python would silently take the last of two values.
        twice = next(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        raise ValueError(f"must have each key once; {twice!r:.40} comes twice. Save it again.")
    if set(entries) == {"float"}:
        # Only what JSON lacks may be written so, as each number has one form in a file.
        if entries["float"] not in _SPECIAL:
            raise ValueError(f"must have numbers; got {entries['float']!r:.40}. Save it again.")
        return float(entries["float"])
    return entries


def _refused(constant: str) -> Any:
    raise ValueError(f"must be JSON, which has no {constant}. Save it again.")
