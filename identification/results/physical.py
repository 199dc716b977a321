"""Physical consistency: the arm nearest to an identified one that consists of possible bodies.

The nearest f in the metric of the identified covariance follows from point masses within boxes
(`identification.equation_error.possible_bodies`). Dependencies that the lumping ignores (f3 = a f5
of the paper) hold for the result, as for any bodies.

Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice Hall 1974 (non-negative
least squares); P. M. Wensing, S. Kim, J.-J. E. Slotine, Linear matrix inequalities for physically
consistent inertial parameter identification, IEEE Robotics and Automation Letters 3 (2018)
(physical consistency).
"""

import dataclasses
import functools
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import Estimate, PointMasses, nearest_amounts
from plant import Arm, Body
from plant.machine import LEAST_MOTOR_INERTIA
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    instance,
    known_options,
    whole,
)

# Share of the largest variance that is added to all, because a number that was kept fixed has none,
# and the covariance must be invertible.
_RIDGE = 1e-9


@frozen
class Physical(Shown, Frozen):
    """The nearest physically consistent arm.

    Attributes
    ----------
    arm : Arm
    bodies : tuple of Body
        One of the sets of bodies that have these f, which does not determine them all.
    distance : float
        From the identified f, in standard deviations (root of chi squared); with p numbers, up to
        about sqrt(p) + 2 is noise, and far more shows that the rig or the boxes are wrong.
    """

    arm: Arm
    bodies: tuple[Body, ...]
    distance: float

    def _short(self) -> str:
        bodies = f"{len(self.bodies)} bodies"
        return f"{bodies}, {self.distance:.3g} standard deviations from what was found"

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
def nearest_physical(found: Estimate, boxes: ArrayLike, *, points: int = 5) -> Physical:
    """The arm nearest to an identified one whose links are bodies within boxes.

    Parameters
    ----------
    found : Identification or TorqueFit
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
    >>> arm = puma560.literature_arm(1.5)
    >>> record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference())
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> boxes = [((-0.6, 0.6), (-0.6, 0.6), (-0.3, 0.3))] * 2
    >>> near = nearest_physical(found, boxes, points=3)
    >>> print([body.mass > 0 for body in near.bodies])
    [True, True]
    """
    instance("found", found, Estimate, "Pass what identify or fit_torque gave.")
    dynamics = found.arm.dynamics
    n = found.arm.n
    boxes = array(
        "boxes", boxes, (n, 3, 2), advice="Give (low, high) of x, y and z for each link [m]."
    )
    for label, box in zip(dynamics.chain.joint_labels, boxes, strict=True):
        # Equal ends are allowed: a link can be a plate or a rod.
        if (box[:, 0] > box[:, 1]).any():
            raise ValueError(
                f"boxes must have low <= high in x, y and z; that of {label} is reversed. Swap its"
                " ends."
            )
    whole("points", points, "The default is 5.", least=2)
    # In whitened numbers, least squares counts standard deviations.
    whiten = whitening(found)

    # 1. Non-negative least squares in point masses. Every motor has some inertia at least.
    grid = PointMasses.in_boxes(dynamics, boxes, points)
    lowest = LEAST_MOTOR_INERTIA * found.rig.drive.reflected_inertia()
    system = np.column_stack([grid.columns, grid.rotors])
    amounts, distance = nearest_amounts(whiten, system, found.f - grid.rotors @ lowest)

    # 2. The masses of each link as one body.
    inertias = amounts[len(grid.links) :] + lowest
    bodies = []
    for link in range(n):
        masses = [
            Body(mass=float(mass), com=point)
            for mass, i, point in zip(amounts, grid.links, grid.places, strict=False)
            if i == link and mass > 0
        ]
        body = functools.reduce(Body.joined, masses, Body(mass=0.0, com=(0, 0, 0)))
        bodies.append(dataclasses.replace(body, rotor=float(inertias[link])))
    arm = dynamics.arm(dynamics.f(tuple(bodies)))
    return Physical(arm=arm, bodies=tuple(bodies), distance=distance)


def whitening(estimate: Estimate) -> Floats:
    """W with W C W' = 1, C the covariance of f; an error without one."""
    covariance = estimate.covariance_of(estimate.arm.dynamics.names)
    ridge = _RIDGE * np.diag(covariance).max() * np.eye(len(covariance))
    return np.linalg.inv(np.linalg.cholesky(covariance + ridge))
