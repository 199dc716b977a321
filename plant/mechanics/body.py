"""Body: mass, centre of mass and inertia of a link with its attachments; pseudo-inertia."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant.parts import Floats, Part, Vector, array, instance, number, part, signs

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
        Rotor inertia Jm k^2, reflected to the joint, or to the shaft of a coupled motor [kg m^2]
        (`Drive.reflected_inertia`).

    Notes
    -----
    Mass and rotor are not negative. An inertia that no body can have is accepted, since base
    parameters can need it; `require_physical` refuses it.

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

    def joined(self, body: Body) -> Body:
        """This body and a tool or load that is fixed to it, as one; both are in the same frame."""
        instance("body", body, Body, "Give mass and com; a point mass needs no inertia.")
        mass = self.mass + body.mass
        rotor = self.rotor + body.rotor
        # Without any mass the common centre of mass would be 0 / 0.
        if not mass:
            added = self.inertia + body.inertia
            return Body(mass=0.0, com=self.com, inertia=added, rotor=rotor)
        com = (self.mass * self.com + body.mass * body.com) / mass
        # Both inertias are shifted to the common centre of mass by the parallel-axis theorem.
        inertia = sum(b.inertia + b.mass * parallel_axis(b.com - com) for b in (self, body))
        return Body(mass=mass, com=com, inertia=inertia, rotor=rotor)

    @property
    def standard_parameters(self) -> Floats:
        """Standard parameters phi (10,): m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz; no rotor.

        Mass [kg], first moments [kg m], and inertia about the *origin* of the frame [kg m^2].
        """
        # The parallel-axis theorem: about the origin the torque is linear in mass, first moment and
        # inertia; about the centre of mass it is not.
        about_origin = self.inertia + self.mass * parallel_axis(self.com)
        return np.array([self.mass, *(self.mass * self.com), *about_origin])

    @classmethod
    def from_standard_parameters(cls, parameters: ArrayLike) -> Body:
        """The body with these `standard_parameters` (10,); ten zeros give one without mass."""
        phi = array("parameters", parameters, (10,), advice=_STANDARD)
        mass = float(phi[0])
        # Only the empty load (all ten zero) may lack mass: its centre of mass is then arbitrary.
        if not mass > 0 and phi.any():
            raise ValueError(
                f"parameters must have a positive mass; got {mass:g} kg. Ten zeros stand for an"
                " empty gripper."
            )
        com = phi[1:4] / mass if mass > 0 else np.zeros(3)
        return cls(mass=mass, com=com, inertia=phi[4:] - mass * parallel_axis(com))

    def seen_from(self, placement: Placement) -> Body:
        """The same body in another frame, in which its present frame has this pose."""
        rotation = np.array(placement.rotation)
        # R I R'. The inertia is about the centre of mass, so the shift of the frame adds nothing.
        matrix = rotation @ inertia_matrix(self.inertia) @ rotation.T
        com = np.array(placement.position) + rotation @ self.com
        return Body(mass=self.mass, com=com, inertia=matrix[_UPPER], rotor=self.rotor)

    def excess(self) -> float:
        """Share of the largest principal moment by which it exceeds the sum of the others, or 0."""
        moments = np.linalg.eigvalsh(inertia_matrix(self.inertia))
        # A point mass has no moments.
        size = max(1e-300, np.abs(moments).max())
        return max(0.0, float(moments[2] - moments[0] - moments[1]) / size)

    def require_physical(self, name: str, slip: float = 1e-9) -> None:
        """Refuse numbers that no body can have; `name` is that of the body in messages.

        The mass is positive, the inertia is positive semidefinite, and no principal moment exceeds
        the sum of the others by more than its share `slip`, which by default is that of rounding.
        """
        moments = np.linalg.eigvalsh(inertia_matrix(self.inertia))
        # Files round their inertias: moments below zero by 1e-9 of the largest are accepted. A
        # point mass has no moments.
        slack = 1e-9 * max(1e-300, np.abs(moments).max())
        if not self.mass > 0:
            raise ValueError(
                f"body {name} must have a positive mass; got {self.mass} kg. State it, or fix the"
                " link to its neighbour."
            )
        if moments[0] < -slack:
            raise ValueError(
                f"body {name} must have a positive semidefinite inertia; got principal moments"
                f" {moments}. Check the signs of Ixy, Ixz and Iyz, and that it is given about the"
                " centre of mass."
            )
        if self.excess() > slip:
            raise ValueError(
                f"body {name} must have an inertia that a body can have (triangle inequality); got"
                f" principal moments {moments}. Check its entries."
            )


def parallel_axis(r: Floats) -> Floats:
    """Inertia (6,) about a point of a unit mass at r (3,): the parallel-axis theorem."""
    x, y, z = r
    return np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])


_UPPER = np.triu_indices(3)
_STANDARD = "Give m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz."


def inertia_matrix(entries: ArrayLike) -> Floats:
    """The symmetric matrix (3, 3) with these Ixx, Ixy, Ixz, Iyy, Iyz, Izz (6,)."""
    advice = "Give Ixx, Ixy, Ixz, Iyy, Iyz, Izz."
    upper = np.zeros((3, 3))
    upper[_UPPER] = array("entries", entries, (6,), advice=advice, finite=False)
    return np.asarray(upper + np.triu(upper, 1).T)


def pseudo_inertia(parameters: ArrayLike) -> Floats:
    """Pseudo-inertia P = [[S, m c], [m c', m]] (4, 4) of standard parameters (10,).

    c is the centre of mass, and S the integral of r r' dm. A body of positive density exists
    exactly where P is positive definite, which says three things in one: the mass is positive, the
    inertia about the centre of mass is too, and the triangle inequality holds. Source: P. M.
    Wensing, S. Kim, J.-J. E. Slotine, Linear matrix inequalities for physically consistent inertial
    parameter identification, IEEE Robotics and Automation Letters 3 (2018).
    """
    phi = array("parameters", parameters, (10,), advice=_STANDARD, finite=False)
    inertia = inertia_matrix(phi[4:])
    result = np.zeros((4, 4))
    # I = trace(S) 1 - S and trace(I) = 2 trace(S); so S = trace(I) / 2 1 - I.
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = phi[1:4]
    result[3, 3] = phi[0]
    return result


def from_pseudo_inertia(P: ArrayLike) -> Floats:
    """Standard parameters (10,) of a pseudo-inertia; the way back from `pseudo_inertia`."""
    P = np.asarray(P, float)
    moments = P[:3, :3]
    inertia = np.trace(moments) * np.eye(3) - moments
    return np.concatenate([[P[3, 3]], P[:3, 3], inertia[_UPPER]])


def body_in(mass: float, inertia: Floats, name: str, pose: Placement) -> Body | None:
    """The body of an element of a file, at this pose in the frame of its link; None for a frame."""
    if mass < 0:
        raise ValueError(f"link {name} must have a positive mass; got {mass}. Correct it.")
    # A frame, such as that of a tool's tip, has neither mass nor inertia.
    if not mass and not np.any(inertia):
        return None
    return Body(mass=mass, com=np.zeros(3), inertia=inertia).seen_from(pose)


def symmetric_basis(d: int) -> Floats:
    """Orthonormal basis of the symmetric matrices (d, d): (d (d + 1) / 2, d, d)."""
    basis = []
    for i in range(d):
        for j in range(i, d):
            matrix = np.zeros((d, d))
            # Off the diagonal an element counts twice in the norm, hence the root of one half.
            matrix[i, j] = matrix[j, i] = 1.0 if i == j else np.sqrt(0.5)
            basis.append(matrix)
    return np.array(basis)


# Root-mean-square extent [m] of a slender link, for priors without extent: a point mass, a rod.
_THIN = 0.03


def prior_factor(parameters: ArrayLike) -> Floats:
    """Factor L (4, 4) of the pseudo-inertia L L' of a prior body (10,).

    Directions in which the body has no extent are widened, since L L' has to be positive definite.
    """
    P = pseudo_inertia(parameters)
    # A prior without mass has no Cholesky factor: it gets a small mass, in proportion to its
    # moments.
    if not P[3, 3] > 0:
        P = P + np.diag([0.0, 0.0, 0.0, 1e-3 * max(1e-3, float(np.trace(P[:3, :3])))])
    # Second moments about the centre of mass: along each principal axis m times the square of the
    # root-mean-square extent. Only directions without extent are widened; a stated extent stays.
    central = P[:3, :3] - np.outer(P[:3, 3], P[:3, 3]) / P[3, 3]
    widths, axes = np.linalg.eigh(central)
    thin = widths < (1e-3 * _THIN) ** 2 * P[3, 3]
    widening = np.maximum(widths, _THIN**2 * P[3, 3] * thin) - widths
    # Added along the principal axes; mass and first moment do not change.
    P[:3, :3] += axes @ np.diag(widening) @ axes.T
    return np.asarray(np.linalg.cholesky(P), dtype=float)


def prior_changes(factor: Floats) -> Floats:
    """Standard parameters (10, 10) of L S L' for each S of an orthonormal basis, in columns."""
    # phi is linear in P: these are its changes where P becomes L (1 + S) L'.
    return np.array([from_pseudo_inertia(factor @ S @ factor.T) for S in symmetric_basis(4)]).T
