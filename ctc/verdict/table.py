"""Tables as text: columns as wide as their cells, joints in columns or, where those are too many, in rows."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

__all__ = ["aligned", "by_joint"]

_WIDE, _TITLE = 110, 14
"""Letters of a line at most, and of a title above a column of numbers."""


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first cell of each row to the left, the others to the right, two blanks between."""
    first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
    return [
        "  ".join([f"{name:<{first}}", *(f"{cell:>{w}}" for cell, w in zip(cells, others, strict=True))]).rstrip()
        for name, *cells in rows
    ]


def by_joint(labels: Sequence[str], quantities: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table of quantities, each a title and one cell per joint."""
    rows = [("", *labels), *quantities]
    if len((lines := aligned(rows))[0]) <= _WIDE:
        return lines
    titles, *joints = zip(*rows, strict=True)
    unbroken = [textwrap.wrap(title.replace("N m", "N~m"), _TITLE) for title in titles]
    wrapped = [[line.replace("~", " ") for line in lines] for lines in unbroken]
    height = max(map(len, wrapped))
    return aligned([*zip(*([""] * (height - len(each)) + each for each in wrapped), strict=True), *joints])
