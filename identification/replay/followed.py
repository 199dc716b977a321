"""One record, ready to be followed by a model that is corrected at every sample."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from identification.equation_error import FADED, Memory, Resumption
from identification.replay.experiment import Experiment, Rounding
from plant import Dynamics, Record
from plant.checkup import hardly_moving
from plant.machine import InnerLoop
from plant.parts import Floats, frozen_settings
from plant.simulation import LOGGED, logged_kernel


@frozen_settings
class FollowedSettings:
    """Which samples of a record are compared; chosen by hand.

    Parameters
    ----------
    gap : float
        Longest time without a sample that a replay bridges [periods].
    settling : int
        Samples not compared after a longer gap, while the replay converges to the log again. After
        a start at an unknown speed up to twice as many are not compared.
    window : int
        Samples on either side over which the speed of the counts is taken.
    slow : float
        Counts per sample below which the loop feels single counts.
    ringing : int
        Samples for which a single count is felt on elastic gears.
    """

    gap: float = 4.5
    settling: int = 80
    window: int = 10
    slow: float = 1.0
    ringing: int = 30


SETTINGS = FollowedSettings()


class Followed(Experiment):
    """One record, ready to be followed by a model that an observer corrects.

    `heard` (n,): joints that are compared; if `moving`, only those that move. `weight` (N, n): root
    of the number of independent readings in each sample; if `steady`, and the law replays no log,
    0 during slow motion and shortly after. `remembered`: number of unknowns for the state of law
    and arm at the first sample, 0 where that state is known.
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
        self._stated = len(self.places)
        self.remembered = 0 if memory is None else memory.usual.size + 2 * dynamics.n
        if memory is not None:
            self.places += [
                i for i, name in enumerate(self.loop.number_names) if name.startswith("law.state[")
            ]
        # Each lane of the kernel simulates the loop with its own values of the unknowns.
        self._kernel = logged_kernel(self.loop, self.places, uneven=self.clock.even is None)
        self.heard = ~hardly_moving(record) | (not moving)
        self._tables = self._kernel.along(
            self.loop, **self.driven, data=self._measured(record.counts)
        )
        self._weigh(record.counts)

    def _measured(self, counts):
        """Measured positions and weights that the kernel reads, of counts (N, n)."""
        encoder = self.record.rig.encoder
        return self.data(encoder.position_in_pulses(encoder.cell_centre(counts)))

    def _weigh(self, counts):
        """Weigh samples by how counts (N, n) move."""
        # Counts that pass in a sample, either way. In place: a long log has no room for copies.
        passed = np.diff(counts, axis=0, prepend=counts[:1])
        travelled = np.cumsum(np.abs(passed, out=passed), axis=0, out=passed)
        moved = speed_of(travelled, SETTINGS.window)
        # All samples in one quantisation cell share one rounding error. So a sample is worth the
        # average number of cells entered per sample around it, but no more than one reading.
        valid = (self.record.valid * self._settled())[:, None]
        self.weight = np.sqrt(np.minimum(1.0, moved) * valid) * self.heard
        if self._steady and not self.loop.law.replays:
            self.weight *= _steady(moved)[:, None]

    def _settled(self):
        """0 (N,) at samples where the simulation has not converged to the log, else 1.

        Zeros follow an unknown start and, if the law replays and there is no `memory`, each gap.
        """
        settled = np.ones(len(self.record))
        record = self.record
        if self.memory is not None:
            settled[:FADED] = 0
        # The counts of a servo's log give its speed at the start only roughly, and goals none.
        if isinstance(record.law, InnerLoop) and record.initial is None:
            settled[: min(SETTINGS.settling, len(record) // 4)] = 0
        if record.law is None or not record.law.replays or self.memory is not None:
            return settled
        # The counts give the speed at the start only roughly, and no reference gives it better.
        if record.initial is None and self.begin[1].any():
            settled[: min(2 * SETTINGS.settling, len(record) // 4)] = 0
        # After a gap the simulation has drifted from the log, and the observer needs time to catch
        # up. Rows without weight at the start are a gap as well.
        measured = np.flatnonzero(record.valid)
        missing = np.diff(record.t[measured], prepend=record.t[0])
        for row in measured[missing > SETTINGS.gap * record.rig.period].tolist():
            settled[row : row + SETTINGS.settling] = 0
        return settled

    def resumption(self, values: Floats, std: Floats | None = None) -> Resumption | None:
        """Where law and arm were at the first sample, of values with standard deviations (k,).

        None where it is known.
        """
        if self.memory is None:
            return None
        # Behind the shared unknowns come coordinates of the law's state, then the arm's position
        # and speed, relative to those that the counts show.
        state = self.memory.at(values[self._stated :][: self.memory.usual.size])
        start = slice(-2 * self.loop.n, None)
        return Resumption(
            state,
            np.add(self.begin, values[start].reshape(2, -1)),
            None if std is None else std[start].reshape(2, -1),
        )

    def _start(self, values):
        """Position and speed at the start, and all numbers of the loop, of values."""
        numbers = self.numbers.copy()
        resumed = self.resumption(values)
        if resumed is not None:
            values = np.append(values[: self._stated], resumed.state)
        numbers[self.places] = values
        return self.began(numbers) if resumed is None else resumed.initial, numbers

    @property
    def rounds(self) -> bool:
        """Whether rounded counts drove the arm in the log; the model does not round them."""
        return not (self.loop.law.replays or self.record.rig.encoder.smooth)

    def rounded(
        self, values: Floats, shifts: Sequence[Floats], threads: int, steps: int
    ) -> list[Floats]:
        """Counts (N, n) of the logs that the model itself makes with rounding encoders.

        `shifts`: shifts (n,) of the encoders, one array for each log. `steps`: steps per sample; at
        each step the model feels the counts.
        """
        start, numbers = self._start(values)
        return Rounding(self.loop, self.record, steps).counts(
            start, numbers, self.loop.number_names, shifts, threads
        )

    def innovations_of(self, values: Floats, counts: Floats) -> Floats:
        """Weighted innovations (N n,) with values (k,), of a log with these counts (N, n)."""
        copied = copy.copy(self)
        # The path and its times stay: only the measured columns are other ones.
        copied._tables = self._kernel.with_data(self._tables, self._measured(counts))
        copied._weigh(counts)
        return copied.innovations(values)

    def beside(self, torque: Floats) -> Self:
        """A copy with another injected torque (N, n) [N m]; a replayed column changes with it."""
        # A shallow copy shares the kernel and the tables of the path, which are large.
        copied = copy.copy(self)
        record = self.record
        drive = record.rig.drive
        columns: dict[str, Any] = {"injected": torque}
        name = column = "injected"
        if not self.loop.injected:
            # The loop repeats a logged column, in which the injected torque was measured too.
            change = torque if record.injected is None else torque - record.injected
            name = "logged"
            column = str(self.loop.law.replays)
            if column == "current":
                change = drive.motor_torque(change) / drive.motor_gain
            columns[column] = getattr(record, column) + change
        copied.record = replace(record, **columns)
        copied._tables = self._kernel.with_column(
            self.loop, self._tables, name, columns[column], self.clock
        )
        return copied

    def innovations(self, values: Floats) -> Floats:
        """Weighted innovations (N n,) with values (k,) of the unknowns.

        All of them are inf if the run diverges.
        """
        return self.block([values])[0]

    def block(self, vectors: Sequence[Floats]) -> list[Floats]:
        """The same for at most `LOGGED` vectors of values, side by side in lanes of a kernel."""
        n = self.loop.n
        loop = self.loop

        # 1. Initial states. The last numbers of a loop are its encoder offsets: by these the arm
        # begins elsewhere than its counts say.
        states = []
        lanes = []
        for values in vectors:
            (q, qd), numbers = self._start(values)
            states.append(loop.initial_state(q + numbers[-n:], qd, numbers))
            lanes.append(numbers[self.places])

        # 2. Empty lanes repeat the last vector: a kernel has no lane that does nothing.
        empty = LOGGED - len(states)
        state, lane = (np.array(rows + rows[-1:] * empty).T.copy() for rows in (states, lanes))

        # 3. Simulate part by part, and weight what is measured of each.
        uniform = self.numbers[list(self._kernel.uniform)]
        rows = self.clock.rows
        innovations = np.empty((len(vectors), len(rows), n))
        sound = np.ones(LOGGED, bool)
        for part, tables in self._kernel.parts(self._tables, len(self.clock)):
            state, errors = self._kernel.run(tables, part.stop - part.start, state, lane, uniform)
            in_part = slice(*np.searchsorted(rows, (part.start, part.stop)).tolist())
            measured = errors[rows[in_part] - part.start]
            sound &= np.isfinite(measured).all(axis=(0, 1))
            # What diverged may be infinite in a row without weight.
            with np.errstate(invalid="ignore"):
                for j, weighted in enumerate(innovations):
                    np.multiply(measured[:, :, j], self.weight[in_part], out=weighted[in_part])

        # 4. A run that diverged costs inf in all its rows.
        sound &= loop.sound(state)
        innovations[~sound[: len(vectors)]] = np.inf
        return list(innovations.reshape(len(vectors), -1))


def speed_of(counts: Floats, window: int) -> Floats:
    """Counts that pass in a sample (N, n), over a window on both sides of it."""
    rows = np.arange(len(counts))
    # At the ends of the log the window is shorter.
    low = np.maximum(rows - window, 0)
    high = np.minimum(rows + window, len(counts) - 1)
    return (counts[high] - counts[low]) / np.maximum(high - low, 1)[:, None]


def _steady(moved):
    """1 (N,) while all joints are fast enough; 0 while one is slow, and for a while after it.

    The counts of a slow joint change one by one. Each change causes a torque that a model without
    rounding lacks, and this torque excites elastic gears. A joint that is slow in at least half of
    the samples is ignored.
    """
    slow_joints = moved < SETTINGS.slow
    slow = slow_joints[:, slow_joints.mean(axis=0) < 0.5].any(axis=1)
    # Slow samples so far: where the number does not grow over the window there was none in it.
    number = np.append(0, np.cumsum(slow))
    rows = np.arange(slow.size)
    begin = np.maximum(rows - SETTINGS.ringing, 0)
    return np.asarray(number[rows + 1] == number[begin], dtype=float)
