"""Physically possible bodies that are nearest to a fit of the torque equation.

A fit of the inertial parameters f may belong to no arm that can exist. Here each link is made of
point masses on a grid within a box: as long as no mass is negative, its mass, centre and inertia
are possible. f is linear in these masses and in the inertias of the motors, so the nearest such f,
in the metric of a covariance, is a problem of non-negative least squares. Friction that is fitted
beside f is non-negative in the same problem.

Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice Hall 1974 (non-negative
least squares).
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.equation_error.bounds import brakes
from identification.equation_error.torque_fit import TorqueFit
from plant import Body, Dynamics, Rig
from plant.machine import LEAST_MOTOR_INERTIA
from plant.mechanics import STANDARD, standard_parameters
from plant.parts import Floats, Integers, frozen_settings


@frozen_settings
class PossibleBodySettings:
    """Boxes of bodies that nobody measured, and a least mass in them; all are chosen by hand.

    Parameters
    ----------
    points : int
        Points of the grid along each edge of a box.
    beside : float
        By how much a box exceeds its link and the two joints of that, as a share of the length of
        the chain.
    least_beside : float
        By how much it does at least [m].
    least : float
        Least mass of a point, as a share of the mean of all points: without it a light link would
        have no inertia about its joint, and the arm no motion.
    """

    points: int = 4
    beside: float = 0.1
    least_beside: float = 0.05
    least: float = 0.01


SETTINGS = PossibleBodySettings()


class PointMasses(NamedTuple):
    """Grid of a chain's boxes: f is `columns` (p, m) times the masses of its points.

    `links` (m,): of each point. `places` (m, 3): in the frame of its link's body [m]. `rotors` (p,
    n): f per rotor inertia.
    """

    links: Integers
    places: Floats
    columns: Floats
    rotors: Floats

    @classmethod
    def in_boxes(cls, dynamics: Dynamics, boxes: Floats, points: int) -> "PointMasses":
        """The grid of boxes (n, 3, 2), so many points along each edge that has a length."""
        width = len(STANDARD)
        matrix = np.array(dynamics.lumping.matrix)
        links = []
        places = []
        columns = []
        for i, (link, box) in enumerate(zip(dynamics.chain.links, boxes, strict=True)):
            # An edge without length has a single point.
            edges = [np.unique(np.linspace(low, high, points)) for low, high in box]
            of_link = matrix[:, width * i : width * (i + 1)]
            for point in itertools.product(*edges):
                mass = Body(mass=1.0, com=point).seen_from(link.frame)
                links.append(i)
                places.append(point)
                columns.append(of_link @ standard_parameters([mass]))
        return cls(
            links=np.array(links),
            places=np.array(places),
            columns=np.array(columns).T,
            rotors=matrix[:, STANDARD.index("J") :: width],
        )


def nearest_amounts(whiten: Floats, system: Floats, target: Floats) -> tuple[Floats, float]:
    """Non-negative amounts (m,) for which system @ amounts is nearest to a target, and how near.

    `system` (k, m), `target` (k,). `whiten` (k, k): makes numbers in whose metric it is nearest.
    """
    from scipy.optimize import nnls

    columns = whiten @ system
    length = np.linalg.norm(columns, axis=0)
    # A point without effect has amount zero; its length must not divide by zero.
    length[length == 0] = 1.0
    amounts, distance = nnls(columns / length, whiten @ target, maxiter=50 * system.shape[1])
    return amounts / length, float(distance)


def boxes_of(dynamics: Dynamics) -> Floats:
    """Boxes (n, 3, 2) of bodies that nobody measured, around each link and its two joints [m]."""
    links = dynamics.chain.links
    ends = [np.array(link.rotation(0.0)[1], float).ravel() for link in links[1:]]
    lengths = [float(np.linalg.norm(end)) for end in ends]
    beside = np.full(len(links), max(SETTINGS.beside * sum(lengths), SETTINGS.least_beside))
    # Of the last link no next joint is known: with its tool it may be as long as any other.
    ends.append(np.zeros(3))
    beside[-1] = max([beside[-1], *lengths])
    boxes = []
    for link, end, margin in zip(links, ends, beside, strict=True):
        # Corners in the frame of the body, whatever its pose on the link.
        corners = np.array([np.zeros(3), end])
        rotation = np.array(link.frame.rotation)
        corners = (corners - np.array(link.frame.position)) @ rotation
        boxes.append(np.column_stack([corners.min(axis=0) - margin, corners.max(axis=0) + margin]))
    return np.array(boxes)


def with_possible_bodies(dynamics: Dynamics, rig: Rig, fit: TorqueFit) -> TorqueFit | None:
    """A fit with the values of the nearest possible bodies, and friction that brakes.

    Nearest in the sum of squares of the fit itself. None where f is partly known.
    """
    if not set(dynamics.names) <= set(fit.names):
        return None
    grid = PointMasses.in_boxes(dynamics, boxes_of(dynamics), SETTINGS.points)
    size = len(fit.names)
    places = [fit.names.index(name) for name in dynamics.names]
    of_f = np.column_stack([grid.columns, grid.rotors])
    others = [i for i in range(size) if i not in places]
    # An unknown of either sign is the difference of two amounts.
    braking = brakes(fit.names)
    signed = [i for i in others if not braking[i]]
    unit = np.eye(size)
    system = np.zeros((size, of_f.shape[1]))
    system[places] = of_f
    system = np.column_stack([system, unit[:, others], -unit[:, signed]])

    # 1. The inverse covariance of white noise is the curvature of the sum of squares: in this
    # metric the nearest values are those with the least residual.
    deviation = np.sqrt(np.diag(fit.noise_covariance))
    correlation = fit.noise_covariance / np.outer(deviation, deviation)
    whiten = np.linalg.inv(np.linalg.cholesky(correlation)) / deviation
    lowest = np.zeros(system.shape[1])
    count = len(grid.links)
    lowest[count : of_f.shape[1]] = LEAST_MOTOR_INERTIA * rig.drive.reflected_inertia()
    amounts, _ = nearest_amounts(whiten, system, fit.values - system @ lowest)

    # 2. Once more with a little mass everywhere: each link then has an inertia about its joint.
    lowest[:count] = SETTINGS.least * amounts[:count].mean()
    amounts, distance = nearest_amounts(whiten, system, fit.values - system @ lowest)
    return replace(
        fit,
        values=system @ (amounts + lowest),
        # That is exact where the residuals of all joints grow by the same ratio.
        relative_error=fit.relative_error * float(np.sqrt(1 + distance**2 / fit.rows)),
    )
