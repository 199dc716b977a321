"""The reference of a loop, tabulated beforehand for every step of the law, the log and the plant.

Samples are at the times of a `Clock`. The sub-steps read the reference at their middle. A logged or
injected torque, or a current, is held from its sample to the next, and interpolated linearly across
gaps; logged counts are on straight lines, and so is a torque whose law says so.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.parts import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import Logged, Path

# Sub-steps whose rows are made at once. While it evaluates a path, a table takes several times its
# own memory, so that a long one is made in parts.
_ROWS = 1 << 17


def time_tables(
    loop: ClosedLoop,
    path: Path | Logged,
    clock: Clock,
    logged: Floats | None = None,
    injected: Floats | None = None,
    columns: Sequence[Sequence[int]] | None = None,
) -> tuple[Floats, ...]:
    """Rows of `loop.time_names` for every step of the law, the log and the plant.

    The law replays the `logged` column (N, n); the `injected` torque (N, n) acts beside it [N m],
    if the loop has one. Each table gets its `columns`, by default all, with the length of a step
    behind them.
    """
    steps = loop.steps_per_sample
    counts = _law_steps(loop, clock), len(clock), len(clock) * steps
    samples = max(1, _ROWS // steps)
    tables: list[Floats] = []
    filled = [0, 0, 0]
    for block in in_blocks(loop, path, clock, logged, injected, columns, samples=samples):
        # One block is all, as for most logs: no copy is made.
        if len(block[1]) == len(clock):
            return block
        if not tables:
            tables = [
                np.empty((count, part.shape[1])) for count, part in zip(counts, block, strict=True)
            ]
        for i, part in enumerate(block):
            tables[i][filled[i] : filled[i] + len(part)] = part
            filled[i] += len(part)
    return tuple(tables)


def _law_steps(loop, clock):
    """Steps of the law that begin within a clock; 0 for a law without a period."""
    if not loop.steps_per_law:
        return 0
    return -(-len(clock) * loop.steps_per_sample // loop.steps_per_law)


def samples_of_law(loop: ClosedLoop) -> int:
    """Samples after which a step of the law and a sample begin together again."""
    if not loop.steps_per_law:
        return 1
    return loop.steps_per_law // math.gcd(loop.steps_per_law, loop.steps_per_sample)


def column_at(
    values: Floats, clock: Clock, *, held: bool
) -> Callable[[Floats, NDArray[Any]], Floats]:
    """A function of times t (K,) [s] and their samples (K,) that reads a column (N, n) of a log.

    Values are `held` from each sample to the next, or on straight lines between samples.
    """
    if not held:
        return lambda t, sample: clock.between(values, t)
    bridged = clock.bridged(values)
    return lambda t, sample: bridged[sample]


def in_blocks(
    loop: ClosedLoop,
    path: Path | Logged,
    clock: Clock,
    logged: Floats | None = None,
    injected: Floats | None = None,
    columns: Sequence[Sequence[int]] | None = None,
    *,
    samples: int,
) -> Iterator[tuple[Floats, ...]]:
    """The tables in blocks of about `samples`, each of which begins with a step of the law."""
    steps = loop.steps_per_sample
    every = loop.steps_per_law
    transport = loop.rig.transport
    jitter = loop.rig.jitter
    # Only a reference can be the wrong one; counts fit any law.
    if isinstance(path, Path):
        path.require_fit(loop.law)
    replayed = {
        name: column_at(values, clock, held=name == "injected" or not loop.law.interpolates)
        for name, values in (("logged", logged), ("injected", injected))
        if values is not None
    }
    of_law = _law_steps(loop, clock)
    # One word and one draw per step of the law, for the whole run: blocks must not change them.
    words = transport.words(of_law) if transport is not None else np.empty(0)
    draws = jitter.draws(of_law) if jitter is not None else np.empty(0)

    def rows_at(table, t, places):
        """Rows of one of the three tables, at times t (K,) in these sub-steps (K,)."""
        motion, pulses = path(t)
        # The motion itself is dearer than the counts' own; only the law's table needs it, or all
        # where the law is evaluated in every sub-step.
        if loop.follows_motion and (table == 0 or not every):
            motion = path.setpoint(t)
        sample = places // steps
        inputs = {
            "q_r": motion.q,
            "qd_r": motion.qd,
            "qdd_r": motion.qdd,
            "pulses_r": pulses,
            "h": clock.step_lengths(steps, places),
        }
        inputs |= {name: values_at(t, sample) for name, values_at in replayed.items()}
        if transport is not None:
            inputs["place"] = places % every
            inputs["lost"] = words[places // every]
        if jitter is not None:
            inputs["draw"] = draws[places // every]
        if loop.steps_per_inner:
            inputs["due"] = places % loop.steps_per_inner == 0
        # Inputs that this loop does not have are no columns.
        rows = np.column_stack([inputs[name] for name in loop.time_fields.fields if name in inputs])
        return rows if columns is None else rows[:, [*columns[table], -1]]

    # Blocks of whole units, in each of which a step of the law and a sample begin together.
    unit = samples_of_law(loop)
    samples = max(1, samples // unit) * unit
    for begin in range(0, len(clock), samples):
        block = np.arange(begin, min(begin + samples, len(clock)))
        places = np.arange(block[0] * steps, (block[-1] + 1) * steps)
        at_law = places[places % every == 0] if every else places[:0]
        tables = (
            rows_at(0, clock.starts(steps, at_law, every or 1), at_law),
            rows_at(1, clock.t[block], block * steps),
            rows_at(2, clock.middles(steps, places), places),
        )
        yield tuple(np.ascontiguousarray(table) for table in tables)
