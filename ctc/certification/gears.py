"""What gears and drives do that a rigid rig leaves out, drawn for each plant: resonance, damping, imperfections.

A resonance is stated as a range in which it lies, not as a distribution: somewhere in it is the one that the arm has.
The plants are spread over it, and what is said of them holds for the worst part of it (`ctc.certification.cells`).
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.certification.imperfections import Drawn, drawn_of, placed_in
from ctc.certification.uncertainty import Uncertainty
from plant import Arm, Elasticity, Rig
from plant.machine.elasticity import gears
from plant.machine.motor_inertia import shaft_inertias
from plant.parts.sums import product


def require_possible(uncertainty: Uncertainty, rig: Rig) -> None:
    """Refuse what this rig cannot have, before anything is fitted or drawn.

    Raises
    ------
    ValueError
    """
    if uncertainty.resonance is not None:
        if len(uncertainty.resonance) not in (1, rig.n):
            raise ValueError(
                f"resonance must be one pair, or {rig.n}; got {len(uncertainty.resonance)}. Give (low, high)."
            )
        some = Elasticity(stiffness=np.ones(rig.n), damping=np.zeros(rig.n))
        rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=some))
    for ends in zip(*uncertainty.imperfections.values(), strict=True):
        placed_in(rig, {name: (0.0, end) for name, end in zip(uncertainty.imperfections, ends, strict=True)})


def prepared(uncertainty: Uncertainty, arm: Arm, rig: Rig, pose: ArrayLike) -> Rig:
    """The rig with a place for each number that is drawn; elastic gears in the middle of their range."""
    drive = rig.drive
    if uncertainty.resonance is not None:
        middle = np.sqrt(np.prod(uncertainty.resonance, axis=1))
        elasticity = Elasticity.from_resonance(arm, middle, np.mean(uncertainty.damping_ratio), drive=drive, q=pose)
        rig = dataclasses.replace(rig, drive=dataclasses.replace(drive, elasticity=elasticity))
    return placed_in(rig, uncertainty.imperfections)


def places_of(uncertainty: Uncertainty, random: Any, count: int) -> NDArray[np.float64]:
    """Where in their ranges resonances and damping ratio of each plant are (P, m + 1), from 0 to 1."""
    return random.uniform(0, 1, (count, 1 + len(uncertainty.resonance or ())))


def draw_gears(
    uncertainty: Uncertainty, random: Any, arm: Arm, rig: Rig, f: NDArray[np.float64], pose: ArrayLike,
    places: NDArray[np.float64],
) -> Drawn:  # fmt: skip
    """What gears and drives do of arms with these f (P, p), at these `places_of`, on a rig that is `prepared`."""
    count, n = len(f), rig.n
    others = drawn_of(uncertainty.imperfections, random, count, n)
    if uncertainty.resonance is None:
        return others
    low, high = np.log(uncertainty.resonance).T
    hz = np.exp(low + places[:, :-1] * (high - low))
    ratio = uncertainty.damping_ratio[0] + places[:, -1:] * np.ptp(uncertainty.damping_ratio)
    links = product(f, shaft_inertias(arm.dynamics, rig, pose)) - rig.drive.reflected_inertia()
    found = gears(np.broadcast_to(hz, (count, n)), ratio, links)
    names = ["resonance"] if len(low) == 1 else [f"resonance[{i}]" for i in range(n)]
    own = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(n)]
    return Drawn(
        names=(*names, "damping_ratio", *others.names), values=np.hstack([hz, ratio, others.values]),
        derived_names=(*own, *others.derived_names), derived=np.hstack([*found, others.derived]),
    )  # fmt: skip
