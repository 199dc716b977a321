"""Links of a serial chain: geometry as modified Denavit-Hartenberg rows, and the bodies that hang on them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.part import Part, number, part, structure

__all__ = ["Body", "Chain", "Link", "parallel_axis"]


@part
class Link(Part):
    """One revolute joint and its link, as a row of the modified Denavit-Hartenberg table.

    Parameters
    ----------
    name : str
        Number or name of the link as the literature counts it; it labels its parameters ("m3", "Izz3").
    alpha : float
        Twist alpha_{i-1} about x_{i-1} [rad].
    a : float
        Length a_{i-1} along x_{i-1} [m].
    d : float
        Offset d_i along z_i [m].
    theta : float
        Joint angle at q = 0 [rad].
    """

    name: str = structure(str)
    alpha: float = structure(float)
    a: float = structure(float)
    d: float = structure(float)
    theta: float = structure(float, default=0.0)

    def rotation(self, q):
        """Rotation (3, 3) from this link's frame to the previous one, and the origin's position (3,) there [m]."""
        ca_, sa = _exact(np.cos(self.alpha)), _exact(np.sin(self.alpha))
        c, s = ca.cos(q + self.theta), ca.sin(q + self.theta)
        rotation = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s * ca_, c * ca_, -sa), ca.horzcat(s * sa, c * sa, ca_))
        return rotation, ca.vertcat(self.a, -sa * self.d, ca_ * self.d)


def _exact(x):
    """Cosines of right angles are whole numbers; rounding them back keeps the equations short."""
    return float(np.round(x)) if abs(x - np.round(x)) < 1e-15 else float(x)


@part
class Chain(Part):
    """Serial chain of revolute joints.

    Parameters
    ----------
    links : tuple of Link
        From the base outwards.
    gravity : (3,) array_like
        Acceleration of gravity in the base frame [m/s^2].
    """

    links: tuple = structure()
    gravity: np.ndarray = structure(default=(0.0, 0.0, -9.81))

    def __post_init__(self):
        links = tuple(self.links) if np.iterable(self.links) else (self.links,)
        if not links or not all(isinstance(link, Link) for link in links):
            raise ValueError(f"links must be at least one Link; got {self.links!r:.80}. Give a tuple of Link(...).")
        gravity = np.asarray(self.gravity, float)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise ValueError(f"gravity must be 3 finite numbers [m/s^2]; got {self.gravity!r}. Use (0, 0, -9.81).")
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))

    @property
    def n(self):
        """Number of joints."""
        return len(self.links)


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
        mass = self.mass + other.mass
        com = (self.mass * self.com + other.mass * other.com) / mass
        inertia = sum(b.inertia + b.mass * parallel_axis(b.com - com) for b in (self, other))
        return Body(mass=mass, com=com, inertia=inertia, rotor=self.rotor + other.rotor)


def parallel_axis(r):
    """Inertia (6,) about a point of a unit mass at r (3,): the parallel-axis theorem."""
    x, y, z = r
    return np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
