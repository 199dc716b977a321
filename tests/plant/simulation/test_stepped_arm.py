"""An arm stepped by a script: the same samples as `simulate`, and loads that come and go."""

import dataclasses

import numpy as np
import pytest

from plant import PD, Body, Elasticity, SteppedArm, Transport, puma560, simulate
from plant.simulation import DivergenceError

PATH = puma560.reference()


def followed(rig, law, samples, arm=None):
    arm = puma560.arm() if arm is None else arm
    motion = PATH(np.arange(samples) * rig.period)
    stepped = SteppedArm(arm, rig, motion.q[0], motion.qd[0])
    controller, pulses, errors = law.start(rig, stepped.pulses, guards=None), stepped.pulses, []
    for state in zip(*motion, strict=True):
        errors.append(rig.counts(state[0]) - pulses)
        pulses = stepped.step(controller.step(pulses, *state))
    return np.array(errors), stepped


@pytest.mark.parametrize("elastic", [False, True])
def test_the_samples_are_those_of_the_simulator(elastic):
    """The same kernel under a held torque: the same counts, to the bit."""
    rig = puma560.rig()
    if elastic:
        gears = Elasticity.from_resonance(puma560.arm(), (60.0, 60.0), 0.02)
        rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears))
    law = PD(gain=(0.1, 0.075), derivative=(0.004, 0.004), filter=3000.0, period=rig.period)
    record = simulate(puma560.arm(), rig, law, PATH, duration=0.2)
    errors, _ = followed(rig, law, len(record))
    np.testing.assert_array_equal(errors, record.error_pulses)


def test_a_load_falls_and_an_empty_arm_does_not_remember():
    """Under the torque that holds the empty arm, a load pulls down at once, and off again it
    leaves no force.
    """
    rig, rest = puma560.rig(), np.array([0.0, np.pi / 2])
    held = puma560.arm().h(rest, np.zeros(2))
    empty, loaded = (SteppedArm(puma560.arm(), rig, rest) for _ in range(2))
    for _ in range(50):
        empty.step(held)
        loaded.carry(Body(mass=20.0, com=(0.0, -0.5, 0.0)))
        loaded.step(held)
    assert np.abs(empty.qd).max() < 1e-6
    assert np.abs(loaded.qd).max() > 0.05
    loaded.carry(None)
    loaded._state[:] = empty._state
    loaded.step(held)
    empty.step(held)
    np.testing.assert_array_equal(loaded.q, empty.q)


def test_what_is_refused():
    rig, arm = puma560.rig(), puma560.arm()
    with pytest.raises(ValueError, match="transport"):
        SteppedArm(arm, dataclasses.replace(rig, transport=Transport(delay=1e-4)), [0, 0])
    with pytest.raises(ValueError, match="order"):
        SteppedArm(rig, arm, [0, 0])
    with pytest.raises(ValueError, match="torque"):
        SteppedArm(arm, rig, [0, 0]).step([1.0])
    with pytest.raises(DivergenceError, match="bounded"):
        SteppedArm(arm, rig, [0, 0], [1e7, 0]).step([0.0, 0.0])
