"""Torque of a motion point by point, and an arm of one joint, for the tests of what a motion
demands.
"""

import dataclasses

import numpy as np
from packaged_arms import planar

from plant import Dynamics, puma560


def joint_torque(arm, rig, motion):
    """Inverse dynamics and friction, point by point."""
    rigid = np.array([arm.inverse(*row) for row in zip(*motion, strict=True)])
    return rigid + rig.drive.friction(motion.qd)


def one_joint(limit=10.0, viscous=0.0, coulomb=0.0):
    """An arm of one joint without gravity, its inertia, and a rig whose amplifier gives so much
    joint torque.
    """
    dynamics = Dynamics.from_chain(dataclasses.replace(planar(1), gravity=(0.0, 0.0, 0.0)))
    arm, rig = dynamics.arm(dynamics.f()), puma560.rig()
    drive = type(rig.drive)(
        gear=(-50.0,),
        motor_inertia=(2e-5,),
        viscous=(viscous / 50**2,),
        coulomb=(coulomb / 50,),
        motor_gain=(0.2,),
        current_limit=(limit / 50 / 0.2,),
    )
    rig = dataclasses.replace(rig, drive=drive, encoder=type(rig.encoder)(resolution=(1000,)))
    return arm, arm.D([0.0])[0, 0], rig
