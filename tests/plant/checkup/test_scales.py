"""A gear that is stated wrongly scales a reference in degrees: a law tells by how much."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from plant import PID, Harmonics, P, Record, puma560, read_robot, simulate

PERIOD = 0.005
ROBOT = read_robot("ur5e")


def slow_log():
    """A UR5e at 5 ms: its fine encoders move many pulses between two samples."""
    rig = dataclasses.replace(ROBOT.rig, period=PERIOD)
    gain = 0.03 * np.asarray(ROBOT.law.gain)
    law = PID(gain=gain, integral=2 * gain, derivative=0.04 * gain, filter=100.0, period=PERIOD)
    waves = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 6, 4)) / np.arange(1, 5)
    path = Harmonics(
        period=4.0, offset=(0, -1.2, 1.0, -0.5, 0.8, 0), cosine=waves[0], sine=waves[1]
    )
    dynamics = ROBOT.dynamics
    arm = dynamics.arm(dynamics.f(dynamics.chain.bodies))
    return simulate(arm, rig, law, path, steps_per_sample=16)


@pytest.fixture(scope="module")
def record():
    return slow_log()


def with_gear(record, joint, factor):
    """The log of an owner who states another gear and whose reference is in degrees."""
    factors = np.ones(record.n)
    factors[joint] = factor
    drive = dataclasses.replace(record.rig.drive, gear=factors * record.rig.drive.gear)
    rig = dataclasses.replace(record.rig, drive=drive)
    reference = np.round(factors * record.reference_pulses)
    counts = record.counts
    return dataclasses.replace(
        record, rig=rig, reference_pulses=reference, error_pulses=reference - counts
    )


@pytest.mark.parametrize(("joint", "factor"), [(2, 1.03), (1, 1.01), (4, 0.99)])
def test_a_gear_that_is_a_per_cent_off_is_named(record, joint, factor):
    """The loop itself follows at 0.4 to 2 per cent beside one, so the motion cannot tell."""
    causes = with_gear(record, joint, factor).check().causes
    assert [(cause.name, cause.joints) for cause in causes] == [("scale of reference", (joint,))]
    assert causes[0].size == pytest.approx(factor, rel=2e-3)
    assert ROBOT.rig.joint_labels[joint] in causes[0].line


@pytest.mark.parametrize(("law", "factor"), [("P", 0.97), ("PID", 1.02)])
def test_a_tight_loop_shows_its_scale_and_nothing_else(law, factor):
    """A reference that is a count off in some rows changes the torque of a tight loop wholly: the
    path behind the reference is rounded once, and gears are whole numbers.
    """
    base = puma560.rig()
    rig = dataclasses.replace(base, drive=dataclasses.replace(base.drive, gear=(100.0, 80.0)))
    gain = np.array((0.1, 0.075))
    laws = {
        "P": P(gain=gain),
        "PID": PID(
            gain=gain, integral=4 * gain, derivative=4e-3 * gain, filter=1500.0, period=7e-4
        ),
    }
    path = puma560.reference()
    made = simulate(puma560.literature_arm(1.5), rig, laws[law], path, steps_per_sample=8)
    wrong = with_gear(made, 1, factor)
    angles = np.round(np.rad2deg(path(made.t).q), 6)
    stated = Record.from_table(
        {"t": made.t, "counts": made.counts, "deg": angles, "A": rig.drive.current(made.torque)},
        rig=wrong.rig,
        law=laws[law],
        columns={"t": "t", "counts": "counts", "reference_position": "deg", "current": "A"},
        units={"t": "s", "reference_position": "deg", "current": "A"},
    )
    causes = stated.check().causes
    assert [(cause.name, cause.joints) for cause in causes] == [("scale of reference", (1,))]
    assert causes[0].size == pytest.approx(factor, rel=1e-4)


def test_a_right_log_of_a_slow_clock_has_no_cause(record):
    assert record.check().causes == ()


def test_a_wrong_gear_beside_whole_counts_is_no_scale_of_one():
    """The log has its reference in counts; the path that is stated beside them is another one.

    Without that path the law gives the torque, whatever the scale.
    """
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    made = simulate(arm, rig, ComputedTorque(arm, rig), path, steps_per_sample=8)
    gear = (1.0, 1.1) * rig.drive.gear
    wrong = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, gear=gear))
    stated = dataclasses.replace(made, rig=wrong, law=ComputedTorque(arm, rig))
    assert not [cause for cause in stated.check().causes if cause.name.startswith("scale of")]
