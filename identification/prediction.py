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

import dataclasses

import numpy as np

from identification.experiment import Experiment, checked, cores, shared_out
from identification.least_squares import least_squares
from plant.correction import Correction
from plant.loop import bounded

__all__ = ["Fit", "Prediction", "gauss_newton", "memory_of", "slopes"]

_MEMORY = 10
"""Samples over which the correction forgets, to begin with."""

_REPLAYED = 7
"""The same where a law repeats a log, and kept: what such a model lacks is friction, not noise, and has a memory. Left
to the log, the shares would follow the counts so closely that little else shows."""

_SMALL = 0.01
"""Step of the shares, relative."""

_TURN, _TURNED = 1e-4, 0.5
"""Step of a counter's zero, and its largest magnitude [rad]."""

_UNEQUAL = 1.5
"""Ratio of scatters from which on records and joints are weighted by them."""

_POSITION, _SPEED = (1e-3, 0.9), (1e-7, 0.5)
"""Between which the shares of position and of speed are looked for."""

_WINDOW = 10
"""Samples before and after, over which the speed of the counts is taken."""

_DEPENDENT = 1e-4
"""Share of its own below which the change that an unknown makes is that of others: of central differences."""

_SHORTER = 8
"""How often a step that loses the log is cut to a quarter."""

_LAGS = 50
"""Samples over which the memory of the surprises is added up."""


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
        self.nuisance_steps = np.append(0.0 if replayed else _SMALL, _TURN)[[0] * len(shares) + [1] * len(turns)]
        self.nuisance_steps[: len(shares)] *= self.nuisances[: len(shares)]
        limits = ([_POSITION] * n + [_SPEED] * n)[: len(shares)] + [(-_TURNED, _TURNED)] * len(turns)
        self.nuisance_bounds = np.array(limits).reshape(-1, 2)
        names = (*unknown, *shares, *(correction.number_names("correction.")[2 * n :] if zeros else ()))
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = [_Followed(dynamics, record, names, options) for record in records]
        self.weights = np.concatenate([followed.weight.ravel() for followed in self._followed])
        self.scales = np.ones(len(self.weights))
        self.threads = int(threads or cores())
        self.evaluations = 0

    def _each(self, values):
        """Each record's loop, and what it is given of values (k,)."""
        own, zeros = values[: self._own], np.asarray(values[self._own :]).reshape(len(self._followed), -1)
        return [(followed, np.append(own, zero)) for followed, zero in zip(self._followed, zeros, strict=True)]

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
        self._tables = self._kernel.prepared((*self.times, self.data(record.rig.counted(counts))), logged=True)
        before = np.maximum(np.arange(len(counts)) - _WINDOW, 0)
        after = np.minimum(np.arange(len(counts)) + _WINDOW, len(counts) - 1)
        steps = np.vstack([np.zeros(record.n), np.abs(np.diff(counts, axis=0)).cumsum(axis=0)])
        moved = (steps[after] - steps[before]) / np.maximum(after - before, 1)[:, None]
        self.weight = np.sqrt(np.minimum(1.0, moved) * record.valid[:, None])

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


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What `gauss_newton` found.

    Attributes
    ----------
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
    residual : (M,) numpy.ndarray
    scatter : float
        Root mean square of the surprises, weights divided out [pulses].
    """

    values: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    scatter: float


def gauss_newton(prediction, start, step, bounds, *, rounds=15, tolerance=1e-5):
    """Smallest sum of squared surprises.

    Parameters
    ----------
    prediction : Prediction
    start : (k,) array_like
    step : (k,) array_like
        Of the central differences; zero leaves an unknown as it is.
    bounds : (k, 2) array_like
        Values stay inside.
    rounds : int
    tolerance : float
        Relative decrease of the sum below which the search ends.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        A start that diverges, or unknowns that the log cannot tell apart (with names).
    """
    bounds, step = np.asarray(bounds, float), np.array(step, float)
    values = np.clip(start, *bounds.T)
    residual = prediction.surprises(values)
    if not np.isfinite(residual).all():
        raise ValueError(
            f"the search must start from an arm that follows the log; {values} diverges. Check the ranges."
        )
    for _ in range(rounds):
        change = _change(prediction, values, residual, step, bounds)
        cost, shares = residual @ residual, 0.5 ** np.arange(8)
        tried = np.clip(values + shares[:, None] * change, *bounds.T)
        for i in range(0, len(shares), 4):
            results = prediction.all_surprises(tried[i : i + 4])
            costs = [np.inf if not np.isfinite(r).all() else r @ r for r in results]
            best = int(np.argmin(costs))
            if costs[best] < cost:
                values, residual = tried[i + best], results[best]
                break
        if not residual @ residual < (1 - tolerance) * cost:
            break
    covariance, free = np.zeros((len(values), len(values))), np.flatnonzero(step)
    names = [prediction.unknown[i] for i in free]
    change_per_step = slopes(prediction, values, step, free)
    readings, left = prediction.weights @ prediction.weights, residual * prediction.scales
    part = least_squares(names, change_per_step, residual, dependent=_DEPENDENT)[1] * np.outer(step[free], step[free])
    covariance[np.ix_(free, free)] = part * (residual @ residual / readings) * memory_of(residual)
    return Fit(values=values, covariance=covariance, residual=left, scatter=float(np.sqrt(left @ left / readings)))


def _change(prediction, values, residual, step, bounds):
    """Gauss-Newton's change (k,) of the values; one that would leave its bounds stays, the others make up for it."""
    free, change = np.flatnonzero(step), np.zeros(len(values))
    change_per_step, moving = slopes(prediction, values, step, free), np.ones(len(free), bool)
    while moving.any():
        some = free[moving]
        names = [prediction.unknown[i] for i in some]
        solved = least_squares(names, change_per_step[:, moving], residual, dependent=_DEPENDENT)[0]
        change[:] = 0
        change[some] = -solved * step[some]
        low, high = bounds[some].T
        pushed = ((values[some] <= low) & (change[some] < 0)) | ((values[some] >= high) & (change[some] > 0))
        if not pushed.any():
            break
        change[some[pushed]] = 0
        moving[np.flatnonzero(moving)[pushed]] = False
    return change


def slopes(prediction, values, step, free):
    """Change of the surprises per step, by central differences; steps that lose the log are shortened in place."""
    found, waiting = np.empty((len(prediction.weights), len(free))), list(range(len(free)))
    for _ in range(_SHORTER):
        moves = np.zeros((len(waiting), len(values)))
        moves[np.arange(len(waiting)), free[waiting]] = step[free[waiting]]
        results = prediction.all_surprises([*(values + moves), *(values - moves)])
        lost = []
        for i, up, down in zip(waiting, results[: len(waiting)], results[len(waiting) :], strict=True):
            if np.isfinite(up).all() and np.isfinite(down).all():
                found[:, i] = (up - down) / 2
            else:
                lost.append(i)
        if not lost:
            return found
        step[free[lost]] *= 0.25
        waiting = lost
    names = ", ".join(prediction.unknown[free[i]] for i in lost)
    raise ValueError(f"every unknown must keep the arm on the log; any change of {names} loses it. Narrow the ranges.")


def memory_of(residual):
    """By how much the variance of a mean exceeds that of independent samples: 1 where there is no memory."""
    spectrum = np.abs(np.fft.rfft(residual, 2 * len(residual))) ** 2
    own = np.fft.irfft(spectrum)[: _LAGS + 1]
    if not own[0] > 0:
        return 1.0
    return float(max(1.0, 1 + 2 * np.sum(own[1:] / own[0] * (1 - np.arange(1, _LAGS + 1) / (_LAGS + 1)))))
