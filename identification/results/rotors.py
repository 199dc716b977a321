"""Inertias that were found below those of the stated rotors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.machine.motor_inertia import shaft_inertias

__all__ = ["lighter_than_rotors"]

_SURE, _ROOM = 4.0, 0.05
"""By how many standard deviations, and by what share of itself, an inertia has to fall below that of its rotor."""


def lighter_than_rotors(found: Any) -> Iterator[str]:
    """A line for each joint whose inertia, at the first position of the log, is below its stated rotor's alone.

    D at the motors' shafts is at least diag(Jm k^2), whatever the links are: the rotor turns with its joint.
    """
    rig, dynamics = found.rig, found.arm.dynamics
    rows = shaft_inertias(dynamics, rig, found.records[0].rig.to_angle(found.records[0].counts[0]))
    inertia, rotors, std = found.f @ rows, rig.drive.reflected_inertia(), np.zeros(rig.n)
    if found.covariance is not None:
        own = [i for i, name in enumerate(found.unknown) if name in dynamics.names]
        slopes = rows[[dynamics.names.index(found.unknown[i]) for i in own]]
        std = np.sqrt(np.einsum("ki,kl,li->i", slopes, found.covariance[np.ix_(own, own)], slopes))
    for i, label in enumerate(dynamics.chain.joint_labels):
        if inertia[i] + _SURE * std[i] + _ROOM * rotors[i] < rotors[i]:
            unit = "kg" if dynamics.chain.links[i].prismatic else "kg m^2"
            yield (
                f"the inertia of {label}, {inertia[i]:.3g} {unit}, is below that of its rotor as stated, Jm k^2 = "
                f"{rotors[i]:.3g} {unit}: check motor_inertia and gear."
            )
