"""A load in the hand of a known arm: one number, found from a log of its own."""

from __future__ import annotations

import dataclasses

import numpy as np

from identification.replay.gauss_newton import gauss_newton
from identification.replay.prediction import Prediction
from plant import Arm, Body, Record
from plant.parts.arguments import array, instance, known_options

__all__ = ["Load", "find_load"]

_STEP = 0.01
"""Of the derivatives [kg]."""

_HEAVIEST = 1e3
"""[kg]"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Load:
    """A point mass on the last link, or another one.

    Attributes
    ----------
    mass, std : float
        [kg]
    arm : Arm
        The known arm with this load.
    scatter : float
        Root mean square surprise [pulses]; rounding alone gives 0.289.
    """

    mass: float
    std: float
    arm: Arm
    scatter: float


@known_options
def find_load(arm, record, position, *, link=-1, steps_per_sample=4):
    """The mass of a load at a known place, with all else known.

    Parameters
    ----------
    arm : Arm
        Without the load, such as ``found.arm``.
    record : Record
        Made with the load, under P control.
    position : (3,) array_like
        Of the load in the frame of the link's body [m].
    link : int
        Place of the link in the chain.
    steps_per_sample : int

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Bad input, or a load that cannot be told (a log that does not move it).
    """
    instance("arm", arm, Arm, "The order is arm, record, position.")
    instance("record", record, Record, "The order is arm, record, position.")
    position = array("position", position, (3,), advice="Give x, y and z in the frame of the link's body [m].")
    dynamics = arm.dynamics
    bodies = [Body(mass=0.0, com=(0, 0, 0)) for _ in range(arm.n)]
    bodies[link] = Body(mass=1.0, com=position)
    follow = _WithLoad(Prediction(dynamics, record, steps_per_sample=steps_per_sample), arm.f, dynamics.f(bodies))
    prediction = follow.prediction
    bounds = np.vstack([(-_HEAVIEST, _HEAVIEST), prediction.nuisance_bounds])
    start, steps = np.append(0.0, prediction.nuisances), np.append(_STEP, prediction.nuisance_steps)
    fit = gauss_newton(follow, start, steps, bounds)
    mass = float(fit.values[0])
    loaded = dynamics.arm(arm.f + mass * follow.direction)
    return Load(mass=mass, std=float(np.sqrt(fit.covariance[0, 0])), arm=loaded, scatter=fit.scatter)


class _WithLoad:
    """A prediction whose unknowns are a mass and the shares of correction."""

    def __init__(self, prediction, f, direction):
        self.prediction, self.f, self.direction = prediction, f, direction
        self.unknown = ("load", *prediction.unknown[len(f) :])
        self.weights, self.scales = prediction.weights, prediction.scales

    def _whole(self, values):
        return np.append(self.f + values[0] * self.direction, values[1:])

    def surprises(self, values):
        return self.prediction.surprises(self._whole(values))

    def all_surprises(self, many):
        return self.prediction.all_surprises([self._whole(values) for values in many])
