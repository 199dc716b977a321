"""Position servos and MIT drives below a law: what they do, and what they refuse."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servos import GAIN, VISCOUS, arm, dynamics, rig

from ctc import ComputedTorque, FeedForward, Uncertainty, certify, evaluate
from identification import identify
from plant import (
    PD,
    PID,
    Guards,
    Harmonics,
    Law,
    LoggedTorque,
    MitDrive,
    P,
    PointToPoint,
    PositionServo,
    Transport,
    everyday_motions,
    replay,
    simulate,
    to_control,
    to_fmu,
)
from plant.analysis import SampledLoops

ARM = arm()
STILL = PointToPoint(start=(0.3, 0.2), goal=(0.3, 0.2), duration=1.0)
PER_RADIAN = 4096 / (2 * np.pi)
FAST = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))


def plain(period):
    """A law that sends the reference itself as the goal."""
    return PD(gain=(0, 0), derivative=(0, 0), filter=100.0, period=period)


def test_ramp_of_goals_lags_by_viscous_friction_over_gain():
    # Analytic: in steady motion K lag = B v. The goal is that of the middle of its period, so the
    # half period by which held goals lag is not in it.
    speed = 0.5
    turn = 1e3 * speed / (2 * np.pi)
    ramp = Harmonics(period=1e3, offset=(0, 0), cosine=((0,), (0,)), sine=((turn,), (-turn,)))
    weightless = dynamics(gravity=(0, 0, 0))
    free = weightless.arm(weightless.f())
    record = simulate(free, rig(coulomb=0.0), plain(0.01), ramp, duration=4.0)
    lag = (ramp(record.t).q - record.true_q)[-200:].mean(axis=0) * PER_RADIAN
    np.testing.assert_allclose(lag, np.array([1, -1]) * VISCOUS * speed / GAIN, atol=0.5)


def test_sag_of_plain_goals_is_weight_over_gain():
    loop = rig(coulomb=0.0)
    record = simulate(ARM, loop, plain(0.01), STILL, duration=3.0)
    sag = ARM.h(record.true_q[-1], (0, 0)) / GAIN
    # Goals and counts are whole numbers.
    np.testing.assert_allclose(record.error_pulses[-100:].mean(axis=0), sag, atol=1.0)


@pytest.mark.parametrize("inner", ["servo", MitDrive(kp=10.0, kd=0.5)])
def test_clamping_integrates_where_goals_and_frames_round_the_torque(inner):
    law = PID(
        gain=(0.002, 0.002),
        derivative=(0, 0),
        integral=(0.05, 0.05),
        filter=600.0,
        period=0.01,
        anti_windup="clamping",
    )
    record = simulate(ARM, rig(inner=inner, coulomb=0.0), law, STILL, duration=2.0)
    np.testing.assert_allclose(record.error_pulses[-20:], 0, atol=1)


def test_feed_forward_takes_the_sag_and_the_lag_away():
    loop = rig()
    behind = simulate(ARM, loop, plain(0.01), FAST).error_pulses
    law = FeedForward(ARM, loop, feedback=plain(0.01))
    ahead = simulate(ARM, loop, law, FAST).error_pulses
    assert np.abs(behind).max(axis=0).min() > 30
    assert np.abs(ahead).max() <= 3


@pytest.mark.parametrize("frequency", [50, 100, 200])
def test_computed_torque_through_a_servo_follows_within_two_counts(frequency):
    # The servo's gain, friction and masses differ from what the law believes.
    believed = rig(1 / frequency)
    true = rig(1 / frequency, PositionServo(gain=0.95 * GAIN), coulomb=0.06, viscous=1.05 * VISCOUS)
    heavy = dynamics().arm(1.02 * dynamics().f())
    law = ComputedTorque(ARM, believed)
    report = evaluate(heavy, true, law, FAST, duration=6.0)
    assert report.max_true_error_pulses.max() < (3.0 if frequency == 50 else 2.0)
    counts = evaluate(heavy, true, plain(1 / frequency), FAST, duration=6.0)
    assert counts.max_true_error_pulses.max() > 25


def test_both_backends_run_the_two_rates_alike():
    loop = rig(1 / 30)
    law = ComputedTorque(ARM, loop)
    by_kernel, by_casadi = (
        simulate(ARM, loop, law, FAST, duration=1.0, backend=backend)
        for backend in ("numba", "casadi")
    )
    np.testing.assert_array_equal(by_kernel.error_pulses, by_casadi.error_pulses)
    np.testing.assert_allclose(by_kernel.torque, by_casadi.torque, atol=1e-9)


def test_linear_loops_lose_stability_where_the_simulated_arm_does():
    # Counts so fine and joints so free that the simulated loop is nearly the linear one.
    fine = rig(inner=PositionServo(gain=GAIN / 1000), coulomb=0.0)
    encoder = dataclasses.replace(fine.encoder, resolution=1000 * fine.encoder.resolution)
    fine = dataclasses.replace(fine, encoder=encoder)
    path = PointToPoint(start=(0.3, 0.2), goal=(0.4, 0.1), duration=0.5)
    for bandwidth, stable in ((60.0, True), (200.0, True), (400.0, False)):
        law = ComputedTorque(ARM, fine, bandwidth=bandwidth, start_boost=1.0, dead_zone=0.0)
        assert (SampledLoops(ARM, fine, law, (0.3, 0.2)).unstable_pole() is None) == stable
        worst = evaluate(ARM, fine, law, path, duration=1.5).max_true_error_pulses.max() / 1000
        assert (worst < 0.1) == stable


# -- the servo's own loop --------------------------------------------------------------------------
def torque_of(servo, errors, period=1e-3):
    """Motor torques (N, 2) of a servo on a sequence of goal minus count, counts at 0."""
    block = servo.block(rig(period, None))
    state = block.initial
    torques = []
    for error in errors:
        goal = np.full(2, float(error))
        torque, state = block.step(
            state, 0, 0, 0, goal, np.zeros(2), np.zeros(2), period, block.values
        )
        torques.append(torque.full()[:, 0])
    return np.array(torques)


def test_dead_zone_and_start_of_a_servo():
    servo = PositionServo(gain=0.5, dead_zone=2, start=3.0)
    torque = torque_of(servo, (-10, -3, -2, 0, 2, 3, 5, 7))
    expected = [-5, -3, 0, 0, 0, 3, 3, 3.5]
    np.testing.assert_allclose(torque, np.column_stack([expected, expected]))


def test_a_servo_s_law_begins_by_the_method_of_all_laws(tmp_path):
    """Its `start` is a torque; in a control script it is a P controller with that torque."""
    servo = PositionServo(gain=GAIN, start=0.2, period=0.01)
    below = rig(inner=None)
    counts = below.counts((0.3, -0.2))
    running = Law.start(servo, below, counts, guards=None)
    goal = below.cell_centre(counts + np.array([2, -20]))
    torque = running.step(counts, goal, np.zeros(2), np.zeros(2))
    assert torque == pytest.approx([0.2, -20 * GAIN])
    to_fmu(servo, tmp_path / "servo.fmu", below)
    assert (tmp_path / "servo.fmu").stat().st_size > 0


def test_goal_inside_a_servo_moves_at_its_speed():
    servo = PositionServo(gain=1.0, speed=1000.0)
    torque = torque_of(servo, (0, 5, 5, 5, -3))
    np.testing.assert_allclose(torque[:, 0], [0, 1, 2, 3, 2])


def test_supply_scales_gain_and_damping():
    low = torque_of(PositionServo(gain=1.0, supply=0.9), (4,))
    np.testing.assert_allclose(low, 3.6)


# -- frames ----------------------------------------------------------------------------------------
def drive(**fields):
    return MitDrive(kp=(40.0, 20.0), kd=(2.0, 1.0), **fields)


def test_for_arm_follows_the_rule_within_the_fields():
    made = MitDrive.for_arm(ARM, rig(), stiffness=40, pose=(0.3, 0.2))
    inertia = 1 / np.diag(np.linalg.inv(ARM.D((0.3, 0.2))))
    step = 500 / (2**12 - 1), 5 / (2**12 - 1)
    for gain, rule, size in zip(
        (made.kp, made.kd), (40**2 * inertia, 1.4 * 40 * inertia), step, strict=True
    ):
        short = rule - gain
        assert short.min() >= 0
        assert short.max() <= size
    # A gain beyond its field: the whole pair becomes softer, with the same damping ratio.
    hard = MitDrive.for_arm(ARM, rig(), stiffness=1000, pose=(0.3, 0.2))
    assert hard.kd.max() <= 5
    assert hard.kp.max() <= 500
    w = hard.kd / (1.4 * inertia)
    np.testing.assert_allclose(hard.kp, w**2 * inertia, rtol=2e-3)


def for_arm(**options):
    options = {"limits": (12.5, 30, 5000, 500, 300)} | options
    return MitDrive.for_arm(ARM, rig(), **options)


def test_limits_and_bits_may_be_arrays():
    limits, bits = (12.5, 30.0, 500.0, 5.0, 10.0), (16, 12, 12, 12, 12)
    made = drive(limits=np.array(limits), bits=np.array(bits))
    assert made == drive(limits=limits, bits=bits)
    by_joint = np.array(limits)[:, None] * (1, 2)
    assert drive(limits=by_joint).limits[0] == (12.5, 25.0)
    given = for_arm(stiffness=20, bits=np.array(bits))
    assert given == for_arm(stiffness=20)


@settings(max_examples=25, deadline=None)
@given(
    q=st.floats(-3, 3), qd=st.floats(-5, 5), torque=st.floats(-5, 5), count=st.integers(-999, 999)
)
def test_frames_are_rounded_fields_that_add_up_to_the_torque(q, qd, torque, count):
    loop = rig(0.002, drive())
    law = FeedForward(ARM, loop, feedback=plain(0.002))
    running = law.start(loop, (count, count), guards=None)
    running.step((count, count), (q, q), (qd, qd), (0, 0))
    angle, speed, kp, kd, tau = running.frame
    ends = np.array([12.5, 30, 10])
    bits = np.array([16, 12, 12])
    places = (np.array([angle, speed, tau]) + ends[:, None]) / (2 * ends / (2.0**bits - 1))[:, None]
    np.testing.assert_allclose(places, np.round(places), atol=1e-6)
    np.testing.assert_array_equal(kp, (40, 20))
    np.testing.assert_array_equal(kd, (2, 1))
    # Beside the reference in the middle of the period: what the law asks for, to half a step.
    total = kp * (angle - q - 0.001 * qd) + kd * (speed - qd) + tau
    wanted = ARM.h((q, q), (qd, qd)) + loop.drive.friction(np.array([qd, qd]))
    assert np.abs(total - wanted).max() <= 0.5 * 20 / (2**12 - 1) + 1e-9


def test_goals_are_whole_counts_at_most_the_torque_limit_away():
    loop = rig()
    law = ComputedTorque(ARM, loop)
    running = law.start(loop, loop.counts((0.3, 0.2)))
    np.testing.assert_array_equal(running.goal, loop.counts((0.3, 0.2)))
    running.step(loop.counts((0.3, 0.2)), (0.3, 0.2), (0, 0), (0, 0))
    sag = ARM.h((0.3, 0.2), (0, 0)) / GAIN
    assert running.goal.dtype.kind == "i"
    np.testing.assert_allclose(running.goal - (0.3 * PER_RADIAN, 0.2 * PER_RADIAN), sag, atol=1.01)
    # A joint that is held 400 counts away gets no goal beyond the limit of its torque.
    away = loop.counts((0.3, 0.2)) - 400
    free = law.start(loop, away, guards=None)
    free.step(away, (0.3, 0.2), (0, 0), (0, 0))
    assert np.abs(free.goal - away).max() <= np.ceil(3.35 / GAIN)


def test_servo_holds_where_the_law_lets_go():
    # Counts that go on jumping stop the law; the servo keeps the joint where it was.
    loop = rig()
    begin = loop.counts((0.3, 0.2))
    held = {}
    for stop in ("gravity", "zero"):
        running = ComputedTorque(ARM, loop).start(loop, begin, guards=Guards(stop=stop))
        for k in range(40):
            running.step(begin + 500 * max(0, k - 5) ** 2, (0.3, 0.2), (0, 0), (0, 0))
        assert running.stopped
        held[stop] = running.goal
    sag = ARM.h((0.3, 0.2), (0, 0)) / GAIN
    np.testing.assert_allclose(held["gravity"], begin + sag, atol=2)
    np.testing.assert_allclose(held["zero"], running.pulses, atol=2)


# -- refusals --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PositionServo(gain=0.0), "gain must be positive"),
        (lambda: PositionServo(gain=(0.1, 0.2, 0.3)).block(rig(inner=None)), "2 joints"),
        (lambda: rig(period=5e-4), "at least that of its inner loop, 0.001 s"),
        (lambda: P(gain=(1, 1)).block(rig()), "P is fast hardware"),
        (lambda: LoggedTorque().block(rig()), "repeats the motors' own torque"),
        (lambda: PositionServo(gain=1.0).block(rig()), "is such a loop itself"),
        (lambda: ComputedTorque(ARM, rig(inner=None)).block(rig()), "the same inner loop, none"),
        (lambda: ComputedTorque(ARM, rig()).block(rig(inner=None)), "PositionServo; got none"),
        (lambda: drive(limits=(12.5, 30, 500, 1, 10)), "kd must fit its field, which ends at 1"),
        (lambda: drive(limits=(12.5, 30)), "limits must be five"),
        (lambda: drive(bits=(16, 12, 12, 12, 1)), "bits of tau"),
        (lambda: MitDrive(kp=500.0001, kd=1), r"ends at 500\.0; got 500\.0001 at joint 0"),
        (lambda: MitDrive(kp=0.05, kd=1), r"kp .* step is 0\.1221; got 0\.05 at joint 0"),
        (lambda: MitDrive(kp=(40, 20), kd=(1, 5e-4)), r"kd .* step is 0\.001221; .* at joint 1"),
        (lambda: for_arm(stiffness=0.3), r"kp .* step is 1\.221; got 0\.\d+ at joint 0"),
        (lambda: for_arm(stiffness=20, bits=(16, 12)), "bits must be five"),
        (lambda: for_arm(stiffness=20, bits=None), "bits must be five"),
        (
            lambda: for_arm(stiffness=20, limits=(9, 9, (9, 9, 9), 9, 9)),
            "kp must have 2 joints; got 3",
        ),
        (lambda: MitDrive(kp=1, kd=1, limits=None), "limits must be five"),
        (lambda: MitDrive(kp=1, kd=1, limits=np.ones((3, 2))), "limits must be five"),
        (lambda: drive(limits=((), 30, 500, 5, 10)), "limits of q must not be empty"),
        (lambda: drive(limits=(12.5, 30, 500, 5, (9, 9, 9))), "limits of tau must have 2 joints"),
        (
            lambda: MitDrive(kp=1, kd=1, limits=((1, 2, 3), 30, 500, 5, (9, 9))),
            "limits of tau must have 3 joints; got 2",
        ),
        (
            lambda: rig(inner=MitDrive(kp=1, kd=1, limits=(12.5, 30, 500, 5, (9, 9, 9)))),
            r"inner\.limits of tau must have 2 joints; got 3",
        ),
        (lambda: drive(period=0.0), "period must be a positive number; got 0"),
        (lambda: PositionServo(gain=1.0, period=-1e-3), "period must be a positive number"),
        (lambda: ComputedTorque(ARM, rig()).start(rig(), (0, 0)).frame, "take running.goal"),
    ],
)
def test_refusals_of_inner_loops(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "target",
    [
        lambda law, loop, folder: law.to_c(folder, loop),
        lambda law, loop, folder: law.to_c(folder, loop, guards=None),
        lambda law, loop, folder: to_control(law, loop),
        lambda law, loop, folder: to_control(ARM, loop, sampled=True),
    ],
)
def test_targets_that_take_torques_alone_refuse_goals(target, tmp_path):
    loop = rig()
    with pytest.raises(ValueError, match="has an inner loop"):
        target(ComputedTorque(ARM, loop), loop, tmp_path)
    assert not list(tmp_path.iterdir())


def test_torque_rig_has_no_goal():
    loop = rig(inner=None)
    running = ComputedTorque(ARM, loop, bandwidth=30).start(loop, (0, 0))
    with pytest.raises(ValueError, match="goal needs a rig with an inner loop"):
        _ = running.goal


# -- delay, certification, logs --------------------------------------------------------------------
def test_stated_delay_of_goals_is_made_up_for():
    late = Transport(delay=0.01)
    move = PointToPoint(start=(0.3, -0.2), goal=(1.3, -1.2), duration=1.2)
    worst = {}
    for name, known in {"unknown": rig(), "stated": rig(transport=late)}.items():
        ahead = FeedForward(ARM, known, feedback=plain(0.01))
        runs = (
            evaluate(ARM, rig(transport=late), law, move, duration=2.0)
            for law in (ahead, ComputedTorque(ARM, known))
        )
        worst[name] = [run.max_true_error_pulses.max() for run in runs]
    # Without feedback a goal that is 10 ms late is 10 counts behind, at 1.6 rad/s.
    assert worst["unknown"][0] > 8
    assert worst["stated"][0] < 3
    # The observer makes up for most of what it is not told.
    assert worst["unknown"][1] < 3
    assert worst["stated"][1] < 2


def test_certificate_of_goals_counts_the_servo_s_gain():
    loop = rig()
    stated = Uncertainty(covariance=np.diag((0.01 * dynamics().f()) ** 2), friction=0.02)
    certificate = certify(
        ARM, loop, ComputedTorque(ARM, loop), FAST, stated, samples=20, within=2, progress=False
    )
    peak = np.asarray(certificate.runs.peak)
    assert peak.shape == (20, 2)
    assert 0 < np.median(peak) <= 2
    # Motions for such arms are slower than their motors, and not all within a count.
    assert set(everyday_motions(ARM, loop))


def test_supply_of_the_servos_is_sampled_and_refused_without_servos():
    loop = rig()
    law = ComputedTorque(ARM, loop)
    options = {"samples": 20, "within": 2, "progress": False}
    peaks = {}
    for name, supply in {"as stated": (0.0, 0.0), "uncertain": (0.6, 1.4)}.items():
        stated = Uncertainty(covariance=np.diag((0.01 * dynamics().f()) ** 2), supply=supply)
        certificate = certify(ARM, loop, law, FAST, stated, **options)
        peaks[name] = np.median(certificate.runs.peak)
        words = "supply of the servos"
        assert any(words in text for text in certificate.plants.said[0]) == (name == "uncertain")
    assert peaks["uncertain"] > 1.2 * peaks["as stated"]
    plain_rig = rig(inner=None)
    with pytest.raises(ValueError, match="needs a rig with a PositionServo"):
        certify(
            ARM, plain_rig, ComputedTorque(ARM, plain_rig, bandwidth=30), FAST, stated, **options
        )


def test_record_of_goals_is_the_same_experiment_as_goals_from_above():
    # The law of a log is the inner loop of the rig: the record leaves it out of the rig.
    loop = rig()
    record = simulate(ARM, rig(inner=None), loop.inner, FAST)
    kept = dataclasses.replace(record, rig=loop, law=loop.inner)
    assert kept.rig == record.rig
    again = replay(ARM, kept)
    np.testing.assert_array_equal(again.error_pulses, record.error_pulses)


def test_identification_from_goals_and_counts_gives_the_torque_in_units_of_the_gain():
    # Twice the gain that the servo has: f and friction are twice as large, and nothing else.
    true = rig(inner=None)
    servo = PositionServo(gain=GAIN)
    path = Harmonics(
        period=10.0,
        offset=(0.3, -0.2),
        cosine=((0.2, -0.1, 0.1), (0.1, 0.2, -0.2)),
        sine=((0.3, 0.2, -0.2), (-0.3, 0.2, 0.2)),
    )
    record = simulate(ARM, true, servo, path)
    unknown = [
        *dynamics().names, *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1))
    ]  # fmt: skip
    doubled = dataclasses.replace(
        record, law=PositionServo(gain=2 * GAIN), torque=None, current=None
    )
    found = identify(dynamics(), doubled, unknown=unknown, progress=False)
    np.testing.assert_allclose(found.rig.drive.viscous, 2 * VISCOUS, rtol=0.05)
    np.testing.assert_allclose(found.rig.drive.coulomb, 2 * 0.052, rtol=0.1)
    assert found.rig.inner == found.law
    # The goals that its computed torque sends are those of the true gain.
    law = ComputedTorque(found)
    report = evaluate(ARM, rig(), law, FAST, duration=4.0)
    assert report.max_true_error_pulses.max() < 2
