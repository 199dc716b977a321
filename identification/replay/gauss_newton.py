"""Gauss-Newton on the surprises of a prediction: the smallest sum of squares, and how well the values are known.

Slopes are central differences of whole runs: through friction and a quantiser there is no derivative to be had.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from identification.equation_error.least_squares import least_squares

__all__ = ["Fit", "gauss_newton", "memory_of", "slopes"]

_DEPENDENT = 1e-4
"""Share of its own below which the change that an unknown makes is that of others: of central differences."""

_SHORTER = 8
"""How often a step that loses the log is cut to a quarter."""

_LAGS = 50
"""Samples over which the memory of the surprises is added up."""


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
            "the search must start from an arm that follows the log; the one that it was given diverges. Check signs, "
            "units and the order of joints, or give ranges."
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
