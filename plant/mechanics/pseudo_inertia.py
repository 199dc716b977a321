"""Pseudo-inertia: mass, first moments and second moments of a body as one symmetric matrix (4, 4).

P = [[S, m c], [m c', m]] with S the integral of r r' dm. A body of positive density exists exactly where P is positive
definite: positive mass, a positive inertia about the centre of mass, and the triangle inequality in one.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, Linear matrix inequalities for physically consistent inertial parameter
identification, IEEE Robotics and Automation Letters 3 (2018).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

_UPPER = np.triu_indices(3)


def pseudo_inertia(parameters: ArrayLike) -> NDArray[np.float64]:
    """Pseudo-inertia (4, 4) of a body's standard parameters (10,): m, m c, inertia about the *origin* of the frame."""
    m, *rest = np.asarray(parameters, float)
    inertia, result = np.zeros((3, 3)), np.zeros((4, 4))
    inertia[_UPPER] = rest[3:]
    inertia += np.triu(inertia, 1).T
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = rest[:3]
    result[3, 3] = m
    return result


def from_pseudo_inertia(P: ArrayLike) -> NDArray[np.float64]:
    """Standard parameters (10,) of a pseudo-inertia; the way back from `pseudo_inertia`."""
    P = np.asarray(P, float)
    moments = P[:3, :3]
    inertia = np.trace(moments) * np.eye(3) - moments
    return np.concatenate([[P[3, 3]], P[:3, 3], inertia[_UPPER]])
