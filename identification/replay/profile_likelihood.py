"""Profile likelihood: how far one coordinate can go before the log speaks against it, all others
fitted anew.

Where innovations are no linear function of a coordinate (a resonance), the curvature at the best
fit says little of the interval; the sum of squares, fitted anew at each of its values, does. Slopes
are taken anew where a walk begins, and updated along the way (Broyden).

Source: C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Mathematics
of Computation 19 (1965) (slopes from evaluations alone).
"""

import dataclasses
from typing import Any

import numpy as np

from identification.equation_error.least_squares import least_squares
from identification.replay.gauss_newton import DEPENDENT, slopes
from plant.parts.fields import Floats
from plant.parts.sums import dot, product

# Steps with which the others are fitted anew, and the decrease, as a share of the level, that ends
# it.
_ROUNDS = 8
_CLOSE = 0.02

_AGAIN = 3  # how often, at most, slopes are taken anew where a walk begins

# Values of a coordinate that are tested for an end, and the relative distance from the level that
# is near enough.
_TRIES = 7
_NEAR = 0.1

_LOWER = 0.25  # by how much, as a share of the level, a lower sum must be lower

# ratio of a sum to that of the best fit from which on the log is lost: slopes say nothing there
_LOST = 100.0

# by how much the distance changes from one to the next
_LEAST = 0.4
_MOST = 2.5


@dataclasses.dataclass
class _Point:
    """Coordinates, their innovations, and the slopes of these per step of the varied
    coordinates.
    """

    z: Floats
    residual: Floats
    slopes: Floats

    @property
    def cost(self) -> float:
        return dot(self.residual, self.residual)


class Profile:
    """The sum of squared innovations along one coordinate.

    `best` (k,): coordinates of the best fit. `change` (M, v): of the innovations there, per step of
    the varied coordinates (v,). `step` (k,): those steps; zero where a coordinate is not varied.
    `bounds` (k, 2). `place`: of the one. `final`: go on where a lower sum is met.

    Attributes: `better` (k,) or None: coordinates with a lower sum than the best fit, if some were
    met on the way; unless `final`, a walk ends there.
    """

    def __init__(
        self,
        view: Any,
        best: Floats,
        change: Floats,
        step: Floats,
        bounds: Floats,
        place: int,
        *,
        final: bool = False,
    ) -> None:
        self._prediction = view
        self._step = step
        self._bounds = bounds
        self._place = place
        self._final = final
        varied = np.flatnonzero(step)
        self._own = int(np.flatnonzero(varied == place)[0])
        self._others = varied != place
        self._places = varied[self._others]
        self._names = [view.unknown[i] for i in self._places]
        self._best = _Point(best, view.innovations(best), change)
        self.better: Floats | None = None

    def rise(self, value: float, level: float) -> float:
        """By how much the least sum exceeds that of the best fit, with the coordinate held at a
        value.
        """
        return self._begun(value, level).cost - self._best.cost

    def end(self, distance: float, level: float, limit: float) -> float:
        """Where the sum has risen by the level, on the way from the best fit to a limit; the limit
        if nowhere.

        `distance`: to be tried first, signed.
        """
        start = self._best.z[self._place]
        sign = np.sign(limit - self._best.z[self._place])
        reach = abs(limit - start)
        # distances: the last below the level, the first above
        low = 0.0
        high = np.inf
        size = min(abs(distance), reach)
        point = None
        for _ in range(_TRIES):
            if not size > 0:
                break
            value = start + sign * size
            point = (
                self._moved(point, value, level)
                if point and self._follows(point)
                else self._begun(value, level)
            )
            if not self._follows(point):
                point = self._begun(value, level)
            rise = point.cost - self._best.cost
            if self.better is not None and not self._final:
                return float(start)
            if abs(rise - level) < _NEAR * level:
                break
            low, high = (size, high) if rise < level else (low, size)
            if low >= reach:
                return limit
            guess = (
                size * np.sqrt(level / max(rise, 1e-3 * level))
                if np.isfinite(rise)
                else size * _LEAST
            )
            guess = min(max(guess, _LEAST * size), _MOST * size, reach)
            size = guess if low < guess < high else (low + min(high, reach)) / 2
        return float(start + sign * size)

    def _follows(self, point: _Point) -> bool:
        return point.cost < _LOST * self._best.cost

    def _begun(self, value: float, level: float) -> _Point:
        """The others fitted with the coordinate at a value: from where they are at the best fit, or
        move to from there.

        The better of both goes on with slopes of its own.
        """
        begun = [self._moved(self._best, value, level, along) for along in (True, False)]
        point = min(begun, key=lambda each: each.cost)
        varied = np.flatnonzero(self._step)
        for _ in range(_AGAIN):
            if not self._follows(point):
                break
            step = self._step.copy()
            before = point.cost
            change = slopes(self._prediction, point.z, step, varied, point.residual)
            point.slopes = change * (self._step[varied] / step[varied])
            point = self._fitted(point, level)
            if before - point.cost < _CLOSE * level:
                break
        return point

    def _moved(self, point: _Point, value: float, level: float, along: bool = True) -> _Point:
        """The others fitted with the coordinate moved to a value, beginning where it takes them
        along, or as they are.

        Where it takes them follows from the slopes.
        """
        z = point.z.copy()
        change = (value - point.z[self._place]) / self._step[self._place]
        if along:
            z[self._places] += self._change(
                point.slopes, point.residual + point.slopes[:, self._own] * change
            )
            z = np.clip(z, *self._bounds.T)
        z[self._place] = value
        return self._fitted(_Point(z, self._prediction.innovations(z), point.slopes), level)

    def _change(self, change: Floats, residual: Floats) -> Floats:
        """Gauss-Newton's change of the other coordinates; none where their slopes do not tell
        them apart.
        """
        try:
            solved = least_squares(
                self._names, change[:, self._others], residual, dependent=DEPENDENT
            )[0]
        except ValueError:
            return np.zeros(len(self._places))
        return -solved * self._step[self._places]

    def _fitted(self, point: _Point, level: float) -> _Point:
        """The others fitted at the point's value of the coordinate."""
        if not self._follows(point):
            return point
        shorter = 1.0
        value = point.z[self._place]
        point = _Point(point.z, point.residual, point.slopes.copy())
        for _ in range(_ROUNDS):
            z = point.z.copy()
            z[self._places] += shorter * self._change(point.slopes, point.residual)
            z = np.clip(z, *self._bounds.T)
            z[self._place] = value
            went = (z[self._places] - point.z[self._places]) / self._step[self._places]
            residual = self._prediction.innovations(z)
            if not went.any():
                break
            if not dot(residual, residual) < _LOST * point.cost:
                shorter /= 4
                continue
            lacking = residual - point.residual - product(point.slopes[:, self._others], went)
            point.slopes[:, self._others] += np.outer(lacking, went) / (went @ went)
            gained = point.cost - dot(residual, residual)
            if gained <= 0:
                shorter /= 2
                continue
            point.z = z
            point.residual = residual
            shorter = 1.0
            if gained < _CLOSE * level:
                break
        if point.cost < self._best.cost - _LOWER * level:
            self.better = point.z
        return point
