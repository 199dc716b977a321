"""Prediction error: the model follows the log, corrected a little at every sample, and is judged by its innovations.

The innovation is the difference between a counted position and its prediction from all samples before. With the right
observer gains (an alpha-beta observer) innovations are small and uncorrelated, which makes their sum of squares a
likelihood. Gains of zero give the simulated tracking errors of objective (4) (output error), gains of one would give
the equation error; the log itself decides between the two, since the gains are found together with f.

The model's encoder does not round here: at speeds of many pulses per sample the P loop feels the mean of its counts. At
low speeds the counts of a quantisation cell repeat one error, so that a sample weighs as many independent readings as
it sees new cells: at most one.

Source: L. Ljung, System Identification, Prentice Hall 1999, ch. 7 (prediction-error methods).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.naming import each_named, record_label
from identification.replay.experiment import Experiment, as_records
from plant import Dynamics, Record
from plant.simulation.closed_loop import bounded
from plant.simulation.correction import Correction
from plant.simulation.threads import cores, shared_out

__all__ = ["Prediction"]

_MEMORY = 10
"""Samples over which the observer forgets, to begin with."""

_REPLAYED = 8
"""The same where a law repeats a log, and the least: what such a model lacks is friction, not noise, and is correlated.
With a shorter one it would follow the counts so closely that little else shows."""

_SMALL = 0.01
"""Step of the observer gains, relative."""

_ZERO_STEP, _ZERO_LIMIT = 1e-4, 0.5
"""Step of a counter's zero, and its largest magnitude [rad]."""

_LOST, _SETTLING = 4.5, 80
"""Periods that may be missing, and samples after a longer gap that are not compared."""

_UNEQUAL = 1.5
"""Ratio of RMS innovations from which on records and joints are weighted by them."""

_POSITION, _SPEED = (1e-3, 0.9), (1e-7, 0.5)
"""Between which the observer gains of position and of speed are searched."""

_WINDOW = 10
"""Samples before and after, over which the speed of the counts is taken."""

_SLOW, _RINGING = 1.0, 30
"""Counts per sample below which the loop feels single counts, and samples that this is felt for."""


class Prediction:
    """Innovations of a model that follows records.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
    unknown : sequence of str
        All of f, and numbers of rig and law; by default f.
    simulated : bool
        Without correction: simulated, not predicted.
    zeros : bool
        Where the joints are when their counters say zero is unknown, in each record anew.
    steady : bool
        Leave out samples while a joint is slow, and for a while after it: on elastic gears single counts are felt.
    steps_per_sample, sweeps, threads
        As for `Objective`.

    Attributes
    ----------
    unknown : tuple of str
        What `innovations` takes values for: the given names, then those of the *nuisances*: observer gains
        (``correction.position[0]`` and so on), and the zeros of each record.
    nuisances, nuisance_steps : (m,) numpy.ndarray
        Their values to begin with, and steps of their central differences; zero for one that is kept.
    nuisance_bounds : (m, 2) numpy.ndarray
    weights : (M,) numpy.ndarray
        Weight of each innovation: the root of the independent readings that its sample gives.
    scales : (M,) numpy.ndarray
        What each innovation is divided by; 1 [pulse] until `reweigh`.
    evaluations : int
        Simulations so far.
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
        steps_per_sample: int = 4,
        sweeps: int = 3,
        threads: int | None = None,
    ) -> None:
        records, unknown = as_records(dynamics, records, unknown)
        n, replayed = dynamics.n, any(record.law is not None and record.law.replays for record in records)
        correction = Correction.with_memory(n, _REPLAYED if replayed else _MEMORY)
        if simulated:
            correction = Correction(position=(0.0,) * n, speed=(0.0,) * n, zero=(0.0,) * n)
        gains = correction.number_names("correction.")[: 0 if simulated else 2 * n]
        offsets = [f"record[{k}].zero[{i}]" for k in range(len(records) if zeros else 0) for i in range(n)]
        self.unknown, self._own = (*unknown, *gains, *offsets), len(unknown) + len(gains)
        self.nuisances = np.append(correction.number_values()[: len(gains)], np.zeros(len(offsets)))
        self.nuisance_steps = np.append(_SMALL * self.nuisances[: len(gains)], np.full(len(offsets), _ZERO_STEP))
        limits = ([_POSITION] * n + [_SPEED] * n)[: len(gains)] + [(-_ZERO_LIMIT, _ZERO_LIMIT)] * len(offsets)
        self.nuisance_bounds = np.array(limits).reshape(-1, 2)
        if replayed:
            self.nuisance_bounds[: len(gains), 1] = self.nuisances[: len(gains)]
        names = (*unknown, *gains, *(correction.number_names("correction.")[2 * n :] if zeros else ()))
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = list[_Followed]()
        for record, about in each_named(records):
            with about:
                self._followed.append(_Followed(dynamics, record, names, options, steady))
        self.weights = np.concatenate([followed.weight.ravel() for followed in self._followed])
        self.scales = np.ones(len(self.weights))
        self.threads = int(threads or cores())
        self.evaluations = 0

    def _each(self, values: NDArray[np.float64]) -> Iterator[tuple[_Followed, NDArray[np.float64]]]:
        """Each record's loop, and what it is given of values (k,)."""
        for followed, zero in zip(self._followed, self.zeros_in(values), strict=True):
            yield followed, np.append(values[: self._own], zero)

    def zeros_in(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where the joints of each record are when their counters say zero (R, n) [rad], of values (k,)."""
        return np.reshape(values[self._own :], (len(self._followed), -1))

    def innovations(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weighted innovations (M,), scaled, with these values (k,) of the unknowns; inf where the run diverges."""
        self.evaluations += 1
        return np.concatenate([followed.innovations(own) for followed, own in self._each(values)]) / self.scales

    def lost(self, values: NDArray[np.float64]) -> str:
        """What messages call the first record whose run with these values diverges; "" where none is told apart."""
        for k, (followed, own) in enumerate(self._each(values)):
            if not np.isfinite(followed.innovations(own)).all():
                return record_label([each.record for each in self._followed], k)
        return ""

    def reweigh(self, values: NDArray[np.float64]) -> bool:
        """Weight each joint of each record by its RMS innovation.

        What the model lacks differs between records; the one that it follows worst must not dominate the sum.

        Returns
        -------
        bool
            Whether scales have changed: not while all are followed about equally well.
        """
        rms = []
        for followed, own in self._each(values):
            readings = np.maximum((followed.weight**2).sum(axis=0), 1.0)
            squares = (followed.innovations(own).reshape(-1, followed.loop.n) ** 2).sum(axis=0)
            rms.append(np.sqrt(squares / readings))
        if not np.min(rms) > 0 or np.max(rms) < _UNEQUAL * np.min(rms):
            return False
        rows = zip(self._followed, rms, strict=True)
        self.scales = np.concatenate([np.broadcast_to(own, followed.weight.shape).ravel() for followed, own in rows])
        return True

    def all_innovations(self, many: Iterable[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """The same for several vectors of values, side by side."""
        return shared_out(self.innovations, list(many), self.threads)

    def motions(self, values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Joint positions (N, n) [rad] of each record's arm with these values."""
        self.evaluations += 1
        logs = [followed.run(own)[0] for followed, own in self._each(values)]
        return [np.hsplit(log[:, : 4 * self._followed[0].loop.n], 4)[2] for log in logs]


class _Followed(Experiment):
    """One record, ready to be followed."""

    def __init__(
        self, dynamics: Dynamics, record: Record, unknown: Sequence[str], options: dict[str, Any], steady: bool
    ) -> None:
        super().__init__(dynamics, record, unknown, smooth=True, **options)
        counts = record.counts
        self._kernel = self.kernel()
        centres = record.rig.encoder.position_in_pulses(record.rig.encoder.cell_centre(counts))
        self._tables = self._kernel.prepared((*self.times, self.data(centres)), logged=True)
        before = np.maximum(np.arange(len(counts)) - _WINDOW, 0)
        after = np.minimum(np.arange(len(counts)) + _WINDOW, len(counts) - 1)
        steps = np.vstack([np.zeros(record.n), np.abs(np.diff(counts, axis=0)).cumsum(axis=0)])
        moved = (steps[after] - steps[before]) / np.maximum(after - before, 1)[:, None]
        self.weight = np.sqrt(np.minimum(1.0, moved) * (record.valid * self._settled())[:, None])
        if steady and not self.loop.law.replays:
            self.weight *= _steady(moved)[:, None]

    def _settled(self) -> NDArray[np.float64]:
        """0 (N,) while a replay has not converged to the log: after a gap, or a start at an unknown speed; else 1."""
        settled, record = np.ones(len(self.record)), self.record
        if record.law is None or not record.law.replays:
            return settled
        measured = np.flatnonzero(record.valid)
        begins = measured[1:][np.diff(record.t[measured]) > _LOST * record.rig.period].tolist()
        if record.reference is None and record.initial is None and self.begin[1].any():
            begins.append(0)
        for row in begins:
            settled[row : row + _SETTLING] = 0
        return settled

    def run(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log (N, 4n) and final state of a run with these values."""
        numbers, n, (q, qd) = self.numbers.copy(), self.loop.n, self.begin
        numbers[self.places] = values
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
