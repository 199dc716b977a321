"""Prediction error: the model follows the log, corrected a little at every sample, and is judged by its surprises.

The difference between each counted position and its prediction from all samples before is small and, with the right
shares of correction, without memory: that makes their sum of squares a likelihood. Shares of zero are the simulated
tracking errors of objective (4) (output error), shares of one would be the equation error; the log itself decides
between the two, since the shares are found together with f.

The model's encoder does not round here: at speeds of many pulses per sample the P loop feels the mean of its counts. At
low speeds the counts of a cell repeat one error, so that a sample weighs as many independent readings as it sees new
cells: at most one.

Source: L. Ljung, System Identification, Prentice Hall 1999, ch. 7 (prediction-error methods).
"""

from __future__ import annotations

import numpy as np

from identification.replay.experiment import Experiment, checked
from plant.simulation.closed_loop import bounded
from plant.simulation.correction import Correction
from plant.simulation.threads import cores, shared_out

__all__ = ["Prediction"]

_MEMORY = 10
"""Samples over which the correction forgets, to begin with."""

_REPLAYED = 8
"""The same where a law repeats a log, and the least: what such a model lacks is friction, not noise, and has a memory.
With a shorter one it would follow the counts so closely that little else shows."""

_SMALL = 0.01
"""Step of the shares, relative."""

_TURN, _TURNED = 1e-4, 0.5
"""Step of a counter's zero, and its largest magnitude [rad]."""

_LOST, _SETTLING = 4.5, 80
"""Periods that may be missing, and samples after a longer gap that are not compared."""

_UNEQUAL = 1.5
"""Ratio of scatters from which on records and joints are weighted by them."""

_POSITION, _SPEED = (1e-3, 0.9), (1e-7, 0.5)
"""Between which the shares of position and of speed are looked for."""

_WINDOW = 10
"""Samples before and after, over which the speed of the counts is taken."""


class Prediction:
    """Surprises of a model that follows records.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
    unknown : sequence of str
        What `surprises` takes values for: all of f, numbers of rig and law, and ``correction.position[0]`` and so on.
    free : bool
        Without correction: simulated, not predicted.
    zeros : bool
        Where the joints are when their counters say zero is unknown, in each record anew.
    steps_per_sample, sweeps, threads
        As for `Objective`.

    Attributes
    ----------
    unknown : tuple of str
        What `surprises` takes values for: the given names, then those of the *nuisances*: shares of correction, and the
        zeros of each record.
    nuisances, nuisance_steps : (m,) numpy.ndarray
        Their values to begin with, and steps of their derivatives; zero for one that is kept.
    nuisance_bounds : (m, 2) numpy.ndarray
    weights : (M,) numpy.ndarray
        Weight of each surprise: the root of the independent readings that its sample gives.
    scales : (M,) numpy.ndarray
        What each surprise is divided by; 1 [pulse] until `reweigh`.
    """

    def __init__(
        self, dynamics, records, unknown=None, *, free=False, zeros=False, steps_per_sample=4, sweeps=3, threads=None
    ):
        records, unknown = checked(dynamics, records, unknown)
        n, replayed = dynamics.n, any(record.law is not None and record.law.replays for record in records)
        correction = Correction.with_memory(n, _REPLAYED if replayed else _MEMORY)
        if free:
            correction = Correction(position=(0.0,) * n, speed=(0.0,) * n, zero=(0.0,) * n)
        shares = correction.number_names("correction.")[: 0 if free else 2 * n]
        turns = [f"record[{k}].zero[{i}]" for k in range(len(records) if zeros else 0) for i in range(n)]
        self.unknown, self._own = (*unknown, *shares, *turns), len(unknown) + len(shares)
        self.nuisances = np.append(correction.number_values()[: len(shares)], np.zeros(len(turns)))
        self.nuisance_steps = np.append(_SMALL * self.nuisances[: len(shares)], np.full(len(turns), _TURN))
        limits = ([_POSITION] * n + [_SPEED] * n)[: len(shares)] + [(-_TURNED, _TURNED)] * len(turns)
        self.nuisance_bounds = np.array(limits).reshape(-1, 2)
        if replayed:
            self.nuisance_bounds[: len(shares), 1] = self.nuisances[: len(shares)]
        names = (*unknown, *shares, *(correction.number_names("correction.")[2 * n :] if zeros else ()))
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = [_Followed(dynamics, record, names, options) for record in records]
        self.weights = np.concatenate([followed.weight.ravel() for followed in self._followed])
        self.scales = np.ones(len(self.weights))
        self.threads = int(threads or cores())
        self.evaluations = 0

    def _each(self, values):
        """Each record's loop, and what it is given of values (k,)."""
        pairs = zip(self._followed, self.zeros_in(values), strict=True)
        return [(followed, np.append(values[: self._own], zero)) for followed, zero in pairs]

    def zeros_in(self, values):
        """Where the joints of each record are when their counters say zero (R, n) [rad], of values (k,)."""
        return np.reshape(values[self._own :], (len(self._followed), -1))

    def surprises(self, values):
        """Weighted surprises (M,), scaled, with these values (k,) of the unknowns; inf where the run diverges."""
        self.evaluations += 1
        return np.concatenate([followed.surprises(own) for followed, own in self._each(values)]) / self.scales

    def reweigh(self, values):
        """Let each joint of each record count by how closely the model can follow it at all.

        What the model lacks is not the same in every record; the one that it follows worst must not have the last word.

        Returns
        -------
        bool
            Whether scales have changed: not while all are followed about equally well.
        """
        scatter = []
        for followed, own in self._each(values):
            readings = np.maximum((followed.weight**2).sum(axis=0), 1.0)
            scatter.append(np.sqrt((followed.surprises(own).reshape(-1, followed.loop.n) ** 2).sum(axis=0) / readings))
        if not np.min(scatter) > 0 or np.max(scatter) < _UNEQUAL * np.min(scatter):
            return False
        rows = zip(self._followed, scatter, strict=True)
        self.scales = np.concatenate([np.broadcast_to(own, followed.weight.shape).ravel() for followed, own in rows])
        return True

    def all_surprises(self, many):
        """The same for several vectors of values, side by side."""
        return shared_out(self.surprises, list(many), self.threads)

    def motions(self, values):
        """Joint positions (N, n) [rad] of each record's arm with these values."""
        self.evaluations += 1
        logs = [followed.run(own)[0] for followed, own in self._each(values)]
        return [np.hsplit(log, 4)[2] for log in logs]


class _Followed(Experiment):
    """One record, ready to be followed."""

    def __init__(self, dynamics, record, unknown, options):
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

    def _settled(self):
        """0 (N,) while a replay has not found the log again: after a gap, and a start at a speed that nobody knows."""
        settled, record = np.ones(len(self.record)), self.record
        if not record.law.replays:
            return settled
        measured = np.flatnonzero(record.valid)
        begins = measured[1:][np.diff(record.t[measured]) > _LOST * record.rig.period].tolist()
        if record.reference is None and record.initial is None and self.state[self.loop.n : 2 * self.loop.n].any():
            begins.append(0)
        for row in begins:
            settled[row : row + _SETTLING] = 0
        return settled

    def run(self, values):
        """Log (N, 4n) and final state of a run with these values."""
        numbers, n, state = self.numbers.copy(), self.loop.n, self.state.copy()
        numbers[self.places] = values
        state[:n] += numbers[-n:]  # where the counters' zero is
        log, errors = np.full((len(self.clock), 4 * n), np.nan), np.empty((self.steps, n))
        final, _ = self._kernel.run(self._tables, state[:, None], np.empty((0, 1)), numbers, (log, errors))
        return log[self.clock.rows], final[:, 0]

    def surprises(self, values):
        (log, final), n = self.run(values), self.loop.n
        sound = final[-1] > 0 and bounded(final[: 2 * n]) and np.isfinite(log[:, :n]).all()
        return (log[:, :n] * self.weight).ravel() if sound else np.full(log[:, :n].size, np.inf)
