"""The reference of a loop, tabulated beforehand for every step of the law, the log and the plant.

Samples are at the times of a `Clock`. The sub-steps read the reference at their middle. A logged or
injected torque, or a current, is held from its sample to the next, and interpolated linearly across
gaps; logged counts are on straight lines.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from plant.parts.fields import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import Logged, Path

_ROWS = 1 << 17  # that are made at once: what a path needs meanwhile is several times a table


def time_tables(
    loop: ClosedLoop,
    path: Path | Logged,
    clock: Clock,
    logged: Floats | None = None,
    injected: Floats | None = None,
    columns: Sequence[Sequence[int]] | None = None,
) -> tuple[Floats, ...]:
    """Rows of `loop.time_names` for every step of the law, the log and the plant.

    The law replays what was `logged` (N, n); the `injected` torque (N, n) acts beside it [N m], if
    the loop has one. Each table gets its `columns`, by default all, with the length of a step
    behind them.
    """
    steps, tables, done = loop.steps_per_sample, list[Floats](), [0, 0, 0]
    of_law = -(-len(clock) * steps // loop.steps_per_law) if loop.steps_per_law else 0
    for block in in_blocks(
        loop, path, clock, logged, injected, columns, samples=max(1, _ROWS // steps)
    ):
        if len(block[1]) == len(clock):
            return block
        if not tables:
            counts = of_law, len(clock), len(clock) * steps
            tables = [
                np.empty((count, part.shape[1])) for count, part in zip(counts, block, strict=True)
            ]
        for i, part in enumerate(block):
            tables[i][done[i] : done[i] + len(part)] = part
            done[i] += len(part)
    return tuple(tables)


def samples_of_law(loop: ClosedLoop) -> int:
    """Samples after which a step of the law begins together with one."""
    return (
        loop.steps_per_law // math.gcd(loop.steps_per_law, loop.steps_per_sample)
        if loop.steps_per_law
        else 1
    )


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
    """The tables of about so many samples after another; each block begins with a step of the
    law.
    """
    steps = loop.steps_per_sample
    every = loop.steps_per_law
    transport = loop.rig.transport
    jitter = loop.rig.jitter
    if isinstance(path, Path):
        path.require_fit(loop.law)
    reading = loop.law.replays == "counts"
    held = None if logged is None or reading else clock.bridged(logged)
    beside = None if injected is None else clock.bridged(injected)
    of_law = -(-len(clock) * steps // every) if every else 0
    words = transport.words(of_law) if transport is not None else np.empty(0)
    draws = jitter.draws(of_law) if jitter is not None else np.empty(0)

    def rows_at(i: int, t: Floats, places: NDArray[np.int_]) -> Floats:
        motion, pulses = path(t)
        if loop.follows_motion and (i == 0 or not every):
            motion = path.setpoint(t)
        owner = places // steps  # the sample that each sub-step belongs to
        inputs = {
            "q_r": motion.q,
            "qd_r": motion.qd,
            "qdd_r": motion.qdd,
            "pulses_r": pulses,
            "h": clock.step_lengths(steps, places),
        }
        if logged is not None:
            inputs["logged"] = clock.between(logged, t) if held is None else held[owner]
        if beside is not None:
            inputs["injected"] = beside[owner]
        if transport is not None:
            inputs["place"] = places % every
            inputs["lost"] = words[places // every]
        if jitter is not None:
            inputs["draw"] = draws[places // every]
        # Inputs that this loop does not have are no columns.
        rows = np.column_stack([inputs[name] for name in loop.time_fields.fields if name in inputs])
        return rows if columns is None else rows[:, [*columns[i], -1]]

    whole = samples_of_law(loop)
    samples = max(1, samples // whole) * whole
    for begin in range(0, len(clock), samples):
        some = np.arange(begin, min(begin + samples, len(clock)))
        places = np.arange(some[0] * steps, (some[-1] + 1) * steps)
        of_steps = places[places % every == 0] if every else places[:0]
        times = (
            clock.starts(steps, of_steps, every or 1),
            clock.t[some],
            clock.middles(steps, places),
        )
        those = of_steps, some * steps, places
        yield tuple(
            np.ascontiguousarray(rows_at(i, t, at))
            for i, (t, at) in enumerate(zip(times, those, strict=True))
        )
