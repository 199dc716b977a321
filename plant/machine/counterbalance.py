"""Counterbalances: coil springs that pull between two links, and the plain cosine by which many are described."""

from typing import Any

import casadi as ca

from plant.machine.known_torque import KnownTorque
from plant.parts.arguments import signs
from plant.parts.fields import Vector
from plant.parts.part import number, part

_SHORTEST = 1e-18
"""Square of a length [m^2] below which a spring has no direction: of joints that have none, all is 0."""


@part
class Counterbalance(KnownTorque):
    """A coil spring per joint, between a point of the link before it and a point of the link after it.

    Both points turn about the joint's axis, at the distances a and b from it, so that the spring is
    L = sqrt(a^2 + b^2 - 2 a b cos(q - angle)) long, pulls with tension + stiffness (L - free_length), and turns the
    joint by -dL/dq times that. It is on its dead centre at q = angle, where it is shortest, and half a turn from there.

    Parameters
    ----------
    stiffness : (n,) array_like
        [N/m]; 0 of a gas spring, whose force is its tension, and of joints without one.
    base_arm, link_arm : (n,) array_like
        a and b [m]; 0 for joints without one.
    free_length : (n,) array_like
        Length at which the coil pulls with its tension alone [m].
    angle : (n,) array_like
        Joint position at which both points are in one direction from the axis [rad].
    tension : (n,) array_like, optional
        Force at the free length [N], positive where it pulls, negative where it pushes; none by default.

    Raises
    ------
    ValueError
        Negative stiffness or lengths; equal arms of a spring that is not of free length 0: its ends would meet.

    See Also
    --------
    plant.CosineTorque, plant.JointSpring, plant.KnownTorque

    Examples
    --------
    >>> from plant import Counterbalance
    >>> spring = Counterbalance(
    ...     stiffness=(2000, 0), base_arm=(0.2, 0), link_arm=(0.1, 0), free_length=(0.05, 0), angle=(0, 0)
    ... )
    >>> print(spring.torque((0.5, 0)))
    [-11.3209, -0]
    """

    stiffness: Vector = number(("n",))
    base_arm: Vector = number(("n",))
    link_arm: Vector = number(("n",))
    free_length: Vector = number(("n",))
    angle: Vector = number(("n",))
    tension: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        lengths = "base_arm", "link_arm", "free_length"
        signs(self, not_negative=("stiffness", *lengths), advice="Give magnitudes; angle says where it is shortest.")
        forced = (self.stiffness * self.free_length > 0) | (0 if self.tension is None else self.tension != 0)
        meet = (self.base_arm == self.link_arm) & (self.base_arm > 0) & forced
        if meet.any():
            equal = self.base_arm[meet.argmax()]
            raise ValueError(
                f"base_arm and link_arm must differ; joint {meet.argmax()} has {equal:g} m twice, and the ends of its "
                "spring would meet. Correct one."
            )

    def torque(self, q: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] on the joints at q (n, 1) [rad]."""
        a, b, phi = self.base_arm, self.link_arm, q - self.angle
        length = ca.sqrt(ca.fmax(a * a + b * b - 2 * (a * b) * ca.cos(phi), _SHORTEST))
        force = self.stiffness * (length - self.free_length)
        force = force if self.tension is None else force + self.tension
        return -force / length * (a * b) * ca.sin(phi)


@part
class CosineTorque(KnownTorque):
    """amplitude cos(q - phase) on each joint: of an ideal counterbalance, of a weight on the other side of the axis.

    Parameters
    ----------
    amplitude : (n,) array_like
        [N m]; 0 for joints without one.
    phase : (n,) array_like
        Joint position at which it is largest [rad].

    See Also
    --------
    plant.JointSpring, plant.Counterbalance, plant.KnownTorque

    Examples
    --------
    >>> from plant import CosineTorque
    >>> spring = CosineTorque(amplitude=(10, 0), phase=(0, 0))
    >>> print(spring.torque((0, 0)))
    [10, 0]
    """

    amplitude: Vector = number(("n",))
    phase: Vector = number(("n",))

    def torque(self, q: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] on the joints at q (n, 1) [rad]."""
        return self.amplitude * ca.cos(q - self.phase)
