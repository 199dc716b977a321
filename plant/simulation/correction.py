"""Correction of a simulated loop by the log that it repeats: from simulation to prediction.

At every sample the position that was counted is compared with the simulated one; a share of the difference flows into
the simulated position, another into its speed. Without correction the simulation runs free, and what the model lacks
(the rounding between two samples, above all) adds up over the log; with it, every sample is predicted from those
before. The shares are those of an alpha-beta filter: the more the model is to be trusted, the smaller they are.
"""

from __future__ import annotations

import numpy as np

from plant.parts.part import Part, number, part

__all__ = ["Correction"]


@part
class Correction(Part):
    """Shares of the difference between log and model that flow into the model.

    Parameters
    ----------
    position : (n,) array_like
        Share of a motor's difference that its position takes up at a sample, 0 to 1.
    speed : (n,) array_like
        Share of the difference, per sample period, that its speed takes up.
    zero : (n,) array_like
        Where the joints are when the counters say zero [rad].
    """

    position: np.ndarray = number(("n",))
    speed: np.ndarray = number(("n",))
    zero: np.ndarray = number(("n",))

    @classmethod
    def with_memory(cls, n, samples):
        """The correction of n motors whose two poles forget over so many samples."""
        pole = np.exp(-1 / samples)
        return cls(position=(1 - pole**2,) * n, speed=((1 - pole) ** 2,) * n, zero=(0.0,) * n)
