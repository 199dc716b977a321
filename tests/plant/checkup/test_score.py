"""Of a right log no change is likelier, where a faster loop makes the torques noisy."""

import dataclasses

import numpy as np
import pytest
from machine_plans import STAND, gains

from plant import (
    Cascade,
    Drive,
    Dynamics,
    Encoder,
    Record,
    Rig,
    simulate,
)
from plant.checkup.score import Experiment
from plant.checkup.undo import counts_in_time, exchanged_torques


@pytest.fixture(scope="module")
def experiment():
    """Every fourth sample of a cascade at 4 kHz; the loop answers its counts in between, too."""
    drive = Drive(
        gear=STAND.gear,
        motor_inertia=STAND.rotor / STAND.gear**2,
        viscous=STAND.viscous / STAND.gear**2,
        coulomb=STAND.coulomb / np.abs(STAND.gear),
        motor_gain=STAND.motor_gain,
        current_limit=(40.0, 40.0, 40.0),
    )
    encoder = Encoder(resolution=STAND.resolution, rounding="floor")
    rig = Rig(drive=drive, encoder=encoder, period=STAND.speed_period)
    dynamics = Dynamics.from_chain(STAND.chain.with_rotors(drive))
    arm = dynamics.arm(dynamics.f())
    position, speed, integral = gains(STAND)
    law = Cascade(
        position=position,
        speed=speed,
        integral=integral,
        difference=2,
        period=STAND.speed_period,
    )
    made = simulate(arm, rig, law, STAND.path, duration=5.0)
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
