"""Prediction error as a function of a load and friction, in place of f and friction."""

import dataclasses
from typing import Any

import numpy as np

from identification.equation_error.prior import ROUNDING
from identification.replay.gauss_newton import Solution, reweighed, variance_inflation
from identification.replay.prediction import Prediction
from identification.replay.residual import Reparametrised, WithPrior
from identification.search.polish import by_stages
from plant.parts.fields import Floats

# Relative change of the noise above which the priors of friction are weighed anew, and the fit is
# repeated. Chosen by hand.
_CHANGED = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyLoad:
    """Free increments of f, in place of those of a load."""

    names: tuple[str, ...]

    def increments(self, values: Floats) -> Floats:
        """Increments (p,) of f: the leading values."""
        return values[: len(self.names)]


def spoken(name: str) -> str:
    """Name of a number of the load in messages."""
    return f"{name} of the load"


class WithLoad(WithPrior):
    """Residual whose unknowns are numbers of a load, friction, and the nuisances of a prediction.

    `search`: the `LoadSearch` with the known arm, its load and the priors of friction, whose rows
    come behind the innovations. `friction`: names of the friction, in the order of the search.
    """

    def __init__(self, search: Any, prediction: Prediction, friction: tuple[str, ...]) -> None:
        self.search = search
        self.prediction = prediction
        self._loads = len(search.load.names)
        # The prediction orders its numbers: f, friction, nuisances.
        nuisances = prediction.unknown[len(search.f) + len(friction) :]
        unknown = (*map(spoken, search.load.names), *friction, *nuisances)
        self._gains = sum("correction." in name for name in unknown)
        # An infinite deviation is no prior; friction without a deviation is fixed.
        self._priors = np.flatnonzero(np.isfinite(search.deviation) & (search.deviation > 0))
        # Rounding is the noise until a fit shows more.
        residual = Reparametrised(prediction, unknown, self.whole)
        super().__init__(residual, self._deviations, len(self._priors), ROUNDING)

    def whole(self, values: Floats) -> Floats:
        """Values of the prediction: f of the arm with its load, friction and nuisances."""
        return np.append(self.search.f + self.search.load.increments(values), values[self._loads :])

    def _deviations(self, values: Floats) -> Floats:
        """Differences of the friction from its priors, in their standard deviations."""
        friction = values[self._loads :][self._priors]
        deviation = self.search.deviation[self._priors]
        return np.asarray((friction - self.search.friction[self._priors]) / deviation)

    def followed(self, start: Floats, steps: Floats, bounds: Floats, by_stage: bool) -> Solution:
        """Least sum of squares from a start of the unknowns, with or without the nuisances."""
        # A start with nuisances comes from an earlier fit of the same logs.
        k = len(steps)
        prediction = self.prediction
        begin = np.append(start, prediction.nuisances) if len(start) == k else start
        steps = np.append(steps, prediction.nuisance_steps)
        bounds = np.vstack([bounds, prediction.nuisance_bounds])
        gains = slice(k, k + self._gains) if by_stage else None
        solution = by_stages(self, begin, steps, bounds, gains)

        def reweigh(solution: Solution) -> bool:
            # Always both. The weights of records and joints come before: the noise follows them.
            changed = self.reweigh(solution.values)
            return self.trust(solution) or changed

        return reweighed(self, solution, steps, bounds, reweigh)

    def trust(self, solution: Solution) -> bool:
        """Weigh the priors by the noise of the innovations; whether that changed much.

        A prior weighs like one independent reading, so autocorrelation inflates the noise.
        """
        if not len(self._priors):
            return False
        previous = self.noise
        inflation = variance_inflation(solution.residual)
        self.noise = float(solution.rms_innovation * np.sqrt(inflation))
        return abs(self.noise / previous - 1) > _CHANGED
