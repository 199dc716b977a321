"""The one simulator: an arm with a rig under a law, following a reference, gives a record."""

from __future__ import annotations

import dataclasses
import functools
import math

import casadi as ca
import numpy as np

from plant.check import array, choice, known_options
from plant.kernel import LoopKernel
from plant.loop import ClosedLoop
from plant.record import Record
from plant.tables import Logged, Path, time_tables

__all__ = ["Trace", "loop_kernel", "path_of", "replay_start", "run", "simulate"]


@known_options
def simulate(arm, rig, law, reference, *, duration=None, steps_per_sample=4, initial=None, backend="numba"):
    """Simulate the closed loop and log it as the experiment does.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    law : Law
    reference : Reference
    duration : float, optional
        [s]; by default the reference's own. There are ceil(duration / period) samples, at t_k = k period from 0.
    steps_per_sample : int
        Integration steps between two samples; 4 is accurate to the noise of the encoder, 16 is nearly converged.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.
    backend : {"numba", "casadi"}
        The compiled kernel, or casadi evaluating the same step.

    Returns
    -------
    Record
        With torque, current and the true joint motion.

    Raises
    ------
    ValueError
        Bad input, or a loop that diverges (with time and joint).
    """
    choice("backend", backend, ("numba", "casadi"))
    trace = run(arm, rig, law, reference, duration, steps_per_sample, initial, backend)
    return trace.record


@dataclasses.dataclass(frozen=True)
class Trace:
    """A record together with what happened between its samples.

    Attributes
    ----------
    record : Record
    true_error_pulses : (N steps_per_sample, n) numpy.ndarray
        Reference minus position, unrounded, at the middle of every sub-step [pulses].
    """

    record: Record
    true_error_pulses: np.ndarray


def run(arm, rig, law, reference, duration, steps_per_sample, initial, backend):
    """`simulate`, with the sub-steps kept."""
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=steps_per_sample)
    duration = reference.duration if duration is None else duration
    if not isinstance(duration, (int, float, np.number)) or not np.isfinite(duration) or duration <= 0:
        raise ValueError(f"duration must be a positive time [s]; got {duration!r}. Leave it out for one period.")
    samples = math.ceil(duration / rig.period - 1e-9)
    path = Path(reference, rig)
    tables = (*time_tables(loop, path, samples), np.empty((samples, 0)))
    if initial is not None:
        initial = array("initial", initial, (2, rig.n), advice="Give q and qd at t = 0.")
    state = loop.initial_state(*replay_start(path, initial))
    numbers = loop.number_values(arm.f)
    evaluate = _by_kernel if backend == "numba" else _by_casadi
    final, steps, log, true_error = evaluate(loop, tables, state, numbers)
    n = rig.n
    if not final[-1] > 0:
        _refuse(loop, arm, log, final, steps)
    error, torque, q, qd = (log[:, i * n : (i + 1) * n] for i in range(4))
    t = np.arange(samples) * rig.period
    record = Record(
        t=t,
        reference_pulses=path(t)[1],
        error_pulses=error,
        torque=torque,
        current=rig.drive.current(torque),
        rig=rig,
        law=law,
        reference=reference,
        initial=initial,
        true_q=q,
        true_qd=qd,
    )
    return Trace(record, true_error)


def path_of(record):
    """What a record's loop was asked to follow: its reference where it has one, its logged counts otherwise."""
    if record.reference is not None:
        return Path(record.reference, record.rig)
    return Logged(record.reference_pulses, record.rig)


def replay_start(path, initial):
    """Position and velocity (n,) at t = 0: as given, or the reference's."""
    if initial is not None:
        return initial
    motion, _ = path(np.zeros(1))
    return motion.q[0], motion.qd[0]


@functools.lru_cache(maxsize=64)
def _kernel(key, lanes):
    return LoopKernel(key.loop, lanes)


class _Structure:
    """A loop compared by its structure alone: loops with other numbers share one kernel."""

    def __init__(self, loop):
        self.loop = loop
        functions = (loop.law_step, loop.sample, loop.substep)
        self.key = tuple(None if f is None else f.serialize() for f in functions), loop.steps_per_law

    def __eq__(self, other):
        return self.key == other.key and self.loop.steps_per_sample == other.loop.steps_per_sample

    def __hash__(self):
        return hash(self.key)


def loop_kernel(loop, lanes=()):
    """Compiled kernel of a closed loop; `lanes` are the numbers that differ between individuals."""
    return _kernel(_Structure(loop), tuple(lanes))


def _by_kernel(loop, tables, state, numbers):
    samples, steps = len(tables[1]), len(tables[2])
    log, true_error = np.full((samples, 4 * loop.n), np.nan), np.full((steps, loop.n), np.nan)
    final, done = loop_kernel(loop).run(tables, state[:, None], np.empty((0, 1)), numbers, (log, true_error))
    return final[:, 0], done, log, true_error


def _by_casadi(loop, tables, state, numbers):
    """The same loop by casadi: `mapaccum` over chunks in which law and log come round once, then the rest."""
    law_time, sample_time, step_time, _ = tables
    per_sample, per_law = loop.steps_per_sample, loop.steps_per_law
    chunk = math.lcm(per_sample, per_law or per_sample)
    chunks, n = len(step_time) // chunk, loop.n
    law_rows, sample_rows = (chunk // per_law if per_law else 0), chunk // per_sample
    logs, errors, done = [], [], 0

    def accumulate(count, state):
        nonlocal done
        start = done // chunk
        arguments = [
            _columns(table, start * rows, count * rows)
            for table, rows in ((law_time, law_rows), (sample_time, sample_rows), (step_time, chunk))
        ]
        repeated = _repeated(_Structure(loop), chunk, count)
        states, log, error = repeated(state, *arguments, np.repeat(numbers[:, None], count, axis=1))
        logs.append(log.full().T.reshape(-1, 4 * n))
        errors.append(error.full().T.reshape(-1, n))
        done += count * chunk
        return states.full()[:, -1]

    if chunks:
        state = accumulate(chunks, state)
    for i in range(done, len(step_time)):
        if per_law and i % per_law == 0:
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
def _repeated(key, chunk, count):
    return _chunk(key.loop, chunk).mapaccum("loop", count, {"base": 2})


def _columns(table, start, count):
    return np.ascontiguousarray(table[start : start + count].T)


def _chunk(loop, chunk):
    """(state, law rows, sample rows, step rows, numbers) -> (state, log, true error) over `chunk` sub-steps."""
    times, per_law = len(loop.time_names), loop.steps_per_law
    state, numbers = ca.MX.sym("state", len(loop.state_names)), ca.MX.sym("numbers", len(loop.number_names))
    law_time = ca.MX.sym("law_time", times, chunk // per_law if per_law else 0)
    sample_time = ca.MX.sym("sample_time", times, chunk // loop.steps_per_sample)
    step_time = ca.MX.sym("step_time", times, chunk)
    inputs, logs, errors = [state, law_time, sample_time, step_time, numbers], [], []
    for i in range(chunk):
        if per_law and i % per_law == 0:
            state = loop.law_step(state, law_time[:, i // per_law], numbers)
        if i % loop.steps_per_sample == 0:
            state, log = loop.sample(state, sample_time[:, i // loop.steps_per_sample], numbers, ca.MX(0, 1))
            logs.append(log)
        state, error = loop.substep(state, step_time[:, i], numbers)
        errors.append(error)
    return ca.Function("chunk", inputs, [state, ca.horzcat(*logs), ca.horzcat(*errors)]).expand()


def _refuse(loop, arm, log, final, steps):
    """Say when and where a simulation diverged."""
    n = loop.n
    q = log[:, 2 * n : 3 * n]
    values = np.abs(np.where(np.isfinite(final[: 2 * n]), final[: 2 * n], np.inf)).reshape(2, n)
    name = arm.dynamics.chain.links[int(np.argmax(values.max(axis=0)))].name
    finite = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e3))
    time = (finite[-1] if len(finite) else 0) * loop.rig.period
    start = q[0] if len(finite) else final[:n]
    arm.require_positive(start)
    raise ValueError(
        f"the closed loop must stay bounded; it diverges after t = {time:.4f} s, joint {name} first. "
        "Lower the gains, shorten the law's period, or check that f belongs to this arm."
    )
