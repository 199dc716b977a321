"""Closed loops that differ in numbers, simulated side by side.

A run has no log: the kernel updates a few numbers at every sample (`tally`).
"""

import copy
import functools
import math
import secrets
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.compiler import shared_out
from plant.laws import Law
from plant.machine import Rig
from plant.mechanics import Arm
from plant.motion import Reference
from plant.parts import (
    Checkpoint,
    Fields,
    Floats,
    Frozen,
    frozen,
    kept,
    per_joint,
    progress_bar,
    scalars,
)
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.executors import mapped
from plant.simulation.followed_path import Path
from plant.simulation.layout import log_fields_of
from plant.simulation.loop_kernel import LANES, loop_kernel
from plant.simulation.time_tables import time_tables

# Data of a sample, for its score.
DATA = Fields(
    # Largest error that is no violation [pulses].
    limit=scalars(),
    # 1 if the sample counts, 0 while the loop settles.
    counts=scalars(),
    # Time since one period before the start [s], so that 0 can stand for no sample.
    time=scalars(),
    # Position of the reference [rad].
    q_r=per_joint(),
)

# Results of a run so far, which the score updates.
MEMORY = Fields(
    # Largest encoder error [pulses].
    peak=per_joint(),
    # Highest and lowest error of the joint before the encoder rounds [pulses].
    highest=per_joint(),
    lowest=per_joint(),
    # Largest motor current [A].
    current=per_joint(),
    # Sum of the torque's changes from sample to sample, and the last torque [N m].
    change=per_joint(),
    torque=per_joint(),
    # Time of the first sample outside the limit, or 0.
    time=scalars(),
    # Samples outside the limit among those that do not count.
    before=scalars(),
)


@functools.lru_cache(maxsize=32)
def tally(rig: Rig) -> ca.Function:
    """The score of a sample, (log, data, memory) -> 1 if an encoder error is outside, memory.

    `DATA` and `MEMORY` name the fields.
    """
    n = rig.n
    elastic = rig.drive.elasticity is not None
    log_fields = log_fields_of(elastic)
    log_symbols = ca.SX.sym("log", log_fields.length(n))
    data_symbols = ca.SX.sym("data", DATA.length(n))
    memory_symbols = ca.SX.sym("memory", MEMORY.length(n))
    log = log_fields.read(log_symbols, n)
    data = DATA.read(data_symbols, n)
    memory = MEMORY.read(memory_symbols, n)

    # While the loop settles, a sample adds neither an error nor a change of the torque.
    counts = data.counts
    error = counts * ca.fabs(log.error)
    position = log.motor if elastic and rig.encoder.side != "link" else log.q
    unrounded = counts * rig.position_in_pulses(data.q_r - position)
    outside = functools.reduce(ca.fmax, ca.vertsplit(error)) > data.limit
    outside_before = functools.reduce(ca.fmax, ca.vertsplit(ca.fabs(log.error))) > data.limit
    # The first sample, at one period, has no torque before it.
    changes = counts * (data.time > 1.5 * rig.period)
    following = MEMORY.write(
        n,
        peak=ca.fmax(memory.peak, error),
        highest=ca.fmax(memory.highest, unrounded),
        lowest=ca.fmin(memory.lowest, unrounded),
        current=ca.fmax(memory.current, ca.fabs(rig.drive.current(log.torque))),
        change=memory.change + changes * ca.fabs(log.torque - memory.torque),
        torque=log.torque,
        time=memory.time + outside * (memory.time == 0) * data.time,
        before=memory.before + (1 - counts) * outside_before,
    )
    return ca.Function("tally", [log_symbols, data_symbols, memory_symbols], [outside, following])


@kept
@frozen
class Runs(Frozen):
    """Results of P runs of n joints, (P, n) or (P,); in each run `samples` samples count.

    Errors and chatter of a loop that diverged are inf.
    """

    # Largest magnitude, at the samples, of the encoder error, and of the error before the encoder
    # rounds, counted from the encoder's zero [pulses].
    peak: Floats
    unrounded: Floats
    # Samples outside the limit.
    outside: NDArray[np.int64]
    # Largest motor current [A].
    current: Floats
    # Mean change of the torque from sample to sample [N m].
    chatter: Floats
    # Time of the first sample outside [s], or NaN.
    first: Floats
    # Samples outside among those that do not count, and samples whose counts were lost.
    before: NDArray[np.int64]
    lost: NDArray[np.int64]
    samples: int

    def __repr__(self) -> str:
        violations = int((self.outside > 0).sum())
        return f"Runs({len(self.outside)} of {self.samples} samples, {violations} violations)"

    @classmethod
    def joined(cls, several: "Sequence[Runs]") -> "Runs":
        """Runs of the same plants on several references; `first` is the least of their times."""
        columns = {
            field.name: np.array([getattr(runs, field.name) for runs in several])
            for field in fields(cls)
        }
        # Peaks are the largest of all; numbers of samples add up; means are weighted by them.
        largest = {name: columns[name].max(axis=0) for name in ("peak", "unrounded", "current")}
        sums = {name: columns[name].sum(axis=0) for name in ("outside", "before", "lost")}
        samples = int(columns["samples"].sum())
        return cls(
            **largest,
            **sums,
            chatter=np.average(columns["chatter"], axis=0, weights=columns["samples"] / samples),
            first=np.fmin.reduce(columns["first"]),
            samples=samples,
        )


_Block = tuple[Floats, NDArray[np.int64]]
"""Final states (W, s) of the loops that run side by side, and their lost counts (W,)."""

# Populations that a worker process has built, by a random name that is new for each call of `run`.
# A call sends the arguments of its population; a worker builds it once for all blocks of the call.
_BUILT: dict[str, Any] = {}


class Population:
    """Plants (or laws) that differ in numbers, on one reference, ready to run.

    Arm, rig, law and reference give the structure and the common numbers, `names` the numbers of
    the closed loop that differ, with `values` (P, L). Errors above `within` [pulses] count from
    `after` [s] on. The loops start at `initial` (2, n) [rad, rad/s], by default the start of the
    reference. `lost(block, width, steps)` returns (steps, width): whether a loop loses its counts
    at a step of the law.
    """

    def __init__(
        self,
        arm: Arm,
        rig: Rig,
        law: Law,
        reference: Reference,
        names: Sequence[str],
        values: Floats,
        *,
        within: float,
        steps_per_sample: int,
        duration: float,
        after: float = 0.0,
        initial: Floats | None = None,
        lost: Callable[..., NDArray[np.bool_]] | None = None,
    ) -> None:
        self._arguments: dict[str, Any] = {
            "arm": arm,
            "rig": rig,
            "law": law,
            "reference": reference,
            "names": tuple(names),
            "within": within,
            "steps_per_sample": steps_per_sample,
            "duration": duration,
            "after": after,
            "initial": initial,
            "lost": lost,
        }
        # The score is built without transport and without the phase, which `_runs` subtracts.
        encoder = replace(rig.encoder, phase=None)
        loop = ClosedLoop(
            dynamics=arm.dynamics,
            rig=rig,
            law=law,
            steps_per_sample=steps_per_sample,
            score=tally(replace(rig, encoder=encoder, transport=None)),
        )
        clock = Clock.regular(math.ceil(duration / rig.period - 1e-9), rig.period)
        path = Path(reference, rig)
        self.loop = loop
        self._names = tuple(names)
        self._values = values
        self._lost = lost
        # The first sample has no torque before it, so `_changes` leaves it out.
        counts = clock.t >= after - 1e-9 * rig.period
        self.samples = int(counts.sum())
        self._changes = int(counts[1:].sum())
        self._times = time_tables(loop, path, clock)
        self.law_steps = len(self._times[0])
        self._steps = len(self._times[2])
        # The losses of the loops differ, too; `_block` explains `transport.bit`.
        varied = [*names, "transport.bit"] if lost else names
        self._lanes = [loop.number_names.index(name) for name in varied]
        self._kernel = loop_kernel(loop, self._lanes)
        data = {
            "limit": np.full(len(clock), float(within)),
            "counts": counts,
            "time": clock.t + rig.period,
            "q_r": reference(clock.t).q,
        }
        columns = np.column_stack([data[name] for name in DATA.fields])
        self._tables = self._kernel.prepared((*self._times, columns))
        self._numbers = loop.number_values(arm.f)
        self._start = path.start() if initial is None else initial

    def with_values(self, values: Floats) -> Self:
        """The same population with other values (P, L): equations and tables stay."""
        other = copy.copy(self)
        other._values = values
        return other

    def run(
        self,
        threads: int,
        checkpoint: Checkpoint | None = None,
        *,
        progress: bool = False,
        executor: Any = None,
    ) -> Runs:
        """Run all loops, block by block; a block is a stage of the checkpoint.

        On an executor there are neither checkpoint nor progress bar, and `threads` has no effect.
        """
        if executor is not None:
            # Eight blocks per call, so that sending them costs little beside running them.
            size = 8 * LANES
            parts = [
                (i // LANES, self._values[i : i + size]) for i in range(0, len(self._values), size)
            ]
            work = functools.partial(_blocks, secrets.token_hex(8), self._arguments)
            results = mapped(work, parts, executor)
            return self._runs([block for blocks in results for block in blocks])
        stored = Checkpoint(checkpoint, "")

        def block(i):
            values = self._values[i * LANES :][:LANES]
            result = stored.stage(f"loops from {i * LANES}", lambda: self._block(i, values))
            bar.update(len(result[1]))
            return result

        with progress_bar(len(self._values), "closed loops", "loop", progress) as bar:
            return self._runs(shared_out(block, range(-(-len(self._values) // LANES)), threads))

    def _runs(self, blocks):
        final = np.concatenate([states for states, _ in blocks]).T
        n = self.loop.n
        state = self.loop.read_state(final)
        memory = MEMORY.read(state.memory, n)
        # The encoders read zero at their own phase; the true error is counted from there.
        shift = np.zeros((n, 1))
        if "encoder.phase.shift[0]" in self._names:
            columns = [self._names.index(f"encoder.phase.shift[{i}]") for i in range(n)]
            shift = self._values[:, columns].T
        # A loop that has diverged has an infinite error, and is outside in all samples.
        diverged = ~self.loop.sound(final)
        unrounded = np.maximum(np.abs(memory.highest - shift), np.abs(memory.lowest - shift))
        chatter = memory.change / max(self._changes, 1)
        return Runs(
            peak=np.where(diverged, np.inf, memory.peak).T,
            unrounded=np.where(diverged, np.inf, unrounded).T,
            outside=np.where(diverged, self.samples, state.score).astype(int),
            current=memory.current.T,
            chatter=np.where(diverged, np.inf, chatter).T,
            first=np.where(memory.time > 0, memory.time - self.loop.rig.period, np.nan),
            before=memory.before.astype(int),
            lost=np.concatenate([lost for _, lost in blocks]),
            samples=self.samples,
        )

    def _block(self, block, values):
        """Results of at most `LANES` loops; empty lanes repeat the last."""
        count = len(values)
        tables = self._tables
        missing = np.zeros(LANES, int)
        lanes = np.vstack([values, np.repeat(values[-1:], LANES - count, axis=0)]).T
        if self._lost:
            # All loops read one table: a step's losses are the bits of one number, of which each
            # loop takes its own by `transport.bit`.
            lost = self._lost(block, LANES, self.law_steps)
            bits = 2.0 ** np.arange(LANES)
            lanes = np.vstack([lanes, 1 / bits])
            missing = lost.sum(axis=0)
            law_time = self._times[0].copy()
            law_time[:, self.loop.time_names.index("lost")] = lost @ bits
            empty = self._times[1][:0], self._times[2][:0], np.empty((0, self.loop.n_data))
            tables = (self._kernel.prepared((law_time, *empty))[0], *tables[1:])
        numbers = np.repeat(self._numbers[:, None], LANES, axis=1)
        numbers[self._lanes] = lanes
        q, qd = self._start
        state = np.ascontiguousarray(self.loop.initial_state(q, qd, numbers))
        uniform = self._numbers[list(self._kernel.uniform)]
        final, steps = self._kernel.run(tables, state, np.ascontiguousarray(lanes), uniform)
        # The kernel ends early once all loops have diverged.
        if steps < self._steps:
            self.loop.read_state(final).ok[:] = 0.0
        return final[:, :count].T, missing[:count]


def _blocks(name, arguments, part):
    """Run blocks of a population in a worker; `part` is the first block's number and the values."""
    begin, values = part
    # A worker keeps the last four populations.
    while name not in _BUILT and len(_BUILT) >= 4:
        _BUILT.pop(next(iter(_BUILT)), None)
    population = _BUILT.get(name) or Population(values=values, **arguments)
    _BUILT[name] = population
    return [
        population._block(begin + i // LANES, values[i : i + LANES])
        for i in range(0, len(values), LANES)
    ]
