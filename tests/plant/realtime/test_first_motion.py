"""The first motion: wires that are turned, swapped or dead are named; torque, motion and time
are bounded.
"""

import dataclasses

import numpy as np
import pytest

from plant import Elasticity, FirstMotion, SteppedArm, puma560

RIG, ARM, POSE = puma560.rig(), puma560.literature_arm(1.5), np.array([0.3, -0.4])
SECONDS = 4.0


def as_they_are(counts):
    return counts


def turned(counts):
    return counts * (-1, 1)


def swapped(counts):
    return counts[::-1]


def dead(counts):
    return counts * (1, 0)


def run(read=as_they_are, *, arm=ARM, known=ARM, rig=RIG, pose=POSE, drive=np.array, **options):
    """The test on a simulated arm: what it says, its largest torque, and how far [pulses] and
    fast the arm went.
    """
    robot = SteppedArm(arm, rig, pose)
    begin, fastest, most = robot.pulses, 0.0, 0.0

    def seen():
        """Counters are set where the arm stands; then they count what their wires bring."""
        return begin + read(robot.pulses - begin)

    probe = FirstMotion(RIG, seen(), arm=known, **options)
    for _ in range(round(SECONDS / rig.period)):
        torque = probe.step(seen())
        robot.step(drive(torque))
        fastest, most = max(fastest, np.abs(robot.qd).max()), max(most, np.abs(torque).max())
        if probe.done:
            break
    assert probe.done
    return probe, most, np.abs(robot.pulses - begin).max(), fastest


def test_a_sound_arm_is_fine_and_hardly_moves():
    probe, most, far, fastest = run()
    assert probe.fine
    assert probe.status == "motor of joint q[0]: fine\nmotor of joint q[1]: fine"
    assert far < 60
    assert fastest < 0.15
    assert most < np.abs(ARM.h(POSE, np.zeros(2))).max() + 30


@pytest.mark.parametrize(
    ("read", "says", "bound"),
    [
        (turned, "motor of joint q[0]: its counts fell by", 60),
        (swapped, "motor of joint q[0]: the counts of joint q[1] moved by", 60),
        (dead, "motor of joint q[1]: no count moved up to", 1000),  # unseen
    ],
)
def test_what_is_wrong_with_an_encoder_is_named(read, says, bound):
    probe, _, far, fastest = run(read)
    assert not probe.fine
    assert says in probe.status
    assert far < bound
    assert fastest < 0.05 + bound / 1500


@pytest.mark.parametrize(
    "case",
    [
        {"known": None, "torque": (60, 25)},
        {"arm": puma560.literature_arm(9.0)},
        {"drive": lambda torque: -torque},
    ],
    ids=["no weight", "three times the load", "both amplifiers turned"],
)
def test_an_arm_that_moves_by_itself_is_let_go(case):
    probe, *_ = run(**case)
    assert not probe.fine
    assert "moved by itself" in probe.status
    assert (probe.step(np.zeros(2)) == 0).all()


def test_a_load_that_friction_bears_and_elastic_gears_change_nothing():
    soft = Elasticity.from_resonance(ARM, 40, 0.02, drive=RIG.drive)
    elastic = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=soft))
    for case in ({"arm": puma560.literature_arm(2.0)}, {"rig": elastic}):
        assert run(**case)[0].fine, case


def test_a_motor_without_power_is_said():
    probe, *_ = run(drive=lambda torque: torque * (1, 0) + (0, 1) * ARM.h(POSE, np.zeros(2)))
    assert "motor of joint q[1]: no count moved up to" in probe.status


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        ((RIG, (0, 0, 0)), {}, "pulses must have shape"),
        ((RIG, (0, np.nan)), {}, "pulses must be finite"),
        ((RIG, (0, 0)), {"torque": (1, 0)}, "torque must be above 0"),
        ((RIG, (0, 0)), {"travel": 1}, "travel must be at least 4 pulses"),
        ((RIG, (0, 0)), {"arm": RIG}, "arm must be"),
        ((RIG, (0, 0)), {"traval": 1}, "Did you mean 'travel'"),
    ],
)
def test_bad_input_is_refused(arguments, options, says):
    with pytest.raises(ValueError, match=says):
        FirstMotion(*arguments, **options)


def test_counts_that_are_none_are_refused_and_change_nothing():
    probe = FirstMotion(RIG, (0, 0))
    for wrong in ((0, np.nan), (0,), "ab"):
        with pytest.raises(ValueError, match="pulses"):
            probe.step(wrong)
    assert probe.step((0, 0)).tolist() == [0, 0]
