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


def at_rest(probe, counts, seconds=0.2):
    """Counts that stand still until a push begins; the weight's torque is zero without an arm."""
    for _ in range(round(seconds / RIG.period)):
        if probe.step(counts).any():
            return
    raise AssertionError("no push has begun")


def test_a_joint_that_runs_away_is_let_go_in_the_sample_that_shows_it():
    weight = FirstMotion(RIG, (0, 0), arm=ARM).step((0, 0))
    assert weight.any()
    # 1. Before a push: ten times the usual 12 pulses are still allowed.
    probe = FirstMotion(RIG, (0, 0), arm=ARM)
    np.testing.assert_array_equal(probe.step((0, -120)), weight)
    assert not probe.done
    assert (probe.step((0, -121)) == 0).all()
    assert probe.done
    assert probe.status == (
        "motor of joint q[0]: joint q[1] moved by itself before it was pushed; brake it, and check"
        " its weight"
    )
    # 2. Under a push, and when it has just ended.
    for steps in (0, 1):
        probe = FirstMotion(RIG, (0, 0))
        at_rest(probe, (0, 0))
        for _ in range(steps):
            assert (probe.step((20, 0)) == 0).all()
        assert (probe.step((20, -121)) == 0).all()
        assert probe.done
        assert "joint q[1] went farther than 120 counts" in probe.status


def test_a_joint_that_creeps_is_not_pushed():
    """At 100 counts/s its counts would end the push of another motor, and look like its wires."""
    probe = FirstMotion(RIG, (0, 0))
    for k in range(round(1.0 / RIG.period)):
        assert (probe.step((0, 100 * k * RIG.period // 1)) == 0).all()
    assert probe.done
    assert "joint q[1] moved by itself before it was pushed" in probe.status


@pytest.mark.parametrize("creeps", [True, False])
def test_the_rest_after_a_push_is_that_of_the_motion_and_not_of_the_distance(creeps):
    """Both coast by 100 counts; one of them comes to rest in time."""
    probe = FirstMotion(RIG, (0, 0))
    at_rest(probe, (0, 0))
    rate = 150 if creeps else 600
    for k in range(round(0.6 / RIG.period)):
        probe.step((min(rate * k * RIG.period // 1, 100), 0))
    assert probe.done == creeps
    says = "joint q[0] did not come to rest after its push" if creeps else "joint q[0]: fine"
    assert says in probe.status


def test_the_noise_of_a_fine_encoder_is_rest_where_travel_is_long():
    for travel in (12, 120):
        probe = FirstMotion(RIG, (0, 0), travel=travel)
        pushed = [probe.step((8 * (k % 2), 0)).any() for k in range(round(0.2 / RIG.period))]
        assert any(pushed) == (travel == 120)


@pytest.mark.parametrize(
    ("counts", "line"),
    [
        # The second joint follows by half of the angle, in five times as many pulses.
        (lambda own: (own, own * 5), "motor of joint q[0]: fine"),
        # The second joint turns ten times as far.
        (lambda own: (own, own * 100), "motor of joint q[0]: the counts of joint q[1] moved by"),
    ],
    ids=["follows", "swapped"],
)
def test_joints_are_compared_by_angles_and_not_by_pulses_of_different_size(counts, line):
    # As fine at both joints, behind gears that differ; then ten times as fine at the second.
    resolution = np.abs(RIG.encoder.resolution / RIG.encoder.position_in_pulses(RIG.drive.gear))
    fine = dataclasses.replace(RIG.encoder, resolution=3000 * resolution * (1, 10))
    probe = FirstMotion(dataclasses.replace(RIG, encoder=fine), (0, 0), travel=12)
    at_rest(probe, (0, 0))
    own = 0
    for k in range(400):
        # A pulse in ten samples while the torque acts; the arm rests without it.
        own += k % 10 == 0 and not probe._lines and probe._torque.any()
        probe.step(counts(own))
    assert probe.status.splitlines()[0].startswith(line)


def test_the_torque_ends_at_its_largest_at_any_period():
    """0.03 s is no divisor of the ramp's 0.8 s."""
    for period in (0.7e-3, 0.03, 0.1):
        rig = dataclasses.replace(RIG, period=period)
        probe = FirstMotion(rig, (0, 0), torque=(20, 10))
        torques = np.array([probe.step((0, 0)) for _ in range(round(5 / period))])
        assert probe.done
        np.testing.assert_array_equal(np.abs(torques).max(axis=0), (20, 10))
