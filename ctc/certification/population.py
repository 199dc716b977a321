"""Closed loops of many plants under one law, simulated side by side.

The law, and so its model, is the same in all; only the plants differ. Of a run a few numbers are kept, worked out in
the kernel at every sample.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.certification.plants import Plants
from plant import Law, Reference, Rig
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.followed_path import Path
from plant.simulation.loop_kernel import LANES, loop_kernel
from plant.simulation.threads import shared_out
from plant.simulation.time_tables import time_tables

__all__ = ["Population", "Runs"]


@functools.lru_cache(maxsize=32)
def tally(rig: Rig) -> ca.Function:
    """What one sample adds, (log, data, memory) -> 1 if a joint's counted error is outside, memory.

    The data are the limit [pulses], whether the sample counts (1 or 0), its time after the start of the one before
    the first [s], and q_r. The memory holds, per joint, the largest counted error, the highest and lowest error of the
    joint before rounding [pulses], and the largest motor current [A]; and the time of the first sample outside.
    """
    n, elastic = rig.n, rig.drive.elasticity is not None
    log, data, memory = ca.SX.sym("log", (4 + elastic) * n), ca.SX.sym("data", n + 3), ca.SX.sym("memory", 4 * n + 1)
    counted, highest, lowest, current = ca.vertsplit(memory[:-1], n)
    limit, counts, time, first = data[0], data[1], data[2], memory[-1]
    error = counts * ca.fabs(log[:n])
    position = log[-n:] if elastic and rig.encoder.side == "motor" else log[2 * n : 3 * n]
    unrounded = counts * rig.position_in_pulses(data[3:] - position)
    outside = functools.reduce(ca.fmax, ca.vertsplit(error)) > limit
    following = ca.vertcat(
        ca.fmax(counted, error),
        ca.fmax(highest, unrounded),
        ca.fmin(lowest, unrounded),
        ca.fmax(current, ca.fabs(rig.drive.current(log[n : 2 * n]))),
        first + outside * (first == 0) * time,
    )
    return ca.Function("tally", [log, data, memory], [outside, following])


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """Results of P runs of n joints.

    Attributes
    ----------
    peak : (P, n) numpy.ndarray
        Largest counted error, magnitude [pulses]; inf where the loop diverged.
    unrounded : (P, n) numpy.ndarray
        The same before the encoder rounds, seen from its own zero, at the samples.
    outside : (P,) numpy.ndarray
        Samples at which a joint is outside the limit.
    current : (P, n) numpy.ndarray
        Largest motor current [A].
    first : (P,) numpy.ndarray
        Time of the first sample outside [s]; NaN where there is none.
    lost : (P,) numpy.ndarray
        Samples whose counts did not arrive.
    samples : int
        Of each run, those that count.
    """

    peak: NDArray[np.float64]
    unrounded: NDArray[np.float64]
    outside: NDArray[np.int64]
    current: NDArray[np.float64]
    first: NDArray[np.float64]
    lost: NDArray[np.int64]
    samples: int


class Population:
    """Plants under a law on a reference, ready to run.

    Parameters
    ----------
    plants : Plants
    law : Law
    reference : Reference
    within : float
        Limit [pulses].
    steps_per_sample : int
    duration : float
        [s]
    after : float
        Samples before do not count [s].
    """

    def __init__(
        self, plants: Plants, law: Law, reference: Reference, *, within: float, steps_per_sample: int, duration: float,
        after: float = 0.0,
    ) -> None:  # fmt: skip
        rig = plants.rig
        nominal = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, phase=None), transport=None)
        loop = ClosedLoop(
            dynamics=plants.arm.dynamics, rig=rig, law=law, steps_per_sample=steps_per_sample, score=tally(nominal)
        )
        clock = Clock.regular(math.ceil(duration / rig.period - 1e-9), rig.period)
        path = Path(reference, rig)
        self.loop, self.plants, self.clock = loop, plants, clock
        counts = clock.t >= after - 1e-9 * rig.period
        self.samples = int(counts.sum())
        self._times = time_tables(loop, path, clock)
        self.law_steps, self._steps = len(self._times[0]), len(self._times[2])
        names, self._values = plants.numbers()
        if plants.dropped:
            names = (*names, "transport.bit")
        lanes = [loop.number_names.index(name) for name in names]
        self._kernel = loop_kernel(loop, lanes)
        data = [np.full(len(clock), float(within)), counts, clock.t + rig.period, reference(clock.t).q]
        self._tables = self._kernel.prepared((*self._times, np.column_stack(data)))
        self._numbers, self._start, self._lanes = loop.number_values(plants.arm.f), path.start(), lanes

    def run(self, threads: int) -> Runs:
        """Run all plants.

        Returns
        -------
        Runs
        """
        blocks = shared_out(self._block, range(-(-len(self.plants) // LANES)), threads)
        final, missing = (np.concatenate(each) for each in zip(*blocks, strict=True))
        n = self.loop.n
        counted, highest, lowest, current = np.hsplit(final[:, -3 - 4 * n : -3], 4)
        shift = np.zeros(n)
        names = list(self.plants.names)
        if "encoder.phase.shift[0]" in names:
            shift = self.plants.values[:, [names.index(f"encoder.phase.shift[{i}]") for i in range(n)]]
        diverged = ~((final[:, -1] > 0) & bounded(final[:, : 2 * n].T))
        unrounded = np.maximum(np.abs(highest - shift), np.abs(lowest - shift))
        return Runs(
            peak=np.where(diverged[:, None], np.inf, counted),
            unrounded=np.where(diverged[:, None], np.inf, unrounded),
            outside=np.where(diverged, self.samples, final[:, -2]).astype(int),
            current=current,
            first=np.where(final[:, -3] > 0, final[:, -3] - self.loop.rig.period, np.nan),
            lost=missing,
            samples=self.samples,
        )

    def _block(self, block):
        """Final states (W, s) of at most `LANES` loops, and their lost counts; empty lanes repeat the last."""
        values = self._values[block * LANES : (block + 1) * LANES]
        count, tables, missing = len(values), self._tables, np.zeros(LANES, int)
        lanes = np.vstack([values, np.repeat(values[-1:], LANES - count, axis=0)]).T
        if self.plants.dropped:
            lost, bits = self.plants.lost(block, LANES, self.law_steps), 2.0 ** np.arange(LANES)
            lanes, missing = np.vstack([lanes, 1 / bits]), lost.sum(axis=0)
            law_time = self._times[0].copy()
            law_time[:, self.loop.time_names.index("lost")] = lost @ bits
            nothing = (self._times[1][:0], self._times[2][:0], np.empty((0, self.loop.n_data)))
            tables = (self._kernel.prepared((law_time, *nothing))[0], *tables[1:])
        numbers = np.repeat(self._numbers[:, None], LANES, axis=1)
        numbers[self._lanes] = lanes
        state = np.ascontiguousarray(self.loop.initial_state(*self._start, numbers))
        uniform = self._numbers[list(self._kernel.uniform)]
        final, steps = self._kernel.run(tables, state, np.ascontiguousarray(lanes), uniform)
        if steps < self._steps:  # all have diverged
            final[-1] = 0.0
        return final[:, :count].T, missing[:count]
