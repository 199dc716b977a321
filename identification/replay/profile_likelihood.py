"""Profile likelihood: the interval of one coordinate, with all others fitted again at each value.

Where innovations are no linear function of a coordinate (a resonance), the curvature at the best
fit says little of the interval; the sum of squares, fitted again at each of its values, does.
Slopes are taken by differences where a walk begins, and updated along the way (Broyden).

Source: C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Mathematics
of Computation 19 (1965) (slopes from evaluations alone).
"""

import numpy as np

from identification.equation_error import IDENTIFIABLE, least_squares
from identification.replay.gauss_newton import Descent, slopes
from identification.replay.residual import Innovations
from plant.parts import Floats, dot, frozen_settings, product


@frozen_settings
class ProfileSettings:
    """Effort and accuracy of a profile; chosen by hand.

    Parameters
    ----------
    rounds : int
        Most steps with which the other coordinates are fitted at one value.
    settled : float
        Decrease of the sum of squares, relative to the level, that ends such a fit.
    linearisations : int
        Most times that slopes are taken by differences where a walk begins.
    values : int
        Most values of the coordinate that are tested for an end.
    accuracy : float
        Relative distance of the sum from the level at which a value is an end.
    lower : float
        Least decrease below the best fit, relative to the level, that makes another fit better.
    lost : float
        A sum of squares that exceeds the best fit's by this factor means that the log is lost;
        slopes say nothing there.
    shrink, grow : float
        Least and largest ratio of neighbouring distances from the best fit.
    """

    rounds: int = 8
    settled: float = 0.02
    linearisations: int = 3
    values: int = 7
    accuracy: float = 0.1
    lower: float = 0.25
    lost: float = 100.0
    shrink: float = 0.4
    grow: float = 2.5


SETTINGS = ProfileSettings()


class Profile:
    """The sum of squared innovations along one coordinate.

    `best` (k,): coordinates of the best fit. `change` (M, v): of the innovations there, per step of
    the varied coordinates (v,). `step` (k,): those steps; zero where a coordinate is not varied.
    `bounds` (k, 2). `place`: of the one coordinate. `final`: go on where a lower sum is met.

    Attributes: `better` (k,) or None: coordinates with a lower sum than the best fit, if some were
    met on the way; unless `final`, a walk ends there.
    """

    def __init__(
        self,
        residual: Innovations,
        best: Floats,
        change: Floats,
        step: Floats,
        bounds: Floats,
        place: int,
        *,
        final: bool = False,
    ) -> None:
        self._residual = residual
        self._step = step
        self._bounds = bounds
        self._place = place
        self._final = final
        # Of the slopes, the column of the one coordinate, and those of the others.
        varied = np.flatnonzero(step)
        self._column = int(np.flatnonzero(varied == place)[0])
        self._others = varied != place
        self._places = varied[self._others]
        self._names = [residual.unknown[i] for i in self._places.tolist()]
        self._best = Descent(best, residual.innovations(best), change)
        self.better: Floats | None = None
        self._lowest = self._best.squares

    def rise(self, value: float, level: float) -> float:
        """Least sum with the coordinate held at a value, less that of the best fit."""
        return self._begun(value, level).squares - self._best.squares

    def end(self, distance: float, level: float, limit: float) -> float:
        """Value of the coordinate at which the sum has risen by the level.

        The limit if it does not rise so much on the way to it.

        `distance`: first distance to try; its sign does not count, the side is that of the limit.
        """
        if np.isnan(distance):
            raise ValueError(
                "distance must be a number; got nan. Give about that at which the sum has risen by"
                " the level, such as twice a standard deviation."
            )
        # Distances from the best fit towards the limit are positive, whichever way that is.
        start = self._best.values[self._place]
        sign = np.sign(limit - start)
        reach = abs(limit - start)
        # The end lies between two distances: the last below the level, and the first above it.
        low = 0.0
        high = np.inf
        size = min(abs(distance), reach)
        point = None
        for _ in range(SETTINGS.values):
            if not size > 0:
                break
            value = start + sign * size
            # 1. Fit the others there: from the previous value if that follows the log, else anew.
            if point and self._follows(point):
                point = self._moved(point, value, level)
            else:
                point = self._begun(value, level)
            if not self._follows(point):
                point = self._begun(value, level)
            # A lower sum than at the best fit: an interval about that would be about a wrong value.
            rise = point.squares - self._best.squares
            if self.better is not None and not self._final:
                return float(start)
            if abs(rise - level) < SETTINGS.accuracy * level:
                break

            # 2. Narrow the interval.
            low, high = (size, high) if rise < level else (low, size)
            if low >= reach:
                return limit

            # 3. The sum rises about with the square of the distance; else bisect.
            guess = size * SETTINGS.shrink
            if np.isfinite(rise):
                # The lower limit of the rise keeps a flat sum from throwing the guess far away.
                guess = size * np.sqrt(level / max(rise, 1e-3 * level))
            guess = min(max(guess, SETTINGS.shrink * size), SETTINGS.grow * size, reach)
            size = guess if low < guess < high else (low + min(high, reach)) / 2
        else:
            # No value rose so much. Between the highest and the limit nothing was tried.
            if not np.isfinite(high):
                return limit
        return float(start + sign * size)

    def _follows(self, point):
        return point.squares < SETTINGS.lost * self._best.squares

    def _begun(self, value, level):
        """Fit of the others with the coordinate at a value, from the best fit.

        Two starts are tried: the others as at the best fit, and the others moved by its slopes. The
        better one goes on, with new slopes by differences.
        """
        points = [self._moved(self._best, value, level, along) for along in (True, False)]
        point = min(points, key=lambda point: point.squares)
        varied = np.flatnonzero(self._step)
        for _ in range(SETTINGS.linearisations):
            if not self._follows(point):
                break
            step = self._step.copy()
            previous = point.squares
            change = slopes(
                self._residual, point.values, step, varied, point.innovations, self._bounds
            )
            # Differences may have been shortened; slopes are per the steps of this profile.
            point.slopes = change * (self._step[varied] / step[varied])
            point = self._fitted(point, level)
            if previous - point.squares < SETTINGS.settled * level:
                break
        return point

    def _moved(self, point, value, level, along=True):
        """Fit of the others after the coordinate has moved to a value.

        With `along` the others first move as the slopes predict; else they begin unchanged.
        """
        z = point.values.copy()
        change = (value - point.values[self._place]) / self._step[self._place]
        if along:
            predicted = point.innovations + point.slopes[:, self._column] * change
            z[self._places] += self._change(point.slopes, predicted)
            z = np.clip(z, *self._bounds.T)
        z[self._place] = value
        return self._fitted(Descent(z, self._residual.innovations(z), point.slopes), level)

    def _change(self, change, innovations):
        """Gauss-Newton's change of the other coordinates.

        Zero where their slopes do not separate them, or are zero.
        """
        # Slopes that were updated along a walk may become dependent, and some of the others may do
        # nothing there; then all of them stay.
        try:
            solved = least_squares(
                self._names, change[:, self._others], innovations, dependent=IDENTIFIABLE.slopes
            )[0]
        except ValueError:
            return np.zeros(len(self._places))
        return -solved * self._step[self._places]

    def _fitted(self, point, level):
        """The others fitted at the point's value of the coordinate, with Broyden's slopes.

        Not by `descend`: one simulation serves as trial and as update of the slopes, also where the
        step is rejected.
        """
        if not self._follows(point):
            return point
        shortening = 1.0
        value = point.values[self._place]
        point = Descent(point.values, point.innovations, point.slopes.copy())
        for _ in range(SETTINGS.rounds):
            # 1. A step of the others, within their bounds.
            z = point.values.copy()
            z[self._places] += shortening * self._change(point.slopes, point.innovations)
            z = np.clip(z, *self._bounds.T)
            z[self._place] = value
            move = (z[self._places] - point.values[self._places]) / self._step[self._places]
            # All at their bounds, or not separable: no step is left.
            if not move.any():
                break
            innovations = self._residual.innovations(z)
            if not dot(innovations, innovations) < SETTINGS.lost * point.squares:
                shortening /= 4
                continue

            # 2. Broyden's update: the slopes explain this step exactly, and others as before.
            predicted = product(point.slopes[:, self._others], move)
            lacking = innovations - point.innovations - predicted
            point.slopes[:, self._others] += np.outer(lacking, move) / (move @ move)

            # 3. Accept the step if it lowers the sum.
            gained = point.squares - dot(innovations, innovations)
            if gained <= 0:
                shortening /= 2
                continue
            point.values = z
            point.innovations = innovations
            shortening = 1.0
            if gained < SETTINGS.settled * level:
                break
        # A little lower is no news: the best fit ended within its own tolerance.
        lower = self._best.squares - SETTINGS.lower * level
        if point.squares < min(lower, self._lowest):
            self._lowest = point.squares
            self.better = point.values
        return point
