"""Of a right log no change is likelier, where a faster loop makes the torques noisy."""

import dataclasses

import numpy as np
import pytest

from plant import (
    Body,
    Cascade,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    Record,
    Rig,
    simulate,
)
from plant.checkup.score import Experiment
from plant.checkup.undo import counts_in_time, exchanged_torques

CHAIN = Chain(
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
)
PATH = Harmonics(
    period=5.0,
    offset=(0.0, -0.7, 0.6),
    cosine=((0.5, -0.3, 0.1), (0.3, -0.2, 0.1), (-0.4, 0.2, 0.15)),
    sine=((-0.3, 0.3, 0.2), (-0.25, 0.2, 0.1), (0.3, -0.3, 0.1)),
)


@pytest.fixture(scope="module")
def experiment():
    """Every fourth sample of a cascade at 4 kHz; the loop answers its counts in between, too."""
    gear = np.array((100.0, -120.0, 80.0))
    drive = Drive(
        gear=gear,
        motor_inertia=(9e-5, 7.6e-5, 4.7e-5),
        viscous=(4e-4, 3.5e-4, 3.1e-4),
        coulomb=(0.03, 0.033, 0.019),
        motor_gain=(0.1, 0.1, 0.08),
        current_limit=(40.0, 40.0, 40.0),
    )
    encoder = Encoder(resolution=(2000.0, 2000.0, 2000.0), rounding="floor")
    rig = Rig(drive=drive, encoder=encoder, period=2.5e-4)
    dynamics = Dynamics.from_chain(CHAIN.with_rotors(drive))
    arm = dynamics.arm(dynamics.f())
    # Gains of one bandwidth, 90 rad/s, on the inertia of each joint.
    speed = 90.0 * np.diag(arm.D(PATH([0.0]).q[0])) / np.abs(gear) / np.abs(rig.counts(np.ones(3)))
    law = Cascade(
        position=(18.0, 18.0, 18.0), speed=speed, integral=8 * speed, difference=2, period=2.5e-4
    )
    made = simulate(arm, rig, law, PATH, duration=5.0)
    record = Record(
        t=made.t[::4],
        error_pulses=made.error_pulses[::4],
        reference_pulses=made.reference_pulses[::4],
        torque=made.torque[::4],
        rig=dataclasses.replace(rig, period=1e-3),
        law=None,
    )
    return Experiment(record)


@pytest.mark.parametrize("joints", [(0, 1), (0, 2), (1, 2)])
def test_what_a_speed_explains_of_its_own_torque_tells_the_joint(experiment, joints):
    """Beside noise the other terms of a motion explain any joint's torque."""
    changed = experiment.changed(exchanged_torques(experiment.record, joints, 1.0))
    assert experiment.score > changed.score


@pytest.mark.parametrize("delay", [3.0, 5.0, 8.0])
def test_a_loop_of_the_second_order_has_no_late_counts(experiment, delay):
    """It lags by its position loop, and by the speed loop inside."""
    changed = experiment.changed(counts_in_time(experiment.record, (), delay))
    assert experiment.score > changed.score
