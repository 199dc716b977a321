"""A link: one joint and its frame, by a row of the Denavit-Hartenberg table; limits of joints."""

from dataclasses import replace

import casadi as ca
import numpy as np

from plant.mechanics.placement import Placement, exact
from plant.parts import (
    SLIDES,
    TURNS,
    Floats,
    JointUnits,
    Part,
    Vector,
    number,
    part,
    signs,
    structure,
)

# Length that no link of an arm exceeds [m]; a longer one was probably given in mm.
_LONGEST = 50.0


@part
class Link(Part):
    """One joint and its link: a row of the *modified* Denavit-Hartenberg table.

    The frame is ``before`` RotX(alpha) TransX(a) RotZ(theta + q) TransZ(d); for a prismatic joint,
    it ends with RotZ(theta) TransZ(d + q). The joint turns about, or slides along, its z axis.
    `Chain.standard` reads rows of the standard table.

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
        Offset d_i along z_i [m]; for a prismatic joint, the offset where q = 0.
    theta : float
        Joint angle where q = 0, or the fixed angle of a prismatic joint [rad].
    prismatic : bool
        The joint slides: q is in m, and the torque a force [N].
    before : Placement
        Pose of the frame where the row begins, in the frame of the previous link: for geometry that
        no row describes.
    frame : Placement
        Pose of the frame of the link's `Body`, in the frame of the link.

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
        # Degrees and millimetres are the usual mistakes: both give numbers that no arm has.
        advice = "Use np.radians if it is in degrees, or take whole turns off."
        angle = ("an angle in radians, within one turn", 2 * np.pi, advice)
        rule = f"a length in metres, at most {_LONGEST:g}"
        length = (rule, _LONGEST, "Divide by 1000 what is in mm.")
        distance = max(map(abs, self.before.position))
        # The offset d is judged by the chain: along nearly parallel axes it may be of any length.
        for name, value, (rule, limit, advice) in (
            ("alpha", self.alpha, angle),
            ("theta", self.theta, angle),
            ("a", self.a, length),
            ("before.position", distance, length),
        ):
            if abs(value) > limit:
                raise ValueError(
                    f"{name} of link {self.name} must be {rule}; got {value:g}. {advice}"
                )

    @property
    def units(self) -> JointUnits:
        """Units of its joint in tables and messages."""
        return SLIDES if self.prismatic else TURNS

    def rotation(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rotation (3, 3) and origin (3,) [m] of this link's frame in that of the previous link."""
        # A revolute joint turns about z by q, a prismatic one slides along z by q.
        angle = self.theta if self.prismatic else q + self.theta
        offset = self.d + q if self.prismatic else self.d
        # Sines and cosines of fixed angles are plain numbers, exact at right angles, so that terms
        # with a factor of zero vanish from the equations.
        ca_, sa = (float(exact(f(self.alpha))) for f in (np.cos, np.sin))
        if self.prismatic:
            c, s = (float(exact(f(angle))) for f in (np.cos, np.sin))
        else:
            c = ca.cos(angle)
            s = ca.sin(angle)
        # The rotation is RotX(alpha) RotZ(angle); the position is a along x, then the offset along
        # the twisted z axis.
        rotation = ca.vertcat(
            ca.horzcat(c, -s, 0), ca.horzcat(s * ca_, c * ca_, -sa), ca.horzcat(s * sa, c * sa, ca_)
        )
        position = ca.vertcat(self.a, -sa * offset, ca_ * offset)
        if self.before == Placement():
            return rotation, position
        # A pose ahead of the row; sparse, so that its zeros leave no terms.
        turned = ca.sparsify(ca.DM(exact(np.array(self.before.rotation))))
        return turned @ rotation, ca.DM(self.before.position) + turned @ position


# Two axes are nearly parallel if the sine of the angle between them is below this. Their common
# normal, which places the frames of the table, may then lie far away. The parallel axes of an arm
# deviate by some 1e-3 rad after calibration.
_PARALLEL = 0.05


def near_each_other(links: tuple[Link, ...]) -> tuple[Link, ...]:
    """The same links, with frames that lie near each other on their axes.

    The common normal of two nearly parallel axes may lie hundreds of metres away. The rows of a
    calibrated arm then lead there along one axis and back along the other. The frame of a link may
    lie anywhere on its axis, so a far frame is moved to the point nearest to the previous frame.

    Raises
    ------
    ValueError
        An offset exceeds 50 m, and its axis is not nearly parallel to a neighbour's; or a frame
        is still more than 50 m from the previous one, or that of the last body from its link.
    """
    far_links = [link for link in links if abs(link.d) > _LONGEST]
    if not far_links:
        return links
    far_link = far_links[0]  # whose offset the chain has to come back from
    twists = [abs(float(_axis_of(link)[2])) for link in links] + [0.0]
    limit = float(np.sqrt(1 - _PARALLEL**2))
    moved = []
    shift = 0.0  # of the frame before, along its own axis
    for link, twist, twist_behind in zip(links, twists[:-1], twists[1:], strict=True):
        back = Placement(position=(0.0, 0.0, -shift))
        pose = back @ link.before @ Placement.of_row(alpha=link.alpha, a=link.a, d=link.d)
        shift = 0.0
        if abs(link.d) > _LONGEST:
            far_link = link
            if max(twist, twist_behind) <= limit:
                raise _offset_error(far_link)
            # Move the frame to the point of its axis that is nearest to the previous frame.
            shift = -float(np.array(pose.rotation)[:, 2] @ pose.position)
            pose = pose @ Placement(position=(0.0, 0.0, shift))
        if link is far_link or back != Placement():
            if np.abs(pose.position).max() > _LONGEST:
                raise _offset_error(far_link)
            frame = Placement(position=(0.0, 0.0, -shift)) @ link.frame
            link = replace(link, before=pose, alpha=0.0, a=0.0, d=0.0, frame=frame)
        moved.append(link)
    # Behind the last link no row leads back.
    if np.abs(moved[-1].frame.position).max() > _LONGEST:
        raise _offset_error(far_link)
    return tuple(moved)


def _offset_error(link: Link) -> ValueError:
    return ValueError(
        f"d of link {link.name} must be a length in metres, at most {_LONGEST:g}, unless a"
        f" neighbour's nearly parallel axis leads back; got {link.d:g}. Divide by 1000 if it is in"
        " mm."
    )


def _axis_of(link: Link) -> Floats:
    """Direction (3,) of the axis of a link, in the frame of the link before."""
    pose = link.before @ Placement.of_row(alpha=link.alpha)
    return np.array(pose.rotation)[:, 2]


@part
class Limits(Part):
    """Limits of the joints of a chain, not of its motors; infinite where a joint has no limit.

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
    >>> Limits(lower=(-2,), upper=(2,), velocity=(3,), effort=(200,))
    Limits(lower=array([-2.]), upper=array([2.]), velocity=array([3.]), effort=array([200.]))
    """

    lower: Vector = number(("n",), finite=False)
    upper: Vector = number(("n",), finite=False)
    velocity: Vector = number(("n",), finite=False)
    effort: Vector = number(("n",), finite=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Ends may be equal: a joint that is locked.
        for joint in np.flatnonzero(self.lower > self.upper):
            got = f"got {self.lower[joint]} and {self.upper[joint]} at joint {joint + 1}"
            raise ValueError(
                f"lower must not be above upper; {got}. Swap them if they are"
                " exchanged, or correct one."
            )
        signs(self, not_negative=("velocity", "effort"), advice="Limits are magnitudes.")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)
