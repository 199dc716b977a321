"""What an estimator is made of: numbers that can be sent to the process where it works."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from identification.payload.genetic_estimate import GeneticEstimator
from identification.payload.kernel_estimate import KernelEstimator
from identification.payload.shape import LoadShape
from identification.payload.torque_window import Window
from plant import Arm, Rig

FORGETTING = 0.02
"""Over which a replay of the genetic algorithm forgets [s]; with 0.04 its errors were three times as large."""


@dataclasses.dataclass(frozen=True)
class Specification:
    """An estimator of either kind.

    Parameters
    ----------
    method : {"kernel", "genetic"}
    arm, rig, shape, unknown, root
        As for `KernelEstimator`.
    samples : int
        Of the windows.
    seed : int
        Of the genetic algorithm.
    """

    method: str
    arm: Arm
    rig: Rig
    shape: LoadShape
    unknown: tuple[str, ...]
    root: NDArray[np.float64]
    samples: int
    seed: int

    def made(self) -> KernelEstimator | GeneticEstimator:
        """The estimator, with all compiled that it needs."""
        estimator: KernelEstimator | GeneticEstimator
        if self.method == "genetic":
            estimator = GeneticEstimator(self.arm, self.rig, self.shape, FORGETTING, seed=self.seed)
        else:
            estimator = KernelEstimator(self.arm, self.rig, self.shape, self.unknown, self.root)
        time = np.arange(self.samples)[:, None] * self.rig.period
        counts = self.rig.counts(0.1 * np.sin(10 * time) * np.ones(self.arm.n))
        estimator(Window(counts, np.zeros(counts.shape), np.zeros(self.arm.n)))
        return estimator
