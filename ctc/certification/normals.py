"""Monte Carlo samples as functions of standard normal numbers, and their largest errors: what rare failures need."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ctc.certification.rare import Rare, subset_simulation
from ctc.certification.task import Task
from plant import Law, Reference
from plant.parts.fields import Floats

_NOT_NUMBERS = ("jitter", "dropped", "plants")
"""What an `Uncertainty` draws at every instant, or takes in turn."""


class Normals:
    """Stands for a random generator: what it gives are columns of u (P, d), which grow with what is first asked for."""

    def __init__(self, u: Floats, random: Any = None) -> None:
        self.u, self._random, self._at = u, random, 0
        self.sound = np.ones(len(u), bool)

    def standard_normal(self, shape: Any) -> Floats:
        """The next columns."""
        count = int(np.prod(np.atleast_1d(shape)[1:]))
        if self._random is not None:
            self.u = np.hstack([self.u, self._random.standard_normal((len(self.u), count))])
        self._at += count
        return self.u[:, self._at - count : self._at].reshape(shape)

    def uniform(self, low: Any, high: Any, shape: Any) -> Floats:
        """The same between two ends."""
        from scipy.special import ndtr

        return np.asarray(low + (high - low) * ndtr(self.standard_normal(shape)))


def rare_failure(
    task: Task, law: Law, motions: Mapping[str, tuple[Reference, dict[str, Any]]], rare: float, confidence: float
) -> Rare:
    """Probability that the error before rounding exceeds the limit in any motion, over the samples of a task."""
    for name in _NOT_NUMBERS:
        value = getattr(task.uncertainty, name)
        if value is not None and np.any(np.asarray(value) != 0):
            raise ValueError(f"rare needs what is one number of each sample; {name} is none. Leave out {name} or rare.")

    def response(u: Floats) -> Floats:
        normals = Normals(u)
        plants, worst = task.sampled(len(u), normals=normals), np.full(len(u), -np.inf)
        for path, settings in motions.values():
            runs = plants.under(law, path, within=task.within, **settings).run(task.threads)
            worst = np.maximum(worst, runs.unrounded.max(axis=1))
        return np.where(normals.sound, worst, -np.inf)

    grown = Normals(np.empty((2, 0)), np.random.default_rng(0))
    task.sampled(2, normals=grown)
    return subset_simulation(response, task.within, grown.u.shape[1], rare, task.seed, confidence)
