"""A load as physics: mass, centre of mass and inertia, and the increments of f that they are.

A load is a body fixed to a link. Its ten standard parameters enter f linearly: f = f of the empty arm + B phi, for any
chain and any lumping. B is read off `Dynamics.f`, with point masses as probes; no equation is written a second time.
"""

import dataclasses
import functools
import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.mechanics.body import Body, parallel_axis
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.lumping import STANDARD, standard_parameters
from plant.parts.arguments import array, instance

LOAD = STANDARD[:-1]
"""Names of phi, a load's standard parameters: mass [kg], first moments [kg m], and inertia about the *origin* of the
frame of the link's body [kg m^2]."""


def load_parameters(body: Body) -> NDArray[np.float64]:
    """Standard parameters phi (10,) of a load, in the order of `LOAD`.

    Parameters
    ----------
    body : Body
        In the frame of the link's own body, as for `Chain.carrying`; its rotor does not count.

    Returns
    -------
    (10,) numpy.ndarray
        [kg, kg m, kg m^2]

    See Also
    --------
    plant.load_matrix

    Examples
    --------
    >>> from plant import Body, load_parameters
    >>> load_parameters(Body(mass=2, com=(0.1, 0, 0))).round(3)[:4]
    array([2. , 0.2, 0. , 0. ])
    """
    instance("body", body, Body, "Give mass and com; a point mass needs no inertia.")
    return standard_parameters([body])[: len(LOAD)]


def load_body(parameters: ArrayLike) -> Body:
    """The load with these standard parameters phi (10,): the way back from `load_parameters`."""
    phi = array("parameters", parameters, (len(LOAD),), advice="Give m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz.")
    mass = float(phi[0])
    if not mass > 0 and phi.any():
        raise ValueError(f"a load must have a positive mass; got {mass:g} kg. Only an empty gripper has none.")
    com = phi[1:4] / mass if mass > 0 else np.zeros(3)
    return Body(mass=mass, com=com, inertia=phi[4:] - mass * parallel_axis(com))


def load_matrix(dynamics: Dynamics, link: int | str = -1) -> NDArray[np.float64]:
    """Increments of f by a load on a link: f = f of the empty arm + B phi.

    Parameters
    ----------
    dynamics : Dynamics
        Of any chain.
    link : int or str
        Place in the chain from 0, or name; by default the last.

    Returns
    -------
    B : (p, 10) numpy.ndarray
        A row per f, a column per `LOAD`.

    Raises
    ------
    ValueError
        A link that the chain does not have.

    See Also
    --------
    plant.load_parameters, identification.find_load

    Examples
    --------
    >>> from plant import load_matrix, puma560
    >>> load_matrix(puma560.dynamics()).shape
    (9, 10)
    """
    instance("dynamics", dynamics, Dynamics, "Pass arm.dynamics.")
    return _matrix(dynamics, link).copy()


@functools.lru_cache(maxsize=32)
def _matrix(dynamics: Dynamics, link: int | str) -> NDArray[np.float64]:
    """B, from point masses at ten places whose standard parameters are independent."""
    empty = dataclasses.replace(dynamics.chain, bodies=(Body(mass=0.0, com=(0, 0, 0)),) * dynamics.n)
    places = [np.zeros(3), *np.eye(3), *-np.eye(3)]
    places += [a + b for a, b in itertools.combinations(np.eye(3), 2)]
    probes = [Body(mass=1.0, com=place) for place in places]
    increments = np.array([dynamics.f(empty.carrying(probe, link).bodies) for probe in probes])
    matrix = np.linalg.solve(np.array([load_parameters(probe) for probe in probes]), increments).T
    matrix[np.abs(matrix) < 1e-13 * np.abs(matrix).max()] = 0.0  # rounding
    return matrix
