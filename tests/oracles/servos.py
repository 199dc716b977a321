"""A small arm on hobby servos: two joints, counts on the output, the torque the servo's own."""

import numpy as np

from plant import Body, Chain, Drive, Dynamics, Encoder, Link, PositionServo, Rig

__all__ = ["GAIN", "VISCOUS", "arm", "dynamics", "rig"]

# Of an STS3215 at 7.4 V with P = 32: motor torque per count [N m], back-EMF with friction.
GAIN, VISCOUS = 0.0273, 0.608


def dynamics(gravity=(0, 0, -9.81)):
    rotor = 0.0284
    bodies = [
        Body(mass=0.2, com=(0.09, 0, 0), inertia=(0, 0, 0, 1e-4, 0, 1e-4), rotor=rotor),
        Body(mass=0.2, com=(0.07, 0, 0), inertia=(0, 0, 0, 1e-4, 0, 1e-4), rotor=rotor),
    ]
    links = (Link(name="lift", alpha=np.pi / 2), Link(name="elbow", a=0.12))
    return Dynamics.from_chain(Chain(links=links, bodies=bodies, gravity=gravity))


def arm():
    equations = dynamics()
    return equations.arm(equations.f())


def rig(period=0.01, inner="servo", *, coulomb=0.052, viscous=VISCOUS, **fields):
    """The rig; `inner` is a servo by default."""
    drive = Drive(
        gear=(1, 1),
        motor_inertia=0.0284,
        viscous=viscous,
        coulomb=coulomb,
        motor_gain=1.0,
        current_limit=3.35,
        joints=("lift", "elbow"),
    )
    inner = PositionServo(gain=GAIN) if inner == "servo" else inner
    return Rig(drive=drive, encoder=Encoder(resolution=4096), period=period, inner=inner, **fields)
