"""Springs between neighbouring links, about the axis of their joint."""

from typing import Any

import casadi as ca

from plant.machine.known_torque import KnownTorque
from plant.parts.arguments import signs
from plant.parts.fields import Vector
from plant.parts.part import number, part


@part
class JointSpring(KnownTorque):
    """Linear springs about the joints' axes: preload - stiffness (q - angle). Joint side, on the links.

    Parameters
    ----------
    stiffness : (n,) array_like
        Torque per angle [N m/rad]; of joints that slide, force per path [N/m]. 0 where there is no spring.
    angle : (n,) array_like
        Joint position at which the spring is at rest [rad].
    preload : (n,) array_like, optional
        Torque there, in the direction of q [N m]: of a spring of constant torque, or in place of an angle that is not
        known, since the torque is linear in it.

    Raises
    ------
    ValueError
        Negative stiffness.

    See Also
    --------
    plant.Counterbalance, plant.CosineTorque, plant.KnownTorque

    Examples
    --------
    >>> from plant import JointSpring
    >>> spring = JointSpring(stiffness=(20, 0), angle=(0, 0))
    >>> print(spring.torque((0.1, 0)))
    [-2. -0.]
    """

    stiffness: Vector = number(("n",))
    angle: Vector = number(("n",))
    preload: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, not_negative=("stiffness",), advice="A spring that pushes away from its rest is a Counterbalance.")

    def torque(self, q: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] on the joints at q (n, 1) [rad]."""
        torque = -self.stiffness * (q - self.angle)
        return torque if self.preload is None else torque + self.preload
