"""Torque of springs and counterbalances on the joints: a known function of where the arm is."""

import abc
import functools
import operator
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from plant.parts import ArrayOrSymbols, Part, Vector, instance, joint_label, number, part, signs

# What casadi and numpy raise where a torque cannot be worked out.
_REFUSED = (TypeError, ValueError, RuntimeError, IndexError, AttributeError, NotImplementedError)

# Shortest length of a coil [m]; ends that are nearer give its force no direction. It also keeps
# joints without a coil (a = b = 0) from 0 / 0.
_SHORTEST = 1e-9


class KnownTorque(Part, abc.ABC):
    """Base class of torques on the joints that depend on q alone; a subclass is a `@part`.

    Such a torque acts on the links, also behind elastic gears; motors, gears and amplifiers feel it
    through the arm alone. Fields declared with `plant.number` are numbers of the rig, such as
    ``springs.stiffness[0]``.

    See Also
    --------
    plant.JointSpring, plant.Counterbalance, plant.CosineTorque

    Examples
    --------
    >>> import casadi as ca
    >>> from plant import KnownTorque, number, part
    >>> @part
    ... class Cable(KnownTorque):
    ...     stiffness: object = number(("n",))
    ...     def torque(self, q):
    ...         return -self.stiffness * ca.sin(q)
    ...
    >>> print(Cable(stiffness=(3.0, 1.0)).torque((0.1, 0.0)))
    [-0.2995, -0]
    """

    @abc.abstractmethod
    def torque(self, q: SX) -> SX:
        """Torque (n, 1) [N m] at q (n, 1) [rad], in casadi; positive in the direction of q."""


def total_torque(parts: Iterable[KnownTorque], q: ArrayOrSymbols) -> ArrayOrSymbols:
    """Sum of the torques [N m] at q [rad]: (n, 1) of symbols, (..., n) of an array (..., n)."""
    if isinstance(q, (SX, ca.MX, ca.DM)):
        # Symbols stay symbols: the torque becomes part of a kernel.
        return functools.reduce(operator.add, (part.torque(q) for part in parts))
    angles = np.asarray(q, dtype=float)
    # Arrays go through the same casadi expression, so that both ways agree; `map` takes all rows at
    # once.
    symbols = SX.sym("q", angles.shape[-1])
    function = ca.Function("torque", [symbols], [ca.densify(total_torque(parts, symbols))])
    rows = angles.reshape(-1, angles.shape[-1])
    return (
        function.map(len(rows))(rows.T).full().T.reshape(angles.shape)
        if len(rows)
        else angles.copy()
    )


def require_torques(parts: Iterable[Any], n: int) -> None:
    """Refuse what is no `KnownTorque`, or one whose torque does not fit n joints."""
    for spring in parts:
        instance("springs", spring, KnownTorque, "Give JointSpring(stiffness=..., angle=...).")
        kind = type(spring).__name__
        spring.require_joints(n, f"{kind}.")
        # The torque is evaluated once on symbols. A wrong part is refused here, with its name, and
        # not in a simulation.
        q = SX.sym("q", n)
        numbers = SX.sym("numbers", len(spring.number_names()))
        try:
            torque = spring.with_numbers(numbers).torque(q)
        except _REFUSED as error:
            # The last line of casadi's message is the one that says something.
            reason = (str(error).strip() or "it fails").splitlines()[-1][:80].rstrip(".")
            raise ValueError(
                f"torque of {kind} must be a casadi expression of q ({n}, 1); {reason}."
            ) from error
        if not isinstance(torque, SX) or torque.shape != (n, 1):
            shaped = isinstance(torque, (SX, np.ndarray))
            result = torque.shape if shaped else type(torque).__name__
            raise ValueError(
                f"torque of {kind} must return casadi SX of shape ({n}, 1), one torque per joint;"
                f" got {result}. Write ca.vertcat(...), 0 for joints that it does not drive."
            )
        # A symbol that is neither q nor a number of the part would stay open in every kernel. Its
        # name proves nothing: others may be called q, too.
        allowed = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(q, numbers))}
        free = [
            symbol.name() for symbol in ca.symvar(torque) if symbol.element_hash() not in allowed
        ]
        if free:
            raise ValueError(
                f"torque of {kind} must depend on q and the part's numbers alone; got {free[0]!r}."
            )


@part
class JointSpring(KnownTorque):
    """Linear springs about the joints' axes: preload - stiffness (q - angle). Joint side.

    Parameters
    ----------
    stiffness : (n,) array_like
        Torque per angle [N m/rad]; of joints that slide, force per path [N/m]. 0 where there is no
        spring.
    angle : (n,) array_like
        Joint position at which the spring is at rest [rad].
    preload : (n,) array_like, optional
        Torque at that angle, in the direction of q [N m]; none by default. It describes a spring of
        constant torque. It can also stand for an unknown angle, since the torque is linear in it.

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
        signs(
            self,
            not_negative=("stiffness",),
            advice="A spring that pushes away from its rest is a Counterbalance.",
        )

    def torque(self, q: SX) -> SX:
        # A spring pulls back, hence the minus.
        torque = -self.stiffness * (q - self.angle)
        return torque if self.preload is None else torque + self.preload


@part
class Counterbalance(KnownTorque):
    """A coil spring per joint, between a point of the previous link and a point of its own link.

    Both points turn about the joint's axis, at the distances a and b from it. The length of the
    spring is L = sqrt(a^2 + b^2 - 2 a b cos(q - angle)), its force is F = tension + stiffness (L -
    free_length), and its torque on the joint is -F dL/dq. The torque is 0 at the dead centres: at q
    = angle, where the spring is shortest, and half a turn from there.

    Parameters
    ----------
    stiffness : (n,) array_like
        [N/m]; 0 of a gas spring, whose force is its tension, and of joints without one.
    base_arm, link_arm : (n,) array_like
        a and b [m]; 0 for joints without one.
    free_length : (n,) array_like
        Length at which the force is the tension alone [m].
    angle : (n,) array_like
        Joint position at which both points are in one direction from the axis [rad].
    tension : (n,) array_like, optional
        Force at the free length [N], positive where it pulls, negative where it pushes; none by
        default.

    Raises
    ------
    ValueError
        Negative stiffness or lengths; equal arms, whose ends meet at the dead centre, of a spring
        that has a force at length 0.

    See Also
    --------
    plant.CosineTorque, plant.JointSpring, plant.KnownTorque

    Examples
    --------
    >>> from plant import Counterbalance
    >>> spring = Counterbalance(
    ...     stiffness=(2000, 0),
    ...     base_arm=(0.2, 0),
    ...     link_arm=(0.1, 0),
    ...     free_length=(0.05, 0),
    ...     angle=(0, 0),
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
        signs(
            self,
            not_negative=("stiffness", *lengths),
            advice="Give magnitudes; angle says where it is shortest.",
        )
        # Where both arms are equal, the length is 0 at the dead centre, where a force has no
        # direction. None is needed if the force at length 0, tension - stiffness free_length, is 0.
        tension = 0.0 if self.tension is None else self.tension
        forced = tension != self.stiffness * self.free_length
        equal = np.abs(self.base_arm - self.link_arm) < _SHORTEST
        meet = equal & (self.base_arm > 0) & forced
        if meet.any():
            joint = int(meet.argmax())
            raise ValueError(
                f"base_arm and link_arm must differ; {joint_label((), joint)} has"
                f" {self.base_arm[joint]:g} m twice, and the ends of its spring would meet. Correct"
                " one."
            )

    def torque(self, q: SX) -> SX:
        a = self.base_arm
        b = self.link_arm
        phi = q - self.angle
        # Law of cosines.
        length = ca.sqrt(ca.fmax(a * a + b * b - 2 * (a * b) * ca.cos(phi), _SHORTEST**2))
        force = self.stiffness * (length - self.free_length)
        force = force if self.tension is None else force + self.tension
        # tau = -F dL/dq with dL/dq = a b sin(phi) / L.
        return -force / length * (a * b) * ca.sin(phi)


@part
class CosineTorque(KnownTorque):
    """amplitude cos(q - phase) on each joint: an ideal counterbalance, or a counterweight.

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

    def torque(self, q: SX) -> SX:
        return self.amplitude * ca.cos(q - self.phase)
