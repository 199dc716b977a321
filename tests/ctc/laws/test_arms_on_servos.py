"""How arms on servos and MIT drives fail, and what is said then: five kinds of failure."""

import dataclasses
import functools

import numpy as np
import pytest
from servos import GAIN, VISCOUS, arm, dynamics, rig

from ctc import ComputedTorque, FeedForward, Float, FloatSettings, evaluate, evaluate_float
from plant import (
    PD,
    Elasticity,
    Encoder,
    Guards,
    Harmonics,
    MitDrive,
    PointToPoint,
    PositionServo,
    SteppedArm,
    Transport,
    simulate,
)

ARM = arm()
FAST = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
SLOW = Harmonics(period=10.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
MOVE = PointToPoint(start=(0.3, -0.2), goal=(1.3, -1.2), duration=1.2)


def with_play(degrees, side="link"):
    """The rig with gears of that play, and its counters behind it."""
    loop = rig()
    gears = Elasticity(stiffness=(500, 500), damping=(1, 1), backlash=np.deg2rad((degrees,) * 2))
    return dataclasses.replace(
        loop,
        drive=dataclasses.replace(loop.drive, elasticity=gears),
        encoder=Encoder(resolution=4096, side=side),
    )


@functools.cache
def weightless():
    """A joint that nothing preloads."""
    equations = dynamics(gravity=(0, 0, 0))
    return equations.arm(equations.f())


# -- 1. play ---------------------------------------------------------------------------------------
def test_a_joint_without_weight_is_within_its_play_and_the_verdict_says_so():
    law = ComputedTorque(weightless(), rig())
    report = evaluate(weightless(), with_play(1.0), law, SLOW, duration=10.0)
    play = 4096 / 360
    # It cycles in the play, and never runs away.
    assert (report.max_error_pulses > 1).all()
    assert (report.max_error_pulses <= 1.5 * play + 1).all()
    assert not report.holds
    said = [line for line in report.conditions if "within the play, 11.4 pulses" in line]
    assert [line.split(" moves")[0] for line in said] == report.joint_labels


def test_without_play_nothing_is_said_of_it():
    law = ComputedTorque(weightless(), rig())
    assert evaluate(weightless(), rig(), law, SLOW, duration=10.0).in_play == []


# -- 2. late goals, lost reads ---------------------------------------------------------------------
@pytest.mark.parametrize(("period", "unknown", "stated"), [(0.02, 12, 4.5), (0.01, 4, 3)])
def test_goals_a_whole_sample_late_are_bounded_and_better_where_stated(period, unknown, stated):
    late = Transport(delay=period)
    worst = [
        evaluate(ARM, rig(period, transport=late), ComputedTorque(ARM, known), MOVE, duration=2.0)
        .max_true_error_pulses.max()
        for known in (rig(period), rig(period, transport=late))
    ]  # fmt: skip
    assert worst[1] < worst[0] < unknown
    assert worst[1] < stated


def test_lost_reads_are_bridged_and_then_the_servo_holds():
    loop = rig()
    running = ComputedTorque(ARM, loop).start(loop, loop.counts((0.3, -0.2)))
    bench, times = bus(loop), np.arange(0, 1.0, loop.period)
    motion = FAST(times)
    frozen = None
    for k, state in enumerate(zip(*motion, strict=True)):
        counts = bench.pulses
        # One read of another joint's register, and from 0.5 s on the bus repeats its last answer.
        if k == 20:
            counts = counts + 900
        if k >= 50:
            frozen = counts if frozen is None else frozen
            counts = frozen
        running.step(counts, *state)
        if k == 25:
            assert running.bridged == 1
            assert not running.stopped
        drive(bench, running.goal)
    assert running.stopped
    # It holds where the counts stood still, at most the torque cap away.
    assert np.abs(running.goal - frozen).max() <= np.ceil(3.35 / GAIN)
    assert np.abs(bench.qd).max() < 0.5


# -- 3. other gains --------------------------------------------------------------------------------
def test_p_register_halved_supply_low_or_torque_limited():
    law = ComputedTorque(ARM, rig())
    half = rig(inner=PositionServo(gain=GAIN / 2))
    # LeRobot writes P = 16 at every connect: the errors grow, and nothing swings up.
    report = evaluate(ARM, half, law, FAST, duration=4.0)
    assert 1 < report.max_true_error_pulses.max() < 15
    # 6.6 V in place of 7.4 V: gain and back-EMF fall by the same factor.
    low = rig(inner=PositionServo(gain=GAIN, supply=6.6 / 7.4), viscous=0.059 + 0.549 * 6.6 / 7.4)
    assert evaluate(ARM, low, law, FAST, duration=4.0).max_true_error_pulses.max() < 4


def test_overload_protection_stops_the_law_with_a_named_joint():
    # A servo that is overheated gives a fifth of its torque; the law's goals stay near the joint.
    loop = rig()
    weak = rig(inner=None, period=1e-3)
    weak = dataclasses.replace(weak, drive=weak.drive.limited_to((0.1, 0.1)))
    running = ComputedTorque(ARM, loop).start(
        loop, loop.counts((0.3, -0.2)), guards=Guards(error=60)
    )
    bench = SteppedArm(ARM, weak, (0.3, -0.2))
    for state in zip(*FAST(np.arange(0, 2.0, loop.period)), strict=True):
        running.step(bench.pulses, *state)
        assert np.abs(running.goal - bench.pulses).max() <= np.ceil(3.35 / GAIN)
        drive(bench, running.goal)
    assert running.stopped
    assert "lift" in str(running.status) or "elbow" in str(running.status)


# -- 4. float --------------------------------------------------------------------------------------
def test_float_refuses_what_could_drive_itself_and_rests_otherwise():
    loop = rig(inner=None)
    known = FloatSettings(gravity=0.005)
    with pytest.raises(ValueError, match=r"assist must be at most 0\.7[0-6]"):
        Float(ARM, loop, assist=1.1, settings=known)
    law = Float(ARM, loop, assist=0.7, settings=known)
    # Gravity 5 % and friction 15 % off, one standard deviation: some creep, and none runs away.
    drift = np.abs(evaluate_float(ARM, law).drift)
    assert np.mean(drift.max(axis=1) <= 1) >= 0.9
    assert drift.max() < 60


@pytest.mark.parametrize("share", [0.7, 0.9])
def test_float_with_less_friction_than_the_model_comes_to_rest(share):
    law = Float(ARM, rig(inner=None), assist=0.7, settings=FloatSettings(gravity=0.005))
    true = rig(inner=None, coulomb=share * 0.052, viscous=0.9 * VISCOUS)
    here = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0,), (0,)))
    begin = ((0.3, -0.2), (0.5, -0.5))
    counts = simulate(ARM, true, law, here, duration=2.0, initial=begin).counts
    assert np.abs(counts[-1] - counts[-50]).max() <= 1


@pytest.mark.parametrize("inner", ["goal", "frame"])
def test_what_float_sends_lies_beside_the_motion_of_the_hand(inner):
    """Whatever reference is passed: the inner loop does not hold the hand back."""
    loop = rig(inner=PositionServo(gain=GAIN / 4))
    if inner == "frame":
        loop = dataclasses.replace(loop, inner=MitDrive(kp=(5, 5), kd=(0.1, 0.1)))
    law = Float(ARM, loop, settings=FloatSettings(gravity=0.005))
    speed = np.array([0.6, -0.4])
    here, elsewhere = (law.start(loop, loop.counts((0.3, -0.2)), guards=None) for _ in range(2))
    for k in range(200):
        q = (0.3, -0.2) + speed * k * loop.period
        here.step(loop.counts(q), q, speed, np.zeros(2))
        elsewhere.step(loop.counts(q), q + 0.05, -speed, np.zeros(2))
    if inner == "goal":
        np.testing.assert_allclose(here.goal, elsewhere.goal, atol=1)
        # Gravity and 0.7 of friction, from the middle of the period on.
        friction = 0.052 * np.sign(speed) + VISCOUS * speed
        torque = ARM.dynamics.gravity(q, ARM.f).full()[:, 0] + 0.7 * friction
        middle = loop.position_in_pulses(q + speed * loop.period / 2)
        # The observer knows the place to a cell, and the speed to 5 %: 2 of these counts.
        np.testing.assert_allclose(here.goal, middle + torque / (GAIN / 4), atol=3)
        return
    torques = [
        kp * (at - q) + kd * (rate - speed) + tau
        for at, rate, kp, kd, tau in (here.frame, elsewhere.frame)
    ]
    np.testing.assert_allclose(*torques, atol=0.01)


# -- 5. boost, soft gears, fields, profiles, the end of the register -------------------------------
@pytest.mark.parametrize("period", [0.01, 0.005])
def test_a_boost_on_top_of_the_servo_stays_stable(period):
    loop = rig(period)
    true = rig(period, PositionServo(gain=0.97 * GAIN), coulomb=0.06)
    law = ComputedTorque(ARM, loop, start_boost=4.0)
    assert evaluate(ARM, true, law, FAST, duration=4.0).max_true_error_pulses.max() < 2


def test_drives_damp_gears_that_nobody_stated():
    frames = rig(0.002, None)
    drive_of = MitDrive.for_arm(ARM, frames, stiffness=60)
    loop = dataclasses.replace(frames, inner=drive_of)
    # 28 Hz of the rotor on its locked gear.
    stiffness = 0.0284 * (2 * np.pi * 28) ** 2
    soft = Elasticity(stiffness=(stiffness,) * 2, damping=(0.02, 0.02))
    true = dataclasses.replace(loop, drive=dataclasses.replace(loop.drive, elasticity=soft))
    report = evaluate(ARM, true, ComputedTorque(ARM, loop), FAST, duration=4.0)
    assert report.max_true_error_pulses.max() < 2


def test_a_servo_s_own_profile_slower_than_its_goals_stays_behind_and_bounded():
    loop = rig()
    # 1.26 rad/s at most on the path, 820 counts a second.
    slow = rig(inner=PositionServo(gain=GAIN, speed=500))
    report = evaluate(ARM, slow, ComputedTorque(ARM, loop), FAST, duration=4.0)
    assert 20 < report.max_true_error_pulses.max() < 400


def test_goals_end_at_the_ends_of_the_register():
    loop = rig(inner=PositionServo(gain=GAIN, register=(0, 4095)))
    law = ComputedTorque(ARM, loop)
    for count in (5, 4090):
        q = loop.cell_centre(np.array([count, count]))
        running = law.start(loop, (count, count), guards=None)
        for _ in range(3):
            running.step((count, count), q + (0.05 if count > 9 else -0.05), (0, 0), (0, 0))
        assert running.goal.min() >= 0
        assert running.goal.max() <= 4095
        assert 0 in running.goal or 4095 in running.goal
    with pytest.raises(ValueError, match="register must be"):
        PositionServo(gain=1.0, register=(4095, 0))


def test_a_counter_that_wraps_is_no_motion():
    loop = rig()
    start = np.array([4090, 100])
    running = ComputedTorque(ARM, loop).start(loop, start)
    q = loop.cell_centre(start)
    for k in range(10):
        running.step((start + np.array([k, 0])) % 4096, q, (0, 0), (0, 0))
        # 4095 -> 0 is a jump of a turn: bridged, then stopped, and never followed.
        assert np.abs(running.goal - start).max() <= np.ceil(3.35 / GAIN) + 10
    assert running.stopped


# -- at 30 Hz --------------------------------------------------------------------------------------
def test_at_30_hz_the_observer_still_helps_feed_forward():
    loop = rig(1 / 30)
    true = rig(1 / 30, PositionServo(gain=0.97 * GAIN), coulomb=0.06, viscous=1.05 * VISCOUS)
    nothing = PD(gain=(0, 0), derivative=(0, 0), filter=100.0, period=loop.period)
    worst = [
        evaluate(ARM, true, law, SLOW, duration=10.0).max_true_error_pulses.max()
        for law in (FeedForward(ARM, loop, feedback=nothing), ComputedTorque(ARM, loop))
    ]
    assert worst[1] < worst[0] < 6


def bus(loop):
    """The arm without a law: servos are `drive`."""
    free = dataclasses.replace(loop, inner=None, period=1e-3)
    return SteppedArm(ARM, free, (0.3, -0.2))


def drive(bench, goal, gain=GAIN):
    for _ in range(10):
        bench.step(gain * (goal - bench.pulses))
