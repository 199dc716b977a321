"""Physical consistency: the nearest arm whose f bodies and motors can have.

A body within a box is a set of point masses in it: positive mass, a possible inertia, and a centre
of mass inside the box are equivalent to non-negative masses on a fine grid. f is linear in them and
in the motors' inertias, so the nearest such f, in the metric of the identified covariance, is a
problem of non-negative least squares. What the lumping took for independent (f3 = a f5 of the
paper) comes out as bodies have it.

Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice Hall 1974 (non-negative
least squares); P. M. Wensing, S. Kim, J.-J. E. Slotine, Linear matrix inequalities for physically
consistent inertial parameter identification, IEEE Robotics and Automation Letters 3 (2018)
(physical consistency).
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from identification.results.identification import Identification
from plant import Arm, Body
from plant.machine.motor_inertia import LEAST_MOTOR_INERTIA
from plant.mechanics.lumping import STANDARD, standard_parameters
from plant.parts.arguments import array, instance, known_options, whole
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

# share of the largest variance that is added to all: a number kept fixed has no variance
_RIDGE = 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Physical(Shown, Frozen):
    """The nearest physically consistent arm.

    Attributes
    ----------
    arm : Arm
    bodies : tuple of Body
        One of the sets of bodies that have these f; what f does not determine is arbitrary.
    distance : float
        From what was found, in standard deviations (root of chi squared); with p numbers, up to
        about sqrt(p) + 2 is noise, and far more says that the rig or the boxes are wrong.
    """

    arm: Arm
    bodies: tuple[Body, ...]
    distance: float

    def _short(self) -> str:
        return (
            f"{len(self.bodies)} bodies, {self.distance:.3g} standard deviations from what was"
            " found"
        )

    def _shown(self) -> Iterator[Piece]:
        noise = f"up to about {np.sqrt(self.arm.dynamics.p) + 2:.1f} is noise"
        yield Verdict(f"{self._short()}; {noise}")
        labels = self.arm.dynamics.chain.joint_labels
        yield table_of("a set of bodies that has it", zip(labels, self.bodies, strict=True))


def table_of(title: str, bodies: Iterable[tuple[str, Body]]) -> Table:
    """Mass and centre of bodies, by name."""
    rows = [(name, f"{body.mass:.4g}", *(f"{x:.3g}" for x in body.com)) for name, body in bodies]
    return Table((title, "mass [kg]", "x [m]", "y [m]", "z [m]"), rows)


@known_options
def nearest_physical(found: Identification, boxes: ArrayLike, *, points: int = 5) -> Physical:
    """The arm nearest to an identified one whose links are bodies within boxes.

    Parameters
    ----------
    found : Identification
        With a covariance.
    boxes : (n, 3, 2) array_like
        Where the mass of each link can be: lowest and highest x, y and z in the link's frame [m].
    points : int
        Of the grid, along each edge that has a length.

    Returns
    -------
    Physical

    Raises
    ------
    ValueError
        Bad input, or an identification without covariance.

    See Also
    --------
    identification.write_model

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify, nearest_physical
    >>> record = simulate(puma560.literature_arm(1.5), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> boxes = [((-0.6, 0.6), (-0.6, 0.6), (-0.3, 0.3))] * 2
    >>> near = nearest_physical(found, boxes, points=3)
    >>> print([body.mass > 0 for body in near.bodies])
    [True, True]
    """
    from scipy.optimize import nnls

    instance("found", found, Identification, "Pass what identify gave.")
    dynamics = found.arm.dynamics
    n = found.arm.n
    boxes = array(
        "boxes", boxes, (n, 3, 2), advice="Give (low, high) of x, y and z for each link [m]."
    )
    for label, box in zip(dynamics.chain.joint_labels, boxes, strict=True):
        if (box[:, 0] > box[:, 1]).any():
            raise ValueError(
                f"boxes must have low <= high in x, y and z; that of {label} is reversed. Swap its"
                " ends."
            )
    whole("points", points, "The default is 5.", least=2)
    whiten = whitening(found)
    width = len(STANDARD)
    matrix = np.array(dynamics.lumping.matrix)
    places = []
    columns = []
    for i in range(n):
        edges = [np.unique(np.linspace(low, high, points)) for low, high in boxes[i]]
        for place in itertools.product(*edges):
            pi = np.zeros(width * n)
            mass = Body(mass=1.0, com=place).seen_from(dynamics.chain.links[i].frame)
            pi[width * i : width * (i + 1)] = standard_parameters([mass])
            places.append((i, np.array(place)))
            columns.append(matrix @ pi)
    rotors = matrix[:, STANDARD.index("J") :: width]
    least = LEAST_MOTOR_INERTIA * found.rig.drive.reflected_inertia()
    every = np.column_stack([*columns, rotors])
    length = np.linalg.norm(whiten @ every, axis=0)
    length[length == 0] = 1.0
    amounts, distance = nnls(
        whiten @ every / length, whiten @ (found.f - rotors @ least), maxiter=50 * every.shape[1]
    )
    amounts = amounts / length
    sets = [
        [(m, x) for m, (i, x) in zip(amounts, places, strict=False) if i == link and m > 0]
        for link in range(n)
    ]
    bodies = tuple(
        _body(masses, float(j))
        for masses, j in zip(sets, amounts[len(places) :] + least, strict=True)
    )
    return Physical(arm=dynamics.arm(dynamics.f(bodies)), bodies=bodies, distance=float(distance))


def _body(masses: list[tuple[float, Floats]], rotor: float) -> Body:
    """One body of point masses (mass, place), with its motor."""
    points = (Body(mass=float(mass), com=place) for mass, place in masses)
    return dataclasses.replace(
        functools.reduce(Body.joined, points, Body(mass=0.0, com=(0, 0, 0))), rotor=rotor
    )


def whitening(found: Identification) -> Floats:
    """W with W C W' = 1, C the covariance of f; refused without one."""
    _ = found.fit.std  # refuses
    covariance = found.fit.covariance_of(found.arm.dynamics.names)
    ridge = _RIDGE * np.diag(covariance).max() * np.eye(len(covariance))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + ridge)))
