"""Machines as a data sheet states them, for engines that share no code with the library.

`LIFT`: a vertical slide and two joints. `STAND`: three joints, one with a spring that carries its
weight; its drives run at 4 kHz.
"""

from typing import NamedTuple

import numpy as np

from plant import Body, Chain, Dynamics, Harmonics, Link


class Plan(NamedTuple):
    """What a data sheet says of a machine, and the truth beside it; all on the joint but `gear`."""

    chain: Chain
    gear: np.ndarray
    resolution: np.ndarray
    rotor: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    motor_gain: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    bandwidth: np.ndarray
    path: Harmonics
    speed_period: float
    noise: float

    @property
    def counts(self):
        """Counts per rad or m of each joint."""
        return self.gear * self.resolution / (2 * np.pi)


LIFT = Plan(
    chain=Chain(
        links=(
            Link(name="lift", prismatic=True),
            Link(name="shoulder", alpha=np.pi / 2),
            Link(name="elbow", a=0.3),
        ),
        bodies=(
            Body(mass=4.0, com=(0.02, 0.01, 0.1), inertia=(0.05, 0, 0, 0.05, 0, 0.03)),
            Body(mass=3.0, com=(0.14, 0.01, 0.0), inertia=(0.01, 0, 0, 0.04, 0, 0.04)),
            Body(mass=1.5, com=(0.11, -0.02, 0.01), inertia=(0.004, 0, 0, 0.012, 0, 0.012)),
        ),
    ),
    gear=np.array([2 * np.pi / 0.01, -80.0, 60.0]),
    resolution=np.array([4000.0, 4000.0, 4000.0]),
    rotor=np.array([18.0, 0.5, 0.14]),
    viscous=np.array([120.0, 1.5, 0.5]),
    coulomb=np.array([15.0, 2.0, 0.8]),
    motor_gain=np.array([0.12, 0.1, 0.08]),
    stiffness=np.zeros(3),
    rest=np.zeros(3),
    bandwidth=np.array([90.0, 90.0, 90.0]),
    path=Harmonics(
        period=5.0,
        offset=(0.15, 0.4, -0.5),
        cosine=((0.04, -0.03, 0.01), (0.4, -0.3, 0.1), (-0.5, 0.2, 0.15)),
        sine=((0.05, 0.02, -0.02), (-0.3, 0.3, 0.1), (0.3, -0.4, 0.1)),
    ),
    speed_period=1e-3,
    noise=0.02,
)

STAND = Plan(
    chain=Chain(
        links=(
            Link(name="turret"),
            Link(name="boom", alpha=-np.pi / 2, a=0.05),
            Link(name="stick", a=0.35, d=0.04),
        ),
        bodies=(
            Body(mass=6.0, com=(0.01, 0.02, -0.1), inertia=(0.08, 0, 0, 0.08, 0, 0.05)),
            Body(mass=5.0, com=(0.16, 0.0, 0.05), inertia=(0.02, 0, 0, 0.08, 0, 0.08)),
            Body(mass=2.5, com=(0.12, 0.02, 0.02), inertia=(0.006, 0, 0, 0.03, 0, 0.03)),
        ),
    ),
    gear=np.array([100.0, -120.0, 80.0]),
    resolution=np.array([2000.0, 2000.0, 2000.0]),
    rotor=np.array([0.9, 1.1, 0.3]),
    viscous=np.array([4.0, 5.0, 2.0]),
    coulomb=np.array([3.0, 4.0, 1.5]),
    motor_gain=np.array([0.1, 0.1, 0.08]),
    stiffness=np.array([0.0, 14.0, 0.0]),
    rest=np.array([0.0, -1.2, 0.0]),
    bandwidth=np.array([90.0, 90.0, 90.0]),
    path=Harmonics(
        period=5.0,
        offset=(0.0, -0.7, 0.6),
        cosine=((0.5, -0.3, 0.1), (0.3, -0.2, 0.1), (-0.4, 0.2, 0.15)),
        sine=((-0.3, 0.3, 0.2), (-0.25, 0.2, 0.1), (0.3, -0.3, 0.1)),
    ),
    speed_period=0.25e-3,
    noise=0.0,
)


def gains(plan):
    """Gains of a cascade, each for the inertia of its joint: position, speed, integral."""
    dynamics = Dynamics.from_chain(plan.chain)
    moment = np.diag(dynamics.arm(dynamics.f()).D(plan.path([0.0]).q[0])) + plan.rotor
    unit = moment / np.abs(plan.gear) / np.abs(plan.counts)
    w = plan.bandwidth
    return 0.2 * w, unit * w, 8 * unit * w
