"""Links of a serial chain: geometry as Denavit-Hartenberg rows or frames, and the bodies that hang on them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.part import Part, number, part, structure
from plant.placement import Placement, exact

__all__ = ["Body", "Chain", "Link", "parallel_axis"]


@part
class Link(Part):
    """One joint and its link: its frame in that of the previous link, by a row of the *modified* table.

    The frame is ``before`` RotX(alpha) TransX(a) RotZ(theta + q) TransZ(d), or with d + q for a prismatic joint; the
    joint turns about, or slides along, its z axis. `Chain.standard` reads rows of the standard table.

    Parameters
    ----------
    name : str
        Number or name of the link as the literature counts it; it labels its parameters ("m3", "Izz3").
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
        What no row can say: a frame fixed to the previous link, in which the row begins.
    frame : Placement
        Where, seen from the link's frame, the frame is in which its body is given (`Body`).
    """

    name: str = structure(str)
    alpha: float = structure(float, default=0.0)
    a: float = structure(float, default=0.0)
    d: float = structure(float, default=0.0)
    theta: float = structure(float, default=0.0)
    prismatic: bool = structure(bool, default=False)
    before: Placement = structure(Placement, default=Placement())
    frame: Placement = structure(Placement, default=Placement())

    def rotation(self, q):
        """Rotation (3, 3) from this link's frame to the previous one, and the origin's position (3,) there [m]."""
        angle, offset = (self.theta, self.d + q) if self.prismatic else (q + self.theta, self.d)
        ca_, sa = (float(exact(f(self.alpha))) for f in (np.cos, np.sin))
        c, s = (float(exact(f(angle))) for f in (np.cos, np.sin)) if self.prismatic else (ca.cos(angle), ca.sin(angle))
        rotation = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s * ca_, c * ca_, -sa), ca.horzcat(s * sa, c * sa, ca_))
        position = ca.vertcat(self.a, -sa * offset, ca_ * offset)
        if self.before == Placement():
            return rotation, position
        before = ca.DM(exact(np.array(self.before.rotation)))
        return ca.sparsify(before) @ rotation, ca.DM(self.before.position) + ca.sparsify(before) @ position


@part
class Chain(Part):
    """Serial chain of revolute and prismatic joints.

    Parameters
    ----------
    links : tuple of Link
        From the base outwards.
    gravity : (3,) array_like
        Acceleration of gravity in the base frame [m/s^2]; another direction for a base that is tilted (`tilted`).
    bodies : tuple of Body, optional
        What is known of the links' masses, each in its link's ``frame``.
    """

    links: tuple = structure()
    gravity: np.ndarray = structure(default=(0.0, 0.0, -9.81))
    bodies: tuple = structure(default=())

    def __post_init__(self):
        links = tuple(self.links) if np.iterable(self.links) else (self.links,)
        if not links or not all(isinstance(link, Link) for link in links):
            raise ValueError(f"links must be at least one Link; got {self.links!r:.80}. Give a tuple of Link(...).")
        names = [link.name for link in links]
        twice = [name for i, name in enumerate(names) if name in names[:i]]
        if twice:
            raise ValueError(f"links must have names of their own; {twice[0]!r} comes twice. Rename one.")
        gravity = np.asarray(self.gravity, float)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise ValueError(f"gravity must be 3 finite numbers [m/s^2]; got {self.gravity!r}. Use (0, 0, -9.81).")
        bodies = tuple(self.bodies)
        if bodies and (len(bodies) != len(links) or not all(isinstance(body, Body) for body in bodies)):
            raise ValueError(f"bodies must be {len(links)}, one Body per link; got {len(bodies)}. Add or leave out.")
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        object.__setattr__(self, "bodies", bodies)

    @property
    def n(self):
        """Number of joints."""
        return len(self.links)

    def tilted(self, rotation):
        """The same chain on a base turned by a rotation (3, 3): its axes as columns, in a frame with z upwards."""
        placement = Placement(rotation=rotation)
        turned = np.array(placement.rotation).T @ np.array(self.gravity)
        return Chain(links=self.links, gravity=tuple(turned), bodies=self.bodies)

    def carrying(self, body, link=-1):
        """The same chain with another body (a tool, a load) fixed to a link, given in the frame of that link's body."""
        if not self.bodies:
            raise ValueError("bodies must be known to carry one more; this chain has none. Give the Chain its bodies.")
        bodies = list(self.bodies)
        bodies[link] = bodies[link].joined(body)
        return Chain(links=self.links, gravity=self.gravity, bodies=tuple(bodies))

    @classmethod
    def from_urdf(cls, path, joints=None, *, gravity=(0.0, 0.0, -9.81)):
        """A chain, with bodies, from a URDF file.

        Parameters
        ----------
        path : str or Path
        joints : sequence of str, optional
            Names of the joints of the chain, base first; by default all that move, if they lie behind each other. What
            else moves (a gripper) is held at zero and lumped with the link that carries it, as fixed joints are.
        gravity : (3,) array_like
            In the frame of the file's base link.

        Returns
        -------
        Chain
            Bodies are given in the frames of the file's links; limits, meshes and transmissions are not read.

        Raises
        ------
        ValueError
            A file that is malformed, too large, declares entities, or describes no such chain; a body that no body can
            be. The message names link or joint, and the rule.
        """
        from plant.urdf import chain_from_urdf  # which makes chains of this file's class

        return chain_from_urdf(path, joints, gravity)

    @classmethod
    def standard(cls, rows, *, gravity=(0.0, 0.0, -9.81), bodies=()):
        """A chain from rows of the *standard* Denavit-Hartenberg table.

        Parameters
        ----------
        rows : sequence of dict
            alpha_i, a_i, d_i, and optionally theta, prismatic and name, per joint: the frame i is
            RotZ(theta + q) TransZ(d) TransX(a) RotX(alpha) in the frame i - 1.
        gravity : (3,) array_like
        bodies : tuple of Body, optional
            Given in the frames of the standard table, which sit at the far end of their links.
        """
        links, reached = [], {"alpha": 0.0, "a": 0.0}
        for i, row in enumerate(rows):
            unknown = set(row) - {"alpha", "a", "d", "theta", "prismatic", "name"}
            if unknown or not {"alpha", "a", "d"} <= set(row):
                raise ValueError(
                    f"rows must have alpha, a and d, and may have theta, prismatic and name; row {i} has "
                    f"{', '.join(row)}. Correct it."
                )
            rest = {"name": str(i + 1)} | {key: row[key] for key in ("name", "d", "theta", "prismatic") if key in row}
            end = {"alpha": row["alpha"], "a": row["a"]}
            links.append(Link(**reached, **rest, frame=Placement.of_row(**end)))
            reached = end
        return cls(links=tuple(links), gravity=gravity, bodies=bodies)


@part
class Body(Part):
    """Physical parameters of one link with what is fixed to it.

    Parameters
    ----------
    mass : float
        [kg]
    com : (3,) array_like
        Centre of mass in the link's frame [m].
    inertia : (6,) array_like
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre of mass, axes of the link's frame [kg m^2]; entries of the
        inertia matrix (Ixy = -integral of x y dm).
    rotor : float
        Motor inertia as the joint feels it, Jm k^2 [kg m^2] (`Drive.reflected_inertia`).
    """

    mass: float = number(())
    com: np.ndarray = number((3,))
    inertia: np.ndarray = number((6,))
    rotor: float = number((), default=0.0)

    def __post_init__(self):
        super().__post_init__()
        for name in ("mass", "rotor"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} of a body must not be negative; got {getattr(self, name)}. Check its sign.")

    def joined(self, other):
        """This body with another one (a tool, a load) fixed to it, both given in the same frame."""
        if not self.mass + other.mass:
            return Body(mass=0.0, com=self.com, inertia=self.inertia + other.inertia, rotor=self.rotor + other.rotor)
        mass = self.mass + other.mass
        com = (self.mass * self.com + other.mass * other.com) / mass
        inertia = sum(b.inertia + b.mass * parallel_axis(b.com - com) for b in (self, other))
        return Body(mass=mass, com=com, inertia=inertia, rotor=self.rotor + other.rotor)

    def seen_from(self, placement):
        """The same body given in another frame, in which its own one has this placement."""
        rotation, matrix = np.array(placement.rotation), np.zeros((3, 3))
        matrix[np.triu_indices(3)] = self.inertia
        matrix = rotation @ (matrix + np.triu(matrix, 1).T) @ rotation.T
        com = np.array(placement.position) + rotation @ self.com
        return Body(mass=self.mass, com=com, inertia=matrix[np.triu_indices(3)], rotor=self.rotor)

    def require_physical(self, name):
        """Refuse what no body can have.

        Raises
        ------
        ValueError
            With the name of the link, and the rule: positive mass, an inertia that is positive semidefinite and whose
            largest principal moment is at most the sum of the others.
        """
        matrix = np.zeros((3, 3))
        matrix[np.triu_indices(3)] = self.inertia
        moments = np.linalg.eigvalsh(matrix + np.triu(matrix, 1).T)
        slack = 1e-9 * max(1e-300, np.abs(moments).max())
        if not self.mass > 0:
            raise ValueError(f"link {name} must have a positive mass; got {self.mass}. Give it in kg.")
        if moments[0] < -slack:
            raise ValueError(
                f"link {name} must have a positive semidefinite inertia; got principal moments {moments}. Check the "
                "signs of Ixy, Ixz and Iyz, and that it is given about the centre of mass."
            )
        if moments[2] > moments[0] + moments[1] + slack:
            raise ValueError(
                f"link {name} must have an inertia that a body can have (triangle inequality); got principal moments "
                f"{moments}. Check its entries."
            )


def parallel_axis(r):
    """Inertia (6,) about a point of a unit mass at r (3,): the parallel-axis theorem."""
    x, y, z = r
    return np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
