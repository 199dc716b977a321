"""Body: mass, centre of mass and inertia of a link and all that is fixed to it; its
pseudo-inertia.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant.parts.arguments import array, signs
from plant.parts.fields import Floats, Vector
from plant.parts.part import Part, number, part

if TYPE_CHECKING:
    from plant.mechanics.placement import Placement


@part
class Body(Part):
    """Inertial parameters of one link and all that is fixed to it.

    Parameters
    ----------
    mass : float
        [kg]
    com : (3,) array_like
        Centre of mass in the link's frame [m].
    inertia : (6,) array_like
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre of mass, axes of the link's frame [kg m^2];
        entries of the inertia matrix (Ixy = -integral of x y dm). Zero, that of a point mass, by
        default.
    rotor : float
        Rotor inertia reflected to the joint (of a coupled motor: to its shaft), Jm k^2 [kg m^2]
        (`Drive.reflected_inertia`).

    Notes
    -----
    Physically inconsistent numbers are accepted, since base parameters can need them;
    `require_physical` refuses them.

    See Also
    --------
    plant.Link, plant.Chain

    Examples
    --------
    >>> from plant import Body
    >>> link, tool = Body(mass=4, com=(0.2, 0, 0)), Body(mass=1, com=(0.4, 0, 0))
    >>> link.joined(tool).com
    array([0.24, 0.  , 0.  ])
    """

    mass: float = number(())
    com: Vector = number((3,))
    inertia: Vector = number((6,), default=(0.0,) * 6)
    rotor: float = number((), default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, not_negative=("mass", "rotor"), advice="Check the body's numbers.")

    def joined(self, other: Body) -> Body:
        """This body and another one (a tool, a load) fixed to it as one body; all in the same
        frame.
        """
        if not self.mass + other.mass:
            return Body(
                mass=0.0,
                com=self.com,
                inertia=self.inertia + other.inertia,
                rotor=self.rotor + other.rotor,
            )
        mass = self.mass + other.mass
        com = (self.mass * self.com + other.mass * other.com) / mass
        inertia = sum(b.inertia + b.mass * parallel_axis(b.com - com) for b in (self, other))
        return Body(mass=mass, com=com, inertia=inertia, rotor=self.rotor + other.rotor)

    @property
    def standard_parameters(self) -> Floats:
        """Its standard parameters phi (10,): m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz, without
        the rotor's.

        Mass [kg], first moments [kg m], and inertia about the *origin* of the frame [kg m^2].
        """
        about_origin = self.inertia + self.mass * parallel_axis(self.com)
        return np.array([self.mass, *(self.mass * self.com), *about_origin])

    @classmethod
    def from_standard_parameters(cls, parameters: ArrayLike) -> Body:
        """The body with these `standard_parameters` (10,); all zero: none."""
        phi = array(
            "parameters",
            parameters,
            (10,),
            advice="Give m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz.",
        )
        mass = float(phi[0])
        if not mass > 0 and phi.any():
            raise ValueError(
                f"a load must have a positive mass; got {mass:g} kg. Only an empty gripper has"
                " none."
            )
        com = phi[1:4] / mass if mass > 0 else np.zeros(3)
        return cls(mass=mass, com=com, inertia=phi[4:] - mass * parallel_axis(com))

    def seen_from(self, placement: Placement) -> Body:
        """The same body, given in the frame in which its own frame has this pose."""
        rotation = np.array(placement.rotation)
        matrix = rotation @ inertia_matrix(self.inertia) @ rotation.T
        com = np.array(placement.position) + rotation @ self.com
        return Body(mass=self.mass, com=com, inertia=matrix[_UPPER], rotor=self.rotor)

    def require_physical(self, name: str) -> None:
        """Refuse a body that is not physically consistent.

        Consistent: positive mass, positive semidefinite inertia, no principal moment above the sum
        of the others.
        """
        moments = np.linalg.eigvalsh(inertia_matrix(self.inertia))
        slack = 1e-9 * max(1e-300, np.abs(moments).max())
        if not self.mass > 0:
            raise ValueError(
                f"link {name} must have a positive mass; got {self.mass}. Give it in kg."
            )
        if moments[0] < -slack:
            raise ValueError(
                f"link {name} must have a positive semidefinite inertia; got principal moments"
                f" {moments}. Check the signs of Ixy, Ixz and Iyz, and that it is given about the"
                " centre of mass."
            )
        if moments[2] > moments[0] + moments[1] + slack:
            raise ValueError(
                f"link {name} must have an inertia that a body can have (triangle inequality); got"
                f" principal moments {moments}. Check its entries."
            )


def parallel_axis(r: Floats) -> Floats:
    """Inertia (6,) about a point of a unit mass at r (3,): the parallel-axis theorem."""
    x, y, z = r
    return np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])


_UPPER = np.triu_indices(3)


def inertia_matrix(entries: ArrayLike) -> Floats:
    """The symmetric matrix (3, 3) with these Ixx, Ixy, Ixz, Iyy, Iyz, Izz (6,)."""
    upper = np.zeros((3, 3))
    upper[_UPPER] = entries
    return np.asarray(upper + np.triu(upper, 1).T)


def pseudo_inertia(parameters: ArrayLike) -> Floats:
    """Pseudo-inertia P = [[S, m c], [m c', m]] (4, 4) of a body's standard parameters (10,), S the
    integral of r r' dm.

    A body of positive density exists exactly where P is positive definite: positive mass, positive
    inertia about the centre of mass, and the triangle inequality in one. Source: P. M. Wensing, S.
    Kim, J.-J. E. Slotine, Linear matrix inequalities for physically consistent inertial parameter
    identification, IEEE Robotics and Automation Letters 3 (2018).
    """
    m, *rest = np.asarray(parameters, float)
    inertia = inertia_matrix(rest[3:])
    result = np.zeros((4, 4))
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = rest[:3]
    result[3, 3] = m
    return result


def from_pseudo_inertia(P: ArrayLike) -> Floats:
    """Standard parameters (10,) of a pseudo-inertia; the way back from `pseudo_inertia`."""
    P = np.asarray(P, float)
    moments = P[:3, :3]
    inertia = np.trace(moments) * np.eye(3) - moments
    return np.concatenate([[P[3, 3]], P[:3, 3], inertia[_UPPER]])


def body_in(mass: float, inertia: Floats, name: str, pose: Placement) -> Body | None:
    """The body of an element at this pose in its link's frame; None of one that has no mass and
    no inertia.
    """
    if mass < 0:
        raise ValueError(f"link {name} must have a positive mass; got {mass}. Correct it.")
    if not mass and not np.any(inertia):
        return None
    return Body(mass=mass, com=np.zeros(3), inertia=inertia).seen_from(pose)


def symmetric_basis(d: int) -> Floats:
    """Orthonormal basis of the symmetric matrices (d, d): (d (d + 1) / 2, d, d)."""
    found = []
    for i in range(d):
        for j in range(i, d):
            matrix = np.zeros((d, d))
            matrix[i, j] = matrix[j, i] = 1.0 if i == j else np.sqrt(0.5)
            found.append(matrix)
    return np.array(found)


# extent [m], root mean square, that a prior gets where it has none: a point mass, a rod
_THIN = 0.03


def prior_factor(parameters: ArrayLike) -> Floats:
    """L (4, 4) with L L' the pseudo-inertia of a body (10,) that is a prior, made a little thick
    where it is thin.
    """
    P = pseudo_inertia(parameters)
    if not P[3, 3] > 0:
        P = P + np.diag([0.0, 0.0, 0.0, 1e-3 * max(1e-3, float(np.trace(P[:3, :3])))])
    central = P[:3, :3] - np.outer(P[:3, 3], P[:3, 3]) / P[3, 3]
    widths, axes = np.linalg.eigh(central)
    thin = (
        np.maximum(widths, _THIN**2 * P[3, 3] * (widths < (1e-3 * _THIN) ** 2 * P[3, 3])) - widths
    )
    P[:3, :3] += axes @ np.diag(thin) @ axes.T
    return np.asarray(np.linalg.cholesky(P), dtype=float)


def prior_changes(factor: Floats) -> Floats:
    """Standard parameters (10, 10) of L S L' for each S of an orthonormal basis, in columns."""
    return np.array([from_pseudo_inertia(factor @ S @ factor.T) for S in symmetric_basis(4)]).T
