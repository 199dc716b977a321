"""Gauss-Newton on the innovations of a prediction: the least sum of squares, and the covariance of
the values.

Slopes are central differences of whole runs: friction and a quantiser have no derivative.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.least_squares import least_squares
from plant.compiler.background import cores
from plant.parts.fields import Floats
from plant.parts.sums import dot, norm

# An unknown whose slope is independent of the others' by less than this share is not separately
# identifiable.
DEPENDENT = 1e-4

_SHORTER = 8  # how often a step that loses the log is cut to a quarter

_JUMP = 0.01  # change of the innovations, in their own length, from which on it can be a jump

# Unknowns whose slopes are made at once, per core: the runs of all would take twice the memory of
# the slopes.
_PER_CORE = 4

_AT_ONCE = 1 << 21  # innovations of a run, beyond which runs do not go side by side

_LAGS = 50  # samples over which the autocorrelation of the innovations is added up

_WEIGHINGS = 2  # how often, at most, records and joints are weighted anew


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """What `gauss_newton` found.

    `values` (k,). `covariance` (k, k). `residual` (M,). `rms_innovation`: root mean square of the
    innovations, weights divided out [pulses]. `varied` (v,): places of the unknowns that were
    varied. `slopes` (M, v): of the weighted and scaled innovations, by these.
    """

    values: Floats
    covariance: Floats
    residual: Floats
    rms_innovation: float
    varied: NDArray[np.intp]
    slopes: Floats


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

    `prediction`: or anything else with its `innovations`, `all_innovations`, `unknown`, `weights`,
    `scales` and `dependent`. `start` (k,). `step` (k,): of the central differences; zero leaves an
    unknown as it is. `bounds` (k, 2): values stay inside. `tolerance`: relative decrease of the sum
    below which the search ends.
    """
    bounds = np.asarray(bounds, float)
    step = np.array(step, float)
    values = np.clip(start, *bounds.T)
    residual = prediction.innovations(values)
    if not np.isfinite(residual).all():
        where = prediction.lost(values)
        raise ValueError(
            "the search must start from an arm that follows the log; the one that it was given"
            f" diverges{f' on {where}' if where else ''}. Check signs, units and the order of"
            " joints, or give ranges."
        )
    varied = np.flatnonzero(step)
    names = [prediction.unknown[i] for i in varied]
    moved = True
    change_per_step = np.empty((0, 0))

    def solved(moving: NDArray[np.bool_]) -> Floats:
        """Least squares of the unknowns that move (v,)."""
        left = [name for name, moves in zip(names, moving, strict=True) if moves]
        columns = change_per_step if moving.all() else change_per_step[:, moving]
        return least_squares(left, columns, residual, dependent=prediction.dependent)[0]

    for left in reversed(range(rounds)):
        change_per_step = slopes(prediction, values, step, varied, residual)
        change = within_bounds(solved, values, step, bounds)
        cost = dot(residual, residual)
        lengths = 0.5 ** np.arange(8)
        tried = np.clip(values + lengths[:, None] * change, *bounds.T)
        for i in range(0, len(lengths), 4):
            results = prediction.all_innovations(tried[i : i + 4])
            costs = [np.inf if not np.isfinite(r).all() else dot(r, r) for r in results]
            best = int(np.argmin(costs))
            if costs[best] < cost:
                values = tried[i + best]
                residual = results[best].copy()
                break
        del results  # not beside the next ones, like the slopes
        moved = dot(residual, residual) < cost
        if not left or not dot(residual, residual) < (1 - tolerance) * cost:
            break
        change_per_step = np.empty((0, 0))
    if moved:
        change_per_step = np.empty((0, 0))
        change_per_step = slopes(prediction, values, step, varied, residual)
    covariance = np.zeros((len(values), len(values)))
    unscaled = residual * prediction.scales
    part = least_squares(names, change_per_step, residual, dependent=prediction.dependent)[1]
    covariance[np.ix_(varied, varied)] = (
        part * np.outer(step[varied], step[varied]) * noise(prediction, residual)
    )
    rms = float(np.sqrt(dot(unscaled, unscaled) / dot(prediction.weights, prediction.weights)))
    change_per_step /= step[varied]
    return Solution(
        values=values,
        covariance=covariance,
        residual=unscaled,
        rms_innovation=rms,
        varied=varied,
        slopes=change_per_step,
    )


def reweighed(
    view: Any,
    solution: Solution,
    step: ArrayLike,
    bounds: ArrayLike,
    changed: Callable[[Solution], bool] | None = None,
) -> Solution:
    """The solution with records and joints weighted anew by what it leaves, while that changes
    their weights.

    `view`: as for `gauss_newton`, with a `reweigh`. `changed`: weighs anew in place of that.
    """
    for _ in range(_WEIGHINGS):
        if not (view.reweigh(solution.values) if changed is None else changed(solution)):
            break
        solution = gauss_newton(view, solution.values, step, bounds)
    return solution


def within_bounds(
    solved: Callable[[NDArray[np.bool_]], Floats], values: Floats, step: Floats, bounds: Floats
) -> Floats:
    """Gauss-Newton's change (k,) of the values; one that would leave its bounds stays, the others
    make up for it.

    `solved`: which of the varied unknowns move (v,) -> their least squares, to be subtracted, in
    steps.
    """
    varied, change, (low, high) = np.flatnonzero(step), np.zeros(len(values)), bounds.T
    moving = np.ones(len(varied), bool)
    while moving.any():
        some = varied[moving]
        change[:] = 0
        change[some] = -solved(moving) * step[some]
        pushed = ((values <= low) & (change < 0)) | ((values >= high) & (change > 0))
        if not pushed.any():
            break
        change[pushed] = 0
        moving &= ~pushed[varied]
    return change


def slopes(
    prediction: Any,
    values: Floats,
    step: Floats,
    varied: NDArray[np.intp],
    residual: Floats | None = None,
) -> Floats:
    """Change of the innovations per step (M, v), by central differences of the varied unknowns
    (v,).

    Steps that lose the log are shortened in place; with the innovations (M,) of the values
    themselves, also those on which innovations jump to one side.
    """
    found = np.empty((len(varied), len(prediction.weights)))
    waiting = list(range(len(varied)))
    together = _PER_CORE * side_by_side(found.shape[1])
    for attempt in range(_SHORTER):
        step[varied[waiting]] *= 0.25 if attempt else 1.0
        lost = list[int]()
        jumping = list[int]()
        for some in (waiting[i : i + together] for i in range(0, len(waiting), together)):
            moves = np.zeros((len(some), len(values)))
            moves[np.arange(len(some)), varied[some]] = step[varied[some]]
            results = prediction.all_innovations([*(values + moves), *(values - moves)])
            for i, up, down in zip(some, results[: len(some)], results[len(some) :], strict=True):
                if not (np.isfinite(up).all() and np.isfinite(down).all()):
                    lost.append(i)
                    continue
                np.multiply(np.subtract(up, down, out=found[i]), 0.5, out=found[i])
                if residual is not None and _jumps(up, residual, down, found[i]):
                    jumping.append(i)
            del results, up, down  # not beside the next ones
        waiting = [*lost, *jumping]
        if not waiting:
            return found.T
    if not lost:
        return found.T
    names = ", ".join(prediction.unknown[varied[i]] for i in lost)
    raise ValueError(
        f"every unknown must keep the arm on the log; any change of {names} loses it. Narrow the"
        " ranges."
    )


def side_by_side(innovations: int) -> int:
    """How many runs with so many innovations are made at once: as many as cores; of a long log
    one, for its memory.
    """
    return min(cores(), max(1, _AT_ONCE // innovations))


def _jumps(up: Floats, residual: Floats, down: Floats, slope: Floats) -> bool:
    """Whether innovations change to one side alone, and by much: there an arm's links lose their
    inertia.

    Takes `up` as work space. `slope` is half of what is between both.
    """
    up -= 2 * residual
    up += down
    return norm(up) > max(norm(slope), _JUMP * norm(residual))


def noise(prediction: Any, residual: Floats) -> float:
    """Variance of weighted innovations (M,) per independent reading, inflated by their
    autocorrelation.
    """
    return float(
        dot(residual, residual)
        / dot(prediction.weights, prediction.weights)
        * variance_inflation(residual)
    )


def variance_inflation(residual: Floats) -> float:
    """By how much autocorrelation makes the variance of a mean exceed that of independent
    samples: 1 without any.
    """
    lags = np.arange(min(_LAGS + 1, len(residual)))
    own = np.array([dot(residual[: len(residual) - lag], residual[lag:]) for lag in lags])
    if not own[0] > 0:
        return 1.0
    return float(max(1.0, 1 + 2 * np.sum(own[1:] / own[0] * (1 - lags[1:] / (_LAGS + 1)))))
