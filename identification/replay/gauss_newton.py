"""Gauss-Newton on the innovations of a residual: least sum of squares and covariance of the values.

Slopes are central differences of whole simulations: friction and a quantiser have no derivative.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import IDENTIFIABLE, least_squares
from identification.replay.residual import Innovations, Residual, Reweighable
from identification.replay.weak_directions import with_weak_directions
from plant.compiler import cores
from plant.parts import Bools, Floats, Integers, dot, frozen, frozen_settings, norm

# The usual rule; a residual with a prior has another (`Residual.dependent`).
DEPENDENT = IDENTIFIABLE.slopes


@frozen_settings
class GaussNewtonSettings:
    """How `descend` searches, and how its slopes are made; all numbers are chosen by hand.

    Parameters
    ----------
    rounds : int
        Most linearisations.
    tolerance : float
        Relative decrease of the sum of squares below which the search ends.
    batches : tuple of int
        Numbers of step lengths 1, 1/2, 1/4 ... that are simulated together, until one of a batch
        lowers the sum.
    longest : bool
        Take the longest step of a batch that lowers the sum, in place of the one that lowers it
        most.
    shortenings : int
        Number of tries of a difference that loses the log; each is a quarter as long as the last.
    jump : float
        Least second difference of the innovations, relative to their norm, that can be a jump.
    weighings : int
        Most times that records and joints are weighted anew.
    unknowns_per_core : int
        Unknowns whose slopes are made at once, per core: the simulations of all unknowns would take
        twice the memory of the slopes.
    innovations_at_once : int
        Innovations of a simulation beyond which it runs alone, for its memory.
    """

    rounds: int = 15
    tolerance: float = 1e-5
    batches: tuple[int, ...] = (4, 4)
    longest: bool = False
    shortenings: int = 8
    jump: float = 0.01
    weighings: int = 2
    unknowns_per_core: int = 4
    innovations_at_once: int = 1 << 21


SETTINGS = GaussNewtonSettings()


@frozen
class Solution:
    """Least sum of squares that `gauss_newton` reached.

    `values` (k,). `covariance` (k, k). `residual` (M,). `rms_innovation`: root mean square of the
    innovations, weights divided out [pulses]. `varied` (v,): places of the unknowns that were
    varied. `slopes` (M, v): derivatives of the weighted and scaled innovations by these unknowns.
    `undetermined` (u, k): directions of the values that only the expected values determine, not
    the readings.
    """

    values: Floats
    covariance: Floats
    residual: Floats
    rms_innovation: float
    varied: Integers
    slopes: Floats
    undetermined: Floats


@dataclass
class Descent:
    """A point of a search, which `descend` moves.

    `values` (k,). `innovations` (M,) at them. `slopes` (M, v): change of the innovations per step
    of the varied unknowns; where the last linearisation was, not always at `values`. `moved`:
    whether the last round lowered the sum of squares by more than the tolerance.
    """

    values: Floats
    innovations: Floats
    slopes: Floats
    moved: bool = True

    @property
    def squares(self) -> float:
        return dot(self.innovations, self.innovations)


def gauss_newton(
    residual: Residual,
    start: ArrayLike,
    step: ArrayLike,
    bounds: ArrayLike,
    *,
    rounds: int = SETTINGS.rounds,
    tolerance: float = SETTINGS.tolerance,
) -> Solution:
    """Least sum of squared innovations.

    `start` (k,). `step` (k,): of the central differences; zero leaves an unknown as it is. `bounds`
    (k, 2): values stay inside. `tolerance`: relative decrease of the sum below which the search
    ends.
    """
    bounds = np.asarray(bounds, float)
    # A copy: steps that lose the log are shortened in place.
    step = np.array(step, float)
    values = np.clip(start, *bounds.T)
    innovations = residual.innovations(values)
    if not np.isfinite(innovations).all():
        label = residual.lost(values)
        raise ValueError(
            "the search must start from an arm that follows the log; the one that it was given"
            f" diverges{f' on {label}' if label else ''}. Check signs, units and the order of"
            " joints, or give ranges."
        )
    varied = np.flatnonzero(step)
    names = [residual.unknown[i] for i in varied.tolist()]

    def solve(slopes: Floats, innovations: Floats, moving: Bools) -> Floats:
        moving_names = [name for name, moves in zip(names, moving, strict=True) if moves]
        # Without a copy where no bound is active: slopes are the largest array of a fit.
        columns = slopes if moving.all() else slopes[:, moving]
        return least_squares(moving_names, columns, innovations, dependent=residual.dependent)[0]

    def measured(values: Floats, slopes: Floats) -> Floats:
        return with_weak_directions(residual, values, step, varied, slopes).slopes

    # 1. Search.
    settings = replace(SETTINGS, rounds=rounds, tolerance=tolerance)
    point = Descent(values, innovations, np.empty((0, 0)))
    del innovations  # The point replaces them; a long log has no room for both.
    descend(
        residual,
        point,
        step,
        bounds,
        solve,
        settings,
        shorten_jumps=True,
        measured=measured,
    )

    # 2. Covariance, from slopes at the values that the search ended with.
    if point.moved:
        point.slopes = np.empty((0, 0))
        point.slopes = slopes(residual, point.values, step, varied, point.innovations, bounds)
    point.slopes, directions = with_weak_directions(
        residual, point.values, step, varied, point.slopes
    )
    undetermined = np.zeros((len(directions), len(values)))
    undetermined[:, varied] = directions * step[varied]
    # An unknown that was not varied is exact: its row is zero.
    covariance = np.zeros((len(values), len(values)))
    # In pulses, so that solutions with other weights can be compared.
    unscaled = point.innovations * residual.scales
    # The inverse of the information in steps; steps and noise give it the units of the unknowns.
    inverse = least_squares(names, point.slopes, point.innovations, dependent=residual.dependent)[1]
    covariance[np.ix_(varied, varied)] = (
        inverse * np.outer(step[varied], step[varied]) * noise(residual, point.innovations)
    )
    rms = float(np.sqrt(dot(unscaled, unscaled) / dot(residual.weights, residual.weights)))
    # Per unit of the unknown, in place: users of a solution do not know the steps.
    point.slopes /= step[varied]
    return Solution(
        values=point.values,
        covariance=covariance,
        residual=unscaled,
        rms_innovation=rms,
        varied=varied,
        slopes=point.slopes,
        undetermined=undetermined,
    )


def descend(
    residual: Innovations,
    point: Descent,
    step: Floats,
    bounds: Floats,
    solve: Callable[[Floats, Floats, Bools], Floats],
    settings: GaussNewtonSettings,
    *,
    shorten_jumps: bool,
    fixed_slopes: bool = False,
    measured: Callable[[Floats, Floats], Floats] | None = None,
) -> None:
    """Move a point to the least sum of squares in its bounds, by Gauss-Newton with an active set.

    `step` (k,): of the central differences, which may be shortened in place. `solve`: slopes (M,
    v), innovations (M,) and which of the varied unknowns move (v,) -> their least squares, in
    steps, to be subtracted. `shorten_jumps`: shorten differences across a jump, too.
    `fixed_slopes`: keep the slopes that the point has. `measured`: values (k,) and slopes (M, v) at
    them -> slopes whose weak directions are simulated.
    """
    varied = np.flatnonzero(step)
    # Halved steps: innovations are not linear in the unknowns, and the full one may end too far.
    lengths = 0.5 ** np.arange(sum(settings.batches))
    for remaining in reversed(range(settings.rounds)):
        # 1. Linearise. The slopes of the previous round go first: both would not fit.
        if not fixed_slopes:
            point.slopes = np.empty((0, 0))
            point.slopes = slopes(
                residual,
                point.values,
                step,
                varied,
                point.innovations if shorten_jumps else None,
                bounds,
            )
            if measured is not None:
                point.slopes = measured(point.values, point.slopes)

        # 2. Solve, with the unknowns that would leave their bounds held on them.
        change = within_bounds(
            lambda moving: solve(point.slopes, point.innovations, moving),
            point.values,
            step,
            bounds,
        )

        # 3. Search along the change. Clipping projects a step that ends outside onto the bounds.
        squares = point.squares
        vectors = np.clip(point.values + lengths[:, None] * change, *bounds.T)
        _search(residual, point, vectors, settings)
        point.moved = point.squares < (1 - settings.tolerance) * squares
        if not remaining or not point.moved:
            break


def _search(residual, point, vectors, settings):
    """Move a point to the one of several vectors that lowers the squares, batch by batch."""
    squares = point.squares
    begin = 0
    for count in settings.batches:
        rows = residual.all_innovations(vectors[begin : begin + count])
        # A diverged simulation is no candidate.
        costs = [np.inf if not np.isfinite(row).all() else dot(row, row) for row in rows]
        lower = [cost < squares for cost in costs]
        if any(lower):
            best = lower.index(True) if settings.longest else int(np.argmin(costs))
            point.values = vectors[begin + best]
            # A copy: rows of several vectors may share memory that would stay occupied.
            point.innovations = rows[best].copy()
            return
        begin += count


def reweighed(
    residual: Reweighable,
    solution: Solution,
    step: ArrayLike,
    bounds: ArrayLike,
    reweigh: Callable[[Solution], bool] | None = None,
) -> Solution:
    """The solution with records and joints weighted by its innovations, until weights settle.

    `reweigh`: weighs anew in place of the residual's own `reweigh`.
    """
    for _ in range(SETTINGS.weighings):
        # Weights follow from the innovations, and these from a fit with weights: hence in turn.
        changed = residual.reweigh(solution.values) if reweigh is None else reweigh(solution)
        if not changed:
            break
        solution = gauss_newton(residual, solution.values, step, bounds)
    return solution


def within_bounds(
    solve: Callable[[Bools], Floats], values: Floats, step: Floats, bounds: Floats
) -> Floats:
    """Gauss-Newton's change (k,) of the values, with an active set of bounds.

    A value that would leave its bounds stays, and the others are solved again without it.

    `solve`: which of the varied unknowns move (v,) -> their least squares, to be subtracted, in
    steps.
    """
    varied = np.flatnonzero(step)
    change = np.zeros(len(values))
    low, high = bounds.T
    # Each round holds at least one more value: it ends after as many rounds as there are unknowns.
    moving = np.ones(len(varied), bool)
    while moving.any():
        places = varied[moving]
        change[:] = 0
        change[places] = -solve(moving) * step[places]
        # Only a value that lies on a bound already: one inside may move up to it, and is clipped.
        leaving = ((values <= low) & (change < 0)) | ((values >= high) & (change > 0))
        if not leaving.any():
            break
        change[leaving] = 0
        moving &= ~leaving[varied]
    return change


def ended_on_bounds(
    unknown: Sequence[str], values: Floats, bounds: Floats, varied: Integers
) -> list[str]:
    """Names of the varied unknowns whose values (k,) lie on one of their bounds (k, 2)."""
    low, high = bounds.T
    on_bound = ((values <= low) | (values >= high))[: len(unknown)]
    return [unknown[i] for i in varied.tolist() if i < len(on_bound) and on_bound[i]]


def slopes(
    residual: Innovations,
    values: Floats,
    step: Floats,
    varied: Integers,
    innovations: Floats | None = None,
    bounds: Floats | None = None,
) -> Floats:
    """Change of the innovations (M, v) per step of the varied unknowns.

    By central differences; by one-sided ones where a value lies on one of its bounds (k, 2).

    Steps that lose the log are shortened in place. If the innovations (M,) at the values are given,
    steps are also shortened where the innovations jump on one side.
    """
    # A number has no meaning beyond its bound: negative friction would act like positive friction,
    # and the central difference about zero would vanish.
    low, high = (-np.inf, np.inf) if bounds is None else bounds.T
    up_from, down_from = values < high, values > low
    # A row per unknown, which differences fill one by one; the transpose is a view.
    changes = np.empty((len(varied), len(residual.weights)))
    waiting = list(range(len(varied)))
    together = SETTINGS.unknowns_per_core * side_by_side(changes.shape[1])
    for attempt in range(SETTINGS.shortenings):
        # Only the steps that failed are shortened: others have good slopes.
        step[varied[waiting]] *= 0.25 if attempt else 1.0
        lost = []
        jumping = []
        for begin in range(0, len(waiting), together):
            block = waiting[begin : begin + together]
            moves = np.zeros((len(block), len(values)))
            moves[np.arange(len(block)), varied[block]] = step[varied[block]]
            # Both sides of all unknowns of a block in one call, side by side on the cores.
            rows = residual.all_innovations(
                [*(values + up_from * moves), *(values - down_from * moves)]
            )
            for i, up, down in zip(block, rows[: len(block)], rows[len(block) :], strict=True):
                if not (np.isfinite(up).all() and np.isfinite(down).all()):
                    lost.append(i)
                    continue
                central = up_from[varied[i]] and down_from[varied[i]]
                np.subtract(up, down, out=changes[i])
                changes[i] *= 0.5 if central else 1.0
                # A difference to one side alone has no second one to compare it with.
                if not central or innovations is None:
                    continue
                if _jumps(up, innovations, down, changes[i]):
                    jumping.append(i)
            # These rows are as large as the slopes: they go before the next block comes.
            del rows, up, down
        waiting = [*lost, *jumping]
        if not waiting:
            return changes.T
    # A jump that no step avoids is kept: its slope exists. That of a lost log does not.
    if not lost:
        return changes.T
    names = ", ".join(residual.unknown[varied[i]] for i in lost)
    raise ValueError(
        f"every unknown must keep the arm on the log; any change of {names} loses it. Narrow the"
        " ranges."
    )


def side_by_side(innovations: int) -> int:
    """Number of simulations with so many innovations that run at once.

    As many as cores; one of a long log, for its memory.
    """
    return min(cores(), max(1, SETTINGS.innovations_at_once // innovations))


def _jumps(up, innovations, down, slope):
    """Whether innovations change much on one side only, as where the links lose their inertia.

    Overwrites `up`. `slope` is half of the difference between `up` and `down`.
    """
    # The second difference up - 2 r + down; a smooth residual has almost none.
    up -= 2 * innovations
    up += down
    return norm(up) > max(norm(slope), SETTINGS.jump * norm(innovations))


def noise(residual: Residual, innovations: Floats) -> float:
    """Variance of weighted innovations (M,) per independent reading.

    It is inflated by their autocorrelation.
    """
    return float(
        dot(innovations, innovations)
        / dot(residual.weights, residual.weights)
        * variance_inflation(innovations)
    )


def variance_inflation(residual: Floats, window: int = 50) -> float:
    """Factor by which autocorrelation raises the variance of a mean: 1 without any.

    `window`: lags [samples] over which the autocorrelation is summed, with Bartlett's weights,
    under which the sum cannot become negative; chosen by hand.
    """
    # Records follow one another in the rows: products across their ends are few.
    lags = np.arange(min(window + 1, len(residual)))
    products = np.array([dot(residual[: len(residual) - lag], residual[lag:]) for lag in lags])
    # A residual of zeros, of a log that the model made itself, has no correlation.
    if not products[0] > 0:
        return 1.0
    weights = 1 - lags[1:] / (window + 1)
    return float(max(1.0, 1 + 2 * np.sum(products[1:] / products[0] * weights)))
