"""Gauss-Newton on the innovations of a prediction: the least sum of squares, and the covariance of the values.

Slopes are central differences of whole runs: friction and a quantiser have no derivative.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.least_squares import least_squares
from plant.parts.sums import dot, norm

__all__ = ["DEPENDENT", "Solution", "gauss_newton", "noise", "slopes", "variance_inflation"]

DEPENDENT = 1e-4
"""An unknown whose slope is independent of the others' by less than this share is not separately identifiable."""

_SHORTER = 8
"""How often a step that loses the log is cut to a quarter."""

_JUMP = 0.01
"""Change of the innovations, in their own length, from which on it can be a jump."""

_LAGS = 50
"""Samples over which the autocorrelation of the innovations is added up."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """What `gauss_newton` found.

    Attributes
    ----------
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
    residual : (M,) numpy.ndarray
    rms_innovation : float
        Root mean square of the innovations, weights divided out [pulses].
    varied : (v,) numpy.ndarray
        Places of the unknowns that were varied.
    slopes : (M, v) numpy.ndarray
        Of the weighted and scaled innovations, by these.
    """

    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    residual: NDArray[np.float64]
    rms_innovation: float
    varied: NDArray[np.intp]
    slopes: NDArray[np.float64]


def gauss_newton(
    prediction: Any,
    start: ArrayLike,
    step: ArrayLike,
    bounds: ArrayLike,
    *,
    rounds: int = 15,
    tolerance: float = 1e-5,
) -> Solution:
    """Least sum of squared innovations.

    Parameters
    ----------
    prediction : Prediction
        Or anything else with its `innovations`, `all_innovations`, `unknown`, `weights` and `scales`.
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
    Solution

    Raises
    ------
    ValueError
        A start that diverges, or unknowns that are not separately identifiable (with names).
    """
    bounds, step = np.asarray(bounds, float), np.array(step, float)
    values = np.clip(start, *bounds.T)
    residual = prediction.innovations(values)
    if not np.isfinite(residual).all():
        where = prediction.lost(values)
        raise ValueError(
            f"the search must start from an arm that follows the log; the one that it was given diverges"
            f"{f' on {where}' if where else ''}. Check signs, "
            "units and the order of joints, or give ranges."
        )
    for _ in range(rounds):
        change = _change(prediction, values, residual, step, bounds)
        cost, lengths = dot(residual, residual), 0.5 ** np.arange(8)
        tried = np.clip(values + lengths[:, None] * change, *bounds.T)
        for i in range(0, len(lengths), 4):
            results = prediction.all_innovations(tried[i : i + 4])
            costs = [np.inf if not np.isfinite(r).all() else dot(r, r) for r in results]
            best = int(np.argmin(costs))
            if costs[best] < cost:
                values, residual = tried[i + best], results[best]
                break
        if not dot(residual, residual) < (1 - tolerance) * cost:
            break
    covariance, varied = np.zeros((len(values), len(values))), np.flatnonzero(step)
    names = [prediction.unknown[i] for i in varied]
    change_per_step = slopes(prediction, values, step, varied, residual)
    left = residual * prediction.scales
    part = least_squares(names, change_per_step, residual, dependent=DEPENDENT)[1] * np.outer(
        step[varied], step[varied]
    )
    covariance[np.ix_(varied, varied)] = part * noise(prediction, residual)
    rms = float(np.sqrt(dot(left, left) / dot(prediction.weights, prediction.weights)))
    return Solution(
        values=values, covariance=covariance, residual=left, rms_innovation=rms, varied=varied,
        slopes=change_per_step / step[varied],
    )  # fmt: skip


def _change(
    prediction: Any,
    values: NDArray[np.float64],
    residual: NDArray[np.float64],
    step: NDArray[np.float64],
    bounds: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Gauss-Newton's change (k,) of the values; one that would leave its bounds stays, the others make up for it."""
    varied, change = np.flatnonzero(step), np.zeros(len(values))
    change_per_step, moving = slopes(prediction, values, step, varied, residual), np.ones(len(varied), bool)
    while moving.any():
        some = varied[moving]
        names = [prediction.unknown[i] for i in some]
        solved = least_squares(names, change_per_step[:, moving], residual, dependent=DEPENDENT)[0]
        change[:] = 0
        change[some] = -solved * step[some]
        low, high = bounds[some].T
        pushed = ((values[some] <= low) & (change[some] < 0)) | ((values[some] >= high) & (change[some] > 0))
        if not pushed.any():
            break
        change[some[pushed]] = 0
        moving[np.flatnonzero(moving)[pushed]] = False
    return change


def slopes(
    prediction: Any,
    values: NDArray[np.float64],
    step: NDArray[np.float64],
    varied: NDArray[np.intp],
    residual: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Change of the innovations per step (M, v), by central differences of the varied unknowns (v,).

    Steps that lose the log are shortened in place; with the innovations (M,) of the values themselves, also those on
    which innovations jump to one side.
    """
    found, waiting = np.empty((len(prediction.weights), len(varied))), list(range(len(varied)))
    for attempt in range(_SHORTER):
        step[varied[waiting]] *= 0.25 if attempt else 1.0
        moves = np.zeros((len(waiting), len(values)))
        moves[np.arange(len(waiting)), varied[waiting]] = step[varied[waiting]]
        results = prediction.all_innovations([*(values + moves), *(values - moves)])
        lost, jumping = [], []
        for i, up, down in zip(waiting, results[: len(waiting)], results[len(waiting) :], strict=True):
            if not (np.isfinite(up).all() and np.isfinite(down).all()):
                lost.append(i)
                continue
            found[:, i] = (up - down) / 2
            if residual is not None and _jumps(up, residual, down):
                jumping.append(i)
        waiting = [*lost, *jumping]
        if not waiting:
            return found
    if not lost:
        return found
    names = ", ".join(prediction.unknown[varied[i]] for i in lost)
    raise ValueError(f"every unknown must keep the arm on the log; any change of {names} loses it. Narrow the ranges.")


def _jumps(up: NDArray[np.float64], residual: NDArray[np.float64], down: NDArray[np.float64]) -> bool:
    """Whether innovations change to one side alone, and by much: there an arm's links lose their inertia."""
    bent = norm(up - 2 * residual + down)
    return bool(bent > max(norm(up - down) / 2, _JUMP * norm(residual)))


def noise(prediction: Any, residual: NDArray[np.float64]) -> float:
    """Variance of weighted innovations (M,) per independent reading, inflated by their autocorrelation."""
    return float(dot(residual, residual) / dot(prediction.weights, prediction.weights) * variance_inflation(residual))


def variance_inflation(residual: NDArray[np.float64]) -> float:
    """By how much autocorrelation makes the variance of a mean exceed that of independent samples: 1 without any."""
    spectrum = np.abs(np.fft.rfft(residual, 2 * len(residual))) ** 2
    own = np.fft.irfft(spectrum)[: _LAGS + 1]
    if not own[0] > 0:
        return 1.0
    return float(max(1.0, 1 + 2 * np.sum(own[1:] / own[0] * (1 - np.arange(1, _LAGS + 1) / (_LAGS + 1)))))
