"""Faults injected into the paper's arm under computed torque: what the guards say and do, and what
it costs.

Bounds are those of `docs/guides/faults.md`, which `tests/benchmarks/faults.py` measures, with room.
"""

from functools import cache

import numpy as np
import pytest
from faults import BEGIN, END, FAULTS, PATH, RIG, SimulatedArm, experiment

from ctc import ComputedTorque
from plant import Guards, PointToPoint, SteppedArm, puma560

LIMIT = RIG.drive.torque_limit()


@cache
def arm():
    return puma560.arm()


@cache
def outcome(name, guards=True):
    return experiment(ComputedTorque(arm(), RIG), arm(), FAULTS[name], guards=guards)


@pytest.mark.parametrize("name", FAULTS)
def test_torques_stay_finite_and_within_the_amplifier(name):
    torque = outcome(name).torque
    assert torque.shape == (END, 2)
    assert (np.abs(torque) <= LIMIT * (1 + 1e-12)).all()


@pytest.mark.parametrize(
    ("name", "status", "bridged"),
    [
        ("none", "running", 0),
        ("jump", f"running; bridged a jump of 800 pulses of joint 2 (q[0]) at call {BEGIN + 1}", 1),
        ("late", f"running; bridged a call that came 1.4 ms late at call {BEGIN + 1}", 1),
        ("gap", f"running; bridged a reference that is no finite position at call {BEGIN + 2}", 2),
    ],
)
def test_what_lasts_a_moment_is_bridged(name, status, bridged):
    """The arm stays within a pulse of its path, as encoders count it, as if nothing had been."""
    result = outcome(name)
    assert (result.status, result.bridged, result.stopped) == (status, bridged, False)
    assert result.peak_error.max() < 1.5


@pytest.mark.parametrize(
    ("name", "status", "error"),
    [
        # The 800 pulses are the fault's own: it is the counts that are held.
        (
            "slip",
            (
                "safe stop, holding: a jump of 800 pulses of joint 2 (q[0]), 4 times in a row, at"
                " call 1004"
            ),
            (802, 2),
        ),
        ("too late", "safe stop, holding: a call that came 10.5 ms late, at call 1001", (8, 8)),
        (
            "no reference",
            (
                "safe stop, holding: a reference that is no finite position, 4 times in a row, at"
                " call 1004"
            ),
            (1, 1),
        ),
        (
            "leap",
            "safe stop, holding: joint 2 (q[0]) is 1373 pulses from its reference, at call 1001",
            (4, 4),
        ),
    ],
)
def test_what_lasts_stops_the_arm_under_the_law(name, status, error):
    """It brakes along its own path, follows that as closely as any, and stands in the end."""
    result = outcome(name)
    assert result.status == status
    assert (result.peak_error <= error).all()
    assert np.abs(np.diff(result.error[-100:], axis=0)).max() < 0.2


@pytest.mark.parametrize(
    ("name", "why", "moved"),
    [
        ("noise", "pulses of joint 2 (q[0]), 4 times in a row, at call 1004", (8000, 1500)),
        (
            "stuck",
            "the encoder of joint 3 (q[1]) stands still while its reference moved by",
            (1500, 1800),
        ),
        (
            "no reference, gravity",
            "a reference that is no finite position, 4 times in a row",
            (1500, 600),
        ),
        (
            "blocked",
            "the encoder of joint 2 (q[0]) stands still while its reference moved by",
            (50, 1000),
        ),
    ],
)
def test_where_there_is_nothing_to_hold_by_the_torque_goes_to_gravity(name, why, moved):
    """The joints come to rest where their friction and the damping stop them."""
    result = outcome(name)
    assert result.status.startswith("safe stop, ramp to gravity compensation: ")
    assert why in result.status
    assert (result.peak_error <= moved).all()


def test_a_ramp_to_gravity_ends_at_the_weight_of_the_arm():
    """Stopped at rest: the torque is h(q, 0) of the true arm at the counted pose, to rounding."""
    q = np.array([0.3, -0.4])
    robot, running = SimulatedArm(arm(), RIG, q, np.zeros(2)), None
    running = ComputedTorque(arm(), RIG).start(
        RIG, robot.counts(), guards=Guards(stop="gravity", patience=0)
    )
    running.step(robot.counts(), q, np.zeros(2), np.zeros(2))
    for _ in range(100):
        torque = running.step(robot.counts(), np.full(2, np.nan), np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(
        torque, arm().h(RIG.cell_centre(robot.counts()), np.zeros(2)), rtol=1e-10
    )


def test_a_ramp_to_zero_ends_there():
    result = outcome("blocked, zero")
    assert result.status.startswith(
        "safe stop, ramp to zero: the encoder of joint 2 (q[0]) stands still"
    )
    # joint 3 sags, and what is left brakes it
    assert (np.abs(result.torque[-1]) < (0.1, 10.0)).all()
    assert result.peak_error[1] < 2500


def test_without_guards_the_same_faults_do_harm():
    """The guards earn their place: a jump of one sample throws the arm off, and a slip drives it
    there.
    """
    assert outcome("jump", guards=False).peak_error.max() > 5 * outcome("jump").peak_error.max()
    assert outcome("stuck", guards=False).peak_error.max() > 10 * outcome("stuck").peak_error.max()


@pytest.mark.parametrize("known", [True, False], ids=["known", "hidden"])
def test_what_the_torque_limit_cuts_off_reaches_the_observer(known):
    """From 0.02 rad (270 pulses) off, with 30 N m more than the weight: it returns, and runs a
    pulse past.

    Where the same limit acts behind the controller's back, the observer takes what is missing for a
    disturbance; since it comes back no faster than it can brake, that costs no more than another
    pulse.
    """
    q, zero = np.zeros(2), np.zeros(2)
    robot, limit = SimulatedArm(arm(), RIG, np.array([0.02, 0.0]), zero), np.array([130.0, 60.0])
    assert np.abs(arm().h(q, zero))[0] == pytest.approx(100, abs=5)
    # it is saturated for longer than that allows
    law, guards = ComputedTorque(arm(), RIG), Guards(saturation=None)
    running = law.start(RIG, robot.counts(), guards=guards, torque_limit=limit if known else None)
    torque, error = np.zeros((600, 2)), np.zeros((600, 2))
    for k in range(600):
        torque[k] = np.clip(running.step(robot.counts(), q, zero, zero), -limit, limit)
        error[k] = RIG.position_in_pulses(robot.q - q)
        robot.push(torque[k])
    assert running.status == "running"
    assert (np.abs(torque[:50, 0]) >= limit[0] * (1 - 1e-12)).mean() > 0.2
    overshoot = -error[:, 0].min()
    assert overshoot < (1.5 if known else 2.5)


def test_after_a_reset_the_arm_goes_on():
    """Stopped, planned anew from where it stands, and within a pulse after the observer has
    settled.
    """
    motion = PATH(np.arange(300) * RIG.period)
    robot = SimulatedArm(arm(), RIG, motion.q[0], motion.qd[0])
    running = ComputedTorque(arm(), RIG).start(RIG, robot.counts())
    for k in range(1000):
        q = motion.q[min(k, 299)] if k < 300 else np.full(2, np.nan)
        robot.push(running.step(robot.counts(), q, motion.qd[min(k, 299)], motion.qdd[min(k, 299)]))
    assert running.stopped
    stands = RIG.cell_centre(robot.counts())
    running.reset(robot.counts())
    assert running.status == "running"
    errors = []
    for _ in range(300):
        robot.push(running.step(robot.counts(), stands, np.zeros(2), np.zeros(2)))
        errors.append(np.abs(RIG.counts(stands) - robot.counts()).max())
    assert running.status == "running"
    assert max(errors[100:]) <= 1


@pytest.mark.parametrize("joint", [0, 1])
def test_an_encoder_that_freezes_in_a_stop_ends_the_hold(joint):
    """The stop brakes along the path; counts that stand there while the torque grows are no arm
    that holds.
    """
    whole, frozen = puma560.literature_arm(1.5), np.nan
    robot = SteppedArm(whole, RIG, *(each[0] for each in PATH([0.0])[:2]))
    running = ComputedTorque(whole, RIG, bandwidth=150).start(RIG, robot.pulses)
    for k in range(830):
        motion = [each[0] if k < 800 else np.full(2, np.nan) for each in PATH([k * RIG.period])]
        pulses = robot.pulses.astype(float)
        if k == 806:
            assert str(running.status).startswith("safe stop, holding")
            frozen = pulses[joint]
        pulses[joint] = frozen if k >= 806 else pulses[joint]
        robot.step(running.step(pulses, *motion))
    assert str(running.status).startswith("safe stop, ramp to gravity compensation")


def test_a_joint_that_holds_another_s_weight_has_no_dead_encoder():
    """The elbow turns over alone: joint 2 stands, and its torque changes by 33 N m, beyond its
    friction's band.
    """
    whole, path = (
        puma560.literature_arm(1.5),
        PointToPoint(start=(0.0, -1.5), goal=(0.0, 1.5), duration=2.0),
    )
    robot = SteppedArm(whole, RIG, np.array([0.0, -1.5]), np.zeros(2))
    running = ComputedTorque(whole, RIG, bandwidth=150).start(RIG, robot.pulses)
    for k in range(3200):
        motion = path([min(k * RIG.period, 2.0)])
        robot.step(running.step(robot.pulses, *(each[0] for each in motion)))
    assert running.status == "running"
