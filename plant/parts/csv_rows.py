"""Rows of a CSV file as numbers, read line by line; errors name the line."""

import array as packed
import contextlib
import csv
import dataclasses
import time
from collections.abc import Callable, Collection, Iterator, Sequence
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


class Rows:
    """Numbers of a table, packed row by row.

    Parameters
    ----------
    names : sequence of str, optional
        Names of the columns, for messages.
    width : int
        Cells of a row.
    places : sequence of int
        Columns that are read; the other cells may be anything.
    missing : collection of str, optional
        Words, in lower case, of cells without a value (NaN); by default no cell may be missing.
    decimal_comma : bool
        Decimals are written with a comma.
    clock : callable, optional
        The number of a cell with a colon, which states an instant; raises ValueError otherwise.
    surplus, broken : str
        Advice where a row has too many cells, or a cell that is no number.
    """

    def __init__(
        self,
        names: Sequence[str] | None,
        width: int,
        places: Sequence[int],
        *,
        missing: Collection[str] = (),
        decimal_comma: bool = False,
        clock: Callable[[str], float] | None = None,
        surplus: str,
        broken: str,
    ) -> None:
        self._names = names
        self._width = width
        self._places = places
        self._missing = missing
        self._comma = decimal_comma
        self._clock = clock
        self._advice = surplus, broken
        self._values = packed.array("d")
        self._count = 0
        # The least number of decimals in the last column so far.
        self._decimals = 0
        self._deadline = time.monotonic() + LIMITS.seconds

    def append(self, line: int, text: str, cells: Sequence[str]) -> None:
        """Take the cells of a line; the text of the last one may lack its line end."""
        if len(cells) != self._width:
            advice = "Complete it." if len(cells) < self._width else self._advice[0]
            raise ValueError(
                f"line {line} must have {self._width} cells; got {len(cells)}. {advice}"
            )
        try:
            self._values.extend(self._numbers_in(text, cells))
        except ValueError:
            raise ValueError(f"line {line} must be numbers; {self._fault(cells)}") from None
        # A file whose writing was interrupted ends within a number: no line end, and fewer
        # decimals than every line before. The cut number would still be a valid one.
        decimals = len(cells[-1].partition("," if self._comma else ".")[2])
        cut = not text.endswith("\n") and self._count and decimals < self._decimals
        if cut and self._width - 1 in self._places:
            got = f"got {cells[-1]!r} without a line end, and more decimals in all lines before"
            raise ValueError(
                f"line {line} must be complete; {got}. Write the file again, or end that line."
            )
        self._decimals = min(self._decimals, decimals) if self._count else decimals
        self._count += 1
        # The clock is read rarely, since reading it for each row would take time itself.
        if not self._count % 10_000 and time.monotonic() > self._deadline:
            raise ValueError(
                f"must be read within {LIMITS.seconds} s; row {self._count} was not. Save it as"
                " NPZ, or cut it."
            )
        if len(self._values) > LIMITS.numbers:
            raise ValueError(
                f"must hold at most {LIMITS.numbers} numbers; got more. Cut the log into"
                " several files."
            )

    def numbers(self) -> Floats:
        """The numbers (N, columns) of all rows, of which there must be one."""
        # A heading alone, or comments alone, is no log.
        if not self._count:
            raise ValueError(
                "must hold samples; got no row of numbers. Check that it was written to the end."
            )
        return np.array(self._values).reshape(self._count, len(self._places))

    def _numbers_in(self, text: str, cells: Sequence[str]) -> list[float]:
        # `float` is fast, but also reads 1_000 and digits of other scripts: look at the line once.
        if text.isascii() and "_" not in text and not self._comma:
            with contextlib.suppress(ValueError):
                return [float(cells[i]) for i in self._places]
        return [self._number(cells[i]) for i in self._places]

    def _number(self, cell: str) -> float:
        if self._missing and cell.strip().lower() in self._missing:
            return float("nan")
        if self._clock is not None and ":" in cell:
            return self._clock(cell)
        if self._comma:
            # A point beside decimal commas separates thousands, or the file is of two writers.
            if "." in cell:
                raise ValueError
            cell = cell.replace(",", ".")
        return decimal(cell)

    def _fault(self, cells: Sequence[str]) -> str:
        """The cell of a row that is no number, its column, and what to do."""
        bad = next(i for i in self._places if not self._is_sound(cells[i]))
        cell = cells[bad].strip()
        # From the most specific cause to the most general one.
        if self._comma and "." in cell:
            advice = "Write decimals with a comma in all rows, or with a point."
        elif "," in cell and is_number(cell):
            advice = "Write decimals with a point in all rows, or with a comma."
        elif (
            self._names
            and not self._count
            and not any(self._is_sound(cells[i]) for i in self._places if cells[i].strip())
        ):
            advice = "If that is a row of units, put # before it."
        else:
            advice = self._advice[1]
        column = repr(self._names[bad])[:60] if self._names else bad + 1
        return f"got {cell!r:.60} in column {column}. {advice}"

    def _is_sound(self, cell: str) -> bool:
        try:
            self._number(cell)
        except ValueError:
            return False
        return True


def read_rows(
    path: str | Path, *, comment: Callable[[int, str], Any] | None = None
) -> tuple[list[str] | None, Floats]:
    """Names in the heading of a CSV file of this library, or None, and its numbers (N, columns).

    Errors name the line, but not the path. `comment` is called with the number and the text of
    every line that starts with #.
    """
    rows: Rows | None = None
    names: list[str] | None = None
    # Check the size before the first line: 8 bytes of text per number, as many as in memory.
    require_bounded(path, 8 * LIMITS.numbers)
    with open(path, encoding="utf-8-sig") as file:
        for count, text in enumerate(lines_of(file), 1):
            line = text.strip()
            if not line:
                continue
            # Comments of our files carry settings of the log, which `comment` reads.
            if line.startswith("#"):
                if comment is not None:
                    comment(count, line)
                continue
            cells = cells_of(line, ",")
            if rows is None:
                words = [cell.strip().strip('"') for cell in cells]
                # A name begins with a letter and is no number, as nan and inf are.
                if any(word[:1].isalpha() and not is_number(word) for word in words):
                    names = words
                rows = Rows(
                    names,
                    len(cells),
                    range(len(cells)),
                    surplus="Correct it, or give a log: rows of numbers.",
                    broken="Correct it; of a log, map the columns that are needed with columns=.",
                )
                if names is not None:
                    continue
            rows.append(count, text, cells)
    return names, (rows or Rows(None, 0, (), surplus="", broken="")).numbers()


def cells_of(line: str, separator: str | None) -> list[str]:
    """The cells of a line; without a separator, what blanks separate."""
    # A plain split is enough, unless a quoted cell may hold the separator.
    if '"' not in line:
        return line.split(separator)
    return next(csv.reader([line], delimiter=separator or " ", skipinitialspace=True))


def lines_of(file: TextIO) -> Iterator[str]:
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


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or a decimal comma."""
    text = cell.strip()
    # One comma and no point: more of them separate thousands, or cells.
    if text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        decimal(text)
    except ValueError:
        return False
    return True
