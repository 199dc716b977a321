"""Rows of a CSV file as numbers, read line by line; errors name the line."""

import array as packed
import csv
import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from plant.parts.arguments import decimal
from plant.parts.fields import Floats
from plant.parts.files import require_bounded


@dataclasses.dataclass(frozen=True, kw_only=True)
class TextLimits:
    """Largest text file that is read; a hostile or mistaken file must not fill the memory.

    Parameters
    ----------
    line : int
        Characters of a line, for files without line ends; chosen by hand.
    numbers : int
        Numbers of a file: 256 MiB, and at most as many bytes of text; chosen by hand.
    seconds : int
        Time for reading [s]; chosen by hand.
    """

    line: int = 1 << 20
    numbers: int = 1 << 25
    seconds: int = 60


LIMITS = TextLimits()


def read_rows(
    path: str | Path,
    *,
    comment: Callable[[int, str], Any] | None = None,
    chosen: Callable[[str], bool] | None = None,
) -> tuple[list[str] | None, Floats]:
    """Names in the heading of a CSV file, or None, and its numbers (N, columns).

    Errors name the line, but not the path.

    `comment` is called with the number and the text of every line that starts with #. For a foreign
    log `chosen` says whether the column of a name is read: the other cells may be anything, cells
    may be empty (NaN), and may be separated by semicolons or tabs, as in the heading.
    """
    names: list[str] | None = None
    picked: list[int] = []
    width: int | None = None
    table = chosen is not None
    separator = ","
    values = packed.array("d")
    rows = 0
    least = 0
    # Check the size before the first line: 8 bytes of text per number, as many as in memory.
    require_bounded(path, 8 * LIMITS.numbers)
    deadline = time.monotonic() + LIMITS.seconds
    with open(path, encoding="utf-8-sig") as file:
        for count, line in enumerate(_lines(file), 1):
            ended = line.endswith("\n")
            # In a foreign log a leading tab is an empty first cell, so tabs stay.
            line = line.strip() if not table else line.strip(" \r\n")
            if not line:
                continue
            # Comments of our files carry settings of the log, which `comment` reads.
            if line.startswith("#"):
                if comment is not None:
                    comment(count, line)
                continue
            if table and width is None:
                # The first line of a foreign log decides: the separator that occurs most often in
                # it.
                separator = max(",;\t", key=line.count)
            cells = (
                # A plain split is enough, unless a quoted cell may hold the separator.
                next(csv.reader([line], delimiter=separator))
                if '"' in line
                else line.split(separator)
            )
            if width is None:
                width = len(cells)
                names, picked = _heading(cells, chosen)
                if names is not None:
                    continue
            if len(cells) != width:
                # Surplus cells usually come from decimal commas, missing ones from a line cut off.
                advice = (
                    "Complete it."
                    if len(cells) < width
                    else "Correct it; decimals are written with a point."
                )
                advice = advice if rows or table else "Correct it, or give a log: rows of numbers."
                raise ValueError(
                    f"line {count} must have {width} cells; got {len(cells)}. {advice}"
                )
            try:
                # which looks at every cell
                number = float if line.isascii() and "_" not in line else decimal
                values.extend(
                    # An empty cell of a foreign log is a missing sample, NaN.
                    [number(cells[i]) if not table or cells[i].strip() else np.nan for i in picked]
                )
            except ValueError:
                problem = _no_number(cells, picked, names, table, heading_row=not rows)
                raise ValueError(f"line {count} must be numbers; {problem}") from None
            # A file whose writing was interrupted ends within a number: no line end, and fewer
            # decimals than every line before. The cut number would still be a valid one.
            decimals = len(cells[-1].partition(".")[2])
            if not ended and rows and decimals < least and width - 1 in picked:
                got = f"got {cells[-1]!r} without a line end, and more decimals in all lines before"
                raise ValueError(
                    f"line {count} must be complete; {got}. Write the file again, or end that line."
                )
            least = min(least, decimals) if rows else decimals
            rows += 1
            # The clock is read rarely, since reading it for each row would take time itself.
            if not rows % 10_000 and time.monotonic() > deadline:
                raise ValueError(
                    f"must be read within {LIMITS.seconds} s; row {rows} was not. Save it as NPZ,"
                    " or cut it."
                )
            if len(values) > LIMITS.numbers:
                raise ValueError(
                    f"must hold at most {LIMITS.numbers} numbers; got more. Cut the log into"
                    " several files."
                )
    # A heading alone, or comments alone, is no log.
    if not rows:
        raise ValueError(
            "must hold samples; got no row of numbers. Check that it was written to the end."
        )
    return names, np.array(values).reshape(rows, len(picked))


def _lines(file: TextIO) -> Iterator[str]:
    """Lines of bounded length: a file without line ends must not be read into memory as one."""
    count = 0
    try:
        while line := file.readline(LIMITS.line):
            count += 1
            if len(line) == LIMITS.line:
                raise ValueError(
                    f"line {count} must be shorter than {LIMITS.line} characters."
                    " Check the line ends."
                )
            yield line
    except UnicodeDecodeError as error:
        got = f"byte 0x{error.object[error.start]:02x}"
        raise ValueError(f"must be text in UTF-8; got {got}. Save it as CSV in UTF-8.") from None


def _heading(cells, chosen):
    """Names in the first line, or None, and the places that are read.

    A name is no number; in a file of ours, of which nothing is chosen, it begins with a letter.
    """
    words = [cell.strip() for cell in cells]
    # One word that is no number makes the first line a heading; nan and inf are numbers.
    named = any(
        word and not _is_number(word) and (chosen is not None or word[0].isalpha())
        for word in words
    )
    names = [word.strip('"') for word in words] if named else None
    return names, [
        i for i in range(len(words)) if names is None or chosen is None or chosen(names[i])
    ]


def _is_number(cell):
    try:
        decimal(cell.strip())
    except ValueError:
        return False
    return True


def _no_number(cells, picked, names, table, heading_row):
    """The first cell of a row that is no number, its column, and what to do."""
    bad = next(i for i in picked if not _is_number(cells[i]) and (cells[i].strip() or not table))
    # From the most specific cause to the most general one.
    if "," in cells[bad] and _is_number(cells[bad].replace(",", ".")):
        advice = "Write decimals with a point."
    elif names and heading_row and not any(_is_number(cells[i]) for i in picked):
        advice = "If that is a row of units, put # before it."
    elif table:
        advice = "Correct it, leave the cell empty, or leave out that column."
    else:
        advice = "Correct it; of a log, map the columns that are needed with columns=."
    column = repr(names[bad])[:60] if names else bad + 1
    return f"got {cells[bad].strip()!r:.60} in column {column}. {advice}"
