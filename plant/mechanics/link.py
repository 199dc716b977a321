"""A link: one joint and its frame, by a row of the Denavit-Hartenberg table; limits of joints."""

import casadi as ca
import numpy as np

from plant.mechanics.placement import Placement, exact
from plant.parts.arguments import signs
from plant.parts.fields import Vector
from plant.parts.part import Part, number, part, structure

_LONGEST = 50.0  # length [m] of no link of an arm


@part
class Link(Part):
    """One joint and its link: its frame in that of the previous link, by a row of the *modified*
    table.

    The frame is ``before`` RotX(alpha) TransX(a) RotZ(theta + q) TransZ(d), or with d + q for a
    prismatic joint; the joint turns about, or slides along, its z axis. `Chain.standard` reads rows
    of the standard table.

    Parameters
    ----------
    name : str
        Number or name of the link as the literature counts it; it labels the joint and the link's
        parameters ("Izz3").
    alpha : float
        Twist alpha_{i-1} about x_{i-1} [rad].
    a : float
        Length a_{i-1} along x_{i-1} [m].
    d : float
        Offset d_i along z_i [m]; of a prismatic joint, where q = 0.
    theta : float
        Joint angle where q = 0, or the fixed angle of a prismatic joint [rad].
    prismatic : bool
        The joint slides: q is in m, and the torque a force [N].
    before : Placement
        Pose, in the previous link's frame, of the frame in which the row begins: for geometry that
        no row describes.
    frame : Placement
        Pose, in the link's frame, of the frame in which its body is given (`Body`).

    See Also
    --------
    plant.Chain, plant.Body, plant.Placement

    Examples
    --------
    >>> from plant import Link
    >>> import casadi as ca
    >>> rotation, position = Link(name="forearm", a=0.43, d=-0.09).rotation(ca.SX(0))
    >>> print(position)
    [0.43, 0, -0.09]
    """

    name: str = structure(str)
    alpha: float = structure(float, default=0.0)
    a: float = structure(float, default=0.0)
    d: float = structure(float, default=0.0)
    theta: float = structure(float, default=0.0)
    prismatic: bool = structure(bool, default=False)
    before: Placement = structure(Placement, default=Placement())
    frame: Placement = structure(Placement, default=Placement())

    def __post_init__(self) -> None:
        super().__post_init__()
        angle = ("an angle in radians, within one turn", 2 * np.pi, "Use np.radians.")
        length = (
            f"a length in metres, at most {_LONGEST:g}",
            _LONGEST,
            "Divide by 1000 what is in mm.",
        )
        for name, (rule, most, advice) in (
            ("alpha", angle),
            ("theta", angle),
            ("a", length),
            ("d", length),
        ):
            if abs(value := getattr(self, name)) > most:
                raise ValueError(
                    f"{name} of link {self.name} must be {rule}; got {value:g}. {advice}"
                )
        if (far := max(map(abs, self.before.position))) > _LONGEST:
            rule, _, advice = length
            raise ValueError(
                f"before.position of link {self.name} must be {rule}; got {far:g}. {advice}"
            )

    def rotation(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rotation (3, 3) from this link's frame to the previous one, and the origin's position
        (3,) there [m].
        """
        angle, offset = (self.theta, self.d + q) if self.prismatic else (q + self.theta, self.d)
        ca_, sa = (float(exact(f(self.alpha))) for f in (np.cos, np.sin))
        c, s = (
            (float(exact(f(angle))) for f in (np.cos, np.sin))
            if self.prismatic
            else (ca.cos(angle), ca.sin(angle))
        )
        rotation = ca.vertcat(
            ca.horzcat(c, -s, 0), ca.horzcat(s * ca_, c * ca_, -sa), ca.horzcat(s * sa, c * sa, ca_)
        )
        position = ca.vertcat(self.a, -sa * offset, ca_ * offset)
        if self.before == Placement():
            return rotation, position
        before = ca.DM(exact(np.array(self.before.rotation)))
        return (
            ca.sparsify(before) @ rotation,
            ca.DM(self.before.position) + ca.sparsify(before) @ position,
        )


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
