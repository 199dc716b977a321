"""Tables as text, never wider than a terminal: long titles and words wrap, and what is still too
wide goes below.

Cells come as text, numbers already rounded. Numbers stand to the right, words to the left, two
blanks between columns.
"""

import dataclasses
import itertools
import textwrap
from collections.abc import Iterable, Sequence

WIDTH = 80  # letters of a line at most

_GAP = "  "
_TALLEST = 4  # lines of a title at most; before there are more, columns go below each other

# Letters at which a column of words is not narrowed further, and those of the first column at most.
_NARROW = 16
_LABEL = 44


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """Lines of a text that are no longer than the width; all but the first are indented. N m and
    what a no-break space joins stay together.
    """
    lines = textwrap.wrap(
        _joined(text), max(width, 1), subsequent_indent=indent, break_on_hyphens=False
    )
    return [line.replace("\xa0", " ") for line in lines] or [""]


def _joined(text: str) -> str:
    return text.replace("N m", "N\xa0m")


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of cells under their titles `head`, none for rows that need none.

    `words` are columns whose cells are words, not numbers; the first always is.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Sequence[int] = ()

    def lines(self, width: int = WIDTH) -> list[str]:
        """Text of it, no wider than `width` where a column and its row's name fit."""
        columns = list(zip(*([self.head] if self.head else []), *self.rows, strict=True))
        widths = self._widths(columns, width)
        if widths is not None:
            return self._set(columns, range(len(columns)), widths)
        others = range(1, len(columns))
        for panels in itertools.count(2):  # as few as will do, as alike as can be
            size = max(-(-len(others) // panels), 1)
            groups = [(0, *others[i : i + size]) for i in range(0, len(others), size)] or [(0,)]
            parts = [
                (group, self._widths([columns[i] for i in group], width, group)) for group in groups
            ]
            if all(found is not None for _, found in parts) or size == 1:
                break
        lines: list[str] = []
        for group, found in parts:
            own = [columns[i] for i in group]
            lines += [
                *([""] * bool(lines)),
                *self._set(own, group, found or self._least(own, group, _TALLEST)),
            ]
        return lines

    def _widths(
        self, columns: Sequence[Sequence[str]], width: int, places: Sequence[int] | None = None
    ) -> list[int] | None:
        """Width of each column: natural, else with titles that wrap, else with words that wrap;
        None if too wide.
        """
        places = range(len(columns)) if places is None else places
        room = width - len(_GAP) * (len(columns) - 1)
        for height in range(1, _TALLEST + 1):
            widths = self._least(columns, places, height)
            if sum(widths) <= room:
                return widths
        for k in reversed(range(1, len(widths))):  # words wrap, the last first
            if places[k] in self.words:
                widths[k] -= min(max(sum(widths) - room, 0), max(widths[k] - _NARROW, 0))
        return widths if sum(widths) <= room else None

    def _least(
        self, columns: Sequence[Sequence[str]], places: Sequence[int], height: int
    ) -> list[int]:
        """Width of each column whose title may have so many lines, and whose cells have one."""
        head = bool(self.head)
        widths = []
        for i, column in zip(places, columns, strict=True):
            title = column[:head]
            cells = column[head:]
            least = (
                max(map(len, cells), default=0)
                if i
                else min(max(map(len, cells), default=0), _LABEL)
            )
            for name in title:
                least = max(least, *map(len, _joined(name).split(" ")))
                least += next(
                    more for more in itertools.count() if len(wrapped(name, least + more)) <= height
                )
            widths.append(least)
        return widths

    def _set(
        self, columns: Sequence[Sequence[str]], places: Iterable[int], widths: Sequence[int]
    ) -> list[str]:
        """Lines of these columns with these widths."""
        left = [i == 0 or i in self.words for i in places]
        lines = []
        for k, row in enumerate(zip(*columns, strict=True)):
            cells = [wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]
            tall = max(map(len, cells))
            title = k == 0 and bool(self.head)
            cells = [
                [""] * (tall - len(cell)) + cell if title else cell + [""] * (tall - len(cell))
                for cell in cells
            ]
            for line in zip(*cells, strict=True):
                set_ = [
                    f"{c:<{w}}" if word else f"{c:>{w}}"
                    for c, w, word in zip(line, widths, left, strict=True)
                ]
                lines.append(_GAP.join(set_).rstrip())
        return lines


def by_joint(labels: Sequence[str], quantities: Sequence[Sequence[str]]) -> Table:
    """A table of quantities, each a title and one cell per joint; joints are rows where columns
    would be too wide.
    """
    rows = [("", *labels), *quantities]
    wide = sum(max(map(len, column)) for column in zip(*rows, strict=True)) + len(_GAP) * len(
        labels
    )
    cells: Sequence[Sequence[str]] = rows if wide <= WIDTH else list(zip(*rows, strict=True))
    return Table(cells[0], cells[1:])
