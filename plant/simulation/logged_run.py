"""One run of a closed loop with its log, by the compiled kernel or by casadi, the reference; refused if it diverges."""

import functools
import math
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from plant.mechanics.arm import Arm
from plant.parts.fields import Floats
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.loop_kernel import Structure, loop_kernel
from plant.simulation.time_tables import time_tables


def by_casadi(
    loop: ClosedLoop, tables: tuple[Floats, ...], state: Floats, numbers: Floats
) -> tuple[Floats, int, Floats, Floats]:
    """Final state, steps done, log and true errors: `mapaccum` over whole periods of law and log, then the rest."""
    law_time, sample_time, step_time = tables
    per_sample, per_law = loop.steps_per_sample, loop.steps_per_law
    chunk = math.lcm(per_sample, per_law or per_sample)
    chunks, n = len(step_time) // chunk, loop.n
    law_rows, sample_rows = (chunk // per_law if per_law else 0), chunk // per_sample
    logs: list[Floats] = []
    errors: list[Floats] = []
    done = 0

    def accumulate(count: int, state: Floats) -> Floats:
        nonlocal done
        start = done // chunk
        arguments = [
            _columns(table, start * rows, count * rows)
            for table, rows in ((law_time, law_rows), (sample_time, sample_rows), (step_time, chunk))
        ]
        repeated = _repeated(Structure(loop), chunk, count)
        states, log, error = repeated(state, *arguments, np.repeat(numbers[:, None], count, axis=1))
        logs.append(log.full().T.reshape(-1, loop.n_log))
        errors.append(error.full().T.reshape(-1, n))
        done += count * chunk
        return states.full()[:, -1]

    if chunks:
        state = accumulate(chunks, state)
    for i in range(done, len(step_time)):
        if loop.law_step is not None and i % per_law == 0:
            state = loop.law_step(state, law_time[i // per_law], numbers).full()[:, 0]
        if i % per_sample == 0:
            state, log = (x.full()[:, 0] for x in loop.sample(state, sample_time[i // per_sample], numbers, []))
            logs.append(log[None])
        state, error = (x.full()[:, 0] for x in loop.substep(state, step_time[i], numbers))
        errors.append(error[None])
    log, error = np.vstack(logs), np.vstack(errors)
    bad = np.flatnonzero(~np.isfinite(error).all(axis=1))
    return state, int(bad[0]) if len(bad) else len(step_time), log, error


@functools.lru_cache(maxsize=8)
def _repeated(key: Structure, chunk: int, count: int) -> ca.Function:
    return _chunk(key.loop, chunk).mapaccum("loop", count, {"base": 2})


def _columns(table: Floats, start: int, count: int) -> Floats:
    return np.ascontiguousarray(table[start : start + count].T)


def _chunk(loop: ClosedLoop, chunk: int) -> ca.Function:
    """(state, law rows, sample rows, step rows, numbers) -> (state, log, true error) over `chunk` sub-steps."""
    times, per_law = len(loop.time_names), loop.steps_per_law
    state, numbers = ca.MX.sym("state", len(loop.state_names)), ca.MX.sym("numbers", len(loop.number_names))
    law_time = ca.MX.sym("law_time", times, chunk // per_law if per_law else 0)
    sample_time = ca.MX.sym("sample_time", times, chunk // loop.steps_per_sample)
    step_time = ca.MX.sym("step_time", times, chunk)
    inputs, logs, errors = [state, law_time, sample_time, step_time, numbers], [], []
    for i in range(chunk):
        if loop.law_step is not None and i % per_law == 0:
            state = loop.law_step(state, law_time[:, i // per_law], numbers)
        if i % loop.steps_per_sample == 0:
            state, log = loop.sample(state, sample_time[:, i // loop.steps_per_sample], numbers, ca.MX(0, 1))
            logs.append(log)
        state, error = loop.substep(state, step_time[:, i], numbers)
        errors.append(error)
    return ca.Function("chunk", inputs, [state, ca.horzcat(*logs), ca.horzcat(*errors)]).expand()


def logged_run(loop: ClosedLoop, arm: Arm, driven: tuple[Any, ...], start: Any, backend: str) -> tuple[Floats, Floats]:
    """Log and true errors of a run from a start, or a refusal where it diverges.

    It is driven by a path, a clock, what is replayed and what is injected, as for `time_tables`.
    """
    numbers = loop.number_values(arm.f)
    state = loop.initial_state(start[0], start[1], numbers)
    if backend == "numba":
        final, log, true_error = _by_kernel(loop, driven, state, numbers)
    else:
        final, _, log, true_error = by_casadi(loop, time_tables(loop, *driven), state, numbers)
    if not (final[-1] > 0 and bounded(final[: 2 * loop.n])):
        refuse_divergence(loop, arm, log, final)
    return log, true_error


def _by_kernel(
    loop: ClosedLoop, driven: tuple[Any, ...], state: Floats, numbers: Floats
) -> tuple[Floats, Floats, Floats]:
    path, clock, replayed, injected = driven
    samples, steps = len(clock), len(clock) * loop.steps_per_sample
    log, true_error = np.full((samples, loop.n_log), np.nan), np.full((steps, loop.n), np.nan)
    kernel = loop_kernel(loop, uneven=clock.even is None)
    nothing = np.empty((samples, 0))
    tables = kernel.along(loop, path, clock, nothing, logged=True, replayed=replayed, injected=injected)
    final, _ = kernel.run(tables, state[:, None], np.empty((0, 1)), numbers, (log, true_error))
    return final[:, 0], log, true_error


class DivergenceError(ValueError):
    """A closed loop that did not stay bounded; the message says when, and which joint first.

    See Also
    --------
    plant.simulate, plant.LoadError

    Examples
    --------
    >>> import dataclasses
    >>> from plant import DivergenceError, PD, puma560, simulate
    >>> rig, law = puma560.rig(), PD(gain=(2000, 2000), derivative=(0, 0), filter=600.0)
    >>> unlimited = dataclasses.replace(rig.drive, current_limit=(float("inf"), float("inf")))
    >>> try:
    ...     record = simulate(puma560.arm(), dataclasses.replace(rig, drive=unlimited), law, puma560.reference())
    ... except DivergenceError:
    ...     print("the loop is unstable")
    the loop is unstable
    """


def refuse_divergence(loop: ClosedLoop, arm: Arm, log: Floats, final: Floats) -> NoReturn:
    """Say when and where a simulation diverged."""
    n = loop.n
    q = log[:, 2 * n : 3 * n]
    values = np.abs(np.where(np.isfinite(final[: 2 * n]), final[: 2 * n], np.inf)).reshape(2, n)
    label = arm.dynamics.chain.joint_labels[int(np.argmax(values.max(axis=0)))]
    finite = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e3))
    time = (finite[-1] if len(finite) else 0) * loop.rig.period
    start = q[0] if len(finite) else final[:n]
    arm.require_positive(start)
    raise DivergenceError(
        f"the closed loop must stay bounded; it diverges after t = {time:.4f} s, {label} first. "
        "Lower the gains, shorten the law's period, or check that f belongs to this arm."
    )
