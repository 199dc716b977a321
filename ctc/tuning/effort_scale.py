"""Torque to which the chatter of a joint is compared, so that joints of any size and unit count."""

import numpy as np

from plant import Arm, Reference, Rig
from plant.parts import Floats


def effort_scale(arm: Arm, rig: Rig, motions: dict[str, tuple[Reference, float]]) -> Floats:
    """Root mean square (n,) of each joint's torque along the motions [N m], the unit of chatter.

    A joint that needs no torque there has the limit of its amplifier.
    """
    instants = 200  # a torque that is averaged needs no more of them
    rows = [
        np.array(path(np.linspace(0, duration, instants))).swapaxes(0, 1)
        for path, duration in motions.values()
    ]
    # Springs of the rig carry their part of the load without the motors.
    torque = [arm.inverse(*row) - rig.spring_torque(row[0]) for row in np.concatenate(rows)]
    scale = np.sqrt(np.mean(np.square(torque), axis=0))
    return np.where(scale > 0, scale, rig.drive.torque_limit())
