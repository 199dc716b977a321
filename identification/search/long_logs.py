"""Parts that stand for a long log where a fraction of it tells enough: in the genetic search, and in tests of the rig.

They are spread over all of it, so that what changes slowly, or late, is in them; what lasts shorter than from one to
the next may be in none. Values and the covariance of the fit are those of the whole log.
"""

from collections.abc import Sequence

import numpy as np

from plant import Record
from plant.parts.fields import Floats

LONG, PARTS = 50_000, 20
"""Samples above which a record is long, and parts that stand for it then, of so many samples together."""

_STILL = 0.5  # readings of a part, in those of the best one of its stretch, below which that one is taken


def is_long(record: Record) -> bool:
    """Whether parts stand for a record: not if its law or rig cannot go on from the middle of it."""
    law, rig = record.law, record.rig
    knows = law is not None and law.replays != "counts" and (law.replays or not law.has_memory(record.n))
    return len(record) > LONG and knows and rig.transport is None and rig.jitter is None


def parts_of(record: Record) -> list[slice]:
    """Samples of the parts of a record: evenly from first to last where it moves; all of a short one.

    A part in which few counts change is replaced by the one in its twentieth of the record in which most do.
    """
    if not is_long(record):
        return [slice(0, len(record))]
    size, count = LONG // PARTS, len(record)
    moved = np.minimum(np.abs(np.diff(record.counts, axis=0)), 1).sum(axis=1) * record.valid[1:]
    seen, found = np.concatenate([[0, 0], np.cumsum(moved)]), list[slice]()
    ends = np.linspace(0, count, PARTS + 1).astype(int)
    for first, last, even in zip(ends, ends[1:], np.linspace(0, count - size, PARTS).astype(int), strict=False):
        begins = np.append(np.arange(first, last - size + 1, size // 4), even)
        readings = seen[begins + size] - seen[begins]
        begin = int(even if readings[-1] >= _STILL * readings.max() else begins[readings.argmax()])
        found.append(slice(begin, begin + size))
    return found


def in_parts(record: Record) -> list[Record]:
    """The parts of a record as records; a short one as it is."""
    if not is_long(record):
        return [record]
    ends = np.append(record.t, np.inf)
    return [record.cut(ends[rows.start], ends[rows.stop]) for rows in parts_of(record)]


def rows_of_parts(whole: Floats | None, records: Sequence[Record], before: int) -> Floats | None:
    """Rows of the parts, of rows (M,) of all samples and joints of records with so many rows before them."""
    if whole is None:
        return None
    kept, begin = [np.arange(before)], before
    for record in records:
        kept += [np.arange(begin + rows.start * record.n, begin + rows.stop * record.n) for rows in parts_of(record)]
        begin += record.counts.size
    return whole[np.concatenate(kept)]
