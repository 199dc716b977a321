"""Tables as text of at most 80 columns: titles and words wrap, further columns go below.

Cells come as text, numbers already rounded. Numbers stand to the right, words to the left, two
blanks between columns.
"""

import dataclasses
import itertools
import math
import re
import textwrap
from collections.abc import Iterable, Sequence

from plant.parts.fields import Floats

WIDTH = 80  # letters of a line at most

_GAP = "  "


@dataclasses.dataclass(frozen=True, kw_only=True)
class TableLayout:
    """Limits of the layout of a table; all are chosen by hand.

    Parameters
    ----------
    title : int
        Most lines of a title; where a title needs more, columns go below each other instead.
    words : int
        Least number of letters to which a column of words is narrowed.
    label : int
        Letters at which cells of the first column wrap, unless its title is wider.
    """

    title: int = 4
    words: int = 16
    label: int = 44


LAYOUT = TableLayout()


def significant(value: float, digits: int = 2) -> str:
    """A number with `digits` significant digits, or all before the point, without exponent."""
    if not value or not math.isfinite(value):
        return f"{value:g}"
    # The exponent is that of the rounded number: 9.96 becomes 10, not 10.0.
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    # Digits before the point are never rounded away: 12345 stays whole.
    decimals = digits - 1 - exponent
    return f"{value:.{max(decimals, 0)}f}"


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """Lines of a text, no longer than the width; the second and later ones are indented.

    "N m" and words joined by a no-break space stay on one line.
    """
    lines = textwrap.wrap(
        _joined(text), max(width, 1), subsequent_indent=indent, break_on_hyphens=False
    )
    return [line.replace("\xa0", " ") for line in lines] or [""]


def _joined(text: str) -> str:
    # The unit alone, not the end of one word and the start of the next, as in "CAN motor".
    return re.sub(r"\b([km]?N) m\b", "\\1\xa0m", text)


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of cells under the titles `head`, which is empty for a table without titles.

    `words` are the indices of columns of words, not numbers; the first column always is one.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Sequence[int] = ()

    def lines(self, width: int = WIDTH) -> list[str]:
        """The lines of the table, no wider than `width` if each column fits beside the first."""
        # By columns, since each has one width for its title and all its cells.
        columns = list(zip(*([self.head] if self.head else []), *self.rows, strict=True))
        widths = self._widths(columns, width)
        if _total(widths) <= width:
            return self._set(columns, range(len(columns)), widths)
        # Too wide: divide the columns into panels below each other, each with the first column.
        further = range(1, len(columns))
        for panels in itertools.count(2):  # as few as will do, all of one size but the last
            size = max(-(-len(further) // panels), 1)
            groups = [(0, *further[i : i + size]) for i in range(0, len(further), size)] or [(0,)]
            parts = [
                (group, self._widths([columns[i] for i in group], width, group)) for group in groups
            ]
            if all(_total(panel_widths) <= width for _, panel_widths in parts) or size == 1:
                break
        lines: list[str] = []
        for group, panel_widths in parts:
            # The first column again, so that each panel has the names of its rows.
            panel = [columns[i] for i in group]
            lines += [*([""] * bool(lines)), *self._set(panel, group, panel_widths)]
        return lines

    def _widths(
        self, columns: Sequence[Sequence[str]], width: int, places: Sequence[int] | None = None
    ) -> list[int]:
        """Width of each column; titles wrap if they must, then words; even so they may not fit."""
        places = range(len(columns)) if places is None else places
        # The gaps between the columns take width, too.
        room = width - len(_GAP) * (len(columns) - 1)
        # The lowest titles that fit.
        for height in range(1, LAYOUT.title + 1):
            widths = self._least(columns, places, height)
            if sum(widths) <= room:
                return widths
        for k in reversed(range(1, len(widths))):  # words wrap, the last first
            if places[k] in self.words:
                widths[k] -= min(max(sum(widths) - room, 0), max(widths[k] - LAYOUT.words, 0))
        return widths

    def _least(
        self, columns: Sequence[Sequence[str]], places: Sequence[int], height: int
    ) -> list[int]:
        """Least widths for titles of `height` lines at most; only the first column's cells wrap."""
        head = bool(self.head)
        widths = []
        for i, column in zip(places, columns, strict=True):
            title = column[:head]
            cells = column[head:]
            width = (
                max(map(len, cells), default=0)
                if i
                else min(max(map(len, cells), default=0), LAYOUT.label)
            )
            for name in title:
                # A word of a title is never broken.
                width = max(width, *map(len, _joined(name).split(" ")))
                # Words alone do not decide: a title may need more width to fit into its lines.
                width += next(
                    extra
                    for extra in itertools.count()
                    if len(wrapped(name, width + extra)) <= height
                )
            widths.append(width)
        return widths

    def _set(
        self, columns: Sequence[Sequence[str]], places: Iterable[int], widths: Sequence[int]
    ) -> list[str]:
        """Lines of these columns with these widths."""
        # Numbers to the right, so that their points stand below each other.
        left_aligned = [i == 0 or i in self.words for i in places]
        lines = []
        for k, row in enumerate(zip(*columns, strict=True)):
            cells = [wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]
            tall = max(map(len, cells))
            title = k == 0 and bool(self.head)
            # Titles stand at the bottom of their row, cells at the top.
            cells = [
                [""] * (tall - len(cell)) + cell if title else cell + [""] * (tall - len(cell))
                for cell in cells
            ]
            for line in zip(*cells, strict=True):
                set_ = [
                    f"{c:<{w}}" if word else f"{c:>{w}}"
                    for c, w, word in zip(line, widths, left_aligned, strict=True)
                ]
                lines.append(_GAP.join(set_).rstrip())
        return lines


def _total(widths: Sequence[int]) -> int:
    """Width of columns of these widths, with the gaps between them."""
    return sum(widths) + len(_GAP) * (len(widths) - 1)


def heading(title: str, units: Sequence[str]) -> str:
    """A title, with the unit of the joints if all share one; otherwise the cells have units."""
    return f"{title} [{units[0]}]" if len(set(units)) == 1 else title


def with_units(cells: Iterable[str], units: Sequence[str]) -> list[str]:
    """The cells of all joints, each with its unit where these differ."""
    # The heading has the unit that all share.
    if len(set(units)) == 1:
        return list(cells)
    return [f"{cell} {unit}" for cell, unit in zip(cells, units, strict=True)]


def listed(cells: Iterable[str], units: Sequence[str]) -> str:
    """The cells of all joints in a sentence, with their unit once, or each with its own."""
    shared = f" {units[0]}" if len(set(units)) == 1 else ""
    return f"{', '.join(with_units(cells, units))}{shared}"


def largest(values: Sequence[float] | Floats, units: Sequence[str]) -> list[int]:
    """Joints with the largest of the values in each unit: N and N m do not compare.

    A NaN is the largest only where all values of its unit are NaN.
    """
    joints = range(len(units))
    return [
        # The first of equal ones, so that a table does not change from run to run.
        max(
            (j for j in joints if units[j] == unit),
            key=lambda j: (not math.isnan(values[j]), values[j]),
        )
        for unit in dict.fromkeys(units)
    ]


def largest_cell(values: Sequence[float] | Floats, units: Sequence[str]) -> str:
    """The largest of the values of all joints, of each unit."""
    cells = with_units(map(significant, values), units)
    return ", ".join(cells[j] for j in largest(values, units))


def by_joint(labels: Sequence[str], quantities: Sequence[Sequence[str]]) -> Table:
    """A table of quantities, each a title and one cell per joint; joints may become rows.

    They do where one column per joint would be wider than the page.
    """
    # Quantities as rows first; they become columns where the labels take too much width.
    rows = [("", *labels), *quantities]
    wide = sum(max(map(len, column)) for column in zip(*rows, strict=True)) + len(_GAP) * len(
        labels
    )
    cells: Sequence[Sequence[str]] = rows if wide <= WIDTH else list(zip(*rows, strict=True))
    return Table(cells[0], cells[1:])
