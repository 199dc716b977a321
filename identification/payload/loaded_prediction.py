"""A prediction in the numbers of a load and of friction, in place of f and friction."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from identification.replay.gauss_newton import Solution, reweighed, variance_inflation
from identification.replay.prediction import Prediction
from identification.search.polish import by_stages
from plant.parts.fields import Floats

# RMS of rounding [pulses]; and relative change of what an innovation tells from which on stated
# friction is weighed anew.
_ROUNDING = 0.289
_CHANGED = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyLoad:
    """Increments of f that need not be those of a load."""

    names: tuple[str, ...]

    def increments(self, values: Floats) -> Floats:
        return values[: len(self.names)]


def spoken(name: str) -> str:
    """What messages call a number of the load."""
    return f"{name} of the load"


class WithLoad:
    """A prediction whose unknowns are those of a load, friction, and its nuisances."""

    def __init__(self, search: Any, prediction: Prediction, friction: tuple[str, ...]) -> None:
        self.search, self.prediction, p = search, prediction, len(search.f)
        self.unknown = (
            *map(spoken, search.load.names),
            *friction,
            *prediction.unknown[p + len(friction) :],
        )
        self._first, self._gains = (
            len(search.load.names),
            sum("correction." in name for name in self.unknown),
        )
        self._stated = np.flatnonzero(np.isfinite(search.deviation) & (search.deviation > 0))
        self._trust = _ROUNDING
        self.dependent = prediction.dependent
        self.weights = np.append(prediction.weights, np.zeros(len(self._stated)))

    @property
    def scales(self) -> Floats:
        """What each innovation is divided by."""
        return np.append(self.prediction.scales, np.ones(len(self._stated)))

    def whole(self, values: Floats) -> Floats:
        """What the prediction takes, of values of this."""
        return np.append(self.search.f + self.search.load.increments(values), values[self._first :])

    def followed(self, start: Floats, steps: Floats, bounds: Floats, by_stage: bool) -> Solution:
        """Least sum of squares from a start of what is unknown, or of that and of the nuisances."""
        k = len(steps)
        own = self.prediction
        first = np.append(start, own.nuisances) if len(start) == k else start
        steps = np.append(steps, own.nuisance_steps)
        bounds = np.vstack([bounds, own.nuisance_bounds])
        solution = by_stages(
            self, first, steps, bounds, slice(k, k + self._gains) if by_stage else None
        )
        return reweighed(
            self,
            solution,
            steps,
            bounds,
            lambda found: self.reweigh(found.values) | self.trust(found),
        )

    def _with_stated(self, innovations: Floats, values: Floats) -> Floats:
        friction = values[self._first :][self._stated]
        off = (friction - self.search.friction[self._stated]) / self.search.deviation[self._stated]
        return np.append(innovations, self._trust * off)

    def innovations(self, values: Floats) -> Floats:
        return self._with_stated(self.prediction.innovations(self.whole(values)), values)

    def all_innovations(self, many: Iterable[Floats]) -> list[Floats]:
        many = list(many)
        found = self.prediction.all_innovations([self.whole(values) for values in many])
        return [self._with_stated(each, values) for each, values in zip(found, many, strict=True)]

    def lost(self, values: Floats) -> str:
        return self.prediction.lost(self.whole(values))

    def reweigh(self, values: Floats) -> bool:
        return self.prediction.reweigh(self.whole(values))

    def trust(self, solution: Solution) -> bool:
        """Weigh stated friction by what an innovation tells in this log; whether that changes
        much.
        """
        if not len(self._stated):
            return False
        before = self._trust
        residual = solution.residual
        self._trust = float(solution.rms_innovation * np.sqrt(variance_inflation(residual)))
        return abs(self._trust / before - 1) > _CHANGED
