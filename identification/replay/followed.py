"""One record, ready to be followed by a model that is corrected at every sample."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.law_memory import FADED, Memory, Resumption
from identification.replay.experiment import Experiment
from identification.replay.rounding import Rounding
from plant import Dynamics, Record
from plant.simulation.closed_loop import bounded

__all__ = ["Followed"]

_LOST, _SETTLING = 4.5, 80
"""Periods that may be missing, and samples after a longer gap that are not compared."""

_WINDOW = 10
"""Samples before and after, over which the speed of the counts is taken."""

_SLOW, _RINGING = 1.0, 30
"""Counts per sample below which the loop feels single counts, and samples that this is felt for."""


class Followed(Experiment):
    """One record, ready to be followed."""

    def __init__(
        self, dynamics: Dynamics, record: Record, unknown: Sequence[str], options: dict[str, Any], steady: bool,
        memory: Memory | None,
    ) -> None:  # fmt: skip
        self.memory, self._steady = memory, steady
        super().__init__(dynamics, record, unknown, smooth=True, **options)
        self._given = len(self.places)
        self.remembered = 0 if memory is None else memory.usual.size + 2 * dynamics.n
        if memory is not None:
            self.places += [i for i, name in enumerate(self.loop.number_names) if name.startswith("law.state[")]
        self._kernel = self.kernel()
        self._rounding: Rounding | None = None
        self._measure(record.counts)

    def _measure(self, counts: NDArray[np.float64]) -> None:
        """Take counts (N, n) for those of the log."""
        record = self.record
        centres = record.rig.encoder.position_in_pulses(record.rig.encoder.cell_centre(counts))
        self._tables = self._kernel.prepared((*self.times, self.data(centres)), logged=True)
        before = np.maximum(np.arange(len(counts)) - _WINDOW, 0)
        after = np.minimum(np.arange(len(counts)) + _WINDOW, len(counts) - 1)
        steps = np.vstack([np.zeros(record.n), np.abs(np.diff(counts, axis=0)).cumsum(axis=0)])
        moved = (steps[after] - steps[before]) / np.maximum(after - before, 1)[:, None]
        self.weight = np.sqrt(np.minimum(1.0, moved) * (record.valid * self._settled())[:, None])
        if self._steady and not self.loop.law.replays:
            self.weight *= _steady(moved)[:, None]

    def _settled(self) -> NDArray[np.float64]:
        """0 (N,) while a replay has not converged to the log: after a gap, or a start at an unknown speed; else 1."""
        settled, record = np.ones(len(self.record)), self.record
        if self.memory is not None:
            settled[:FADED] = 0
        if record.law is None or not record.law.replays or self.memory is not None:
            return settled
        measured = np.flatnonzero(record.valid)
        begins = measured[1:][np.diff(record.t[measured]) > _LOST * record.rig.period].tolist()
        if record.reference is None and record.initial is None and self.begin[1].any():
            begins.append(0)
        for row in begins:
            settled[row : row + _SETTLING] = 0
        return settled

    def resumption(self, values: NDArray[np.float64]) -> Resumption | None:
        """Where law and arm were at the first sample, of values; None where it is known."""
        if self.memory is None:
            return None
        state = self.memory.at(values[self._given :][: self.memory.usual.size])
        return Resumption(state, np.add(self.begin, values[-2 * self.loop.n :].reshape(2, -1)))

    def _start(self, values: NDArray[np.float64]) -> tuple[Any, NDArray[np.float64]]:
        """Position and speed at the start, and all numbers of the loop, of values."""
        numbers, resumed = self.numbers.copy(), self.resumption(values)
        if resumed is not None:
            values = np.append(values[: self._given], resumed.state)
        numbers[self.places] = values
        return self.began(numbers) if resumed is None else resumed.initial, numbers

    @property
    def rounds(self) -> bool:
        """Whether the arm of the log felt the rounding of its counts, which the model leaves out."""
        return not (self.loop.law.replays or self.record.rig.encoder.smooth)

    def rounded(self, values: NDArray[np.float64], shift: NDArray[np.float64]) -> Followed:
        """The same, of the log that the model itself makes with these values, its encoders shifted (n,) and rounding.

        Raises
        ------
        ValueError
            An arm that diverges.
        """
        if self._rounding is None:
            self._rounding = Rounding(self.loop, self.record)
        other = copy.copy(self)
        other._measure(self._rounding.counts(*self._start(values), self.loop.number_names, shift))
        return other

    def run(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log (N, 4n) and final state of a run with these values."""
        (q, qd), numbers, n = *self._start(values), self.loop.n
        state = self.loop.initial_state(q + numbers[-n:], qd, numbers)  # where the counters' zero is
        log, errors = np.full((len(self.clock), self.loop.n_log), np.nan), np.empty((self.steps, n))
        final, _ = self._kernel.run(self._tables, state[:, None], np.empty((0, 1)), numbers, (log, errors))
        return log[self.clock.rows], final[:, 0]

    def innovations(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        (log, final), n = self.run(values), self.loop.n
        sound = final[-1] > 0 and bounded(final[: 2 * n]) and np.isfinite(log[:, :n]).all()
        return (log[:, :n] * self.weight).ravel() if sound else np.full(log[:, :n].size, np.inf)


def _steady(moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 (N,) while all joints pass counts (N, n) fast enough, and 0 while one is slow and for a while after it.

    A slow joint's counts change one by one; the torque of each, which a model without rounding lacks, excites elastic
    gears like a compliance of their own. A joint that is slow most of the time is left out of this.
    """
    slow = (moved < _SLOW)[:, (moved < _SLOW).mean(axis=0) < 0.5].any(axis=1)
    felt, rows = np.append(0, np.cumsum(slow)), np.arange(slow.size)
    return np.asarray(felt[rows + 1] == felt[np.maximum(rows - _RINGING, 0)], dtype=float)
