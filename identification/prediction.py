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
from plant.simulator import loop_kernel

__all__ = ["Fit", "Prediction", "gauss_newton", "memory_of", "slopes"]

_MEMORY = 10
"""Samples over which the correction forgets, to begin with."""

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
    steps_per_sample, sweeps, threads
        As for `Objective`.
    """

    def __init__(self, dynamics, records, unknown=None, *, free=False, steps_per_sample=4, sweeps=3, threads=None):
        records, unknown = checked(dynamics, records, unknown)
        n = dynamics.n
        correction = Correction(position=(0.0,) * n, speed=(0.0,) * n) if free else Correction.with_memory(n, _MEMORY)
        self.shares = () if free else tuple(correction.number_names("correction."))
        self.initial_shares = np.empty(0) if free else correction.number_values()
        self.share_bounds = np.empty((0, 2)) if free else np.array([_POSITION] * n + [_SPEED] * n)
        self.unknown = (*unknown, *self.shares)
        options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "correction": correction}
        self._followed = [_Followed(dynamics, record, self.unknown, options) for record in records]
        self.threads = int(threads or cores())
        self.evaluations = 0

    def surprises(self, values):
        """Weighted surprises (M,) [pulses] with these values (k,) of the unknowns; inf where the run diverges."""
        self.evaluations += 1
        return np.concatenate([followed.surprises(values) for followed in self._followed])

    def all_surprises(self, many):
        """The same for several vectors of values, side by side."""
        return shared_out(self.surprises, list(many), self.threads)

    def motions(self, values):
        """Joint positions (N, n) [rad] of each record's arm with these values."""
        self.evaluations += 1
        return [followed.run(values)[0][:, 2 * followed.loop.n : 3 * followed.loop.n] for followed in self._followed]

    @property
    def weights(self):
        """Weight (M,) of each surprise: the root of the independent readings that its sample gives."""
        return np.concatenate([followed.weight.ravel() for followed in self._followed])


class _Followed(Experiment):
    """One record, ready to be followed."""

    def __init__(self, dynamics, record, unknown, options):
        super().__init__(dynamics, record, unknown, smooth=True, **options)
        counts = record.counts
        self._kernel = loop_kernel(self.loop)
        self._tables = self._kernel.prepared((*self.times, record.rig.counted(counts)), logged=True)
        before = np.maximum(np.arange(len(counts)) - _WINDOW, 0)
        after = np.minimum(np.arange(len(counts)) + _WINDOW, len(counts) - 1)
        steps = np.vstack([np.zeros(record.n), np.abs(np.diff(counts, axis=0)).cumsum(axis=0)])
        self.weight = np.sqrt(np.minimum(1.0, (steps[after] - steps[before]) / np.maximum(after - before, 1)[:, None]))

    def run(self, values):
        """Log (N, 4n) and final state of a run with these values."""
        numbers, n = self.numbers.copy(), self.loop.n
        numbers[self.places] = values
        log, errors = np.full((len(self.record), 4 * n), np.nan), np.empty((self.steps, n))
        final, _ = self._kernel.run(self._tables, self.state[:, None], np.empty((0, 1)), numbers, (log, errors))
        return log, final[:, 0]

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
    free = np.flatnonzero(step)
    names = [prediction.unknown[i] for i in free]
    values = np.clip(start, *bounds.T)
    residual = prediction.surprises(values)
    if not np.isfinite(residual).all():
        raise ValueError(
            f"the search must start from an arm that follows the log; {values} diverges. Check the ranges."
        )
    for _ in range(rounds):
        change_per_step = slopes(prediction, values, step, free)
        change = np.zeros(len(values))
        change[free] = -least_squares(names, change_per_step, residual, dependent=_DEPENDENT)[0] * step[free]
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
    covariance = np.zeros((len(values), len(values)))
    change_per_step = slopes(prediction, values, step, free)
    weight = prediction.weights
    scatter = float(np.sqrt(residual @ residual / (weight @ weight)))
    part = least_squares(names, change_per_step, residual, dependent=_DEPENDENT)[1] * np.outer(step[free], step[free])
    covariance[np.ix_(free, free)] = part * scatter**2 * memory_of(residual)
    return Fit(values=values, covariance=covariance, residual=residual, scatter=scatter)


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
