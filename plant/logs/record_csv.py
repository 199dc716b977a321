"""Records as lossless CSV files, and plain CSV files of t [s], reference and error [pulses]."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.laws.law import Law
from plant.machine.rig import Rig
from plant.motion.reference import Reference
from plant.parts.csv_rows import read_rows
from plant.parts.fields import Floats
from plant.parts.plain import from_plain

# How a file of `write` begins.
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
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"# {json.dumps(header)}\n{','.join(names)}\n")
        for row in np.hstack(columns):
            # 17 digits restore each float64 exactly.
            file.write(",".join(f"{x:.17g}" for x in row) + "\n")


def is_own(path: str | Path) -> bool:
    """Whether `path` is a file that begins as `write` begins its files."""
    if not Path(path).is_file():
        return False
    with open(path, "rb") as file:
        return file.read(len(_BEGIN)) == _BEGIN


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
    names, table = read_rows(
        path, comment=lambda count, line: header.update(header or _header(count, line))
    )
    _require_finite(path, names, table)
    # Arguments take precedence over the header.
    rig = rig or _part(header, "rig")
    if rig is None:
        raise ValueError("does not name its rig; a plain file needs one. Pass rig= and law=.")
    if not isinstance(rig, Rig):
        raise ValueError(
            f"cannot be read: rig of a record must be a Rig; got {rig!r:.60}. Pass rig=."
        )
    # Names of this format have a unit in brackets; a plain file may use any names without [.
    named = names is not None and any("[" in name for name in names)
    return {
        "t": table[:, 0],
        **(_named(names or [], table, rig.n) if named else _plain(table, rig)),
        "rig": rig,
        "law": law or _part(header, "law"),
        "reference": reference or _part(header, "reference"),
        "initial": header.get("initial") if initial is None else initial,
        "notes": header.get("notes"),
    }


def _require_finite(path: str | Path, names: list[str] | None, table: Floats) -> None:
    """Refuse the first cell that is not finite and name its line; link columns are exempt."""
    links = [name.startswith(COLUMNS["link_counts"][0]) for name in names or [""] * table.shape[1]]
    broken = np.argwhere(~np.isfinite(table) & ~np.array(links))
    if not len(broken):
        return
    row, column = broken[0]
    with open(path, encoding="utf-8-sig") as file:
        # Count the lines of the file again, since rows skip comments and empty lines.
        lines = [
            count
            for count, line in enumerate(file, 1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
    got = f"got {table[row, column]:g} in column {repr(names[column]) if names else column + 1}"
    advice = (
        "Cut such rows out, or put a number there and mark the row invalid, 0 in a column 'valid"
        " [1]'"
    )
    raise ValueError(
        f"line {lines[row + (names is not None)]} must have finite numbers; {got}. {advice}."
    )


def _plain(table: Floats, rig: Rig) -> dict[str, Floats]:
    n = rig.n
    if table.shape[1] != 1 + 2 * n:
        got = f"got {table.shape[1]} columns"
        advice = "Leave out others, or name them with columns=."
        raise ValueError(f"must hold t, {n} reference and {n} error columns; {got}. {advice}")
    # A fraction shows that angles were written in place of counts.
    broken = np.argwhere(np.abs(table[:, 1:] - np.trunc(table[:, 1:])) > 0)
    if len(broken) and not rig.encoder.smooth:
        # The test left out column 0, the time, so the index of the column grows by one.
        row, column = broken[0] + (0, 1)
        value = f"got {table[row, column]:g} in row {row}, column {column + 1}"
        raise ValueError(
            f"must hold whole pulses; {value}. Turn angles into counts with rig.counts(q)."
        )
    return {"reference_pulses": table[:, 1 : 1 + n], "error_pulses": table[:, 1 + n :]}


def _named(names: list[str], table: Floats, n: int) -> dict[str, Floats]:
    places = {
        f"{name}_{i + 1} [{unit}]": (field, i)
        for field, (name, unit) in COLUMNS.items()
        for i in range(n)
    }
    places["valid [1]"] = "valid", 0
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
