"""One joint with a link under the cascade of an ordinary drive, with a fine encoder."""

import dataclasses

import numpy as np

from plant import Body, Cascade, Chain, Drive, Dynamics, Encoder, Harmonics, Link, Rig

GEAR = 50.0
BODY = Body(mass=2.0, com=(0.2, 0.0, 0.0), inertia=(0.01, 0.0, 0.0, 0.03, 0.0, 0.03))
LINK = Link(name="arm", alpha=np.pi / 2)
CHAIN = Chain(links=(LINK,), gravity=(0.0, 0.0, -9.81), bodies=(BODY,))
RIG = Rig(
    drive=Drive(
        gear=(GEAR,),
        motor_inertia=(1e-5,),
        motor_gain=(0.1,),
        current_limit=(10.0,),
        viscous=(1e-4,),
        coulomb=(0.01,),
    ),
    encoder=Encoder(resolution=(65536.0,)),
    period=1e-3,
)
WHOLE = Dynamics.from_chain(CHAIN.with_rotors(RIG.drive))
DYNAMICS = Dynamics.from_chain(dataclasses.replace(CHAIN, bodies=()))
TRUE = WHOLE.f()
SPEED = 80 * TRUE[0] / GEAR**2 / 65536 * 2 * np.pi
LAW = Cascade(position=(20.0,), speed=(SPEED,), integral=(10 * SPEED,), filter=600.0, period=1e-3)
PATH = Harmonics(period=3.0, offset=(0.3,), cosine=((0.4, -0.1, 0.06),), sine=((0.3, 0.15, -0.05),))
