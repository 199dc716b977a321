"""Inertias that were found, against those of the stated rotors."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.machine.motor_inertia import shaft_inertias
from plant.mechanics.lumping import STANDARD

_SURE, _ROOM = 4.0, 0.05
"""By how many standard deviations, and by what share of itself, an inertia has to fall below that of its rotor."""

_OTHER = 0.2
"""Share of a rotor's inertia by which the one found may differ: what turns with it in the gear is seldom stated."""


def of_rotors(found: Any) -> Iterator[str]:
    """A line for each joint whose rotor, as stated, the inertias found contradict.

    D at the motors' shafts is at least diag(Jm k^2), whatever the links are: the rotor turns with its joint. Where a
    base parameter is the inertia of one rotor and nothing else, it is the stated one.
    """
    rig, dynamics, f = found.rig, found.arm.dynamics, found.f
    rows = shaft_inertias(dynamics, rig, found.records[0].rig.to_angle(found.records[0].counts[0]))
    inertia, rotors, alone = f @ rows, rig.drive.reflected_inertia(), _alone(dynamics)
    covariance = np.zeros((len(f), len(f)))
    if found.covariance is not None:
        own = [i for i, name in enumerate(found.fit.unknown) if name in dynamics.names]
        places = [dynamics.names.index(found.fit.unknown[i]) for i in own]
        covariance[np.ix_(places, places)] = found.covariance[np.ix_(own, own)]
    std = np.sqrt(np.einsum("ki,kl,li->i", rows, covariance, rows))
    for i, label in enumerate(dynamics.chain.joint_labels):
        unit = "kg" if dynamics.chain.links[i].prismatic else "kg m^2"
        stated = f"Jm k^2 = {rotors[i]:.3g} {unit}"
        if inertia[i] + _SURE * std[i] + _ROOM * rotors[i] < rotors[i]:
            yield (
                f"the inertia of {label}, {inertia[i]:.3g} {unit}, is below that of its rotor as stated, {stated}: "
                "check motor_inertia and gear."
            )
        elif i in alone and dynamics.names[alone[i]] in found.fit.unknown:
            name, value, own_std = dynamics.names[alone[i]], f[alone[i]], np.sqrt(covariance[alone[i], alone[i]])
            if abs(value - rotors[i]) > _SURE * own_std + _OTHER * rotors[i] > 0:
                yield (
                    f"the rotor of {label} is not as stated: {name} is {value:.3g} {unit}, {stated}. The law has what "
                    "was found; what is said of gears that give has what is stated. Check motor_inertia and gear."
                )


def _alone(dynamics: Any) -> dict[int, int]:
    """Link -> place of the parameter that is the inertia of its rotor and nothing else."""
    rows = [(k, np.flatnonzero(row)) for k, row in enumerate(np.array(dynamics.lumping.matrix))]
    single = [(k, *divmod(int(places[0]), len(STANDARD))) for k, places in rows if len(places) == 1]
    return {link: k for k, link, kind in single if STANDARD[kind] == "J"}
