"""Designed motions: within their limits, and worth more than trajectory (6)."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import design_motion, identify, pulse_budget
from plant import JointSpring, puma560, simulate

ARM, RIG, LAW = puma560.literature_arm(1.5), puma560.rig(), puma560.p_law()
LIMITS = {"position": [(-1.6, 0.1), (-0.1, 1.7)], "velocity": (3.0, 4.0), "acceleration": (12.0, 16.0)}
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()


@pytest.fixture(scope="module")
def motion():
    return design_motion(ARM, RIG, LAW, period=3.65, harmonics=4, starts=1, iterations=60, **LIMITS)


def test_designed_motion_stays_within_its_limits(motion):
    q, qd, qdd = motion(np.linspace(0, 3.65, 2000))
    low, high = np.array(LIMITS["position"]).T
    assert (q >= low).all()
    assert (q <= high).all()
    assert (np.abs(qd) <= LIMITS["velocity"]).all()
    assert (np.abs(qdd) <= LIMITS["acceleration"]).all()
    torque = np.array([ARM.inverse(*state) for state in zip(q, qd, qdd, strict=True)]) + RIG.drive.friction(qd)
    assert (np.abs(torque) < RIG.drive.torque_limit()).all()


def test_springs_that_carry_the_arm_leave_its_amplifiers_free():
    """Amplifiers too weak to hold the arm where it moves: without springs there is no motion."""
    pose = np.array([-0.75, 0.8])
    weight = ARM.h(pose, np.zeros(2))
    weak = dataclasses.replace(RIG, drive=RIG.drive.limited_to((0.6 * np.abs(weight[0]), 40.0)))
    carried = JointSpring(stiffness=(0.0, 0.0), angle=pose, preload=weight)
    limits = LIMITS | {"position": [(-0.9, -0.6), (0.65, 0.95)], "acceleration": (2.0, 2.0)}
    options = {"period": 3.65, "harmonics": 2, "starts": 1, "iterations": 20, **limits}
    with pytest.raises(ValueError, match="limits must allow a motion"):
        design_motion(ARM, weak, LAW, **options)
    path = design_motion(ARM, dataclasses.replace(weak, springs=carried), LAW, **options)
    q, qd, qdd = path(np.linspace(0, 3.65, 500))
    needed = np.array([ARM.inverse(*state) for state in zip(q, qd, qdd, strict=True)])
    needed += RIG.drive.joint_viscous() * qd  # as the design takes it; dry friction is in what it keeps free
    assert (np.abs(needed - weight) < weak.drive.torque_limit()).all()


def test_worst_known_parameter_becomes_known(motion):
    """By the bound of rounding, and by identification from one log: f3, which (6) hardly shows."""
    bounds = [pulse_budget(ARM, RIG, LAW, path).bound / WIDTH for path in (puma560.reference(), motion)]
    assert bounds[1].max() < bounds[0].max()
    logs = [simulate(ARM, RIG, LAW, path, steps_per_sample=16) for path in (puma560.reference(), motion)]
    found = [identify(puma560.dynamics(), log, method="prediction_error", progress=False) for log in logs]
    worst = [(100 * np.abs(each.f - ARM.f) / WIDTH).max() for each in found]
    said = [(100 * np.sqrt(np.diag(each.fit.noise_covariance)) / WIDTH).max() for each in found]
    assert said[1] < said[0] / 2
    assert worst[1] < 3.0


def test_same_seed_same_motion(motion):
    again = design_motion(ARM, RIG, LAW, period=3.65, harmonics=4, starts=1, iterations=60, **LIMITS)
    np.testing.assert_allclose(again.cosine, motion.cosine, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"position": [(0, 1)]}, "position must have shape"),
        ({"position": [(1, 0), (0, 1)]}, "low < high"),
        ({"velocity": (0, 1)}, "speeds and accelerations positive"),
        ({"period": -1}, "period must be a positive number"),
        ({"law": ComputedTorque(ARM, RIG)}, "fast and without memory"),
        ({"arm": puma560.dynamics()}, "arm must be of type Arm"),
        ({"velocty": (1, 1)}, "Did you mean 'velocity'"),
        ({"acceleration": (1e-6, 1e-6), "starts": 1, "iterations": 20}, "limits must allow"),
    ],
)
def test_bad_input_is_refused(change, says):
    given = {"arm": ARM, "rig": RIG, "law": LAW, "period": 3.65, **LIMITS}
    with pytest.raises(ValueError, match=says):
        design_motion(**(given | change))


def test_limits_without_room_are_refused():
    """The arm cannot be held there: gravity alone takes more than the amplifier's share."""
    drive = dataclasses.replace(RIG.drive, current_limit=(0.5, 0.5))
    level = LIMITS | {"position": [(-0.2, 0.1), (-0.1, 0.2)]}
    with pytest.raises(ValueError, match="limits must allow"):
        design_motion(ARM, dataclasses.replace(RIG, drive=drive), LAW, period=3.65, starts=1, iterations=20, **level)
