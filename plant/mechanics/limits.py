"""Limits of joints: positions, speeds and efforts that a model file states."""

import numpy as np

from plant.parts.arguments import signs
from plant.parts.fields import Vector
from plant.parts.part import Part, number, part


@part
class Limits(Part):
    """Limits of a chain's joints, joint side; infinite where there is none.

    Parameters
    ----------
    lower, upper : (n,) array_like
        Positions [rad or m].
    velocity : (n,) array_like
        Largest speeds, magnitudes [rad/s or m/s].
    effort : (n,) array_like
        Largest torques, magnitudes [N m or N].

    See Also
    --------
    plant.Chain, plant.Guards, plant.fastest

    Examples
    --------
    >>> from plant import Limits
    >>> Limits(lower=(-2, -2), upper=(2, 2), velocity=(3, 3), effort=(200, 100))
    Limits(lower=array([-2., -2.]), upper=array([2., 2.]), velocity=array([3., 3.]), effort=array([200., 100.]))
    """

    lower: Vector = number(("n",), finite=False)
    upper: Vector = number(("n",), finite=False)
    velocity: Vector = number(("n",), finite=False)
    effort: Vector = number(("n",), finite=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for joint in np.flatnonzero(self.lower > self.upper):
            got = f"got {self.lower[joint]} and {self.upper[joint]} at joint {joint + 1}"
            raise ValueError(f"lower must not be above upper; {got}. Swap them.")
        signs(self, not_negative=("velocity", "effort"), advice="Limits are magnitudes.")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)
