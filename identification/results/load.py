"""The mass of a load on a known arm, from a log of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.replay.gauss_newton import gauss_newton
from identification.replay.prediction import Prediction
from plant import Arm, Body, Record
from plant.parts.arguments import array, instance, known_options
from plant.parts.frozen import Frozen

__all__ = ["Load", "find_load"]

_STEP = 0.01
"""Of the central differences [kg]."""

_HEAVIEST = 1e3
"""[kg]"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Load(Frozen):
    """A point mass on the last link, or another one.

    Attributes
    ----------
    mass, std : float
        [kg]
    arm : Arm
        The known arm with this load.
    rms_innovation : float
        Root mean square of the innovations [pulses]; rounding alone gives 0.289.
    """

    mass: float
    std: float
    arm: Arm
    rms_innovation: float


@known_options
def find_load(
    arm: Arm, record: Record, position: ArrayLike, *, link: int | str = -1, steps_per_sample: int = 4
) -> Load:
    """The mass of a load at a known place, with all else known.

    Parameters
    ----------
    arm : Arm
        Without the load, such as ``found.arm``.
    record : Record
        Made with the load, under P control.
    position : (3,) array_like
        Of the load in the frame of the link's body [m].
    link : int or str
        Place of the link in the chain, or its name.
    steps_per_sample : int

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Bad input, or a load that is not identifiable (a log that does not move it).
    """
    instance("arm", arm, Arm, "The order is arm, record, position.")
    instance("record", record, Record, "The order is arm, record, position.")
    position = array("position", position, (3,), advice="Give x, y and z in the frame of the link's body [m].")
    dynamics = arm.dynamics
    empty = dataclasses.replace(dynamics.chain, bodies=(Body(mass=0.0, com=(0, 0, 0)),) * arm.n)
    per_kg = dynamics.f(empty.carrying(Body(mass=1.0, com=position), link).bodies)
    prediction = Prediction(dynamics, record, steps_per_sample=steps_per_sample)
    bounds = np.vstack([(-_HEAVIEST, _HEAVIEST), prediction.nuisance_bounds])
    start, steps = np.append(0.0, prediction.nuisances), np.append(_STEP, prediction.nuisance_steps)
    fit = gauss_newton(_WithLoad(prediction, arm.f, per_kg), start, steps, bounds)
    mass = float(fit.values[0])
    loaded, std = dynamics.arm(arm.f + mass * per_kg), float(np.sqrt(fit.covariance[0, 0]))
    return Load(mass=mass, std=std, arm=loaded, rms_innovation=fit.rms_innovation)


class _WithLoad:
    """A prediction whose unknowns are a mass and the observer gains."""

    def __init__(self, prediction: Prediction, f: NDArray[np.float64], per_kg: NDArray[np.float64]) -> None:
        self.prediction, self.f, self.per_kg = prediction, f, per_kg
        self.unknown = ("load", *prediction.unknown[len(f) :])
        self.weights, self.scales = prediction.weights, prediction.scales

    def _whole(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.append(self.f + values[0] * self.per_kg, values[1:])

    def innovations(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.prediction.innovations(self._whole(values))

    def lost(self, values: NDArray[np.float64]) -> str:
        return self.prediction.lost(self._whole(values))

    def all_innovations(self, many: Iterable[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        return self.prediction.all_innovations([self._whole(values) for values in many])
