"""Records as lossless CSV files, and plain CSV files of t [s], reference and error [pulses]."""

import codecs
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.laws import Law
from plant.machine import Rig
from plant.motion import Reference
from plant.parts import Floats, from_plain, path_of, read_rows, require_new, require_untagged

# How a file of `write` begins, perhaps behind the mark of UTF-8 of the program that saved it last.
_BEGIN = b'# {"onepulse":'
# Each field of a record with one column per joint -> the name and the unit of its columns.
COLUMNS = {
    "reference_pulses": ("reference", "pulses"),
    "error_pulses": ("error", "pulses"),
    "torque": ("torque", "N m"),
    "current": ("current", "A"),
    "injected": ("injected", "N m"),
    "link_counts": ("link", "pulses"),
    "true_q": ("true_q", "rad"),
    "true_qd": ("true_qd", "rad/s"),
}


def write(record: Any, path: str | Path) -> None:
    """Write a record. Line 1 is ``#`` and a JSON object, line 2 names columns and units."""
    parts = {name: getattr(record, name) for name in ("rig", "law", "reference")}
    for stated in parts.values():
        if stated is not None:
            require_untagged(type(stated))
    # "onepulse" holds the version of the format, which tells this format from later ones.
    header = {
        "onepulse": 1,
        **{name: None if part is None else part.describe() for name, part in parts.items()},
    }
    header["initial"] = None if record.initial is None else record.initial.tolist()
    header["notes"] = dict(record.notes)
    names = ["t [s]"]
    # Columns follow the order of `COLUMNS`; fields that the record lacks have none.
    columns = [record.t[:, None]]
    for field, (name, unit) in COLUMNS.items():
        value = getattr(record, field)
        if value is not None:
            names += [f"{name}_{i + 1} [{unit}]" for i in range(record.n)]
            columns.append(value)
    # The column of weights is left out if all weights are 1, the default.
    if (record.valid != 1).any():
        names.append("valid [1]")
        columns.append(record.valid[:, None])
    # Before the file is opened, which empties it: what fails here leaves the old file as it is.
    heading = f"# {json.dumps(header)}\n{','.join(names)}\n"
    rows = np.hstack(columns)
    with open(require_new(path, overwrite=True), "w", encoding="utf-8") as file:
        file.write(heading)
        for row in rows:
            # 17 digits restore each float64 exactly.
            file.write(",".join(f"{x:.17g}" for x in row) + "\n")


def is_own(path: str | Path) -> bool:
    """Whether `path` is a file that begins as `write` begins its files."""
    if not path_of("path", path).is_file():
        return False
    with open(path, "rb") as file:
        begin = file.read(len(codecs.BOM_UTF8) + len(_BEGIN))
    return begin.removeprefix(codecs.BOM_UTF8).startswith(_BEGIN)


def read(
    path: str | Path,
    *,
    rig: Rig | None,
    law: Law | None,
    reference: Reference | None,
    initial: ArrayLike | None,
) -> dict[str, Any]:
    """Read what `write` wrote, or a plain file, as the fields of a record."""
    header: dict[str, Any] = {}

    def take(count: int, line: str) -> None:
        """Keep the header of `write`, or else the first comment that is an object of JSON."""
        if "onepulse" in header:
            return
        entries = _header(count, line)
        if not header or "onepulse" in entries:
            header.clear()
            header.update(entries)

    names, table = read_rows(path, comment=take)
    # Names of this format have a unit in brackets; a plain file may use any names without [.
    named = names is not None and any("[" in name for name in names)
    _require_finite(path, names, table, named)
    # Arguments take precedence over the header.
    rig = rig or _part(header, "rig")
    if rig is None:
        raise ValueError("does not name its rig; a plain file needs one. Pass rig= and law=.")
    if not isinstance(rig, Rig):
        raise ValueError(
            f"cannot be read: rig of a record must be a Rig; got {rig!r:.60}. Pass rig=."
        )
    return {
        "t": table[:, 0],
        **(_named(names or [], table, rig.n) if named else _plain(path, names, table, rig)),
        "rig": rig,
        "law": law or _part(header, "law"),
        "reference": reference or _part(header, "reference"),
        "initial": header.get("initial") if initial is None else initial,
        "notes": header.get("notes"),
    }


def _require_finite(path: str | Path, names: list[str] | None, table: Floats, named: bool) -> None:
    """Refuse the first cell that is not finite and name its line; link columns are exempt."""
    name, unit = COLUMNS["link_counts"]
    links = [
        named and text.startswith(f"{name}_") and text.endswith(f"[{unit}]")
        for text in names or [""] * table.shape[1]
    ]
    broken = np.argwhere(~np.isfinite(table) & ~np.array(links))
    if not len(broken):
        return
    line, got = _place(path, names, table, *broken[0])
    # Only named columns can have weights beside them.
    advice = (
        "put a number there and mark the row invalid, 0 in a column 'valid [1]'"
        if named
        else "name the columns and map them with columns=, which gives such rows no weight"
    )
    raise ValueError(f"{line} must have finite numbers; {got}. Cut such rows out, or {advice}.")


def _place(
    path: str | Path, names: list[str] | None, table: Floats, row: int, column: int
) -> tuple[str, str]:
    """The line of a cell in the file, and what came in which column, for messages."""
    with open(path, encoding="utf-8-sig") as file:
        # Count the lines of the file again, since rows skip comments and empty lines.
        lines = [
            count
            for count, line in enumerate(file, 1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
    label = repr(names[column]) if names else column + 1
    got = f"got {table[row, column]:g} in column {label}"
    return f"line {lines[row + (names is not None)]}", got


def _plain(path: str | Path, names: list[str] | None, table: Floats, rig: Rig) -> dict[str, Floats]:
    n = rig.n
    if table.shape[1] != 1 + 2 * n:
        got = f"got {table.shape[1]} columns"
        advice = "Leave out others, or name them with columns=."
        raise ValueError(f"must hold t, {n} reference and {n} error columns; {got}. {advice}")
    # A fraction shows that angles were written in place of counts.
    broken = np.argwhere(np.abs(table[:, 1:] - np.trunc(table[:, 1:])) > 0)
    if len(broken) and not rig.encoder.smooth:
        # The test left out column 0, the time, so the index of the column grows by one.
        line, got = _place(path, names, table, *(broken[0] + (0, 1)))
        raise ValueError(
            f"{line} must hold whole pulses; {got}. Turn angles into counts with rig.counts(q)."
        )
    return {"reference_pulses": table[:, 1 : 1 + n], "error_pulses": table[:, 1 + n :]}


def _named(names: list[str], table: Floats, n: int) -> dict[str, Floats]:
    places = {
        f"{name}_{i + 1} [{unit}]": (field, i)
        for field, (name, unit) in COLUMNS.items()
        for i in range(n)
    }
    places["valid [1]"] = "valid", 0
    # Time in another unit, or another signal, must not be read as seconds; a name without a unit
    # states none.
    if names[0] not in ("t [s]", "t"):
        advice = "Write seconds there, or map the columns with columns= and units=."
        raise ValueError(f"must have time as column 1, 't [s]'; got {names[0]!r:.40}. {advice}")
    fields: dict[str, Floats] = {}
    for column, name in enumerate(names[1:], 1):
        if name not in places:
            raise ValueError(
                f"has an unknown column {name!r:.40}; known are {', '.join(places)}. Rename it."
            )
        # If a name came twice, the later column would silently replace the earlier one.
        if name in names[1:column]:
            raise ValueError(f"has column {name!r} twice; each may come once. Drop one.")
        field, joint = places[name]
        if field == "valid":
            fields[field] = table[:, column]
        else:
            # A joint whose column is missing keeps NaN, which `Record` refuses or accepts by field.
            fields.setdefault(field, np.full((len(table), n), np.nan))[:, joint] = table[:, column]
    if "error_pulses" not in fields:
        raise ValueError(
            f"must hold columns error_1 [pulses] to error_{n} [pulses]; got none. Add them."
        )
    return fields


def _header(count: int, line: str) -> dict[str, Any]:
    try:
        # Every comment starts with #; only a comment that is a JSON object is a header.
        header = json.loads(line[1:])
    except (ValueError, RecursionError):
        return {}  # a comment
    if isinstance(header, dict) and header.get("onepulse", 1) != 1:
        raise ValueError(
            f"line {count} must be version 1; got {header['onepulse']!r}. Use a newer library."
        )
    return header if isinstance(header, dict) else {}


def _part(header: Mapping[str, Any], name: str) -> Any:
    try:
        # A header may be nested deeper than Python's recursion limit.
        return from_plain(header.get(name))
    except RecursionError:
        raise ValueError(
            f"must describe its {name} as to_csv does; it is nested too deep. Correct it."
        ) from None
