"""How a foreign text table is written: separator, decimal mark, heading, units, first row.

The end of a file holds rows and no preamble, so it shows the separator, the number of cells, and
which of them are numbers. The heading is then above the first such row, whatever stands before it.
"""

import codecs
import dataclasses
import itertools
import os
import re
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from plant.logs.clock_times import is_instant
from plant.logs.unit_words import unit_named, without_unit
from plant.parts import LIMITS, cells_of, is_number, lines_of

# The order decides between separators that explain a file equally well. None is any run of blanks.
SEPARATORS = ("\t", ";", ",", "|", None)
# Cells without a value, as spreadsheets, R, Python and databases write them.
MISSING = frozenset({"", "na", "n/a", "#n/a", "null", "none", "-", "--"})


@dataclasses.dataclass(frozen=True, kw_only=True)
class DialectSettings:
    """How much of a file is looked at before it is read; all chosen by hand.

    Parameters
    ----------
    tail : int
        Size of the end of a file [bytes], which shows its rows.
    lines : int
        Lines of that end that are examined.
    share : float
        Least fraction of the cells of a numeric column, missing ones aside, that are numbers or
        instants.
    above : int
        Lines above the first row among which the heading is looked for.
    preamble : int
        Lines that may stand before the first row.
    """

    tail: int = 1 << 16
    lines: int = 300
    share: float = 0.6
    above: int = 8
    preamble: int = 100_000


SETTINGS = DialectSettings()
# A line such as `q[0] := 0.3`, `q: 0.3` or `q = 0.3`.
_NAMED_VALUE = re.compile(r"[^\W\d][^\s:=;,]*\s?(:=|=|:)\s*\S")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dialect:
    """How a text table is written.

    Parameters
    ----------
    encoding : str
    separator : str or None
        None of cells between blanks.
    decimal_comma : bool
    names : tuple of str
        Columns, in order.
    units : dict
        Name -> unit, where a row of units or brackets state it.
    numeric : tuple of str
        Columns whose cells are numbers or instants; those of the others are text.
    skip : int
        Lines before the first row.
    """

    encoding: str
    separator: str | None
    decimal_comma: bool
    names: tuple[str, ...]
    units: Mapping[str, str]
    numeric: tuple[str, ...]
    skip: int

    def cells(self, line: str) -> list[str]:
        """The cells of a row, without the empty one behind a separator at its end."""
        return _trimmed(cells_of(line, self.separator), len(self.names))


class _Layout(NamedTuple):
    """The rows at the end of a file, under one separator."""

    separator: str | None
    # Cells of a row, without an empty one at the end of all rows, which is `trailing`.
    width: int
    trailing: bool
    numeric: frozenset[int]
    # Of these, the columns of instants, which are read as seconds.
    instants: frozenset[int]
    decimal_comma: bool
    # Number of cells that are numbers, times their share among all.
    weight: float

    def is_row(self, cells: Sequence[str]) -> bool:
        """Whether a line is a row: its numeric cells are values or missing, and one is a value."""
        width = len(_trimmed(cells, self.width))
        return width == self.width and _are_numbers(cells, self.numeric)

    def is_empty(self, cells: Sequence[str]) -> bool:
        """Whether a line is a row without values, one of whose cells says so by a word."""
        cells = _trimmed(cells, self.width)
        words = any(character.isalnum() for cell in cells for character in cell)
        missing = all(cell.lower() in MISSING for cell in cells)
        return len(cells) == self.width and words and missing


class _Line(NamedTuple):
    number: int
    cells: list[str]
    # It has the mark of a comment.
    marked: bool

    @property
    def is_words(self) -> bool:
        """Whether no cell is a number, and half of them hold a word."""
        words = [cell for cell in self.cells if cell]
        return 2 * len(words) >= len(self.cells) and not any(map(_is_value, words))

    @property
    def is_numbers(self) -> bool:
        """Whether more than half of the cells are numbers."""
        return 2 * sum(map(_is_value, self.cells)) > len(self.cells)


def dialect_of(path: str | Path) -> Dialect:
    """How the table in a text file is written; errors do not name the path."""
    encoding = _encoding(path)
    ending = _ending(path, encoding)
    layouts = [layout for layout in (_layout(ending, s) for s in SEPARATORS) if layout is not None]
    if not layouts:
        raise ValueError(_no_rows(path, encoding))
    # The best guess from the rows comes first; its separator must also fit the heading.
    layouts.sort(key=lambda layout: layout.weight, reverse=True)
    problems = list[str]()
    better = list[str]()
    for layout in layouts:
        above, row = _lines_above(path, encoding, layout)
        heading = _heading(above, row, layout)
        # A name that contains a better separator shows that the heading and the rows differ in
        # width. If the rows have one cell, any separator shows this.
        foreign = better if layout.width > 1 else [s for s in SEPARATORS if s is not None]
        if heading is None or any(s in name for s in foreign for name in heading[0]):
            problems.append(_no_heading(above, row, layout))
            better += [layout.separator] if layout.separator else []
            continue
        names, units, skip = heading
        return Dialect(
            encoding=encoding,
            separator=layout.separator,
            decimal_comma=layout.decimal_comma,
            names=names,
            units=units | {names[i]: "s" for i in layout.instants},
            numeric=tuple(name for i, name in enumerate(names) if i in layout.numeric),
            skip=skip,
        )
    # The number of a line says more than that there is no heading.
    raise ValueError(next((text for text in problems if text.startswith("line")), problems[0]))


def _encoding(path: str | Path) -> str:
    """UTF-8, UTF-16 by its mark, or else that of western Windows, for degrees and accents."""
    with open(path, "rb") as file:
        head = file.read(SETTINGS.tail)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    try:
        # The last character may be cut in two; a decoder of pieces waits for its rest.
        decoder = codecs.getincrementaldecoder("utf-8")()
        decoder.decode(head, final=len(head) < SETTINGS.tail)
    except UnicodeDecodeError:
        # NUL bytes show that the file is not text, so cp1252 is not tried.
        return "utf-8-sig" if b"\0" in head else "cp1252"
    return "utf-8-sig"


def _ending(path: str | Path, encoding: str) -> list[str]:
    """The last lines of a file, without comments."""
    size = os.path.getsize(path)
    # Wide tables need more bytes for three lines.
    for length in (SETTINGS.tail, LIMITS.line):
        with open(path, "rb") as file:
            # An even distance from the start keeps the characters of UTF-16 in one piece.
            start = max(size - length, 0) // 2 * 2
            file.seek(start)
            data = file.read(length + 2)
            if encoding == "utf-16" and start:
                file.seek(0)
                data = file.read(2) + data
        lines = data.decode(encoding, errors="replace").splitlines()[1 if start else 0 :]
        if len(lines) > 3 or not start:
            break
    return [line for line in map(_stripped, lines) if line and line[0] not in "#%"][
        -SETTINGS.lines :
    ]


def _stripped(line: str) -> str:
    # A tab at either end is an empty cell.
    return line.strip(" \r\n\ufeff")


def _split(line: str, separator: str | None) -> list[str]:
    """Stripped cells of any line; a bracket after a blank belongs to the name before it."""
    cells = [cell.strip().strip('"') for cell in cells_of(line, separator)]
    if separator is not None:
        return cells
    joined = list[str]()
    for cell in cells:
        if cell[0:1] in ("[", "(") and joined and unit_named(cell) is not None:
            joined[-1] += f" {cell}"
        else:
            joined.append(cell)
    return joined


def _is_value(cell: str) -> bool:
    """Whether a cell is a number or an instant, and no word."""
    return is_number(cell) or is_instant(cell)


def _are_numbers(cells: Sequence[str], places: frozenset[int]) -> bool:
    present = [cells[i] for i in places if cells[i].lower() not in MISSING]
    return bool(present) and all(map(_is_value, present))


def _layout(lines: Sequence[str], separator: str | None) -> _Layout | None:
    """What most of these lines are under a separator; None where they hold no numbers."""
    weights = Counter[int]()
    rows = dict[int, list[list[str]]]()
    for line in lines:
        cells = _split(line, separator)
        count = sum(map(_is_value, cells))
        weights[len(cells)] += count
        if count:
            rows.setdefault(len(cells), []).append(cells)
    if not rows:
        return None
    width = max(rows, key=lambda width: weights[width])
    table = rows[width]
    trailing = width > 1 and not any(cells[-1] for cells in table)
    width -= trailing
    numeric = set[int]()
    for i, column in enumerate(list(zip(*table, strict=True))[:width]):
        present = [cell for cell in column if cell.lower() not in MISSING]
        if sum(map(_is_value, present)) >= SETTINGS.share * len(present):
            numeric.add(i)
    instants = {i for i in numeric if any(is_instant(cells[i]) for cells in table)}
    numbers = [cells[i] for cells in table for i in numeric if is_number(cells[i])]
    commas = sum("," in number for number in numbers)
    points = sum("." in number for number in numbers)
    weight = weights[width + trailing] ** 2 / (width * len(table))
    return _Layout(
        separator,
        width,
        trailing,
        frozenset(numeric),
        frozenset(instants),
        commas > points,
        weight,
    )


def _lines_above(
    path: str | Path, encoding: str, layout: _Layout
) -> tuple[list[_Line], _Line | None]:
    """The last lines before the first row, the nearest first, and that row."""
    above = deque[_Line](maxlen=SETTINGS.above)
    # The first of the rows without values that stand directly above the others.
    empty: _Line | None = None
    for line in _numbered(path, encoding, layout.separator):
        if layout.is_row(line.cells):
            # A comment of numbers is neither a row nor a heading.
            if line.marked:
                continue
            return list(above)[::-1], empty or line
        # Without names above, words such as NA may be names.
        named = any(_fits(other.cells, layout) for other in above)
        if named and not line.marked and layout.is_empty(line.cells):
            empty = empty or line
            continue
        empty = None
        # Rulers such as ----- are no names.
        if any(character.isalnum() for cell in line.cells for character in cell):
            above.append(line)
    return list(above)[::-1], None


def _numbered(path: str | Path, encoding: str, separator: str | None) -> Iterator[_Line]:
    """The lines at the start of a file that are not empty; comments lose their mark."""
    with open(path, encoding=encoding) as file:
        for number, text in enumerate(lines_of(file), 1):
            if number > SETTINGS.preamble:
                break
            line = _stripped(text)
            # Numpy, MATLAB and others put a mark before the heading.
            marked = line.startswith(("#", "%"))
            line = line.lstrip("#% ") if marked else line
            if line:
                yield _Line(number, _split(line, separator), marked)


def _heading(
    above: Sequence[_Line], row: _Line | None, layout: _Layout
) -> tuple[tuple[str, ...], dict[str, str], int] | None:
    """Names, units, and the number of lines before the first row; None without a heading."""

    def may_stand_below(line: _Line) -> bool:
        # A comment, or a row with a cell too few or too many, may stand there as well.
        return _fits(line.cells, layout) or line.is_numbers or line.marked

    near = itertools.takewhile(may_stand_below, above)
    fitting = [line for line in near if _fits(line.cells, layout)]
    # Names are words; only where no line has words alone may some names be numbers.
    words = [line for line in fitting if line.is_words]
    mixed = [line for line in fitting if any(c and not _is_value(c) for c in line.cells)]
    if not words and not mixed:
        return None
    line = (words or mixed)[0]
    at = fitting.index(line)
    units = None
    # A row of units stands below the names. It may hold 1 or -, and is no row of words then.
    adjacent = at + 1 < len(fitting) and fitting[at + 1].number == line.number - 1
    if adjacent and _are_units(line.cells) and fitting[at + 1] in mixed:
        units, line, at = line, fitting[at + 1], at + 1
    elif at and _are_units(fitting[at - 1].cells):
        units = fitting[at - 1]
    # Rulers below the heading are skipped, unless a broken row or a comment stands there too.
    nearest = units or line
    skip = row.number - 1 if row is not None and nearest is above[0] else nearest.number
    names = line.cells
    # Names that repeat, such as q1 q2 q1 q2, belong to groups that the line above names.
    above_names = fitting[at + 1].cells if at + 1 < len(fitting) else []
    if len(set(names)) < len(names) and above_names and not any(map(_is_value, above_names)):
        groups = list[str]()
        # A spreadsheet names a group above its first column only.
        for cell in above_names:
            groups.append(cell or (groups[-1] if groups else ""))
        names = [
            f"{group}.{name}" if group else name for group, name in zip(groups, names, strict=False)
        ]
    # A separator at the end of the heading names no column.
    names = _trimmed(names, layout.width)
    labels = tuple(name or f"column {i + 1}" for i, name in enumerate(names))
    stated = {name: without_unit(name)[1] for name in labels}
    if units is not None:
        stated |= {
            name: unit_named(cell) for name, cell in zip(labels, units.cells, strict=False) if cell
        }
    return labels, {name: unit for name, unit in stated.items() if unit is not None}, skip


def _trimmed(cells: Sequence[str], width: int) -> list[str]:
    """Cells without the empty one that follows a separator at the end of a line."""
    surplus = len(cells) == width + 1 and not cells[-1].strip()
    return list(cells[:-1] if surplus else cells)


def _fits(cells: Sequence[str], layout: _Layout) -> bool:
    """Whether a line is as wide as the rows, or one cell wider if it or all rows end empty."""
    surplus = len(cells) == layout.width + 1 and (layout.trailing or not cells[-1])
    return len(cells) == layout.width or surplus


def _are_units(cells: Sequence[str]) -> bool:
    """Whether each cell is a unit or empty, and at least one unit is not "1"."""
    units = [unit_named(cell) for cell in cells if cell]
    return None not in units and any(unit != "1" for unit in units)


def _no_heading(above: Sequence[_Line], row: _Line | None, layout: _Layout) -> str:
    """Why the rows have no names, and what to do."""
    if row is None:
        return (
            f"must have its heading in the first {SETTINGS.preamble} lines; got none there. Delete"
            " the lines above it."
        )
    if _is_no_row(row):
        return _named_values(row)
    names = above[0] if above else None
    if names is not None and layout.width == len(names.cells) == 1:
        # A file that ends within its first row has a heading of more cells.
        widths = [len(cells_of(names.cells[0], s)) for s in SEPARATORS if s is not None]
        if max(widths) > 1:
            return f"line {row.number} must have {max(widths)} cells; got 1. Complete it."
    if names is None or len(names.cells) < 2 or not names.is_words:
        return "must name its columns in a line above the numbers; got none. Add that line."
    # The nearest line has names, but another number of them.
    advice = f"Complete it, or correct the names in line {names.number}."
    if len(row.cells) > len(names.cells):
        advice = f"Name each column in line {names.number}."
        if layout.separator == ",":
            advice += " If decimals have a comma, separate the cells by semicolons."
    return f"line {row.number} must have {len(names.cells)} cells; got {layout.width}. {advice}"


def _no_rows(path: str | Path, encoding: str) -> str:
    """Why a file without numbers is no table, and what to do."""
    line = next(_numbered(path, encoding, None), None)
    if line is not None and _is_no_row(line):
        return _named_values(line)
    return "must hold samples; got no row of numbers. Check that it was written to the end."


def _is_no_row(line: _Line) -> bool:
    """Whether a line is of JSON, or has a name and a value."""
    text = " ".join(line.cells)
    return text[:1] in "{[" or _NAMED_VALUE.match(text) is not None


def _named_values(line: _Line) -> str:
    text = " ".join(line.cells)
    kind = "JSON" if text[:1] in "{[" else "name and value"
    return (
        f"must have a line of names above rows of numbers; line {line.number} is {text!r:.60}, and"
        f" lines of {kind} are not read. Write one row per sample."
    )
