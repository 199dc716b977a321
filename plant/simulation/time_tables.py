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
    tables, reading = [], loop.law.replays == "counts"
    for i, (t, some) in enumerate(zip(times, rows, strict=True)):
        sample, h = owner[some], lengths[some]
        motion, pulses = path(t)
        if loop.follows_motion and (i == 0 or not every):  # with elastic gears, the log is of the motors
            motion = path.setpoint(t, loop.law)
        replayed = [] if logged is None else [clock.between(logged, t) if reading else clock.bridged(logged)[sample]]
        added = [] if injected is None else [clock.bridged(injected)[sample]]
        tables.append(np.ascontiguousarray(np.column_stack([*motion, pulses, *replayed, *added, passing[some], h])))
    return tuple(tables)
