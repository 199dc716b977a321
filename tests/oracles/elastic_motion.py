"""A motion of links on elastic gears, worked out backwards: links first, then what winds up each gear, then motors."""

import dataclasses

import casadi as ca
import numpy as np

from plant import Coupling, Drive, Dynamics, Elasticity, Encoder, Harmonics, LoggedTorque, Record, Rig
from plant.robots.catalogue import planar

PERIOD = 1e-3
WRIST = Coupling(matrix=((1, 0, 0), (0.4, 1, 0), (0, -0.7, 1)))
STIFFNESS, DAMPING = np.array([8e3, 3e3, 600.0]), np.array([8.0, 3.0, 0.5])


def rig_of(period=PERIOD):
    drive = Drive(
        gear=(80.0, -60.0, 50.0), motor_inertia=(2e-4,) * 3, viscous=(1e-3, 2e-3, 1e-3), coulomb=(0,) * 3,
        motor_gain=(0.2,) * 3, current_limit=(50.0,) * 3, coupling=WRIST,
        elasticity=Elasticity(stiffness=STIFFNESS, damping=DAMPING),
    )  # fmt: skip
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,) * 3, smooth=True), period=period)


def experiment(seconds=8.0, fine=6):
    """Dynamics, record (with what both sensors see, unrounded) and f of a coupled planar arm.

    The links move along sums of harmonics. Derivatives of deflections are differences on a grid `fine` times finer than
    the log. Torques are those amid two samples, as they are held.
    """
    rig, chain = rig_of(), planar(3).coupled(WRIST)
    rotors = rig.drive.reflected_inertia()
    bodies = [dataclasses.replace(body, rotor=float(j)) for body, j in zip(chain.bodies, rotors, strict=True)]
    dynamics = Dynamics.from_chain(chain)
    arm = dynamics.arm(dynamics.f(bodies))
    path = Harmonics(
        period=2.0, offset=(0.3, -0.2, 0.1),
        cosine=((-0.5, -0.1, 0.2, 0.1), (0.4, -0.5, 0.1, -0.1), (0.3, 0.4, -0.6, 0.1)),
        sine=((0.3, 0.2, -0.3, 0.1), (-0.4, 0.3, 0.2, 0.1), (0.5, -0.2, 0.3, -0.1)),
    )  # fmt: skip
    h = PERIOD / fine
    t = np.arange(0, seconds, h)
    links = path(t)
    q, qd, qdd = (ca.SX.sym(name, 3) for name in ("q", "qd", "qdd"))
    inverse = ca.Function("inverse", [q, qd, qdd], [dynamics.Y(q, qd, qdd) @ ca.DM(arm.f)])
    on_links = inverse.map(len(t))(*(x.T for x in links)).full().T
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
        t=t[rows], error_pulses=-counts, torque=total[fine // 2 :: fine], rig=rig, law=LoggedTorque(),
        link_counts=rig.position_in_pulses(links.q[rows]),
    )  # fmt: skip
    return dynamics, record, arm.f
