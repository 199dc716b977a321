"""What a checkup says of gears that give: nothing faster than rigid gears allow goes unnoticed, nor is one accused."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from plant import Elasticity, P, puma560, simulate
from plant.machine.encoder import Phase

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH([0.0]).q[0]


def record(gain, hz=None, phase=(0.3, 0.6), law=None):
    """A log whose rig states rigid gears."""
    gears = None if hz is None else Elasticity.from_resonance(ARM, hz, 0.02, drive=RIG.drive, q=START)
    drive = dataclasses.replace(RIG.drive, elasticity=gears)
    rig = dataclasses.replace(RIG, drive=drive, encoder=dataclasses.replace(RIG.encoder, phase=Phase(shift=phase)))
    made = simulate(ARM, rig, law or P(gain=gain), PATH, steps_per_sample=16)
    return dataclasses.replace(made, rig=RIG, true_q=None, true_qd=None)


def found(log):
    """The findings about compliance."""
    return [finding for finding in log.check().findings if finding.check == "compliance"]


def loop_stiffness(gain):
    """Of each joint [N m/rad]: a pulse of error gives `gain` [N m] on the motor, and the gear that of the joint."""
    return np.abs(gain * RIG.drive.gear * RIG.position_in_pulses(np.eye(2)).diagonal())


def two_mass_modes(gain, hz):
    """Frequencies [Hz] of two motors with P gains, and of the links on their springs: M x'' + K x = 0 at the start."""
    rotors, held = RIG.drive.reflected_inertia(), np.diag(loop_stiffness(gain))
    links = ARM.D(START) - np.diag(rotors)
    springs = np.diag((2 * np.pi * hz) ** 2 * links.diagonal())
    mass = np.block([[np.diag(rotors), np.zeros((2, 2))], [np.zeros((2, 2)), links]])
    stiffness = np.block([[held + springs, -springs], [-springs, springs]])
    return np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real) / (2 * np.pi)


@pytest.mark.parametrize(("gain", "hz"), [((0.1, 0.08), 25), ((0.2, 0.15), 40)])
def test_an_oscillation_faster_than_rigid_gears_allow_is_one_of_the_two_masses(gain, hz):
    """The resonance varies by 1.2 to 1.4 along the path, the modes less: within 15 %."""
    seen = [finding for finding in found(record(gain, hz)) if finding.verdict == "look"]
    assert seen
    for finding in seen:
        assert np.abs(two_mass_modes(gain, hz) / finding.value - 1).min() < 0.15
        assert finding.unit == "Hz"
        assert "the gear is elastic" in finding.advice


@pytest.mark.parametrize("seed", range(6))
def test_no_rigid_arm_is_accused(seed):
    rng = np.random.default_rng(seed)
    gain = np.array((0.2, 0.15)) * rng.uniform(0.3, 1.5)
    verdicts = [finding.verdict for finding in found(record(gain, phase=rng.uniform(0, 1, 2)))]
    assert all(verdict.startswith("cannot tell: no oscillation above") for verdict in verdicts)


def test_the_stated_bound_is_that_of_the_motors_alone():
    """Modes of the linearised loop on rigid gears lie below the frequency that the finding states."""
    gain = (0.2, 0.15)
    said = found(record(gain))[0].verdict
    bound = float(said.split("above the ")[1].split(" Hz")[0])
    fastest = two_mass_modes(gain, 1e4)  # so stiff that only the loop's own modes are slow
    assert np.sort(fastest)[1] < bound
    assert bound == round(np.sqrt(max(loop_stiffness(gain) / RIG.drive.reflected_inertia())) / (2 * np.pi))


def test_what_does_not_tell_says_so():
    """Rotors of which nothing is known; a law whose torque is not proportional to the error."""
    log = record((0.1, 0.08), 25)
    unknown = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, motor_inertia=(0.0, 0.0)))
    sampled = record(None, law=ComputedTorque(ARM, RIG))
    for other in (dataclasses.replace(log, rig=unknown), sampled):
        (finding,) = found(other)
        assert finding.verdict.startswith("cannot tell: no fast proportional law and motor inertia; identify()")
        assert finding.joint is None
