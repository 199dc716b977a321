"""The reference of a loop, tabulated beforehand for every step of the law, the log and the plant.

Samples are at the times of a `Clock`. The sub-steps read the reference at their middle. A logged or injected torque, or
a current, is held from its sample to the next, and interpolated linearly across gaps; logged counts are on straight
lines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import Logged, Path

__all__ = ["time_tables"]

_BLOCK = 1 << 17
"""Rows that are made at once: what a path needs meanwhile is several times a table."""


def time_tables(
    loop: ClosedLoop, path: Path | Logged, clock: Clock, logged: NDArray[np.float64] | None = None,
    injected: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], ...]:  # fmt: skip
    """Rows of `loop.time_names` for every step of the law, the log and the plant.

    Parameters
    ----------
    loop : ClosedLoop
    path : Path or Logged
    clock : Clock
    logged : (N, n) numpy.ndarray, optional
        What the law replays, a row for each sample of the log.
    injected : (N, n) numpy.ndarray, optional
        Torque that acts beside the law's, likewise [N m]; the loop says whether it has one.

    Returns
    -------
    law_time, sample_time, step_time : numpy.ndarray
    """
    steps, every = loop.steps_per_sample, loop.steps_per_law
    transport, passing = loop.rig.transport, np.empty((len(clock) * steps, 0))
    if transport is not None:
        step = np.arange(len(passing))
        passing = np.column_stack([step % every, transport.words(-(-len(passing) // every))[step // every]])
    if (jitter := loop.rig.jitter) is not None:
        draws = jitter.draws(-(-len(passing) // every))
        passing = np.column_stack([passing, draws[np.arange(len(passing)) // every]])
    owner = np.repeat(np.arange(len(clock)), steps)  # the sample that each sub-step belongs to
    lengths = clock.step_lengths(steps)
    rows = [slice(None, None, every) if every else slice(0), slice(None, None, steps), slice(None)]
    times = clock.starts(steps, every) if every else np.empty(0), clock.t, clock.middles(steps)
    if loop.law.of_links and not every:
        name = type(loop.law).__name__
        raise ValueError(f"a law that follows the links must have a period; {name} has none. Give it one.")
    reading = loop.law.replays == "counts"
    held = None if logged is None or reading else clock.bridged(logged)
    beside = None if injected is None else clock.bridged(injected)

    def rows_at(i: int, t: NDArray[np.float64], some: NDArray[np.int_]) -> NDArray[np.float64]:
        motion, pulses = path(t)
        if loop.follows_motion and (i == 0 or not every):  # with elastic gears, the log is of the motors
            motion = path.setpoint(t, loop.law)
        replayed = [] if logged is None else [clock.between(logged, t) if held is None else held[owner[some]]]
        added = [] if beside is None else [beside[owner[some]]]
        return np.column_stack([*motion, pulses, *replayed, *added, passing[some], lengths[some]])

    tables = []
    for i, (t, which) in enumerate(zip(times, rows, strict=True)):
        places = np.arange(len(owner))[which]
        table = rows_at(i, t[:_BLOCK], places[: len(t)][:_BLOCK])
        if len(t) > _BLOCK:
            first, table = table, np.empty((len(t), table.shape[1]))
            table[:_BLOCK] = first
            for begin in range(_BLOCK, len(t), _BLOCK):
                block = slice(begin, begin + _BLOCK)
                table[block] = rows_at(i, t[block], places[block])
        tables.append(np.ascontiguousarray(table))
    return tuple(tables)
