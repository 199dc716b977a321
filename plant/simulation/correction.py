"""Observer gains that correct a simulated loop by the log that it repeats: from simulation to one-step prediction.

At every sample the innovation, counted minus simulated position, is fed back into the simulated position and speed, as
in an alpha-beta filter or a steady-state Kalman filter. Without correction the simulation runs in open loop, and model
errors (the rounding between two samples, above all) accumulate over the log; with it, every sample is predicted from
those before. The more the model is trusted, the smaller the gains.
"""

from __future__ import annotations

import numpy as np

from plant.parts.fields import Vector
from plant.parts.part import Part, number, part


@part
class Correction(Part):
    """Observer gains of the innovation, per motor.

    Parameters
    ----------
    position : (n,) array_like
        Gain of the position (alpha), 0 to 1.
    speed : (n,) array_like
        Gain of the speed, per sample period (beta).
    zero : (n,) array_like
        Joint positions where the counters read zero [rad].
    """

    position: Vector = number(("n",))
    speed: Vector = number(("n",))
    zero: Vector = number(("n",))

    @classmethod
    def with_memory(cls, n: int, samples: float) -> Correction:
        """The gains of n motors that give two equal observer poles with a time constant of so many samples."""
        pole = np.exp(-1 / samples)
        return cls(position=(1 - pole**2,) * n, speed=((1 - pole) ** 2,) * n, zero=(0.0,) * n)
