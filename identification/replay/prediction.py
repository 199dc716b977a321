"""Prediction error: the model follows the log, corrected a little at every sample, and is judged by
its innovations.

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
from typing import Self

import numpy as np

from identification.equation_error.law_memory import Memory, Resumption
from identification.equation_error.naming import of_each, record_label
from identification.equation_error.prior import Prior, PriorRows
from identification.replay.experiment import as_records
from identification.replay.followed import Followed, joined
from identification.replay.gauss_newton import DEPENDENT, noise, side_by_side
from plant import Dynamics, Record
from plant.compiler.background import cores, shared_out
from plant.parts.fields import Floats
from plant.simulation.layout import Correction
from plant.simulation.loop_kernel import LOGGED

_MEMORY = 10  # samples over which the observer forgets, to begin with

# The same where a law repeats a log, and the least: what such a model lacks is friction, not noise,
# and is correlated. With a shorter one it would follow the counts so closely that little else
# shows.
_REPLAYED = 8

_SMALL = 0.01  # step of the observer gains, relative

# Steps of what a law remembers [N m], and of where [rad] and how fast [rad/s] the arm begins.
_MEMORY_STEP = 0.05
_BEGIN_STEP = 1e-6
_SPEED_STEP = 1e-4

# RMS of rounding [pulses]; and how far off a law's memory is expected to be, in its magnitudes in
# the log.
_ROUNDING = 0.289
_AT_MOST = 2.0

# step of a encoder offset, and its largest magnitude [rad]
_ZERO_STEP = 1e-4
_ZERO_LIMIT = 0.5

_UNEQUAL = 1.5  # ratio of RMS innovations from which on records and joints are weighted by them

# between which the observer gains of position and of speed are searched
_POSITION = (1e-3, 0.9)
_SPEED = (1e-7, 0.5)


class Prediction:
    """Innovations of a model that follows records.

    `unknown`: all of f, and numbers of rig and law; by default f. `simulated`: without correction:
    simulated, not predicted. `zeros`: where the joints are when their counters say zero is unknown,
    in each record anew. `memories`: of each record, in which directions the state of its law before
    the log is unknown; None where it is known. `steady`: leave out samples while a joint is slow,
    and for a while after it: on elastic gears single counts are felt. `prior`: of f; its
    deviations, times the noise of an innovation, come before the innovations. `moving`: leave out
    joints that hardly move, which friction holds at will; so it is with a prior.
    `steps_per_sample`, `sweeps`, `threads`: as for `Objective`.

    Attributes: `unknown`: what `innovations` takes values for: the given names, then those of the
    *nuisances*: observer gains (``correction.position[0]`` and so on), the zeros of each record,
    and what its law remembered (``memory``). `nuisances`, `nuisance_steps` (m,): their values to
    begin with, and steps of their central differences; zero for one that is kept. `nuisance_bounds`
    (m, 2). `weights` (M,): weight of each innovation: the root of the independent readings that its
    sample gives. `scales` (M,): what each innovation is divided by; 1 [pulse] until `reweigh`.
    `dependent`: share of its own that the slope of each unknown must have. `evaluations`:
    simulations so far.
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
        replayed = any(record.law is not None and record.law.replays for record in records)
        correction = Correction.with_memory(n, _REPLAYED if replayed else _MEMORY)
        if simulated:
            correction = Correction(position=(0.0,) * n, speed=(0.0,) * n, zero=(0.0,) * n)
        gains = correction.number_names("correction.")[: 0 if simulated else 2 * n]
        offsets = [
            f"record[{k}].zero[{i}]" for k in range(len(records) if zeros else 0) for i in range(n)
        ]
        self._memories = list(memories) or [None] * len(records)
        remembered = list[str]()
        known = list[float]()
        steps = list[float]()
        for k, memory in enumerate(self._memories):
            if memory is not None:
                remembered += [f"record[{k}].memory[{i}]" for i in range(memory.usual.size)]
                remembered += [
                    f"record[{k}].{what}[{i}]" for what in ("begin", "speed") for i in range(n)
                ]
                pulse = np.abs(np.diag(records[k].rig.to_angle(np.eye(n))))
                near = [*_AT_MOST * memory.usual, *pulse, *pulse / records[k].rig.period]
                known += [_ROUNDING / expected for expected in near]
                steps += [
                    *np.full(memory.usual.size, _MEMORY_STEP),
                    *np.full(n, _BEGIN_STEP),
                    *np.full(n, _SPEED_STEP),
                ]
        self._expected = np.array(known)
        self.unknown, self._own = (
            (*unknown, *gains, *offsets, *remembered),
            len(unknown) + len(gains),
        )
        self._zeros, count = len(offsets), len(remembered)
        self.nuisances = np.append(
            correction.number_values()[: len(gains)], np.zeros(len(offsets) + count)
        )
        steps = [*_SMALL * self.nuisances[: len(gains)], *[_ZERO_STEP] * len(offsets), *steps]
        self.nuisance_steps = np.array(steps)
        limits = ([_POSITION] * n + [_SPEED] * n)[: len(gains)] + [
            (-_ZERO_LIMIT, _ZERO_LIMIT)
        ] * len(offsets)
        limits += [(-np.inf, np.inf)] * count
        self.nuisance_bounds = np.array(limits).reshape(-1, 2)
        if replayed:
            self.nuisance_bounds[: len(gains), 1] = self.nuisances[: len(gains)]
        names = (
            *unknown,
            *gains,
            *(correction.number_names("correction.")[2 * n :] if zeros else ()),
        )
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = of_each(
            lambda record, memory: Followed(
                dynamics, record, names, options, steady, memory, moving or prior is not None
            ),
            records,
            self._memories,
        )
        heard = np.any([followed.heard for followed in self._followed], axis=0)
        # gains that nothing shows are kept
        self.nuisance_steps[: len(gains)] *= np.tile(heard, 2)[: len(gains)]
        weights = [followed.weight.ravel() for followed in self._followed]
        self.prior = PriorRows(prior, unknown)
        self.weights = np.concatenate([np.zeros(self.prior.count), *weights, np.zeros(count)])
        self.scales = np.ones(len(self.weights))
        self.threads = int(threads or cores())
        self.dependent = self.prior.own(DEPENDENT)
        self.evaluations = 0

    def _each(self, values: Floats) -> Iterator[tuple[Followed, Floats]]:
        """Each record's loop, and what it is given of values (k,)."""
        place = self._own + self._zeros
        for followed, zero in zip(self._followed, self.zeros_in(values), strict=True):
            rest = values[place : place + followed.remembered]
            place += followed.remembered
            yield followed, np.concatenate([values[: self._own], zero, rest])

    def zeros_in(self, values: Floats) -> Floats:
        """Where the joints of each record are when their counters say zero (R, n) [rad], of
        values (k,).
        """
        return np.reshape(values[self._own : self._own + self._zeros], (len(self._followed), -1))

    def resumptions(self, values: Floats) -> tuple[Resumption | None, ...]:
        """Where law and arm of each record were at its first sample, of values (k,); None where
        that is known.
        """
        return tuple(followed.resumption(own) for followed, own in self._each(values))

    def innovations(self, values: Floats) -> Floats:
        """Weighted innovations (M,), scaled, with these values (k,) of the unknowns; inf where
        the run diverges.
        """
        return self.all_innovations([values])[0]

    def lost(self, values: Floats) -> str:
        """What messages call the first record whose run with these values diverges; "" where
        none is told apart.
        """
        for k, (followed, own) in enumerate(self._each(values)):
            if not np.isfinite(followed.innovations(own)).all():
                return record_label([each.record for each in self._followed], k)
        return ""

    def beside(self, torques: Sequence[Floats]) -> Self:
        """The same with another torque (N, n) [N m] injected in each record."""
        other = copy.copy(self)
        other._followed = [
            followed.beside(own) for followed, own in zip(self._followed, torques, strict=True)
        ]
        return other

    def reweigh(self, values: Floats) -> bool:
        """Weight each joint of each record by its RMS innovation, and a prior by the noise.

        What the model lacks differs between records; the one that it follows worst must not
        dominate the sum.

        Returns whether weights have changed: scales do not while all are followed about equally
        well.
        """
        rms = []
        settled = (
            self.prior.settle(noise(self, self.innovations(values))) if self.prior.count else False
        )
        for followed, own in self._each(values):
            readings = np.maximum((followed.weight**2).sum(axis=0), 1.0)
            squares = (followed.innovations(own).reshape(-1, followed.loop.n) ** 2).sum(axis=0)
            rms.append(np.where(followed.heard, np.sqrt(squares / readings), np.nan))
        if not np.nanmin(rms) > 0 or np.nanmax(rms) < _UNEQUAL * np.nanmin(rms):
            return settled
        rows = zip(self._followed, rms, strict=True)
        scales = [
            np.broadcast_to(np.nan_to_num(own, nan=1.0), followed.weight.shape).ravel()
            for followed, own in rows
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
        """Whether the arm of any record felt the rounding of its counts, which the model leaves
        out.
        """
        return any(followed.rounds for followed in self._followed)

    def of_rounded(self, values: Floats, shifts: Floats, steps: int) -> list[Floats]:
        """Weighted innovations (M,) of the logs that the model makes itself with these values, its
        encoders rounding.

        Shifts (L, R, n) [pulses] are those of the encoders of each record, for L logs of each; its
        loop feels counts at so many `steps` in a sample. Innovations of records that did not feel
        rounding are zero.
        """
        of_record = list[list[Floats]]()
        for (followed, own), moved in zip(
            self._each(values), np.swapaxes(shifts, 0, 1), strict=True
        ):
            self.evaluations += 2 * len(shifts)
            if not followed.rounds:
                of_record.append([np.zeros(followed.weight.size) for _ in shifts])
                continue
            logs = followed.rounded(own, list(moved), self.threads, steps)

            def run(counts: Floats, followed: Followed = followed, own: Floats = own) -> Floats:
                # not beside a long log's
                counts[:] = followed.innovations_of(own, counts).reshape(counts.shape)
                return counts.ravel()

            of_record.append(
                shared_out(run, logs, min(self.threads, side_by_side(len(self.weights))))
            )
        known = np.zeros(len(self._expected))
        return [
            joined([np.zeros(self.prior.count), *rows, known], self.scales)
            for rows in zip(*of_record, strict=True)
        ]

    def all_innovations(self, many: Iterable[Floats]) -> list[Floats]:
        """The same for several vectors of values, side by side."""
        many = list(many)
        self.evaluations += len(many)
        given = [[own for _, own in self._each(values)] for values in many]
        blocks = [(k, i) for k in range(len(self._followed)) for i in range(0, len(many), LOGGED)]

        def run(block: tuple[int, int]) -> list[Floats]:
            k, i = block
            return self._followed[k].block([own[k] for own in given[i : i + LOGGED]])

        of_record: list[list[Floats]] = [[] for _ in self._followed]
        for (k, _), found in zip(blocks, shared_out(run, blocks, self.threads), strict=True):
            of_record[k] += found
        known = (self._expected * values[len(values) - len(self._expected) :] for values in many)
        return [
            joined(row, self.scales)
            for row in zip(map(self.prior.of, many), *of_record, known, strict=True)
        ]
