"""Rows of a log that are no measurement: found, bridged for filters, and given no weight.

A lost packet repeats the previous row, or its reference, while the rest moves; a stuck sample
repeats the count of one joint. The count that follows is where the motion went meanwhile, which a
joint at rest does not show. A late stamp comes with a count that was read in time. A counter that
loses or gains a turn goes on from there.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.counts import events
from plant.checkup.innovation import SETTINGS as MOTION
from plant.checkup.innovation import stopped
from plant.checkup.quantisation import grid
from plant.checkup.signals import Signals
from plant.parts import Bools, Floats

BRIDGED = 10
"""Rows of a gap up to which straight lines across it are as good as its neighbours, for filters."""

MOST = 0.5
"""Share of rows that may be lost."""


@dataclass(frozen=True, kw_only=True)
class LostRowSettings:
    """Limits of the search for rows that are no measurement, chosen by hand.

    ``tests/benchmarks/second_reading.py`` measures them on logs that are spoiled in these ways.

    Parameters
    ----------
    fast : float
        Motion [steps of the counts per row], beyond what the arm stops in a row, from which on two
        rows cannot be equal.
    off_reference : float
        Difference [pulses] between the logged and the stated reference of a lost row.
    other_reference : float
        Share of such rows above which the stated reference is another one.
    turn : float
        Deviation of a jump from whole turns [turns] up to which the counter lost them.
    """

    fast: float = 2.0
    off_reference: float = 1.0
    other_reference: float = 0.2
    turn: float = 0.02


SETTINGS = LostRowSettings()


class LostRows(NamedTuple):
    """Rows (N,) that are no measurement, by cause; counts (N, n) that lost turns have added."""

    packets: Bools
    stuck: Bools
    glitches: Bools
    late: Bools
    turns: Floats

    @property
    def any(self) -> Bools:
        """Rows (N,) of any cause."""
        return self.packets | self.stuck | self.glitches | self.late


def lost_rows(record) -> LostRows:
    """Find the rows of a record that are no measurement, among those with weight."""
    N, n = record.counts.shape
    packets, stuck, glitches, late = np.zeros((4, N), bool)
    lost = LostRows(packets, stuck, glitches, late, np.zeros((N, n)))
    rows = np.flatnonzero(record.valid > 0)
    # Fewer rows do not show what the motion is.
    least_rows = 10 * MOTION.neighbours
    if len(rows) < least_rows:
        return lost

    # 1. Repeated rows. A packet is lost if the reference repeats, or everything that moves does.
    reference = record.reference_pulses[rows]
    columns = record.counts[rows]
    # Goals that are held repeat in rows that are read more often than goals are sent.
    if record.reference is None or not record.reference.held:
        columns = np.hstack([columns, reference])
    # Times in intervals: a missing row is no repeated one.
    t = record.t[rows] / np.median(np.diff(record.t))
    repeated = np.zeros(columns.shape, bool)
    fast = np.zeros(columns.shape, bool)
    arm = np.tile(stopped(record.rig, np.median(np.diff(record.t))), columns.shape[1] // n)
    for j, column in enumerate(columns.T):
        step = grid(column)
        limit = SETTINGS.fast + arm[j] / step
        repeated[:, j], fast[:, j] = _repeats(column / step, t, limit)
    packet = repeated[:, n:].any(axis=1)
    packet |= (repeated == fast).all(axis=1) & repeated.any(axis=1)
    # Off the stated reference the row is old if the reference repeats; otherwise its stamp is late.
    off = off_reference(record)[rows]
    new_reference = np.diff(reference, axis=0, prepend=np.nan).any(axis=1)
    packet |= off & ~new_reference
    packets[rows] = packet
    late[rows] = off & new_reference
    stuck[rows] = repeated[:, :n].any(axis=1) & ~packet

    # 2. Late stamps, glitches and lost turns, which those rows would hide.
    bridged_record = on_lines(record, lost.any)
    signals = Signals(bridged_record)
    rows = np.flatnonzero(bridged_record.valid > 0)
    late[rows] |= _late_stamps(signals)
    if len(rows) <= least_rows:
        return lost
    for i in range(n):
        outliers = events(signals, i)
        glitches[rows[outliers.glitches]] = True
        if outliers.step:
            continue  # the jumps are steps of a coarse grid
        sizes = outliers.sizes[outliers.jumps - 1]
        # All counts after a lost turn are off by it.
        turns = _turns(sizes, record.rig.encoder.resolution[i])
        for row, turn in zip(rows[outliers.jumps], turns, strict=True):
            lost.turns[row:, i] += turn
    return lost


def bridged(record) -> Any:
    """The record with lost rows and short gaps bridged without weight, and lost turns taken back.

    A record without any is returned as it is.

    Raises
    ------
    ValueError
        More rows are lost than measured.
    """
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        raise ValueError(
            f"most rows must be measurements; {lost.any.sum()} of {len(record)} repeat others or"
            " are late. Log every sample once, when it is taken."
        )
    return all_bridged(record, lost)


def all_bridged(record, lost: LostRows) -> Any:
    """The record with these rows and short gaps bridged, and lost turns taken back."""
    # Turns first: the lines of the bridges end on the counts beside them.
    if lost.turns.any():
        record = replace(record, error_pulses=record.error_pulses + lost.turns)
    return on_lines(record, lost.any | short_gaps(record.valid == 0, BRIDGED))


def repeats_bridged(record, lost: LostRows) -> Any:
    """The record with lost packets, stuck samples and late stamps bridged.

    Glitches and jumps stay as they are.
    """
    return on_lines(record, lost.packets | lost.stuck | lost.late)


def off_reference(record) -> Bools:
    """Rows (N,) in short gaps whose logged reference is not the stated one.

    There are none where many rows are off: then the record follows another reference.
    """
    if record.reference is None or record.reference.n != record.rig.n:
        return np.zeros(len(record), bool)
    stated = record.rig.counts(record.reference(record.t - record.t[0]).q)
    off = np.abs(stated - record.reference_pulses).max(axis=1) > SETTINGS.off_reference
    return short_gaps(off, BRIDGED) & (off.mean() < SETTINGS.other_reference)


def short_gaps(missing: Bools, longest: int) -> Bools:
    """Those of the missing rows (N,) that lie in gaps of at most so many rows."""
    # Pairs of the first row of a gap and the first row behind it.
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing, [0]])))
    short = np.zeros(len(missing), bool)
    for begin, end in edges.reshape(-1, 2):
        short[begin:end] = end - begin <= longest
    return short


def on_lines(record, rows: Bools) -> Any:
    """The record with these rows on straight lines between the others, and without weight."""
    # Without any other row there is nothing to draw a line between.
    if not rows.any() or rows.all():
        return record

    def lines(table, pulses):
        if table is None:
            return None
        t = record.t[~rows]
        values = np.column_stack([np.interp(record.t, t, column[~rows]) for column in table.T])
        # Whole pulses stay whole: later checks tell counts from angles by that.
        if pulses and (table == np.round(table)).all():
            values = np.round(values)
        return np.where(rows[:, None], values, table)

    reference = lines(record.reference_pulses, True)
    return replace(
        record,
        reference_pulses=reference,
        error_pulses=reference - lines(record.counts, True),
        valid=np.where(rows, 0.0, record.valid),
        torque=lines(record.torque, False),
        current=lines(record.current, False),
        injected=lines(record.injected, False),
        link_counts=lines(record.link_counts, False),
    )


def _repeats(column, t, limit):
    """Rows (M,) of a column that repeat the previous one although it moves; rows of fast motion.

    `t` (M,): their times [median intervals]; `limit`: fast motion per row.
    """
    # 1. The speed before and after each jump between two stretches of equal values.
    reach = MOTION.neighbours
    starts = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    if len(starts) < 2 * reach + 2:
        return np.zeros(len(column), bool), np.zeros(len(column), bool)
    length = np.diff(t[starts])
    jump = np.diff(column[starts])
    # A median leaves out the jump behind a repeated row.
    windows = np.lib.stride_tricks.sliding_window_view(jump / length, reach)
    incoming, outgoing = _before_and_after(np.median(windows, axis=1), len(jump))
    mean = (incoming + outgoing) / 2

    # 2. A stretch repeats its value if the motion is fast on both sides, and the jump at its end
    # is that of its whole length rather than that of one row.
    fast = (np.minimum(np.abs(incoming), np.abs(outgoing)) >= limit) & (incoming * outgoing > 0)
    # In a loop that oscillates from row to row two counts are equal where it turns.
    forwards = (windows * np.sign(np.median(windows, axis=1))[:, None]).min(axis=1)
    fast &= np.minimum(*_before_and_after(forwards, len(jump))) >= limit
    off = np.abs(jump - length * mean)
    tolerance = limit + MOTION.in_time * np.abs(length * mean)
    follows = (off <= tolerance) & (off < np.abs(jump - mean))

    # 3. Back to rows; the first row of a stretch is a measurement.
    stretch = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(column)))
    repeats = np.append(fast & follows, False)[stretch]
    repeats[starts] = False
    return repeats, np.append(fast, False)[stretch]


def _before_and_after(values, count):
    """Values (W,) of windows, before and after each of so many jumps."""
    reach = count + 1 - len(values)
    before = np.concatenate([np.full(reach, values[0]), values[: count - reach]])
    after = np.concatenate([values[1:], np.full(reach, values[-1])])[:count]
    return before, after


def _late_stamps(signals):
    """Rows (M,) stamped late or early whose counts are those of the even time."""
    late = np.zeros(len(signals.t), bool)
    T = signals.interval
    steps = np.diff(signals.t)
    counts = signals.counts
    if len(steps) < 3:
        return late
    # One interval is longer, and the next as much shorter.
    shift = (steps[:-1] - steps[1:]) / 2
    limit = MOTION.mistimed * T
    odd = (np.abs(shift) > limit) & (np.abs(steps[:-1] + steps[1:] - 2 * T) < limit)
    # Deviation of each count from the mean of its neighbours, and its prediction if stamp and count
    # belong together. The share of the prediction that is there says which of them is the case.
    deviation = counts[1:-1] - (counts[2:] + counts[:-2]) / 2
    predicted = (counts[2:] - counts[:-2]) / (2 * T) * shift[:, None]
    power = (predicted**2).sum(axis=1)
    visible = power > (2 * SETTINGS.fast) ** 2
    measured = np.abs((deviation * predicted).sum(axis=1))
    late[1:-1] = odd & visible & (measured < MOTION.in_time * power)
    return late


def _turns(sizes, resolution):
    """Counts of whole turns, or of registers, that jumps (J,) are; 0 for other jumps."""
    turns = np.zeros(len(sizes))
    # Registers of 12, 16, 24 and 32 bits begin again after as many counts.
    for period in (resolution, 2.0**12, 2.0**16, 2.0**24, 2.0**32):
        nearest = np.round(sizes / period) * period
        close = np.abs(sizes - nearest) < SETTINGS.turn * period
        turns = np.where((turns == 0) & close, np.round(nearest), turns)
    return turns
