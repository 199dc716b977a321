"""What a prior of f adds to a sum of squared innovations: a row for each parameter, before those of the records."""

from collections.abc import Sequence

import numpy as np

from identification.equation_error.prior import Prior
from plant.parts.fields import Floats

_ROUNDING = 0.289  # noise [pulses] that is expected of an innovation, until it is known

_SETTLED = 0.05  # relative change of the noise that does not count

_OWN = 1e-5
"""Share of its own that the slope of an unknown must have with a prior, which tells apart what a log cannot."""


class PriorRows:
    """Rows of a prior, or none: whitened deviations of f, times the `noise` of an innovation [pulses]."""

    def __init__(self, prior: Prior | None, unknown: Sequence[str]) -> None:
        self._prior, self.noise = prior, _ROUNDING
        self._places = [] if prior is None else prior.places(unknown)

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self._places)

    def own(self, usual: float) -> float:
        """Share of its own that the slope of an unknown must have, where without a prior it is the usual one."""
        return usual if self._prior is None else _OWN

    def of(self, values: Floats) -> Floats:
        """The rows of values (k,)."""
        if self._prior is None:
            return np.empty(0)
        return self.noise * self._prior.deviations(values[self._places])

    def settle(self, variance: float) -> bool:
        """Weigh the rows by the variance of an innovation; whether that changes much."""
        before, self.noise = self.noise, float(np.sqrt(variance))
        return bool(self._places) and abs(self.noise / before - 1) > _SETTLED
