"""One run of a closed loop with its log, by the compiled kernel or by casadi, the reference;
refused if it diverges.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from plant.mechanics.arm import Arm
from plant.parts.fields import Floats
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.loop_kernel import Structure, loop_kernel
from plant.simulation.time_tables import time_tables


def by_casadi(
    loop: ClosedLoop, tables: tuple[Floats, ...], state: Floats, numbers: Floats
) -> tuple[Floats, int, Floats, Floats]:
    """Final state, steps done, log and true errors: `mapaccum` over whole periods of law and
    log, then the rest.
    """
    per_sample = loop.steps_per_sample
    per_law = loop.steps_per_law
    steps = len(tables[-1])
    chunk = math.lcm(per_sample, per_law or per_sample)
    chunks, left = divmod(steps, chunk)
    done = (
        chunks * (chunk // per_law if per_law else 0),
        chunks * chunk // per_sample,
        chunks * chunk,
    )
    parts: list[Any] = []
    if chunks:
        columns = [
            np.ascontiguousarray(table[:count].T) for table, count in zip(tables, done, strict=True)
        ]
        repeated = _repeated(Structure(loop), chunk, chunks)
        parts.append(repeated(state, *columns, np.repeat(numbers[:, None], chunks, axis=1)))
        state = parts[0][0][:, -1]
    if left:
        rest = [table[count:].T for table, count in zip(tables, done, strict=True)]
        parts.append(_stepped(loop, state, rest, numbers, left))
    log, error = (np.vstack([part[i].full().T for part in parts]) for i in (1, 2))
    bad = np.flatnonzero(~np.isfinite(error).all(axis=1))
    return parts[-1][0].full()[:, -1], int(bad[0]) if len(bad) else steps, log, error


def _stepped(
    loop: ClosedLoop, state: Any, times: Sequence[Any], numbers: Any, steps: int
) -> tuple[Any, Any, Any]:
    """State, log and true errors after sub-steps from where a sample and the law's period begin;
    symbols or numbers.

    The columns of `times` are the rows of the tables for law, samples and sub-steps.
    """
    (law_time, sample_time, step_time), logs, errors = times, [], []
    for i in range(steps):
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
    """(states, law rows, sample rows, step rows, numbers) -> (states, log, true error) over
    `count` chunks.
    """
    loop = key.loop
    per_law = key.loop.steps_per_law
    rows = {
        "law": chunk // per_law if per_law else 0,
        "sample": chunk // loop.steps_per_sample,
        "step": chunk,
    }
    state = ca.MX.sym("state", len(loop.state_names))
    numbers = ca.MX.sym("numbers", len(loop.number_names))
    times = [ca.MX.sym(name, len(loop.time_names), size) for name, size in rows.items()]
    once = ca.Function(
        "chunk", [state, *times, numbers], _stepped(loop, state, times, numbers, chunk)
    ).expand()
    return once.mapaccum("loop", count, {"base": 2})


def logged_run(
    loop: ClosedLoop, arm: Arm, driven: tuple[Any, ...], start: Any, backend: str
) -> tuple[Floats, Floats]:
    """Log and true errors of a run from a start, or a refusal where it diverges.

    It is driven by a path, a clock, what is replayed and what is injected, as for `time_tables`.
    """
    numbers = loop.number_values(arm.f)
    state = loop.initial_state(start[0], start[1], numbers)
    if backend == "numba":
        final, log, true_error = _by_kernel(loop, driven, state, numbers)
    else:
        final, _, log, true_error = by_casadi(loop, time_tables(loop, *driven), state, numbers)
    if not loop.sound(final):
        refuse_divergence(loop, arm, log, final)
    return log, true_error


def _by_kernel(
    loop: ClosedLoop, driven: tuple[Any, ...], state: Floats, numbers: Floats
) -> tuple[Floats, Floats, Floats]:
    path, clock, replayed, injected = driven
    samples = len(clock)
    steps = len(clock) * loop.steps_per_sample
    log = np.full((samples, loop.n_log), np.nan)
    true_error = np.full((steps, loop.n), np.nan)
    kernel = loop_kernel(loop, uneven=clock.even is None)
    nothing = np.empty((samples, 0))
    tables = kernel.along(
        loop, path, clock, nothing, logged=True, replayed=replayed, injected=injected
    )
    final, _ = kernel.run(tables, state[:, None], np.empty((0, 1)), numbers, (log, true_error))
    return final[:, 0], log, true_error


class DivergenceError(ValueError):
    """A closed loop that did not stay bounded; the message says when, and which joint first."""


def refuse_divergence(loop: ClosedLoop, arm: Arm, log: Floats, final: Floats) -> NoReturn:
    """Raise an error with the time at which a simulation diverged, and the joint."""
    state = loop.read_state(final)
    q = loop.log_fields.read(log.T, loop.n).q.T
    motion = np.array([state.q, state.qd])
    values = np.abs(np.where(np.isfinite(motion), motion, np.inf))
    label = arm.dynamics.chain.joint_labels[int(np.argmax(values.max(axis=0)))]
    finite = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e3))
    time = (finite[-1] if len(finite) else 0) * loop.rig.period
    start = q[0] if len(finite) else state.q
    arm.require_positive(start)
    raise DivergenceError(
        f"the closed loop must stay bounded; it diverges after t = {time:.4f} s, {label} first. "
        "Lower the gains, shorten the law's period, or check that f belongs to this arm."
    )
