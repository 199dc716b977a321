"""What is unknown of a load: its mass, and where its centre is known or somewhere along a line."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import ArrayLike

from plant import Arm, Body
from plant.mechanics.lumping import LOAD, STANDARD
from plant.parts.arguments import array, real
from plant.parts.fields import Floats

_PLACES = 61  # along the line where the centre may be


@dataclasses.dataclass(frozen=True)
class LoadShape:
    """Loads of any mass in a range whose centre is at a known place, or along a line.

    `mass` (2,): lowest and highest [kg]. `places` (K, 3): where the centre may be, in the frame of the last link's body
    [m]; one where it is known. `inertia` (6,): own inertia about the centre, per kg [m^2]; zero for a point mass.
    """

    mass: Floats
    places: Floats
    inertia: Floats

    @classmethod
    def of(
        cls, arm: Arm, mass: ArrayLike, position: ArrayLike | None, along: ArrayLike | None, reach: ArrayLike,
        inertia: ArrayLike,
    ) -> LoadShape:  # fmt: skip
        """From what a user states.

        Raises a ValueError: a range that is none; an inertia that no body has; a line without direction.
        """
        limits = array("mass", mass, (2,), advice="Give the lightest and the heaviest load, such as (0, 5) [kg].")
        if not 0 <= limits[0] < limits[1]:
            raise ValueError(f"mass must be a range from 0 or more upwards; got {mass!r}. Give kg, such as (0, 5).")
        own = array("inertia", inertia, (6,), advice="Give Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre, per kg.")
        if own.any():
            Body(mass=1.0, com=np.zeros(3), inertia=own).require_physical("of the load")
        if position is not None:
            if along is not None:
                raise ValueError("a load has a known position, or one along a line; got both. Leave one out.")
            place = array("position", position, (3,), advice="Give x, y, z in the frame of the last link's body [m].")
            return cls(limits, place[None], own)
        ends = array("reach", reach, (2,), advice="Give the shortest and the longest distance, such as (0.2, 0.5) [m].")
        if not ends[0] < ends[1]:
            raise ValueError(f"reach must be a shorter and a longer distance; got {reach!r}. Give metres.")
        direction = _outwards(arm) if along is None else array("along", along, (3,), advice="Give a direction.")
        length = real("length of along", np.linalg.norm(direction), "Give a direction that is not zero.", positive=True)
        return cls(limits, np.linspace(ends[0], ends[1], _PLACES)[:, None] * direction / length, own)

    @functools.cached_property
    def per_kg(self) -> Floats:
        """Standard parameters (K, 10) of 1 kg at each place."""
        bodies = (Body(mass=1.0, com=place, inertia=self.inertia) for place in self.places)
        return np.array([body.standard_parameters for body in bodies])

    @functools.cached_property
    def basis(self) -> Floats:
        """Standard parameters (b, 10) of which those of all places are combinations: one, or of a parabola three."""
        chosen = [0] if len(self.places) == 1 else [0, len(self.places) // 2, len(self.places) - 1]
        return self.per_kg[chosen]

    @functools.cached_property
    def shares(self) -> Floats:
        """Shares (K, b) of the basis at each place."""
        return np.asarray(np.linalg.lstsq(self.basis.T, self.per_kg.T, rcond=None)[0].T)

    @property
    def prior(self) -> Floats:
        """Standard parameters (10,) of half the heaviest load, in the middle of the places."""
        return self.mass[1] / 2 * self.per_kg[len(self.places) // 2]


def _outwards(arm: Arm) -> Floats:
    """Axis of the last link's frame along which its own centre of mass lies, as far as f says it by itself."""
    matrix = np.array(arm.dynamics.lumping.matrix)
    alone = ~matrix[:, : -len(STANDARD)].any(axis=1)
    increments = arm.dynamics.load_matrix()[alone]
    phi = np.linalg.lstsq(increments, np.array(arm.f)[alone], rcond=None)[0] if alone.any() else np.zeros(len(LOAD))
    moments = np.where(np.abs(increments).sum(axis=0) > 0, phi, 0.0)[1:4]
    if not np.linalg.norm(moments) > 1e-3 * np.abs(arm.f).max():
        raise ValueError(
            "along must be given for this arm: its f does not say by itself where the last link points. Give the "
            "direction in which the load's centre lies, in the frame of the last link's body, such as (0, 0, 1)."
        )
    longest = int(np.argmax(np.abs(moments)))
    return np.asarray(np.sign(moments[longest]) * np.eye(3)[longest])
