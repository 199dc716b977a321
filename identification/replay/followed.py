"""One record, ready to be followed by a model that is corrected at every sample."""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from identification.equation_error.law_memory import FADED, Memory, Resumption
from identification.replay.experiment import Experiment, Rounding
from plant import Dynamics, Record
from plant.checkup.counts import hardly_moving
from plant.parts.fields import Floats
from plant.simulation.loop_kernel import LOGGED, logged_kernel

# periods that may be missing, and samples after a longer gap that are not compared
_LOST = 4.5
_SETTLING = 80

_WINDOW = 10  # samples before and after, over which the speed of the counts is taken

# Counts per sample below which the loop feels single counts, and samples that this is felt for.
_SLOW = 1.0
_RINGING = 30


class Followed(Experiment):
    """One record, ready to be followed; `heard` (n,): joints that are compared, of `moving`
    those that move.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        record: Record,
        unknown: Sequence[str],
        options: dict[str, Any],
        steady: bool,
        memory: Memory | None,
        moving: bool = False,
    ) -> None:
        self.memory = memory
        self._steady = steady
        super().__init__(dynamics, record, unknown, smooth=True, **options)
        self._given = len(self.places)
        self.remembered = 0 if memory is None else memory.usual.size + 2 * dynamics.n
        if memory is not None:
            self.places += [
                i for i, name in enumerate(self.loop.number_names) if name.startswith("law.state[")
            ]
        self._kernel = logged_kernel(self.loop, self.places, uneven=self.clock.even is None)
        self.heard = ~hardly_moving(record) | (not moving)
        self._tables = self._kernel.along(
            self.loop, **self.driven, data=self._measured(record.counts)
        )
        self._weigh(record.counts)

    def _measured(self, counts: Floats) -> Floats:
        """What the kernel is given of counts (N, n)."""
        encoder = self.record.rig.encoder
        return self.data(encoder.position_in_pulses(encoder.cell_centre(counts)))

    def _weigh(self, counts: Floats) -> None:
        """Weigh samples by how counts (N, n) move."""
        record = self.record
        passed = np.diff(counts, axis=0, prepend=counts[:1])
        moved = speed_of(np.cumsum(np.abs(passed, out=passed), axis=0, out=passed), _WINDOW)
        self.weight = (
            np.sqrt(np.minimum(1.0, moved) * (record.valid * self._settled())[:, None]) * self.heard
        )
        if self._steady and not self.loop.law.replays:
            self.weight *= _steady(moved)[:, None]

    def _settled(self) -> Floats:
        """0 (N,) while a replay has not converged to the log: after a gap, or a start at an
        unknown speed; else 1.
        """
        settled = np.ones(len(self.record))
        record = self.record
        if self.memory is not None:
            settled[:FADED] = 0
        if record.law is None or not record.law.replays or self.memory is not None:
            return settled
        measured = np.flatnonzero(record.valid)
        begins = measured[1:][np.diff(record.t[measured]) > _LOST * record.rig.period].tolist()
        # not as the reference, and by an unknown speed
        if record.initial is None and self.begin[1].any():
            settled[: min(2 * _SETTLING, len(record) // 4)] = 0
        for row in begins:
            settled[row : row + _SETTLING] = 0
        return settled

    def resumption(self, values: Floats) -> Resumption | None:
        """Where law and arm were at the first sample, of values; None where it is known."""
        if self.memory is None:
            return None
        state = self.memory.at(values[self._given :][: self.memory.usual.size])
        return Resumption(state, np.add(self.begin, values[-2 * self.loop.n :].reshape(2, -1)))

    def _start(self, values: Floats) -> tuple[Any, Floats]:
        """Position and speed at the start, and all numbers of the loop, of values."""
        numbers = self.numbers.copy()
        resumed = self.resumption(values)
        if resumed is not None:
            values = np.append(values[: self._given], resumed.state)
        numbers[self.places] = values
        return self.began(numbers) if resumed is None else resumed.initial, numbers

    @property
    def rounds(self) -> bool:
        """Whether the arm of the log felt the rounding of its counts, which the model leaves
        out.
        """
        return not (self.loop.law.replays or self.record.rig.encoder.smooth)

    def rounded(
        self, values: Floats, shifts: Sequence[Floats], threads: int, steps: int
    ) -> list[Floats]:
        """Counts (N, n) of the logs that the model itself makes with values, its encoders shifted
        (n,) and rounding at so many `steps` in a sample.
        """
        start, numbers = self._start(values)
        return Rounding(self.loop, self.record, steps).counts(
            start, numbers, self.loop.number_names, shifts, threads
        )

    def innovations_of(self, values: Floats, counts: Floats) -> Floats:
        """Weighted innovations (N n,) with values (k,), of a log with these counts (N, n)."""
        other = copy.copy(self)
        other._tables = self._kernel.with_data(self._tables, self._measured(counts))
        other._weigh(counts)
        return other.innovations(values)

    def beside(self, torque: Floats) -> Self:
        """The same with another torque (N, n) [N m] injected; what a law repeats is more by what
        is injected more.
        """
        other = copy.copy(self)
        record = self.record
        drive = self.record.rig.drive
        columns: dict[str, Any] = {"injected": torque}
        name = column = "injected"
        if not self.loop.injected:
            more = torque if record.injected is None else torque - record.injected
            name = "logged"
            column = str(self.loop.law.replays)
            more = drive.motor_torque(more) / drive.motor_gain if column == "current" else more
            columns[column] = getattr(record, column) + more
        other.record = dataclasses.replace(record, **columns)
        other._tables = self._kernel.with_held(
            self._tables, name, self.clock.bridged(columns[column])
        )
        return other

    def innovations(self, values: Floats) -> Floats:
        """Weighted innovations (N n,) with values (k,) of the unknowns; inf where the run
        diverges.
        """
        return self.block([values])[0]

    def block(self, some: Sequence[Floats]) -> list[Floats]:
        """The same for at most `LOGGED` vectors of values, side by side; empty lanes repeat the
        last.
        """
        n = self.loop.n
        loop = self.loop
        states = []
        lanes = []
        for values in some:
            (q, qd), numbers = self._start(values)
            # where the encoder offset is
            states.append(loop.initial_state(q + numbers[-n:], qd, numbers))
            lanes.append(numbers[self.places])
        empty = LOGGED - len(states)
        state, lane = (np.array(rows + rows[-1:] * empty).T.copy() for rows in (states, lanes))
        uniform = self.numbers[list(self._kernel.uniform)]
        rows = self.clock.rows
        found = np.empty((len(some), len(self.clock.rows), n))
        sound = np.ones(LOGGED, bool)
        for part, tables in self._kernel.parts(self._tables, len(self.clock)):
            state, errors = self._kernel.run(tables, part.stop - part.start, state, lane, uniform)
            own = slice(*np.searchsorted(rows, (part.start, part.stop)).tolist())
            seen = errors[rows[own] - part.start]
            sound &= np.isfinite(seen).all(axis=(0, 1))
            for j, weighted in enumerate(found):
                np.multiply(seen[:, :, j], self.weight[own], out=weighted[own])
        sound &= loop.sound(state)
        found[~sound[: len(some)]] = np.inf
        return list(found.reshape(len(some), -1))


def speed_of(counts: Floats, window: int) -> Floats:
    """Counts that pass in a sample (N, n), over a window on both sides of it."""
    rows = np.arange(len(counts))
    before = np.maximum(rows - window, 0)
    after = np.minimum(rows + window, len(counts) - 1)
    return np.asarray((counts[after] - counts[before]) / np.maximum(after - before, 1)[:, None])


def _steady(moved: Floats) -> Floats:
    """1 (N,) while all joints pass counts (N, n) fast enough, and 0 while one is slow and for a
    while after it.

    A slow joint's counts change one by one; the torque of each, which a model without rounding
    lacks, excites elastic gears like a compliance of their own. A joint that is slow most of the
    time is left out of this.
    """
    slow = (moved < _SLOW)[:, (moved < _SLOW).mean(axis=0) < 0.5].any(axis=1)
    felt = np.append(0, np.cumsum(slow))
    rows = np.arange(slow.size)
    return np.asarray(felt[rows + 1] == felt[np.maximum(rows - _RINGING, 0)], dtype=float)
