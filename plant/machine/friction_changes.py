"""What changes the level of friction: the load on the gear, and time."""

import casadi as ca
import numpy as np

from plant.parts.arguments import signs
from plant.parts.fields import ArrayOrSymbols, Vector
from plant.parts.part import Part, number, part


@part
class LoadFriction(Part):
    """Coulomb friction in proportion to the torque that the gear transmits to its link.

    Parameters
    ----------
    share : (n,) array_like
        Rise of the Coulomb level over the magnitude of the transmitted torque, both joint side.
    """

    share: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not ((self.share >= 0) & (self.share < 1)).all():
            raise ValueError(f"load_friction must be from 0 to below 1; got {self.share}. Give a share, such as 0.1.")

    def level(self, load: ca.SX) -> ca.SX:
        """Rise of the Coulomb level [N m] under a transmitted torque [N m], both on the shaft."""
        return self.share * ca.fabs(load)


@part
class FrictionDrift(Part):
    """Slow drift of friction from the start of a run, as of a gear that warms up; viscous and dry friction alike.

    Friction is 1 + amount (1 - exp(-t / time)) times its value at the start.

    Parameters
    ----------
    amount : (n,) array_like
        Relative change in the end, above -1: -0.2 is a fall by 20 %.
    time : (n,) array_like
        Time constant [s].

    See Also
    --------
    plant.Drive, plant.FrictionCurve

    Examples
    --------
    >>> from plant import FrictionDrift
    >>> FrictionDrift(amount=(-0.2, -0.1), time=(60, 60))  # a fifth less after some minutes
    FrictionDrift(amount=array([-0.2, -0.1]), time=array([60., 60.]))
    """

    amount: Vector = number(("n",))
    time: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("time",), advice="Give the time constant in seconds.")
        if (self.amount <= -1).any():
            raise ValueError(f"amount must be above -1; got {self.amount}. Give a relative change, such as -0.2.")

    def factor(self, drifted: ArrayOrSymbols) -> ArrayOrSymbols:
        """Friction over that at the start, when so much of the way is done (0 to 1)."""
        return 1 + self.amount * drifted

    def following(self, drifted: ArrayOrSymbols, h: ArrayOrSymbols) -> ArrayOrSymbols:
        """How much of the way is done a time h [s] later."""
        passed = -h / self.time
        return 1 - (1 - drifted) * (np.exp(passed) if isinstance(passed, np.ndarray) else ca.exp(passed))
