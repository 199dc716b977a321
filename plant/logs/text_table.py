"""Columns of a text table of any `Dialect`, such as loggers, drives and spreadsheets export."""

import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from plant.logs.clock_times import ClockTimes
from plant.logs.dialect import MISSING, dialect_of
from plant.logs.unit_words import without_unit
from plant.parts import LIMITS, Rows, lines_of, require_bounded


def read_text(
    path: str | Path, wanted: Collection[str] | None, prefix: str, numbers_only: bool = False
) -> tuple[list[str], dict[str, NDArray[Any]], dict[str, str]]:
    """Names of all columns, the wanted ones (without names all that start with the prefix), and
    the units that the file states of them.

    Only wanted columns are parsed, so that others may hold text.
    """
    # Check the size before the first line: 8 bytes of text per number, as many as in memory.
    require_bounded(path, 8 * LIMITS.numbers)
    dialect = dialect_of(path)
    names = list(dialect.names)
    # What a column is called by the caller -> its name in the file.
    called = (
        {
            name: name
            for name in (dialect.numeric if numbers_only else names)
            if name.startswith(prefix)
        }
        if wanted is None
        else {name: home for name in wanted if (home := home_of(name, names)) is not None}
    )
    # Two names of a caller may mean one column, which is parsed once.
    homes = set(called.values())
    places = [i for i, name in enumerate(names) if name in homes]
    read = [names[i] for i in places]
    if len(homes) < len(read):
        twice = Counter(read).most_common(1)[0][0]
        raise ValueError(f"has column {twice!r} twice; each may come once. Rename one.")
    rows = Rows(
        names,
        len(names),
        places,
        missing=MISSING,
        decimal_comma=dialect.decimal_comma,
        clock=ClockTimes(),
        surplus="Correct it, or name each column in the heading.",
        broken="Correct it, leave the cell empty, or leave out that column.",
    )
    with open(path, encoding=dialect.encoding) as file:
        for number, text in enumerate(lines_of(file), 1):
            # A tab at either end is an empty cell, so only blanks and line ends go.
            line = text.strip(" \r\n")
            if line and number > dialect.skip and line[0] not in "#%":
                rows.append(number, text, dialect.cells(line))
    columns = dict(zip(read, rows.numbers().T, strict=True))
    units = {name: dialect.units[home] for name, home in called.items() if home in dialect.units}
    return names, {name: columns[home] for name, home in called.items()}, units


def home_of(wanted: str, names: Collection[str]) -> str | None:
    """The column that a caller means: by its name, without its unit, or as ``q.1`` for ``q[1]``."""
    if wanted in names:
        return wanted
    spelt = re.sub(r"\.(\d{1,9})$", r"[\1]", wanted)
    matches = [name for name in names if without_unit(name)[0] in (wanted, spelt)]
    return matches[0] if len(matches) == 1 else None
