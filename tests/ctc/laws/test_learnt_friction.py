"""Friction that computed torque learns while it runs: how soon, what it does not take for it,
and its next start.
"""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from plant import Harmonics, SteppedArm, puma560

ARM, RIG = puma560.arm(), puma560.rig()
BACK = Harmonics(
    period=3.0, offset=(-0.65, 1.05), cosine=np.full((2, 1), -0.15), sine=np.zeros((2, 1))
)
STATED = np.array([RIG.drive.coulomb, RIG.drive.viscous])


def stated(factor):
    """The rig with friction so many times as high as the robot's."""
    drive = dataclasses.replace(
        RIG.drive, coulomb=RIG.drive.coulomb * factor, viscous=RIG.drive.viscous * factor
    )
    return dataclasses.replace(RIG, drive=drive)


def law(factor=1.0, **options):
    return ComputedTorque(ARM, stated(factor), **{"bandwidth": 100, "dead_zone": 0.2} | options)


def worked(controller, path, seconds, arm=ARM):
    """Errors (N, n) [pulses] of the robot under a running controller, and how its Coulomb
    friction went (N, n).
    """
    motion = path(np.arange(round(seconds / RIG.period)) * RIG.period)
    robot = SteppedArm(arm, RIG, motion.q[0], motion.qd[0])
    pulses, errors, coulomb = robot.pulses, [], []
    for each in zip(*motion, strict=True):
        errors.append(RIG.counts(each[0]) - pulses)
        pulses = robot.step(controller.step(pulses, *each))
        coulomb.append(controller.friction[0])
    return np.array(errors), np.array(coulomb)


def started(controller, path):
    return controller.start(RIG, RIG.counts(path([0.0]).q[0]))


CASES = [(BACK, 0.7)]
SLOW = [
    *((BACK, factor) for factor in (0.9, 1.1, 1.3)),
    *((puma560.reference(), factor) for factor in (0.7, 0.9, 1.1, 1.3)),
]


@pytest.mark.parametrize(
    ("path", "factor"), [*CASES, *(pytest.param(*each, marks=pytest.mark.slow) for each in SLOW)]
)
def test_friction_that_is_off_is_learnt_within_two_periods(path, factor):
    """Each joint has turned back then. Coulomb friction within 8 % of the robot's, the errors
    within a pulse; without learning they exceed it wherever 30 % are missing.
    """
    running = started(law(factor), path)
    errors, coulomb = worked(running, path, 3 * path.duration)
    last = round(2 * path.duration / RIG.period)
    assert np.abs(errors[last:]).max() <= 1
    np.testing.assert_allclose(coulomb[-1], STATED[0], rtol=0.08)
    if factor == 0.7:
        still, _ = worked(started(law(factor, learn_friction=False), path), path, 3 * path.duration)
        assert np.abs(still[last:]).max() > 1


def test_the_torque_does_not_jump_where_friction_is_learnt():
    """What goes to friction comes from the disturbance torque: from sample to sample it moves as
    without learning.
    """
    chatter = []
    for learns in (True, False):
        running, torque = started(law(0.7, learn_friction=learns), BACK), []
        motion = BACK(np.arange(4000) * RIG.period)
        robot = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
        pulses = robot.pulses
        for each in zip(*motion, strict=True):
            torque.append(running.step(pulses, *each))
            pulses = robot.step(torque[-1])
        chatter.append(np.abs(np.diff(torque, axis=0)).max(axis=0))
    assert (chatter[0] <= 1.5 * chatter[1]).all()


def test_gravity_that_is_off_is_not_taken_for_friction():
    """5 % of all of f, on a path whose joints turn back: Coulomb friction stays within 8 %."""
    _, coulomb = worked(started(law(), BACK), BACK, 9.0, arm=ARM.dynamics.arm(1.05 * ARM.f))
    np.testing.assert_allclose(coulomb, np.broadcast_to(STATED[0], coulomb.shape), rtol=0.08)


@pytest.mark.slow
def test_what_was_learnt_is_begun_with_and_bounded():
    running = started(law(0.8), BACK)
    worked(running, BACK, 6.0)
    again = law(0.8).start(RIG, running.pulses, friction=running.friction)
    np.testing.assert_allclose(again.friction, running.friction, rtol=1e-12)
    again.reset(running.pulses)
    np.testing.assert_allclose(again.friction, running.friction, rtol=1e-12)
    errors, _ = worked(started(law(0.8), BACK), BACK, 0.5)
    begun, _ = worked(
        law(0.8).start(RIG, RIG.counts(BACK([0.0]).q[0]), friction=running.friction), BACK, 0.5
    )
    assert np.abs(begun).mean() < np.abs(errors).mean()
    narrow = started(law(0.7, learnable=0.1), BACK)
    worked(narrow, BACK, 6.0)
    np.testing.assert_allclose(narrow.friction[0], 0.7 * 1.1 * STATED[0], rtol=1e-9)


def test_a_torque_that_holds_is_begun_with():
    """Gravity 50 % off, far beyond what static friction holds: told the torque that holds the
    arm it hardly moves.
    """
    q = np.zeros(2)
    heavier, peak = ARM.dynamics.arm(1.5 * ARM.f), []
    holds = heavier.h(q, q)
    assert (np.abs(holds - ARM.h(q, q)) > RIG.drive.joint_coulomb()).any()
    for known in (None, holds):
        controller, robot = law().start(RIG, (0, 0), torque=known), SteppedArm(heavier, RIG, q, q)
        pulses, most = robot.pulses, 0.0
        for _ in range(500):
            pulses = robot.step(controller.step(pulses, q, q, q))
            most = max(most, np.abs(pulses).max())
        peak.append(most)
    assert peak[1] <= 1 < peak[0]


@pytest.mark.parametrize(("options", "said"), [
    ({"torque": (999.0, 0.0)}, r"torque must be within the amplifier's \[294.9408 153.3672\]; got \[999.   0.\]"),
    ({"torque": (20.0, 0.0), "torque_limit": (15.0, 9.0)}, r"within the amplifier's \[15.  9.\]; got \[20.  0.\]"),
    ({"friction": 2 * STATED}, "friction must be within 40% of the rig's"),
    ({"friction": -STATED}, "friction must be within 40% of the rig's"),
    ({"friction": STATED[0]}, r"friction must have shape \(2, 2\)"),
])  # fmt: skip
def test_bad_starts_are_refused_in_one_line(options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        law().start(RIG, (0, 0), **options)
    assert "\n" not in str(refusal.value)


def test_others_learn_none():
    with pytest.raises(ValueError, match="P learns none"):
        puma560.p_law().start(RIG, (0, 0), guards=None).friction  # noqa: B018
    with pytest.raises(ValueError, match="left out where none is learnt"):
        law(learn_friction=False).start(RIG, (0, 0), friction=STATED)
    with pytest.raises(ValueError, match=r"learnable must be a share, 0 to 0\.99; got 1"):
        law(learnable=1.0)
    np.testing.assert_array_equal(law(learn_friction=False).start(RIG, (0, 0)).friction, STATED)
