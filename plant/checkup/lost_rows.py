"""Rows of a log that are no measurement: told apart, bridged for filters, and given no weight.

A lost packet repeats the row before, or its reference, while the rest moves; a stuck sample the
count of one joint: the count that follows is where the motion went meanwhile, which a joint at rest
does not do. A late stamp is read with a count that was taken in time. A counter that loses or gains
a turn goes on from there.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.checkup.counts import events
from plant.checkup.quantisation import grid
from plant.checkup.signals import Signals
from plant.parts.fields import Floats

# rows of a gap up to which straight lines across it are as good as its neighbours, for filters
BRIDGED = 10

# Counts per row from which on rows cannot be equal; how far, relatively, the next count may be off
# the motion's; and steps to each side that tell the motion.
_FAST = 2.0
_FOLLOWS = 0.35
_AROUND = 4

# Pulses by which a logged reference may differ from the stated one; and share of rows that may be
# lost.
_OFF = 1.0
MOST = 0.5

_OTHER = 0.2  # share of rows off the stated reference above which it is another one

# Intervals by which a stamp is late, at least; and of that, how far off the even time its count may
# be.
_ODD = 0.2
_EVEN = 0.3

# Part of a turn within which a jump is a whole one; and counts after which registers begin again.
_TURN = 0.02
_REGISTERS = (2.0**12, 2.0**16, 2.0**24, 2.0**32)


class LostRows(NamedTuple):
    """Rows (N,) that are no measurement, by cause, and counts (N, n) that jumps of whole turns
    have added.
    """

    packets: NDArray[np.bool_]
    stuck: NDArray[np.bool_]
    glitches: NDArray[np.bool_]
    late: NDArray[np.bool_]
    turns: Floats

    @property
    def any(self) -> NDArray[np.bool_]:
        """Rows (N,) of any cause."""
        return self.packets | self.stuck | self.glitches | self.late


def lost_rows(record: Any) -> LostRows:
    """Rows of a record with weight that are no measurement; those without are left out."""
    N, n = record.counts.shape
    none = np.zeros(N, bool)
    rows = np.flatnonzero(record.valid > 0)
    lost = LostRows(none, none.copy(), none.copy(), none.copy(), np.zeros((N, n)))
    if len(rows) < 10 * _AROUND:
        return lost
    counts = record.counts[rows]
    reference = record.reference_pulses[rows]
    columns = np.hstack([counts, reference])
    t = record.t[rows] / np.median(np.diff(record.t))
    repeats, moving = (
        np.column_stack(each)
        for each in zip(*(_repeats(x / grid(x), t) for x in columns.T), strict=True)
    )
    packet = repeats[:, n:].any(axis=1) | (repeats == moving).all(axis=1) & repeats.any(axis=1)
    off = off_reference(record)[rows]
    again = np.diff(reference, axis=0, prepend=np.nan).any(axis=1)
    packet |= off & ~again
    lost.packets[rows], lost.late[rows] = packet, off & again
    lost.stuck[rows] = repeats[:, :n].any(axis=1) & ~packet
    mended = on_lines(record, lost.any)
    signals = Signals(mended)
    kept = np.flatnonzero(mended.valid > 0)
    lost.late[kept] |= _late(signals)
    for i in range(n if len(kept) > 10 * _AROUND else 0):
        glitches, jumps, sizes, step = events(signals, i)
        lost.glitches[kept[glitches]] = True
        jumps = jumps[:0] if step else jumps
        for row, turn in zip(
            kept[jumps], _turns(sizes[jumps - 1], record.rig.encoder.resolution[i]), strict=True
        ):
            lost.turns[row:, i] += turn
    return lost


def bridged(record: Any) -> Any:
    """The record with lost rows and short gaps on straight lines in time and without weight, and
    lost turns taken back.

    A record without any is returned as it is.

    Raises a ValueError: more lost rows than measurements.
    """
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        raise ValueError(
            f"most rows must be measurements; {lost.any.sum()} of {len(record)} repeat others or"
            " are late. Log every sample once, when it is taken."
        )
    return all_bridged(record, lost)


def all_bridged(record: Any, lost: LostRows) -> Any:
    """The record with these rows bridged, and turns taken back."""
    if lost.turns.any():
        record = dataclasses.replace(record, error_pulses=record.error_pulses + lost.turns)
    return on_lines(record, lost.any | short_gaps(record.valid == 0, BRIDGED))


def repeats_bridged(record: Any, lost: LostRows) -> Any:
    """The record with lost packets, stuck samples and late stamps bridged; glitches and jumps
    are as they were.
    """
    return on_lines(record, lost.packets | lost.stuck | lost.late)


def off_reference(record: Any) -> NDArray[np.bool_]:
    """Rows (N,), a few in a row, whose logged reference is not the stated one where nearly all
    others are.
    """
    if record.reference is None or record.reference.n != record.rig.n:
        return np.zeros(len(record), bool)
    stated = record.rig.counts(record.reference(record.t - record.t[0]).q)
    off = np.abs(stated - record.reference_pulses).max(axis=1) > _OFF
    return short_gaps(off, BRIDGED) & (off.mean() < _OTHER)


def short_gaps(missing: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Those of the missing rows (N,) that lie in gaps of at most so many."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing, [0]])))
    short = np.zeros(len(missing), bool)
    for begin, end in edges.reshape(-1, 2):
        short[begin:end] = end - begin <= most
    return short


def on_lines(record: Any, rows: NDArray[np.bool_]) -> Any:
    """The record with these rows on straight lines between the others, and without weight."""
    if not rows.any():
        return record
    known = ~rows

    def lines(table, whole=True):
        if table is None:
            return None
        made = np.column_stack(
            [np.interp(record.t, record.t[known], column[known]) for column in table.T]
        )
        made = np.round(made) if whole and (table == np.round(table)).all() else made
        return np.where(rows[:, None], made, table)

    reference = lines(record.reference_pulses)
    values = {
        name: lines(getattr(record, name), False)
        for name in ("torque", "current", "injected", "link_counts")
    }
    valid = np.where(rows, 0.0, record.valid)
    error = reference - lines(record.counts)
    return dataclasses.replace(
        record, reference_pulses=reference, error_pulses=error, valid=valid, **values
    )


def _repeats(column, t):
    """Rows (M,) of a column that repeat the one before while it moves on; and rows in which it
    moves too fast to.

    `t` (M,): their times [median intervals].
    """
    starts = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    if len(starts) < 2 * _AROUND + 2:
        return np.zeros(len(column), bool), np.zeros(len(column), bool)
    length = np.diff(t[starts])
    jump = np.diff(column[starts])
    around = np.lib.stride_tricks.sliding_window_view(jump / length, _AROUND)
    speed = np.median(around, axis=1)
    before = np.concatenate([np.full(_AROUND, speed[0]), speed[: len(jump) - _AROUND]])
    after = np.concatenate([speed[1:], np.full(_AROUND, speed[-1])])[: len(jump)]
    mean = (before + after) / 2
    fast = (np.minimum(np.abs(before), np.abs(after)) >= _FAST) & (before * after > 0)
    off = np.abs(jump - length * mean)
    follows = (off <= _FAST + _FOLLOWS * np.abs(length * mean)) & (off < np.abs(jump - mean))
    run = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(column)))
    repeats = np.append(fast & follows, False)[run]
    repeats[starts] = False
    return repeats, np.append(fast, False)[run]


def _late(signals):
    """Rows (M,) stamped late or early whose counts are those of the even time."""
    late = np.zeros(len(signals.t), bool)
    T = signals.interval
    steps = np.diff(signals.t)
    counts = signals.counts
    if len(steps) < 3:
        return late
    shift = (steps[:-1] - steps[1:]) / 2
    odd = (np.abs(shift) > _ODD * T) & (np.abs(steps[:-1] + steps[1:] - 2 * T) < _ODD * T)
    even = counts[1:-1] - (counts[2:] + counts[:-2]) / 2
    moved = (counts[2:] - counts[:-2]) / (2 * T) * shift[:, None]
    # Of a stamp and count that belong together `even` is `moved`.
    seen = (moved**2).sum(axis=1)
    kept = np.abs((even * moved).sum(axis=1))
    late[1:-1] = odd & (seen > (2 * _FAST) ** 2) & (kept < _EVEN * seen)
    return late


def _turns(sizes, resolution):
    """Counts of whole turns, or of a register of bits, that jumps (J,) are; 0 where they are
    something else.
    """
    turns = np.zeros(len(sizes))
    for one in (resolution, *_REGISTERS):
        whole = np.round(sizes / one) * one
        turns = np.where(
            (turns == 0) & (np.abs(sizes - whole) < _TURN * one), np.round(whole), turns
        )
    return turns
