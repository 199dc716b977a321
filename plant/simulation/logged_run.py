"""One run of a closed loop with its log, by the compiled kernel or by casadi, the reference."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from plant.mechanics import Arm
from plant.parts import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.loop_kernel import Structure, loop_kernel
from plant.simulation.time_tables import time_tables


def by_casadi(
    loop: ClosedLoop, tables: tuple[Floats, ...], state: Any, numbers: Floats
) -> tuple[Floats, int, Floats, Floats]:
    """Final state, steps done, log and true errors, by casadi's functions."""
    per_sample = loop.steps_per_sample
    per_law = loop.steps_per_law
    steps = len(tables[-1])

    # 1. `mapaccum` runs all complete chunks. A chunk is the shortest time that has whole periods
    # both of the law and of the log, so that all chunks are alike, whatever the two rates are.
    chunk = math.lcm(per_sample, per_law or per_sample)
    chunks, remaining = divmod(steps, chunk)
    law_rows = chunks * chunk // per_law if per_law else 0
    rows = law_rows, chunks * chunk // per_sample, chunks * chunk
    logs = []
    errors = []
    if chunks:
        columns = [
            np.ascontiguousarray(table[:count].T) for table, count in zip(tables, rows, strict=True)
        ]
        repeated = _repeated(Structure(loop), chunk, chunks)
        states, log, error = repeated(state, *columns, np.repeat(numbers[:, None], chunks, axis=1))
        # The last state of a chunk is that with which the remaining sub-steps begin.
        state = states[:, -1]
        logs.append(log.full().T)
        errors.append(error.full().T)

    # 2. The sub-steps that remain are run one by one.
    if remaining:
        columns = [table[count:].T for table, count in zip(tables, rows, strict=True)]
        state, log, error = _stepped(loop, state, columns, numbers, remaining)
        logs.append(log.full().T)
        errors.append(error.full().T)
    # Sub-steps in order: the chunks, then what remained.
    true_error = np.vstack(errors)
    # After a divergence the kernel ends, but the functions of casadi go on with NaN. So only the
    # steps before the first error that is not finite count as done.
    diverged = np.flatnonzero(~np.isfinite(true_error).all(axis=1))
    done = int(diverged[0]) if len(diverged) else steps
    return state.full()[:, -1], done, np.vstack(logs), true_error


def _stepped(
    loop: ClosedLoop, state: Any, times: Sequence[Any], numbers: Any, steps: int
) -> tuple[Any, Any, Any]:
    """State, log and true errors after some sub-steps; symbols or numbers.

    A sample and a period of the law must begin with the first of these sub-steps. The columns of
    the three matrices in `times` are the rows of the tables for law, samples and sub-steps.
    """
    law_time, sample_time, step_time = times
    logs = []
    errors = []
    for i in range(steps):
        # A law on fast hardware has no step of its own: it is part of the sub-step.
        if loop.law_step is not None and i % loop.steps_per_law == 0:
            state = loop.law_step(state, law_time[:, i // loop.steps_per_law], numbers)
        if i % loop.steps_per_sample == 0:
            state, log = loop.sample(
                state, sample_time[:, i // loop.steps_per_sample], numbers, ca.DM(0, 1)
            )
            logs.append(log)
        state, error = loop.substep(state, step_time[:, i], numbers)
        errors.append(error)
    return state, ca.horzcat(*logs), ca.horzcat(*errors)


@functools.lru_cache(maxsize=8)
def _repeated(key: Structure, chunk: int, count: int) -> ca.Function:
    """The Function of a loop over `count` chunks of sub-steps.

    (states, law rows, sample rows, step rows, numbers) -> (states, log, true error).
    """
    loop = key.loop
    per_law = loop.steps_per_law
    rows = {
        "law": chunk // per_law if per_law else 0,
        "sample": chunk // loop.steps_per_sample,
        "step": chunk,
    }
    state = ca.MX.sym("state", len(loop.state_names))
    numbers = ca.MX.sym("numbers", len(loop.number_names))
    times = [ca.MX.sym(name, len(loop.time_names), size) for name, size in rows.items()]
    # One chunk is expanded to scalar operations; `mapaccum` then repeats this chunk.
    once = ca.Function(
        "chunk", [state, *times, numbers], _stepped(loop, state, times, numbers, chunk)
    ).expand()
    return once.mapaccum("loop", count, {"base": 2})


def logged_run(
    loop: ClosedLoop, arm: Arm, driven: tuple[Any, ...], start: Any, backend: str
) -> tuple[Floats, Floats]:
    """Log and true errors of a run from a start; a run that diverges raises an error.

    `driven` holds the path, the clock, the replayed column and the injected torque that drive the
    run, in the order of `time_tables`.
    """
    numbers = loop.number_values(arm.f)
    state = loop.initial_state(start[0], start[1], numbers)
    # The kernel writes its log in place; casadi needs all tables at once.
    if backend == "numba":
        final, log, true_error = _by_kernel(loop, driven, state, numbers)
    else:
        final, _, log, true_error = by_casadi(loop, time_tables(loop, *driven), state, numbers)
    # The last state tells whether the run diverged, because it keeps a mark of any divergence.
    if not loop.sound(final):
        refuse_divergence(loop, arm, driven[1], log, final)
    return log, true_error


def _by_kernel(
    loop: ClosedLoop, driven: tuple[Any, ...], state: Floats, numbers: Floats
) -> tuple[Floats, Floats, Floats]:
    path, clock, replayed, injected = driven
    samples = len(clock)
    steps = len(clock) * loop.steps_per_sample
    # If the loop diverges, the kernel ends early, and the rows that it has not written stay NaN.
    log = np.full((samples, loop.n_log), np.nan)
    true_error = np.full((steps, loop.n), np.nan)
    kernel = loop_kernel(loop, uneven=clock.even is None)
    no_data = np.empty((samples, 0))
    tables = kernel.along(
        loop, path, clock, no_data, logged=True, replayed=replayed, injected=injected
    )
    final, _ = kernel.run(tables, state[:, None], np.empty((0, 1)), numbers, (log, true_error))
    return final[:, 0], log, true_error


class DivergenceError(ValueError):
    """A closed loop that did not stay bounded; the message has the time and the joint."""


def refuse_divergence(
    loop: ClosedLoop, arm: Arm, clock: Clock, log: Floats, final: Floats
) -> NoReturn:
    """Raise an error with the time at which a simulation diverged, and the joint."""
    state = loop.read_state(final)
    q = loop.log_fields.read(log.T, loop.n).q.T
    # In these samples all positions are finite, and none is yet far beyond any position of an arm.
    # The last of them gives the time.
    sane = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e3))
    last = sane[-1] if len(sane) else 0
    time = clock.t[last]
    # The largest position or speed of the final state names the joint. Coupling spreads a value
    # that is not finite to all joints within a step: of several such joints, the one that moved
    # most between the last two sane samples is named.
    size = np.abs([state.q, state.qd]).max(axis=0)
    lost = ~np.isfinite(size)
    if lost.any():
        moved = np.nan_to_num(np.abs(q[last] - q[max(last - 1, 0)]))
        size = np.where(lost, 1 + moved, 0.0)
    label = arm.dynamics.chain.joint_labels[int(np.argmax(size))]
    # An arm whose inertia matrix D is not positive definite diverges in any loop. For such an arm
    # `require_positive` raises an error with its own message.
    arm.require_positive(q[0] if len(sane) else state.q)
    raise DivergenceError(
        f"the closed loop must stay bounded; it diverges after t = {time:.4f} s, {label} first. "
        "Lower the gains, shorten the law's period, or check that f belongs to this arm."
    )
