"""Prediction error: a model follows the log through an observer, judged by its innovations.

The innovation is the difference between a counted position and its prediction from all samples
before. With the right observer gains (an alpha-beta observer) innovations are small and
uncorrelated, which makes their sum of squares a likelihood. Gains of zero give the simulated
tracking errors of objective (4) (output error), gains of one would give the equation error; the log
itself decides between the two, since the gains are found together with f.

The model's encoder does not round here: at speeds of many pulses per sample the P loop feels the
mean of its counts. At low speeds the counts of a quantisation cell repeat one error, so that a
sample weighs as many independent readings as it sees new cells: at most one.

Source: L. Ljung, System Identification, Prentice Hall 1999, ch. 7 (prediction-error methods).
"""

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from identification.equation_error import (
    FADED,
    IDENTIFIABLE,
    ROUNDING,
    Memory,
    Prior,
    PriorRows,
    Resumption,
    closed,
    of_each,
    record_label,
)
from identification.replay.experiment import as_records
from identification.replay.followed import Followed
from identification.replay.gauss_newton import DEPENDENT, noise, side_by_side
from identification.replay.residual import Stacked, joined
from plant import Dynamics, Record
from plant.compiler import cores, shared_out
from plant.parts import Floats, frozen_settings
from plant.simulation import LOGGED, Correction


@frozen_settings
class PredictionSettings:
    """The observer of a prediction, and how its nuisances are searched; chosen by hand.

    Parameters
    ----------
    memory : int
        Samples over which the observer forgets, to begin with.
    replayed_memory : int
        The same where a law repeats a log, and there the least: the model lacks friction, not
        noise, and is correlated. A shorter memory would follow the counts so closely that little
        else shows.
    gain_step : float
        Relative step of the observer gains.
    position_gains, speed_gains : (float, float)
        Bounds of the observer gains.
    zero_step, zero_limit : float
        Step of an encoder offset, and its largest magnitude [rad].
    state_step : float
        Step of the state of a law [N m].
    begin_step, speed_step : float
        Steps of the position [rad] and of the speed [rad/s] at the start.
    share_of_speed : float
        The latter as a share of the speed that the first counts show, at most.
    unlimited : float
        Largest ratio of a state, or of a start beside it, to its usual magnitude, where no reading
        determines it; the amplifier may limit a state to less.
    unequal : float
        Ratio of RMS innovations from which on records and joints are weighted by them.
    """

    memory: int = 10
    replayed_memory: int = 8
    gain_step: float = 0.01
    position_gains: tuple[float, float] = (1e-3, 0.9)
    speed_gains: tuple[float, float] = (1e-7, 0.5)
    zero_step: float = 1e-4
    zero_limit: float = 0.5
    state_step: float = 0.05
    begin_step: float = 1e-6
    speed_step: float = 1e-4
    share_of_speed: float = 0.25
    unlimited: float = 100.0
    unequal: float = 1.5


SETTINGS = PredictionSettings()


@dataclass(frozen=True, kw_only=True)
class Nuisances:
    """Unknowns of one kind beside those that are asked for.

    `names` (m,). `start`, `step`: their values to begin with, and steps of their central
    differences. `low`, `high`: bounds.
    """

    names: tuple[str, ...]
    start: Floats
    step: Floats
    low: Floats
    high: Floats


class NuisanceVector:
    """The nuisances of a fit in the order in which its vector of unknowns holds them.

    `begin`: place of the first of them. Attribute `end`: that of the next one.
    """

    def __init__(self, begin: int) -> None:
        self.end = begin
        self.groups: list[Nuisances] = []

    def add(
        self,
        names: Iterable[str],
        *,
        step: float | Floats,
        start: float | Floats = 0.0,
        low: float | Floats = -np.inf,
        high: float | Floats = np.inf,
    ) -> slice:
        """Append a group, whose numbers may be given as one for all; its place."""
        names = tuple(names)
        size = len(names)
        self.groups.append(
            Nuisances(
                names=names,
                start=np.broadcast_to(start, size),
                step=np.broadcast_to(step, size),
                low=np.broadcast_to(low, size),
                high=np.broadcast_to(high, size),
            )
        )
        place = slice(self.end, self.end + size)
        self.end = place.stop
        return place

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for group in self.groups for name in group.names)

    def all(self, field: str) -> Floats:
        """A field of all nuisances (m,)."""
        return np.concatenate([np.empty(0), *(getattr(group, field) for group in self.groups)])


def _observer(n: int, simulated: bool, replayed: bool) -> Correction:
    """The observer to begin with; that of a simulation corrects nothing."""
    # Its gains of zero are not searched: with them free it would be a prediction again.
    if simulated:
        return Correction(position=(0.0,) * n, speed=(0.0,) * n, zero=(0.0,) * n)
    return Correction.with_memory(n, SETTINGS.replayed_memory if replayed else SETTINGS.memory)


class Prediction(Stacked):
    """Innovations of a model that follows records.

    `unknown`: names of f, and of numbers of rig and law; by default all of f. `simulated`: correct
    nothing, so that records are simulated instead of predicted. `zeros`: the joint positions at
    zero counts are unknown, separately in each record. `memories`: for each record, the directions
    in which the state of its law before the log is unknown; with a memory, position and speed at
    the first sample are unknown too; None where all are known. `steady`: leave out the samples at
    which a joint is slow, and some samples after them, because an arm on elastic gears responds to
    single counts. `prior`: a prior of f; its rows come before the innovations: deviations from it,
    times the noise of an innovation. `moving`: leave out joints that hardly move, because their
    friction can take any value; a prior implies `moving`. `steps_per_sample`, `sweeps`, `threads`:
    as for `Objective`.

    Attributes: `unknown`: what `innovations` takes values for: the given names, then those of the
    *nuisances*: observer gains (``correction.position[0]`` and so on), the zeros of each record,
    and what its law remembered (``memory``). `nuisances`, `nuisance_steps` (m,): their values to
    begin with, and steps of their central differences; zero for one that is kept. `nuisance_bounds`
    (m, 2). `weights` (M,): weight of each innovation: the root of the independent readings that its
    sample gives. `scales` (M,): what each innovation is divided by; 1 [pulse] until `reweigh`.
    `dependent`: share of the slope of each unknown that must be independent of the others.
    `evaluations`: simulations so far.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        records: Record | Iterable[Record],
        unknown: Iterable[str] | None = None,
        *,
        simulated: bool = False,
        zeros: bool = False,
        steady: bool = False,
        memories: Sequence[Memory | None] = (),
        prior: Prior | None = None,
        moving: bool = False,
        steps_per_sample: int = 4,
        sweeps: int = 3,
        threads: int | None = None,
    ) -> None:
        records, unknown = as_records(dynamics, records, unknown)
        n = dynamics.n
        memories = list(memories) or [None] * len(records)
        # An inner loop begins by itself: there is no memory to be found.
        looped = [closed(record) for record in records]
        memories = [
            memory if in_loop is along else None
            for memory, in_loop, along in zip(memories, looped, records, strict=True)
        ]
        records = looped
        replayed = any(record.law is not None and record.law.replays for record in records)

        # 1. The observer.
        correction = _observer(n, simulated, replayed)
        gains = correction.number_names("correction.")

        # 2. The records, each with its kernel. Offsets of encoders are numbers of the correction.
        searched = () if simulated else gains[: 2 * n]
        # The gains end with the offsets of the encoders, after the position and the speed gains.
        names = (*unknown, *searched, *(gains[2 * n :] if zeros else ()))
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = of_each(
            lambda record, memory: Followed(
                dynamics, record, names, options, steady, memory, moving or prior is not None
            ),
            records,
            memories,
        )
        # Gains are common to all records: a joint that one record compares has some.
        compared = np.any([followed.heard for followed in self._followed], axis=0)

        # 3. The nuisances.
        vector = NuisanceVector(len(unknown))
        start = correction.number_values()
        for begin, bounds in ((0, SETTINGS.position_gains), (n, SETTINGS.speed_gains)):
            initial = start[begin : begin + n]
            if not simulated:
                vector.add(
                    gains[begin : begin + n],
                    start=initial,
                    # Gains of joints that are not compared do nothing: they stay.
                    step=SETTINGS.gain_step * initial * compared,
                    low=bounds[0],
                    # In a replay the memory may become longer, and not shorter.
                    high=initial if replayed else bounds[1],
                )
        # What all records share comes first; a record's own unknowns follow, kind by kind.
        self._shared = slice(0, len(unknown) + len(searched))
        self._zeros = [
            vector.add(
                [f"record[{k}].zero[{i}]" for i in range(n if zeros else 0)],
                step=SETTINGS.zero_step,
                low=-SETTINGS.zero_limit,
                high=SETTINGS.zero_limit,
            )
            for k in range(len(records))
        ]
        expected = np.empty((2, 0))
        self._memories = []
        for k, (record, memory) in enumerate(zip(records, memories, strict=True)):
            begin = vector.end
            if memory is not None:
                expected = np.hstack([expected, _add_memory(vector, k, record, memory)])
            self._memories.append(slice(begin, vector.end))
        self._expected, told = expected
        # Fits take one vector: the numbers that were asked for, and the nuisances behind them.
        self.unknown = (*unknown, *vector.names)
        self.nuisances = vector.all("start")
        self.nuisance_steps = vector.all("step")
        self.nuisance_bounds = np.column_stack([vector.all("low"), vector.all("high")])

        # 4. The rows: a prior's, the records', and the expected magnitudes of what is remembered.
        weights = [followed.weight.ravel() for followed in self._followed]
        super().__init__(PriorRows(prior, unknown), weights, told)
        self.threads = int(threads or cores())
        self.dependent = self.prior.own(DEPENDENT)
        # The state of a law before its log has expected magnitudes, which count little beside
        # thousands of readings; but they are all that determines what no reading does.
        if len(self._expected):
            self.dependent = IDENTIFIABLE.remembered
        self.evaluations = 0

    def _each(self, values):
        """Each record's loop, and its part of values (k,)."""
        for followed, zeros, memory in zip(
            self._followed, self._zeros, self._memories, strict=True
        ):
            # A record takes the shared unknowns, and its own zeros and memory.
            parts = [values[self._shared], values[zeros], values[memory]]
            yield followed, np.concatenate(parts)

    def zeros_in(self, values: Floats) -> Floats:
        """Joint positions (R, n) [rad] at zero counts of each record, from values (k,)."""
        return np.array([values[zeros] for zeros in self._zeros])

    def resumptions(
        self, values: Floats, std: Floats | None = None
    ) -> tuple[Resumption | None, ...]:
        """State of law and arm of each record at its first sample, from values and deviations (k,).

        None where that is known.
        """
        parts = [part for _, part in self._each(values if std is None else std)]
        return tuple(
            followed.resumption(part, None if std is None else deviations)
            for (followed, part), deviations in zip(self._each(values), parts, strict=True)
        )

    def widest(self, directions: Floats) -> Floats:
        """Directions (u, k) that span the same undetermined space, one standard deviation long.

        They are independent. Their lengths follow from the largest plausible magnitudes of the
        remembered numbers. A state can be any torque that the amplifier gives, up to a multiple of
        its usual magnitude, whatever it was in the log. A state that a torque tells is known within
        the noise of that torque. Position and speed at the start are near their counts, but have a
        wide margin beside an unknown state.
        """
        largest = ROUNDING / self._expected
        begin = directions.shape[1] - len(largest)
        for followed, place in zip(self._followed, self._memories, strict=True):
            memory = followed.memory
            if memory is not None and memory.noise is None:
                limit = followed.record.rig.drive.torque_limit().max() / np.sqrt(3)  # uniform
                nuisances = slice(place.start - begin, place.stop - begin)
                state, start = np.split(largest[nuisances], [memory.usual.size])
                state[:] = np.minimum(limit, SETTINGS.unlimited * memory.usual)
                # Friction at the start leaves errors in the slopes of the start. They must not
                # limit a direction of the state.
                start *= SETTINGS.unlimited if state.size else 1.0
        # The whole space at once: one direction alone may be limited where two together are not.
        expected = directions[:, begin:] / largest
        squares, axes = np.linalg.eigh(np.einsum("ik,jk->ij", expected, expected))
        # A direction that nothing limits gets the largest length that rounding errors allow.
        sizes = np.sqrt(np.maximum(squares, np.finfo(float).eps * squares[-1]))
        return axes.T / sizes[:, None] @ directions

    def lost(self, values: Floats) -> str:
        """Label of the first record whose run with these values diverges; "" of a single record."""
        # One record after another: at a start that diverges the time does not matter, the name
        # does.
        for k, (followed, part) in enumerate(self._each(values)):
            if not np.isfinite(followed.innovations(part)).all():
                return record_label([follower.record for follower in self._followed], k)
        return ""

    def beside(self, torques: Sequence[Floats]) -> Self:
        """The same with another torque (N, n) [N m] injected in each record."""
        copied = copy.copy(self)
        pairs = zip(self._followed, torques, strict=True)
        copied._followed = [followed.beside(torque) for followed, torque in pairs]
        return copied

    def reweigh(self, values: Floats) -> bool:
        """Weight each joint of each record by its RMS innovation, and a prior by the noise.

        What the model lacks differs between records; the one that it follows worst must not
        dominate the sum.

        Returns whether weights have changed: scales do not while all are followed about equally
        well.
        """
        # A prior has no scatter of its own to be weighed by: it takes the noise of the innovations.
        settled = False
        if self.prior.count:
            settled = self.prior.settle(noise(self, self.innovations(values)))
        rms = []
        for followed, part in self._each(values):
            # At least one reading: a joint that stands has none.
            readings = np.maximum((followed.weight**2).sum(axis=0), 1.0)
            squares = (followed.innovations(part).reshape(-1, followed.loop.n) ** 2).sum(axis=0)
            # A joint that is not compared has no RMS, and must not be the smallest one.
            rms.append(np.where(followed.heard, np.sqrt(squares / readings), np.nan))
        smallest = np.nanmin(rms)
        # A log that is followed exactly, as made by the model, has nothing to be weighted by.
        if not smallest > 0 or np.nanmax(rms) < SETTINGS.unequal * smallest:
            return settled
        # Each joint of each record by its RMS innovation: rows of equal variance make least squares
        # the likelihood.
        scales = [
            np.broadcast_to(np.nan_to_num(joints, nan=1.0), followed.weight.shape).ravel()
            for followed, joints in zip(self._followed, rms, strict=True)
        ]
        self.scales = np.concatenate(
            [np.ones(self.prior.count), *scales, np.ones(len(self._expected))]
        )
        return True

    @property
    def shape(self) -> tuple[int, int]:
        """Number of records, and of joints."""
        return len(self._followed), self._followed[0].loop.n

    @property
    def lengths(self) -> list[int]:
        """How many innovations each record has."""
        return [followed.weight.size for followed in self._followed]

    @property
    def rounds(self) -> bool:
        """Whether the arm of any record felt the rounding of its counts, which the model omits."""
        return any(followed.rounds for followed in self._followed)

    def of_rounded(self, values: Floats, shifts: Floats, steps: int) -> list[Floats]:
        """Weighted innovations (M,) of logs that the model makes itself with rounding encoders.

        Shifts (L, R, n) [pulses] are those of the encoders of each record, for L logs of each; its
        loop feels counts at so many `steps` in a sample. Innovations of records that did not feel
        rounding are zero.
        """
        of_record = []
        for (followed, part), moved in zip(
            self._each(values), np.swapaxes(shifts, 0, 1), strict=True
        ):
            # A log is simulated once to be made, and once to be followed.
            self.evaluations += 2 * len(shifts)
            if not followed.rounds:
                of_record.append([np.zeros(followed.weight.size) for _ in shifts])
                continue
            # The loop with rounding encoders makes each log; the prediction without rounding then
            # follows it, as it does a measured log.
            logs = followed.rounded(part, list(moved), self.threads, steps)

            def run(counts: Floats, followed: Followed = followed, part: Floats = part) -> Floats:
                # In place of the counts: beside those of a long log there is no room.
                counts[:] = followed.innovations_of(part, counts).reshape(counts.shape)
                return counts.ravel()

            of_record.append(
                shared_out(run, logs, min(self.threads, side_by_side(len(self.weights))))
            )
        # A log that the model makes itself says nothing against a prior.
        prior = np.zeros(self.prior.count)
        expected = np.zeros(len(self._expected))
        return [
            joined([prior, *rows, expected], self.scales) for rows in zip(*of_record, strict=True)
        ]

    def parts(self, vectors: Sequence[Floats]) -> Iterator[list[Floats]]:
        """Rows of each record, then of the expected magnitudes, with each of the vectors."""
        self.evaluations += len(vectors)
        parts_of = [[part for _, part in self._each(values)] for values in vectors]
        # A block is a record with as many vectors as its kernel has lanes; all blocks side by side.
        blocks = [
            (k, begin)
            for k in range(len(self._followed))
            for begin in range(0, len(vectors), LOGGED)
        ]

        def run(block: tuple[int, int]) -> list[Floats]:
            k, begin = block
            return self._followed[k].block([parts[k] for parts in parts_of[begin : begin + LOGGED]])

        of_record: list[list[Floats]] = [[] for _ in self._followed]
        # The order of the blocks keeps the vectors of a record in theirs, on any number of threads.
        for (k, _), rows in zip(blocks, shared_out(run, blocks, self.threads), strict=True):
            of_record[k] += rows
        yield from of_record
        # What is remembered comes last among the unknowns.
        count = len(self._expected)
        yield [self._expected * values[len(values) - count :] for values in vectors]


def _add_memory(vector, k, record, memory):
    """Add the state of a record's law and arm before its log to the nuisances.

    Returns, for each added number, one RMS rounding over its expected magnitude, which is the
    factor that turns the number into a row of the fit; and the weight of that row.
    """
    n = record.n
    vector.add(
        [f"record[{k}].memory[{i}]" for i in range(memory.usual.size)], step=SETTINGS.state_step
    )
    # A joint that moves by at most one count rests or creeps. Its counts show neither its position
    # within the count nor its speed, and friction hides both. A step of zero keeps both.
    travel = np.ptp(record.counts[:FADED], axis=0)
    # The step must not reverse the direction of the joint, because friction changes sign there.
    pulse = np.abs(np.diag(record.rig.to_angle(np.eye(n))))
    shown_speed = pulse * travel / (FADED * record.rig.period)
    steps = {
        "begin": np.full(n, SETTINGS.begin_step),
        "speed": np.minimum(SETTINGS.speed_step, SETTINGS.share_of_speed * shown_speed),
    }
    for name, step in steps.items():
        for i in range(n):
            vector.add([f"record[{k}].{name}[{i}]"], step=step[i] * (travel[i] > 1))
    # The arm can be off by a pulse, and by a pulse per sample.
    magnitudes = np.concatenate([memory.deviations, pulse, pulse / record.rig.period])
    # A state that a torque tells counts as a reading; an expected magnitude does not.
    weights = np.zeros(len(magnitudes))
    weights[: memory.usual.size] = memory.noise is not None
    return ROUNDING / magnitudes, weights
