"""A prediction in the numbers of a load and of friction, in place of f and friction."""

import dataclasses
from typing import Any

import numpy as np

from identification.equation_error.prior import ROUNDING
from identification.replay.gauss_newton import Solution, reweighed, variance_inflation
from identification.replay.prediction import Prediction
from identification.replay.residual import Reparametrised, WithPrior
from identification.search.polish import by_stages
from plant.parts.fields import Floats

# Relative change of the noise from which on stated friction is weighed anew; chosen by hand.
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


class WithLoad(WithPrior):
    """A prediction whose unknowns are those of a load, friction, and its nuisances.

    Friction that is stated with a deviation comes behind the innovations. `search`: the known arm,
    its load and its stated friction.
    """

    def __init__(self, search: Any, prediction: Prediction, friction: tuple[str, ...]) -> None:
        self.search = search
        self.prediction = prediction
        self._loads = len(search.load.names)
        nuisances = prediction.unknown[len(search.f) + len(friction) :]
        unknown = (*map(spoken, search.load.names), *friction, *nuisances)
        self._gains = sum("correction." in name for name in unknown)
        self._stated = np.flatnonzero(np.isfinite(search.deviation) & (search.deviation > 0))
        super().__init__(
            Reparametrised(prediction, unknown, self.whole),
            self._deviations,
            len(self._stated),
            ROUNDING,
        )

    def whole(self, values: Floats) -> Floats:
        """Values that the prediction takes."""
        return np.append(self.search.f + self.search.load.increments(values), values[self._loads :])

    def _deviations(self, values: Floats) -> Floats:
        """Deviations of friction from the stated, in its standard deviations."""
        friction = values[self._loads :][self._stated]
        deviation = self.search.deviation[self._stated]
        return np.asarray((friction - self.search.friction[self._stated]) / deviation)

    def followed(self, start: Floats, steps: Floats, bounds: Floats, by_stage: bool) -> Solution:
        """Least sum of squares from a start of what is unknown, or of that and of the nuisances."""
        k = len(steps)
        prediction = self.prediction
        begin = np.append(start, prediction.nuisances) if len(start) == k else start
        steps = np.append(steps, prediction.nuisance_steps)
        bounds = np.vstack([bounds, prediction.nuisance_bounds])
        gains = slice(k, k + self._gains) if by_stage else None
        solution = by_stages(self, begin, steps, bounds, gains)

        def reweigh(solution: Solution) -> bool:
            # Both, always: records and joints first, since they decide what an innovation tells.
            changed = self.reweigh(solution.values)
            return self.trust(solution) or changed

        return reweighed(self, solution, steps, bounds, reweigh)

    def trust(self, solution: Solution) -> bool:
        """Weigh stated friction by what an innovation tells in this log; whether that changes
        much.
        """
        if not len(self._stated):
            return False
        before = self.noise
        inflation = variance_inflation(solution.residual)
        self.noise = float(solution.rms_innovation * np.sqrt(inflation))
        return abs(self.noise / before - 1) > _CHANGED
