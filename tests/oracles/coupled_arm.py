"""A planar arm of three joints with a coupled wrist: its drive, the arm whose rotors are those
of a rig, a motion.
"""

import dataclasses

from packaged_arms import planar

from plant import Coupling, Drive, Dynamics, Encoder, Harmonics, Rig

PERIOD = 1e-3
WRIST = Coupling(matrix=((1, 0, 0), (0.4, 1, 0), (0, -0.7, 1)))


def rig_of(period=PERIOD, *, smooth=False, **drive):
    """The rig; `drive` adds to what the drive is made of."""
    made = Drive(
        gear=(80.0, -60.0, 50.0),
        motor_inertia=(2e-4,) * 3,
        viscous=(1e-3, 2e-3, 1e-3),
        motor_gain=(0.2,) * 3,
        coupling=WRIST,
        **drive,
    )
    return Rig(drive=made, encoder=Encoder(resolution=(1000,) * 3, smooth=smooth), period=period)


def arm_of(rig):
    chain, rotors = planar(3).coupled(WRIST), rig.drive.reflected_inertia()
    bodies = [
        dataclasses.replace(body, rotor=float(j))
        for body, j in zip(chain.bodies, rotors, strict=True)
    ]
    dynamics = Dynamics.from_chain(chain)
    return dynamics.arm(dynamics.f(bodies))


def path_of(period):
    """Four harmonics of such a period [s]."""
    return Harmonics(
        period=period, offset=(0.3, -0.2, 0.1),
        cosine=((-0.5, -0.1, 0.2, 0.1), (0.4, -0.5, 0.1, -0.1), (0.3, 0.4, -0.6, 0.1)),
        sine=((0.3, 0.2, -0.3, 0.1), (-0.4, 0.3, 0.2, 0.1), (0.5, -0.2, 0.3, -0.1)),
    )  # fmt: skip
