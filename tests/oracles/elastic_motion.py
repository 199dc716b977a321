"""A motion of links on elastic gears, worked out backwards: links first, then what winds up each
gear, then motors.
"""

import dataclasses

import casadi as ca
import numpy as np
from coupled_arm import PERIOD, WRIST, arm_of, path_of, rig_of

from plant import Elasticity, LoggedTorque, Record

STIFFNESS, DAMPING = np.array([8e3, 3e3, 600.0]), np.array([8.0, 3.0, 0.5])


def experiment(seconds=8.0, fine=6, springs=None):
    """Dynamics, record (with what both sensors see, unrounded) and f of a coupled planar arm.

    The links move along sums of harmonics. Derivatives of deflections are differences on a grid
    `fine` times finer than the log. Torques are those amid two samples, as they are held. `springs`
    are a `JointSpring` without preload.
    """
    gears = Elasticity(stiffness=STIFFNESS, damping=DAMPING)
    rig = rig_of(smooth=True, coulomb=(0,) * 3, current_limit=(50.0,) * 3, elasticity=gears)
    rig = dataclasses.replace(rig, springs=springs)
    arm, path, rotors = arm_of(rig), path_of(2.0), rig.drive.reflected_inertia()
    dynamics = arm.dynamics
    h = PERIOD / fine
    t = np.arange(0, seconds, h)
    links = path(t)
    q, qd, qdd = (ca.SX.sym(name, 3) for name in ("q", "qd", "qdd"))
    inverse = ca.Function("inverse", [q, qd, qdd], [dynamics.Y(q, qd, qdd) @ ca.DM(arm.f)])
    on_links = inverse.map(len(t))(*(x.T for x in links)).full().T
    if springs is not None:
        on_links = on_links + springs.stiffness * (links.q - springs.angle)
    C = np.array(WRIST.matrix)
    to_shaft, to_joint = np.linalg.inv(C), C  # torques: C^-T tau; written for rows
    passed = (on_links - (rotors * (links.qdd @ C.T)) @ to_joint) @ to_shaft
    wound = passed / STIFFNESS
    for _ in range(3):  # k d + c d' = passed
        wound = (passed - DAMPING * np.gradient(wound, h, axis=0)) / STIFFNESS
    motor_q = links.q + wound @ np.linalg.inv(C).T
    qd = np.gradient(motor_q, h, axis=0)
    qdd = np.gradient(qd, h, axis=0)
    drive = rig.drive
    shaft = passed + rotors * (qdd @ C.T)
    total = shaft @ to_joint + drive.friction(qd)
    rows = slice(0, None, fine)
    counts = rig.position_in_pulses(motor_q[rows])
    record = Record(
        t=t[rows],
        error_pulses=-counts,
        torque=total[fine // 2 :: fine],
        rig=rig,
        law=LoggedTorque(),
        link_counts=rig.position_in_pulses(links.q[rows]),
    )
    return dynamics, record, arm.f
