"""What a model file says of a first experiment: the arm, and limits of its motion."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import Arm, Chain, Dynamics, Rig
from plant.parts.arguments import array
from plant.parts.fields import Floats

_SHARE, _AROUND, _NARROW = 0.9, np.pi / 2, 0.1
"""Share of the way to a limit, and of a limit of speed; [rad] to either side of joints without limits; near a pose."""


def experiment_of(given: Any, rig: Rig) -> tuple[Any, Rig]:
    """The arm of a chain with bodies, with the drive's rotors where it has none, and the rig within its efforts.

    Anything else as it is.
    """
    if not isinstance(given, Chain):
        return given, rig
    rig.require_fit(given)
    rotors = any(body.rotor for body in given.bodies)
    dynamics = Dynamics.from_chain(given if rotors else given.with_rotors(rig.drive))
    if given.limits is not None:
        rig = dataclasses.replace(rig, drive=rig.drive.limited_to(given.limits.effort))
    return dynamics.arm(dynamics.f()), rig


def motion_limits(
    arm: Arm, period: float, harmonics: int, position: ArrayLike | None, velocity: ArrayLike | None,
    acceleration: ArrayLike | None, narrow: bool = False,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Limits as given; else those of the chain, and as fast as the harmonics can go within them."""
    chain, fastest, advice = arm.dynamics.chain, 2 * np.pi * harmonics / period, "Give one per joint."
    lower, upper, speed = np.full(arm.n, -np.inf), np.full(arm.n, np.inf), np.full(arm.n, np.inf)
    if chain.limits is not None:
        lower, upper, speed = chain.limits.lower, chain.limits.upper, chain.limits.velocity
    position = _within(chain, lower, upper, _NARROW if narrow else 1.0) if position is None else position
    position = array("position", position, (arm.n, 2), advice="Give the lowest and highest angle of each joint.")
    own = np.minimum(_SHARE * speed, fastest * np.diff(position, axis=1).ravel() / 2)
    velocity = array("velocity", own if velocity is None else velocity, (arm.n,), advice=advice)
    acceleration = fastest * velocity if acceleration is None else acceleration
    acceleration = array("acceleration", acceleration, (arm.n,), advice=advice)
    if not (position[:, 0] < position[:, 1]).all() or not (velocity > 0).all() or not (acceleration > 0).all():
        raise ValueError(
            "position must be (low, high) with low < high, speeds and accelerations positive. Correct them."
        )
    return position, velocity, acceleration


def _within(chain: Chain, lower: Floats, upper: Floats, part: float) -> Floats:
    """Positions (n, 2) that leave a share of the way to the limits free; of a joint without, a right angle around 0."""
    endless = upper - lower >= 2 * np.pi
    for i in np.flatnonzero(~np.isfinite(upper - lower)):
        if chain.links[i].prismatic:
            raise ValueError(f"position must be given: {chain.joint_labels[i]} slides without limits. Give (n, 2).")
    lower, upper = np.where(endless, -_AROUND, lower), np.where(endless, _AROUND, upper)
    middle, half = (lower + upper) / 2, part * _SHARE * (upper - lower) / 2
    return np.column_stack([middle - half, middle + half])
