"""Jitter: a sampled law reads the encoders a little before or after its instant, and does not know.

The instants are drawn beforehand. Loops that are simulated side by side on one time table get instants of their own
from the same draws: the fractional parts of a large number, another for each stream, times the draws.
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.parts.part import Part, number, part, structure

_LARGE = 2**20
"""Above all streams by far, so that those of two streams are as good as independent."""


@part
class Jitter(Part):
    """Random displacement of the instants at which a law with a period reads the encoders; uniform, each on its own.

    The log is taken at its own even instants, the torque begins where it would without; linear analysis leaves
    jitter out.

    Parameters
    ----------
    share : float
        Largest displacement to either side, as a share of the law's period.
    seed : int
        Of the draws.
    stream : float
        A whole number, 0 or more: loops with other ones have other instants.

    See Also
    --------
    plant.Rig, plant.Transport

    Examples
    --------
    >>> from plant import Jitter
    >>> Jitter(share=0.1, seed=3)
    Jitter(share=0.1, seed=3, stream=0.0)
    """

    share: float = number(())
    seed: int = structure(default=0)
    stream: float = number((), default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.share <= 0.5:
            raise ValueError(
                f"share must be from 0 to 0.5 of the period; got {self.share:g}. Instants keep apart then."
            )
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise ValueError(f"seed must be a whole number, 0 or more; got {self.seed!r:.60}. Give one, such as 0.")
        if self.stream < 0 or self.stream % 1:
            raise ValueError(
                f"stream must be a whole number, 0 or more; got {self.stream:g}. Leave it out for one loop."
            )
        object.__setattr__(self, "seed", int(self.seed))

    def draws(self, steps: int) -> NDArray[np.float64]:
        """One draw (steps,) from 0 to 1 for each step of the law."""
        return np.random.default_rng(self.seed).random(steps)

    def late(self, draw: ca.SX, period: ca.SX | float) -> ca.SX:
        """How late a step reads the encoders [s]."""
        mine = (_LARGE + self.stream) * draw
        return self.share * period * (2 * (mine - ca.floor(mine)) - 1)
