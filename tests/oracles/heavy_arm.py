"""A heavy six-joint arm worked out backwards: links first, torques by pinocchio, then gears,
motors, and both encoders.

Links follow sums of harmonics; pinocchio's inverse dynamics gives what each gear passes on, k d +
d' the deflection d from it, and the motors' torque holds rotors and friction. The first three gears
have an encoder on either side: the one on the motor counts whole pulses, the one on the link has
2^20 of its own per turn and a zero of its own. The other gears wind up too, which no rig states.
Torques are those amid two samples, as they are held.
"""

import dataclasses

import numpy as np
import pinocchio as pin
from pinocchio_arm import pinocchio_model

from plant import Body, Chain, Drive, Dynamics, Encoder, Harmonics, Link, LoggedTorque, Record, Rig
from plant.mechanics import prior_changes, prior_factor

SEEN = np.arange(6) < 3
STIFFNESS = np.array([1.5e6, 2.0e6, 1.2e6, 4e5, 3e5, 2e5])  # [N m/rad]
DAMPING = 1.2e-3 * STIFFNESS  # a ratio of 3 % at 8 Hz
PERIOD, SECONDS = 2e-3, 8.0
_LINKS = ((0, 0, 0.8), (-1, 0.35, 0), (0, 1.25, 0), (-1, 0.05, 1.1), (1, 0, 0), (-1, 0, 0.2))
_MASSES = (450.0, 280.0, 200.0, 70.0, 40.0, 120.0)  # the last with its load
_CENTRES = (
    (0.15, 0.05, -0.2),
    (0.6, 0.02, 0.1),
    (0.1, 0.15, 0.05),
    (0.01, 0.02, -0.4),
    (0.01, 0.05, 0.02),
    (0.03, 0.02, 0.25),
)
_SIZES = (0.5, 0.8, 0.4, 0.5, 0.15, 0.25)  # [m]
GEAR = np.array([180.0, 200.0, 180.0, 140.0, 120.0, 90.0])
DRIVE = Drive(
    gear=GEAR,
    motor_inertia=np.array([8, 8, 5, 1.5, 1.5, 1.5]) * 1e-3,
    viscous=np.full(6, 2e-3),
    coulomb=np.array([0.6, 0.8, 0.5, 0.2, 0.2, 0.15]),
    motor_gain=np.full(6, 1.5),
    current_limit=np.full(6, 200.0),
)
RIG = Rig(drive=DRIVE, encoder=Encoder(resolution=np.full(6, 4096)), period=PERIOD)


def bodies():
    """Of the data sheet, without rotors."""
    shapes = np.array([1.0, 0.1, -0.05, 0.8, 0.05, 0.7])
    return tuple(Body(mass=m, com=c, inertia=m * (s / 2) ** 2 * shapes / 3)
                 for m, c, s in zip(_MASSES, _CENTRES, _SIZES, strict=True))  # fmt: skip


def arm_of(some):
    """The arm of these bodies, with the drive's rotors."""
    links = [
        Link(name=str(i + 1), alpha=turn * np.pi / 2, a=a, d=d)
        for i, (turn, a, d) in enumerate(_LINKS)
    ]
    dynamics = Dynamics.from_chain(Chain(links=tuple(links), bodies=tuple(some)).with_rotors(DRIVE))
    return dynamics.arm(dynamics.f())


def other(some, spread, random):
    """Bodies that deviate from these by a relative spread."""
    made = []
    for body in some:
        pi = body.standard_parameters
        change = prior_changes(prior_factor(pi)) @ random.normal(size=10)
        made.append(
            Body.from_standard_parameters(
                pi + spread * np.append(change, np.zeros(len(pi) - 10))[: len(pi)]
            )
        )
    return tuple(made)


def run(some, stiffness, damping, random, noise=0.0, seconds=SECONDS):
    """A record of the arm with these bodies and gears, on a path of its own; `noise` of the
    logged torque, relative.
    """
    arm = arm_of(some)
    slow, fast = np.array([0.35, 0.25, 0.25, 0.5, 0.5, 0.5]), 1 / np.arange(1, 11)
    waves = random.normal(size=(2, 6, 10)) * slow[:, None] * fast
    path = Harmonics(
        period=seconds, offset=(0, -0.9, 0.3, 0, 0.4, 0), cosine=waves[0], sine=waves[1]
    )
    t = PERIOD * np.arange(round(seconds / PERIOD))
    links, model = path(t), pinocchio_model(arm.dynamics.chain, some)
    data = model.createData()
    passed = np.array([pin.rnea(model, data, *each) for each in zip(*links, strict=True)])
    wound = passed / stiffness
    for _ in range(4):
        wound = (passed - damping * np.gradient(wound, PERIOD, axis=0)) / stiffness
    motors = links.q + wound
    rate = np.gradient(motors, PERIOD, axis=0)
    torque = (
        passed
        + DRIVE.reflected_inertia() * np.gradient(rate, PERIOD, axis=0)
        + DRIVE.friction(rate)
    )
    torque = (torque + np.vstack([torque[1:], torque[-1:]])) / 2
    torque = torque + noise * np.std(torque, axis=0) * random.normal(size=torque.shape)
    pulse = 2 * np.pi / 2**20
    seen = pulse * np.round((links.q + random.uniform(-0.01, 0.01, 6)) / pulse)
    return Record(
        t=t,
        error_pulses=-np.floor(RIG.position_in_pulses(motors) + random.uniform(0, 1, 6)),
        torque=torque,
        rig=RIG,
        law=LoggedTorque(),
        link_counts=np.where(SEEN, RIG.position_in_pulses(seen), np.nan),
    )


def shown_by(record, *, sensors):
    """The record with link encoders at these joints alone."""
    return dataclasses.replace(record, link_counts=np.where(sensors, record.link_counts, np.nan))
