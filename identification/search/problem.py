"""What a method of identification is given, and what it gives back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from identification.replay.objective import Objective
from identification.search.genetic import GeneticResult, GeneticSettings
from plant import Dynamics

__all__ = ["Outcome", "Search"]

_POSITIVE = ("drive.viscous", "drive.coulomb", "law.gain")
"""Numbers that cannot be negative."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """What is looked for, and where.

    Attributes
    ----------
    dynamics, records, unknown
        As for `identify`.
    objective : Objective
        Of these unknowns.
    nominal : (k,) numpy.ndarray
        What the first record says of them; NaN for f.
    ranges : (k, 2) numpy.ndarray or None
    settings : GeneticSettings
    seed : int
    zeros : bool
        Where each record's counters have their zero is unknown.
    options : dict
        Sub-steps, sweeps and threads of the model.
    show : callable
        Called with each `GeneticState`.
    """

    dynamics: Dynamics
    records: tuple
    unknown: tuple
    objective: Objective
    nominal: np.ndarray
    ranges: np.ndarray | None
    settings: GeneticSettings
    seed: int
    zeros: bool
    options: dict
    show: Callable

    @property
    def everywhere(self):
        """Ranges (k, 2), or those of the dynamics; None where there are neither."""
        if self.ranges is None and self.unknown == self.dynamics.names and self.dynamics.ranges is not None:
            return np.array(self.dynamics.ranges)
        return self.ranges

    @property
    def known(self):
        """What needs no search, because both ends of its range are one: name -> value."""
        if self.ranges is None:
            return {}
        return {name: low for name, (low, high) in zip(self.unknown, self.ranges.tolist(), strict=True) if low == high}

    @property
    def bounds(self):
        """Ranges (k, 2), or what physics says where there are none."""
        if self.ranges is not None:
            return self.ranges
        low = [0.0 if name.startswith(_POSITIVE) else -np.inf for name in self.unknown]
        return np.column_stack([low, np.full(len(low), np.inf)])


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a method found.

    Attributes
    ----------
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray or None
    scatter : float or None
        Root mean square of what is left between model and counts [pulses].
    evaluations : int
        Simulated experiments.
    message : str
    trouble : str or None
        Why the values are not those of the last fit.
    genetic : GeneticResult or None
    stages : dict
        Name of a stage -> its values (k,).
    candidates : (C, k) numpy.ndarray or None
        Vectors that repeat the records as well as the best, but for the noise of objective (4); best first.
    zeros : (R, n) numpy.ndarray or None
        Where the joints of each record are when their counters say zero [rad].
    """

    values: np.ndarray
    covariance: np.ndarray | None = None
    scatter: float | None = None
    evaluations: int = 0
    message: str = ""
    trouble: str | None = None
    genetic: GeneticResult | None = None
    stages: dict = dataclasses.field(default_factory=dict)
    candidates: np.ndarray | None = None
    zeros: np.ndarray | None = None
