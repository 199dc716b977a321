"""Straight-line code cut into pieces, each a loop over the individuals, joined by rows of the work array.

A processor looks a few hundred instructions ahead. In one long loop these all belong to one individual (or a vector of
them) and wait for each other; in short loops they belong to several individuals, and do not.
"""

from collections.abc import Callable, Mapping
from itertools import accumulate, pairwise
from typing import NamedTuple


class Line(NamedTuple):
    """One assignment; in the template ``{0}``, ``{1}`` stand for what it `needs`: names or literals."""

    names: tuple[str, ...]
    template: str
    needs: tuple[str, ...]
    weight: int = 1

    def text(self, renamed: Mapping[str, str] | None = None) -> str:
        """The right side, with some names changed."""
        text = self.template
        for i, name in enumerate(self.needs):
            text = text.replace(f"{{{i}}}", (renamed or {}).get(name, name))
        return text

    def __str__(self) -> str:
        return f"{', '.join(self.names)} = {self.text()}"


def cut(
    lines: list[Line], stores: Mapping[int | str, str], rows: Mapping[str, int], fresh: Callable[[], int], size: int
) -> list[list[str]]:
    """Pieces of about `size` instructions, as texts in which ``{row}`` stands for that row of the work array.

    `stores` says which name or literal a row, or another place, holds in the end, `rows` which row a name may be read
    from; `fresh` gives a new row.
    """
    bounds = _bounds(lines, stores, size)
    rows, last = dict(rows), len(bounds) - 2
    piece_of = {name: k for k, (a, b) in enumerate(pairwise(bounds)) for line in lines[a:b] for name in line.names}
    read_in: dict[str, int] = {}  # name -> last piece that reads it
    for k, (a, b) in enumerate(pairwise(bounds)):
        read_in |= dict.fromkeys((name for line in lines[a:b] for name in line.needs), k)
    read_in |= dict.fromkeys((name for name in stores.values() if name in rows), last)  # copied from row to row
    kept: dict[int | str, str] = {row: name for name, row in rows.items()}
    # A row is overwritten as soon as its new value is known and its old one has been read for the last time.
    known_in = dict.fromkeys(rows, last) | piece_of
    stored_in = {row: max(known_in.get(name, 0), read_in.get(kept.get(row, ""), 0)) for row, name in stores.items()}
    pieces = []
    for k, (a, b) in enumerate(pairwise(bounds)):
        ending = {row: name for row, name in stores.items() if stored_in[row] == k}
        here = {name for line in lines[a:b] for name in line.names}
        needed = dict.fromkeys([*(name for line in lines[a:b] for name in line.needs), *ending.values()])
        # What is read has another name in every piece: variables that are assigned once compile much faster.
        read = {name: f"{name}_{k}" for name in needed if name in rows and name not in here}
        text = [f"{new} = {{{rows[name]}}}" for name, new in read.items()]
        text += [f"{', '.join(line.names)} = {line.text(read)}" for line in lines[a:b]]
        later = {name for line in lines[b:] for name in line.needs}
        later |= {name for row, name in stores.items() if stored_in[row] > k}
        for line in lines[a:b] if k < last else []:
            for name in line.names:
                if name in later:
                    rows[name] = fresh()
                    text.append(f"{{{rows[name]}}} = {name}")
        text += [f"{_target(row)} = {read.get(name, name)}" for row, name in ending.items()]
        pieces.append(text)
    return pieces


def _target(place: int | str) -> str:
    return place if isinstance(place, str) else f"{{{place}}}"


def _bounds(lines: list[Line], stores: Mapping[int | str, str], size: int) -> list[int]:
    """Where to cut: near equal sizes, at the places that fewest values have to cross."""
    made = {name: i for i, line in enumerate(lines) for name in line.names}
    read = {name: i for i, line in enumerate(lines) for name in line.needs} | dict.fromkeys(stores.values(), len(lines))
    change = [0] * (len(lines) + 2)
    for name, i in made.items():
        if name in read:
            change[i + 1] += 1
            change[read[name] + 1] -= 1
    crossing = list(accumulate(change))  # values made before line k and read from there on
    before = list(accumulate((line.weight for line in lines), initial=0))
    count = max(1, round(before[-1] / size))
    bounds = [0]
    for k in range(1, count):
        low, high = ((k + side / 3) * before[-1] / count for side in (-1, 1))
        near = [i for i, weight in enumerate(before) if low <= weight <= high and i > bounds[-1]]
        bounds += [min(near, key=lambda i: crossing[i])] if near else []
    return [*bounds, len(lines)]
