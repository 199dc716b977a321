"""The computed-torque law: torque against inverse dynamics, poles against a closed form, and the law at work.

One-joint reasoning behind the closed form: with D-hat = D and no gravity the joints decouple into edd = -v, an exact
double integrator under a held v, so the loop of a joint has the five poles of error and observer; see `joint_loop`.
"""

import dataclasses
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ctc import ComputedTorque, evaluate
from plant import Harmonics, PointToPoint, Rig, puma560, simulate
from plant.mechanics.chain import Chain
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.link import Link
from plant.mechanics.lumping import Lumping
from plant.parts.plain import from_plain
from plant.simulation.closed_loop import ClosedLoop

RIG = puma560.rig()
LIMIT = RIG.drive.torque_limit()


@cache
def arm():
    return puma560.arm()


def drive(rig=RIG, **changes):
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **changes))


def smooth(rig=RIG):
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))


def law(rig=RIG, robot=None, **options):
    return ComputedTorque(robot or arm(), rig, **options)


def asked(controller, pulses, *motion, state=None):
    """Commanded torque of a law and its next state, by casadi: its symbolic step, before the amplifier."""
    block = controller.block(RIG)
    state = block.initial if state is None else state
    torque, following = block.step(
        state, *motion, RIG.counts(motion[0]), pulses, np.zeros(2), block.period, block.values
    )
    return torque.full().ravel(), following.full().ravel()


# -- torque ---------------------------------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None, derandomize=True)
def test_the_first_torque_is_inverse_dynamics_and_friction(seed):
    """On the reference (in the middle of the encoder's cell) nothing is fed back: tau = Y f + friction(qd_r).

    Tolerance: some hundred roundings of the largest term.
    """
    random = np.random.default_rng(seed)
    pulses = random.integers(-5000, 5000, 2)
    q, qd, qdd = RIG.cell_centre(pulses), random.normal(0, 0.5, 2), random.normal(0, 1, 2)
    b, c, k = RIG.drive.viscous, RIG.drive.coulomb, RIG.drive.gear
    expected = arm().inverse(q, qd, qdd) + b * k**2 * qd + c * abs(k) * np.sign(qd)
    expected = np.clip(expected, -LIMIT, LIMIT)
    np.testing.assert_allclose(law().start(RIG, pulses).step(pulses, q, qd, qdd), expected, rtol=0, atol=1e-10)
    unaided, _ = asked(law(friction=False), pulses, q, qd, qdd)
    np.testing.assert_allclose(unaided, arm().inverse(q, qd, qdd), rtol=0, atol=1e-10)


def test_the_amplifier_limits_what_is_given():
    asked = np.array([1e3, -1e4])
    qdd = np.linalg.solve(arm().D((0.0, 0.0)), asked)
    torque = law().start(RIG, (0, 0)).step((0, 0), (0.0, 0.0), (0.0, 0.0), qdd)
    np.testing.assert_array_equal(torque, LIMIT * (1, -1))
    np.testing.assert_allclose(RIG.drive.current(torque), (12, 12), rtol=1e-12)  # k3 < 0: both currents are positive


def test_with_a_smooth_encoder_and_the_true_f_the_error_is_next_to_nothing():
    """What is left is the hold: the torque of t_k acts until t_k + dt, an error of acceleration dt/2 times the jerk.

    The jerk of (6) is at most 32 rad/s^3 (joint 3: pi/4 (4 pi / 3.65)^3), with gravity and Coriolis terms of the same
    size: 0.02 rad/s^2, against a stiffness of bandwidth^2: 5e-7 rad = 0.005 pulse, and less where the observer has had
    time to see it. Coulomb friction is off, since the sign of the reference velocity is not that of the joint.
    """
    rig = smooth(drive(coulomb=(0.0, 0.0)))
    verdict = evaluate(arm(), rig, law(rig), puma560.reference(), steps_per_sample=4)
    assert verdict.max_true_error_pulses.max() < 0.005
    # The model earns it: with f 5 % off, the error is larger by far more than 5 %.
    verdict = evaluate(
        arm(), rig, law(rig, puma560.dynamics().arm(1.05 * arm().f)), puma560.reference(), steps_per_sample=4
    )
    assert verdict.max_true_error_pulses.max() > 0.05


# -- poles ----------------------------------------------------------------------------------------------------------
def linearised(robot, period, **options):
    """Spectrum of the simulator's own law step and sub-step about a pose, without friction, boost spent."""
    rig = smooth(drive(Rig(drive=RIG.drive, encoder=RIG.encoder, period=period), coulomb=(0, 0), viscous=(0, 0)))
    loop = ClosedLoop(dynamics=robot.dynamics, rig=rig, law=law(rig, robot, **options), steps_per_sample=1, smooth=True)
    names = (loop.state_names, loop.time_names, loop.number_names)
    state, time, numbers = (ca.SX.sym("x", len(each)) for each in names)
    following = loop.substep(loop.law_step(state, time, numbers), time, numbers)[0]
    slope = ca.Function("slope", [state, time, numbers], [ca.jacobian(following, state)])
    pose = np.array([0.3, -0.4])
    at_rest = loop.initial_state(pose, np.zeros(2))
    at_rest[max(i for i, name in enumerate(loop.state_names) if name.startswith("law["))] = 0.0
    row = np.concatenate([pose, np.zeros(4), rig.position_in_pulses(pose), [period]])
    return np.linalg.eigvals(slope(at_rest, row, loop.number_values(robot.f)).full())


def joint_loop(bandwidth, omega, dt):
    """Matrix (6, 6) of one joint: error, rate, their estimates, the estimated disturbance, and the last v.

    Written down by hand: the error is a double integrator of -v, sampled exactly; the observer predicts with the last v
    and corrects with gains for a triple pole z; v = bandwidth^2 e + 2 bandwidth edot + x3.
    """
    z = np.exp(-omega * dt)
    gains = np.array([1 - z**3, 1.5 * (1 - z) ** 2 * (1 + z) / dt, (1 - z) ** 3 / dt**2])
    predicted = np.zeros((3, 6))
    predicted[:, 2:5] = [[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]]
    predicted[:, 5] = [-(dt**2) / 2, -dt, 0]
    corrected = predicted + np.outer(gains, np.eye(6)[0] - predicted[0])
    v = np.array([bandwidth**2, 2 * bandwidth, 1]) @ corrected
    loop = np.zeros((6, 6))
    loop[:2] = [[1, dt, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]] - np.outer([dt**2 / 2, dt], v)
    loop[2:5], loop[5] = corrected, v
    return loop


def weightless():
    """The published arm without gravity, which would add a stiffness of its own."""
    return puma560.dynamics().arm(np.where(np.isin(np.arange(9), (4, 5, 7, 8)), 0.0, puma560.PUBLISHED))


@pytest.mark.parametrize("period", [0.7e-3, 2e-5])
@pytest.mark.parametrize(("bandwidth", "ratio"), [(250.0, 1.5), (120.0, 4.0)])
def test_the_closed_loop_is_two_such_joints(period, bandwidth, ratio):
    """All poles: two joints, the boost, the score and the flag (held), and memory that does not last.

    Compared by the coefficients of the characteristic polynomial, which are well conditioned where multiple poles are
    not: some hundred roundings of coefficients up to 2,000.
    """
    joint = np.linalg.eigvals(joint_loop(bandwidth, ratio * bandwidth, period))
    got = linearised(weightless(), period, bandwidth=bandwidth, observer_ratio=ratio, start_time=0.02)
    known = np.concatenate([joint, joint, [np.exp(-period / 0.02), 1.0, 1.0]])
    expected = np.concatenate([known, np.zeros(len(got) - len(known))])
    np.testing.assert_allclose(np.poly(got), np.poly(expected), rtol=0, atol=1e-9)


def test_the_poles_are_as_designed_for_a_short_period():
    """At 20 us: a double pole at 200 rad/s per joint, a triple one at 400. The hold of v is a delay of dt / 2.

    A double pole splits by the square root of what such a delay does, bandwidth sqrt(bandwidth dt) = 13 rad/s, about a
    mean that holds within bandwidth dt = 0.4 %.
    """
    spectrum = linearised(weightless(), 2e-5, bandwidth=200.0, observer_ratio=2.0, start_time=0.02)
    poles = np.log(np.array([z for z in spectrum if np.exp(-450 * 2e-5) < abs(z) < np.exp(-100 * 2e-5)])) / 2e-5
    assert len(poles) == 10
    poles = poles[np.argsort(-poles.real)]
    assert poles[:4].mean().real == pytest.approx(-200, rel=0.01)
    np.testing.assert_allclose(poles[:4], -200, atol=13)
    # A triple pole moves by the cube root of roundings (1e-5 here, of z, over dt).
    np.testing.assert_allclose(poles[4:], -400, atol=2)


# -- the law in a control script ------------------------------------------------------------------------------------
def replay(controller, record, start=0, running=None):
    """Feed a record's pulses to a running controller; torques (N, n)."""
    motion, pulses = record.reference(record.t), record.reference_pulses - record.error_pulses
    running = running or controller.start(record.rig, pulses[start])
    return np.array([running.step(pulses[k], *(x[k] for x in motion)) for k in range(start, len(record))]), running


@pytest.mark.parametrize("options", [{}, {"delay": 1}], ids=["law", "delayed"])
def test_the_running_controller_gives_the_torque_of_the_simulation(options):
    """At every sample, to rounding (1e-12 of the largest torque); the same after describe and restore."""
    controller = law(**options)
    backend = "casadi" if options else "numba"  # the delayed loop is not compiled for this test alone
    record = evaluate(arm(), RIG, controller, puma560.reference(), duration=1.0, backend=backend).record
    assert np.abs(np.diff(record.torque, axis=0)).max() > 10
    for each in (controller, from_plain(controller.describe())):
        torque, running = replay(each, record)
        np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max())
        np.testing.assert_array_equal(running.torque, torque[-1])


def test_a_running_p_controller_is_gear_times_gain_times_error():
    record = simulate(arm(), RIG, puma560.p_law(), puma560.reference(), duration=0.5, steps_per_sample=16)
    torque, _ = replay(puma560.p_law(), record)
    np.testing.assert_allclose(torque, RIG.drive.gear * (0.20, 0.15) * record.error_pulses, rtol=1e-14)
    np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max())


def test_a_refused_call_changes_nothing():
    record = evaluate(arm(), RIG, law(), puma560.reference(), duration=0.1, backend="numba").record
    undisturbed, _ = replay(law(), record)
    running = law().start(RIG, (0, 0), guards=None)
    motion, pulses = record.reference(record.t), record.reference_pulses - record.error_pulses
    for k in range(len(record)):
        before = (running.state.copy(), running.torque.copy(), running.pulses.copy())
        for bad in (
            (pulses[k] + 0.5, *(x[k] for x in motion)),
            (pulses[k], motion.q[k], np.full(2, np.nan), motion.qdd[k]),
            (pulses[k], motion.q[k], motion.qd[k], motion.qdd[k][None]),
            (pulses[k][:1], *(x[k] for x in motion)),
        ):
            with pytest.raises(ValueError):  # noqa: PT011 - the messages have a test of their own
                running.step(*bad)
        for now, then in zip((running.state, running.torque, running.pulses), before, strict=True):
            np.testing.assert_array_equal(now, then)
        torque = running.step(pulses[k], *(x[k] for x in motion))
        np.testing.assert_array_equal(torque, undisturbed[k])


def test_the_torque_handed_out_is_the_users_own():
    running = law().start(RIG, (0, 0))
    torque = running.step((0, 0), (0, 0), (0.1, 0.1), (0, 0))
    kept = running.torque.copy()
    torque[:] = np.nan
    np.testing.assert_array_equal(running.torque, kept)


def test_two_running_controllers_do_not_share_state():
    controller = law()
    one, other = controller.start(RIG, (0, 0)), controller.start(RIG, (0, 0))
    first = one.step((3, -2), (0, 0), (0, 0), (0, 0))
    one.step((5, -9), (0, 0), (0, 0), (0, 0))
    np.testing.assert_array_equal(other.step((3, -2), (0, 0), (0, 0), (0, 0)), first)


# -- options --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("options", [{"delay": 1}, {"measured": True}, {"delay": 1, "measured": True}], ids=str)
def test_options_run_and_track(options):
    """Within 3 pulses ("a few"): the delayed loop has less phase margin, the measured model some noise."""
    verdict = evaluate(arm(), RIG, law(**options), puma560.reference(), steps_per_sample=4)
    assert verdict.within(3)
    assert verdict.fraction_within(1) > 0.98


def test_a_delayed_torque_acts_one_sample_later():
    """The first torque of a delayed law is nothing, held back at the start; the second what it commanded first."""
    pulses = np.array([100, -200])
    arguments = (pulses, RIG.cell_centre(pulses), (0.3, -0.2), (1.0, 2.0))
    at_once, _ = asked(law(), *arguments)
    first, state = asked(law(delay=1), *arguments)
    second, _ = asked(law(delay=1), *arguments, state=state)
    np.testing.assert_array_equal(first, 0)
    np.testing.assert_allclose(second, at_once, rtol=0, atol=1e-10)


# -- the start -------------------------------------------------------------------------------------------------------
def torques(controller, path, samples=20):
    """Torques (samples, n) of a running law, at counts that are up to two off their reference."""
    motion = path(controller.rig.period * np.arange(samples))
    counts = RIG.counts(motion.q) + np.array([1, -2])
    running = controller.start(controller.rig, counts[0], guards=None)
    return np.array([running.step(at, *row) for at, *row in zip(counts, *motion, strict=True)])


def test_an_observer_begins_faster_only_where_the_reference_begins_at_once():
    """Without acceleration as without a boost, along trajectory (6) with all of it, in between with a part."""
    gentle = PointToPoint(start=(0, 0), goal=(0.5, -0.4), duration=1.0)
    np.testing.assert_array_equal(torques(law(), gentle), torques(law(start_boost=1), gentle))
    motion = RIG.position_in_pulses(puma560.reference()(np.zeros(1)).qdd[0] * 0.02**2 / 2)
    assert np.abs(motion).max() > 8
    kinds = [law(start_boost=1), law(), law(start_boost=3, start_time=1e-3)]
    plain, boosted, brief = (torques(each, puma560.reference()) for each in kinds)
    assert np.abs(boosted - plain).max() > 10 * np.abs(brief - plain).max() > 0


def test_what_the_observer_begins_with_follows_the_first_reference_alone():
    """Half of eight pulses within start_time: half of the boost is left after it, over e; whatever comes then."""
    block, pulse = law().block(RIG), RIG.to_angle(np.ones(2))
    state = block.initial
    for k in range(20):
        qdd = pulse * 4 / (0.02**2 / 2) if k == 0 else np.ones(2)
        _, state = asked(law(), RIG.counts(np.zeros(2)), np.zeros(2), np.zeros(2), qdd, state=state)
    assert state[-1] == pytest.approx(0.5 * np.exp(-20 * RIG.period / 0.02), rel=1e-12)
    _, moving = asked(law(), RIG.counts(np.zeros(2)), np.zeros(2), pulse * (8 / 0.02), np.zeros(2))
    assert moving[-1] == pytest.approx(np.exp(-RIG.period / 0.02), rel=1e-12)


def test_measured_and_reference_agree_on_the_reference():
    """On the path both models are evaluated at one point, so the first torque is the same."""
    pulses = np.array([321, -1234])
    arguments = (pulses, RIG.cell_centre(pulses), (0.3, -0.2), (1.0, 2.0))
    torques = [asked(law(measured=measured), *arguments)[0] for measured in (False, True)]
    np.testing.assert_allclose(torques[1], torques[0], rtol=0, atol=1e-10)


def test_friction_feed_forward_is_worth_its_place():
    """FINDINGS 10: without it the loop leaves ±1 pulse where the motion turns back."""
    without = evaluate(arm(), RIG, law(friction=False), puma560.reference(), steps_per_sample=4)
    assert not without.within(1)
    assert without.fraction_within(1) > 0.95


def test_the_observer_knows_what_the_amplifier_cut_off():
    """Started 0.02 rad (270 pulses) off, the loop saturates; the error must come back without wind-up.

    At 295 N m on some 7 kg m^2 it takes 30-40 ms to turn round and come back, and five time constants of the bandwidth
    (23 ms) to settle: within a pulse from 0.07 s on, and no overshoot on the way beyond the last few pulses.
    """
    start = [[0.02, -0.02], [0.0, 0.0]]
    verdict = evaluate(arm(), RIG, law(), puma560.reference(), duration=0.3, initial=start, backend="numba")
    assert (np.abs(verdict.record.torque[:20]) >= LIMIT * (1 - 1e-12)).all(axis=1).any()
    error = verdict.record.error_pulses * np.sign(verdict.record.error_pulses[0])
    assert (error[0] > 150).all()
    assert error.min() >= -5
    assert np.abs(error[100:]).max() <= 1


# -- what cannot be ------------------------------------------------------------------------------------------------
def test_an_arm_that_no_feedback_stabilises_is_refused():
    """D(q) positive, but not above the motors' own inertia at every q: f1 just below Jm_min k3^2 = 0.288."""
    f = puma560.PUBLISHED.copy()
    f[1:4] = 0.0
    f[0] = 1e-4 * 53.7**2 - 1e-6
    with pytest.raises(ValueError, match="falls short by 1e-06") as refusal:
        law(robot=puma560.dynamics().arm(f))
    assert "\n" not in str(refusal.value)
    f[0] = 1e-4 * 53.7**2 + 1e-6
    law(robot=puma560.dynamics().arm(f))
    # Indefinite only where the elbow is straight or folded (q3 = 0, pi), sound in between.
    f = puma560.PUBLISHED.copy()
    f[2:4] = 2.5, 0.0
    assert np.linalg.eigvalsh(puma560.dynamics().arm(f).D([0.0, np.pi / 2]))[0] > 1.2
    with pytest.raises(ValueError, match="Identify again"):
        law(robot=puma560.dynamics().arm(f))


def one_joint_rig():
    full = RIG.drive
    names = (field.name for field in dataclasses.fields(full) if "number" in field.metadata)
    numbers = {name: getattr(full, name)[:1] for name in names}
    encoder = dataclasses.replace(RIG.encoder, resolution=(800,))
    return Rig(drive=dataclasses.replace(full, **numbers), encoder=encoder, period=RIG.period)


def one_joint_arm():
    chain = Chain(links=(Link(name="1", alpha=0.0, a=0.0, d=0.0),))
    lumping = Lumping.from_equation(lambda link: {"J": link.J + link.Izz + link.m * link.x**2 + link.m * link.y**2},
                                    links=1, inertial=("J",), gravitational=())  # fmt: skip
    return Dynamics(chain=chain, lumping=lumping).arm([2.0])


def running():
    return law().start(RIG, (0, 0))


Q, QD, QDD = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: law(bandwidth=np.nan), "bandwidth"),
        (lambda: law(bandwidth=-200.0), "bandwidth must be positive; got -200"),
        (lambda: law(bandwidth=0), "bandwidth must be positive"),
        (lambda: law(bandwidth=np.inf), "bandwidth"),
        (lambda: law(bandwidth=(200.0, 200.0)), "one number"),
        (lambda: law(bandwidth="fast"), "bandwidth"),
        (lambda: law(observer_ratio=-1), "observer_ratio"),
        (lambda: law(start_boost=0), "start_boost"),
        (lambda: law(start_time=-1e-3), "start_time"),
        (lambda: law(delay=2), "delay must be 0 or 1"),
        (lambda: law(delay=-1), "delay must be 0 or 1"),
        (lambda: law(bandwith=200.0), "Did you mean 'bandwidth'"),
        (lambda: law(observer=4), "Did you mean 'observer_ratio'"),
        (lambda: law(one_joint_rig()), "equal joints"),
        (lambda: ComputedTorque(one_joint_arm(), RIG), "equal joints"),
        (lambda: ComputedTorque(RIG, arm()), "must be of type Arm; got a value of type Rig"),
        (lambda: ComputedTorque(arm().f, RIG), "must be of type Arm; got a value of type ndarray"),
        (lambda: law().start(RIG, (0.5, 0)), "whole encoder counts"),
        (lambda: law().start(RIG, (0, 0, 0)), r"pulses must have shape \(2,\); got shape \(3,\)"),
        (lambda: running().step((1.5, 0), Q, QD, QDD), "whole encoder counts"),
        (lambda: running().step((np.nan, 0), Q, QD, QDD), "pulses.*index 0|pulses.*0"),
        (lambda: running().step((0, 0), (0, np.nan), QD, QDD), "q_r.*1"),
        (
            lambda: running().step((0, 0), (0, 2e5), QD, QDD),
            r"q_r must be below 100000 rad; got .* Take whole turns off",
        ),
        (lambda: running().step((0, 0), Q, (np.inf, 0), QDD), "qd_r.*0"),
        (lambda: running().step((0, 0), Q, QD, (None, 0)), "qdd_r"),
        (lambda: running().step((0, 0), np.zeros((2, 1)), QD, QDD), r"q_r must have shape \(2,\); got shape \(2, 1\)"),
        (lambda: running().step((0, 0), 0.0, QD, QDD), "q_r must have shape"),
        (lambda: law().start(one_joint_rig(), (0,)), "rig must have 2 joints"),
        (lambda: evaluate(one_joint_arm(), one_joint_rig(), law(), still()), "rig must have 2 joints"),
        (lambda: evaluate(arm(), one_joint_rig(), law(), still()), "rig must have 2 joints"),
        (lambda: evaluate(arm(), RIG, law(), still()), "reference must have 2 joints"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def still():
    return Harmonics(period=0.1, offset=(0.0,), cosine=((0.0,),), sine=((0.0,),))
