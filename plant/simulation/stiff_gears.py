"""Gears that are too stiff for a sub-step to follow their vibration."""

import math

import numpy as np
from numpy.typing import NDArray

from plant.machine.rig import Rig
from plant.machine.spring import FOLLOWED, reduced
from plant.mechanics.arm import Arm
from plant.parts.user_warning import warn

_MANY = 100
"""Steps per sample above which none are advised."""


def warn_of_stiff_gears(arm: Arm, rig: Rig, pose: NDArray[np.float64], steps_per_sample: int) -> None:
    """Warn of gears whose vibration at a pose, motor against link, is wrong by more than 1 % in its frequency."""
    drive = rig.drive
    if drive.elasticity is None:
        return
    motors = drive.reflected_inertia()
    links = np.diag(drive.coupling.shaft_inertia(arm.D(pose))) - motors
    h = rig.period / steps_per_sample
    squared = drive.elasticity.stiffness / reduced(motors, np.where(links > 0, links, np.inf))
    joint = int(np.argmax(squared))
    if h * h * squared[joint] <= FOLLOWED:
        return
    hz, most = (math.sqrt(each) / (2 * math.pi) for each in (squared[joint], FOLLOWED / (h * h)))
    steps = math.ceil(steps_per_sample * hz / most)
    more = f"Take steps_per_sample={steps}, or leave" if steps <= _MANY else "Leave"
    warn(
        f"the gear of {arm.dynamics.chain.joint_labels[joint]} vibrates at {hz:.4g} Hz, motor against link; sub-steps "
        f"of {1e3 * h:.3g} ms follow {most:.4g} Hz to 1 %. {more} elasticity out: such a gear is as good as rigid."
    )
