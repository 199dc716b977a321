"""The running controller: its compiled core, what it costs, what it refuses, and guards and safe
stop by themselves.

What the guards do to an arm is in tests/ctc/laws/test_faults.py.
"""

import dataclasses
import gc
import tracemalloc

import casadi as ca
import numba
import numpy as np
import pytest
from closed_loops import Filtered, direct_rig
from numba.core.runtime import _nrt_python, rtsys

from plant import Cascade, Coupling, Guards, Law, PointToPoint, number, part, puma560
from plant.realtime import memory

RIG = puma560.rig()
LAW = Filtered(gain=(8.0, 6.0), rate=40.0, period=RIG.period)
LIMIT = RIG.drive.torque_limit()
ZERO = np.zeros(2)


@part
class Root(Law):
    """The torque sqrt(gain), NaN for a negative one, and the reference's acceleration as state."""

    period = None

    gain: np.ndarray = number(("n",))

    def initial_state(self, n):
        return np.zeros(n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return ca.sqrt(self.gain - setpoint.qdd), setpoint.qdd


def recorded(samples=400, seed=0):
    """Counts (N, 2) that follow a motion with an error of some pulses, and the motion."""
    path = PointToPoint(start=(0.1, -0.2), goal=(0.5, 0.1), duration=samples * RIG.period)
    motion = path(np.arange(samples) * RIG.period)
    error = np.random.default_rng(seed).integers(-3, 4, (samples, 2))
    return RIG.counts(motion.q) + error, motion


def run(running, counts, motion):
    return np.array([running.step(counts[k], *(x[k] for x in motion)) for k in range(len(counts))])


def step_all(step, memory, counts, q, qd, qdd, torques):
    """A user's own loop, to be compiled by numba."""
    for k in range(len(counts)):
        if step(counts[k], q[k], qd[k], qdd[k], np.nan, memory, torques[k]):
            return k
    return len(counts)


# -- the core ------------------------------------------------------------------------------------
def test_the_core_in_a_compiled_loop_gives_the_same_bits():
    """And twice: same inputs, same bits."""
    counts, motion = recorded()
    expected = run(LAW.start(RIG, counts[0]), counts, motion)
    loop = numba.njit(step_all)
    running, torques = LAW.start(RIG, counts[0]), np.empty_like(expected)
    assert loop(running.core.step, running.core.memory, counts, *motion, torques) == len(counts)
    np.testing.assert_array_equal(torques, expected)
    np.testing.assert_array_equal(running.torque, expected[-1])
    np.testing.assert_array_equal(run(LAW.start(RIG, counts[0]), counts, motion), expected)
    assert np.ptp(expected, axis=0).min() > 1.0


def test_guards_that_see_nothing_change_no_bit():
    counts, motion = recorded()
    guarded, bare = LAW.start(RIG, counts[0]), LAW.start(RIG, counts[0], guards=None)
    np.testing.assert_array_equal(run(guarded, counts, motion), run(bare, counts, motion))
    assert guarded.status == bare.status == "running"
    assert guarded.core.step is bare.core.step


def test_the_core_allocates_nothing():
    """By numba's own count, over a loop with a jump in it: 400 samples take what none take, for
    what is passed in.
    """
    counts, motion = recorded()
    counts[200] += 900
    running, torques = LAW.start(RIG, counts[0]), np.empty((len(counts), 2))
    loop, given = numba.njit(step_all), (counts, *motion, torques)
    loop(running.core.step, running.core.memory, *given)
    running.reset(counts[0])
    _nrt_python.memsys_enable_stats()
    try:
        marks = [rtsys.get_allocation_stats().alloc]
        for samples in (0, len(counts)):
            loop(running.core.step, running.core.memory, *(x[:samples] for x in given))
            marks.append(rtsys.get_allocation_stats().alloc)
        assert marks[1] > marks[0]
        assert marks[2] - marks[1] == marks[1] - marks[0]
    finally:
        _nrt_python.memsys_disable_stats()
    assert running.bridged == 1


def test_calls_from_python_leave_nothing_behind():
    """Besides the torque handed out, which is the caller's: 20,000 calls, less than a byte each."""
    running = LAW.start(RIG, (0, 0))
    counts = np.zeros(2, int)
    for _ in range(100):
        running.step(counts, ZERO, ZERO, ZERO)
    gc.collect()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(20_000):
            running.step(counts, ZERO, ZERO, ZERO)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 20_000


@pytest.mark.parametrize(
    "make", [list, tuple, lambda x: np.asarray(x, np.float32), lambda x: np.asarray(x)[::1]]
)
def test_arguments_of_any_kind_give_the_same(make):
    values = ((5, -3), (0.25, -0.5), (0.5, 1.0), (-1.0, 2.0))  # all exact in single precision
    expected = LAW.start(RIG, (0, 0)).step(*(np.array(v, float) for v in values))
    np.testing.assert_array_equal(LAW.start(RIG, (0, 0)).step(*map(make, values)), expected)


# -- limits --------------------------------------------------------------------------------------
def test_a_torque_limit_of_ones_own_is_told_to_the_law():
    """Filtered subtracts 0.02 of the torque applied last: the second torque shows which one it
    was told.
    """
    limit = np.array([40.0, 30.0])
    far = ((0, 0), (0.02, -0.02), (0, 0), (0, 0))
    running = LAW.start(RIG, (0, 0), torque_limit=limit, guards=None)
    np.testing.assert_allclose(running.step(*far), limit * (1, -1), rtol=1e-15)
    block = LAW.block(RIG)
    state = block.step(
        block.initial,
        *far[1:],
        RIG.counts(np.array(far[1])),
        far[0],
        ZERO,
        RIG.period,
        block.values,
    )[1]
    back = (RIG.counts(np.array(far[1])), *far[1:])
    expected = block.step(
        state, *far[1:], back[0], back[0], limit * (1, -1), RIG.period, block.values
    )[0]
    got = running.step(*back)
    inside = np.abs(expected.full().ravel()) < limit
    assert inside.any()
    np.testing.assert_allclose(got[inside], expected.full().ravel()[inside], rtol=1e-12)


def test_a_torque_limit_above_the_amplifiers_changes_nothing():
    far = ((0, 0), (0.5, -0.5), (0, 0), (0, 0))
    running = LAW.start(RIG, (0, 0), torque_limit=(1e9, np.inf), guards=None)
    np.testing.assert_allclose(np.abs(running.step(*far)), LIMIT, rtol=1e-12)


# -- guards and safe stop by themselves ----------------------------------------------------------
def test_a_law_without_a_torque_is_refused_or_stopped():
    """Without guards nothing changes; with them the torque goes to zero within a tenth of the
    duration.
    """
    good, bad = ((0, 0), ZERO, ZERO, ZERO), ((3, 4), ZERO, ZERO, (50.0, 50.0))
    law = Root(gain=(9.0, 16.0))
    bare = law.start(RIG, (0, 0), guards=None)
    bare.step(*good)
    with pytest.raises(ValueError, match="the law must give finite torques; it does not at pulses"):
        bare.step(*bad, now=1.0)
    for kept in ("pulses", "torque", "state"):
        np.testing.assert_array_equal(
            getattr(bare, kept), {"pulses": (0, 0), "torque": (3, 4), "state": ZERO}[kept]
        )
    np.testing.assert_array_equal(bare.step(*good, now=1.0), (3, 4))

    guarded = law.start(RIG, (0, 0), guards=Guards(duration=0.07))
    np.testing.assert_array_equal(guarded.step(*good), (3, 4))
    torques = np.array([guarded.step((0, 0), *bad[1:]) for _ in range(15)])
    share = 1 - np.minimum(1, np.arange(15) * RIG.period / 7e-3)
    np.testing.assert_allclose(torques, share[:, None] * (3, 4), atol=1e-12)
    assert guarded.status == "safe stop, ramp to zero: the law gives no finite torque, at call 2"
    guarded.reset((0, 0))
    np.testing.assert_array_equal(guarded.step(*good), (3, 4))
    assert guarded.status == "running"


def test_the_braking_of_a_stop_is_a_motion():
    """q, qd and qdd that the law is given belong together: from the speed at the stop to rest
    within the duration.

    Differences of q over a sample against the mean of qd: an error of dt^2/12 times the jerk, here
    6 qd / T^2.
    """
    running = LAW.start(RIG, (0, 0), guards=Guards(patience=0, duration=0.1))
    dt, speed = RIG.period, np.array([0.5, -0.25])
    nothing = np.full(2, np.nan)
    q = [dt * speed * 0]
    running.step((0, 0), q[0], speed, ZERO)
    rows = []
    for _ in range(160):
        running.step(RIG.counts(running.reference), nothing, nothing, nothing)
        rows.append([running.reference, running._row("qd"), running._row("qdd")])
    q, qd, qdd = np.array(rows).transpose(1, 0, 2)
    assert running.stopped
    np.testing.assert_allclose(qd[0], speed)
    slack = 2 * dt**2 * 6 * 0.5 / 0.1**2
    np.testing.assert_allclose(np.diff(q, axis=0) / dt, (qd[1:] + qd[:-1]) / 2, atol=slack)
    np.testing.assert_allclose(
        np.diff(qd, axis=0) / dt, (qdd[1:] + qdd[:-1]) / 2, atol=20 * slack / dt / 100
    )
    np.testing.assert_allclose(q[-1] - q[0], speed * 0.1 / 2, rtol=1e-12)
    np.testing.assert_array_equal(qd[-1], 0)


def test_a_bridged_reference_goes_on_with_its_acceleration():
    """Against the parabola itself, over three samples, to rounding; then the reference is back."""
    running, dt = LAW.start(RIG, (0, 0)), RIG.period
    speed, acceleration, nothing = (
        np.array([0.05, -0.02]),
        np.array([30.0, -40.0]),
        np.full(2, np.nan),
    )
    running.step((0, 0), ZERO, speed, acceleration)
    for k in (1, 2, 3):
        t = k * dt
        running.step((0, 0), nothing, speed, acceleration)
        np.testing.assert_allclose(
            running.reference, speed * t + acceleration * t**2 / 2, rtol=1e-12
        )
    running.step((0, 0), ZERO, ZERO, ZERO)
    np.testing.assert_array_equal(running.reference, 0)
    assert (running.bridged, running.stopped) == (3, False)


def test_a_late_call_is_told_to_the_law():
    """Against the law's own step over three periods, of which two were missed."""
    running, block = LAW.start(RIG, (0, 0)), LAW.block(RIG)
    running.step((0, 0), ZERO, ZERO, ZERO, now=10.0)
    state = running.state
    running.step((0, 0), ZERO, ZERO, ZERO, now=10.0 + 3 * RIG.period)
    assert running.status == "running; bridged a call that came 1.4 ms late at call 2"
    expected = block.step(state, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, 3 * RIG.period, block.values)[
        1
    ]
    np.testing.assert_allclose(running.state, expected.full().ravel(), rtol=1e-9)


def test_a_late_call_shows_a_cascade_the_speed_at_which_the_joint_moves():
    """Its torque is the speed over four samples, to half a pulse each, also over 3 + 3 periods."""
    options = {"position": (0, 0), "speed": (1e-4, 1e-4), "integral": (0, 0)}
    law = Cascade(difference=4, period=RIG.period, **options)
    running, now, speed = law.start(RIG, (0, 0)), 0.0, np.array([1.0, 0.0])
    for k in range(20):
        now += RIG.period * (3 if k == 19 else 1)
        q = speed * now
        torque = running.step(RIG.counts(q), q, speed, ZERO, now=now)
    assert running.bridged == 1
    expected = -1e-4 * RIG.position_in_pulses(speed)[0]
    half = 1e-4 / (4 * RIG.period)
    assert RIG.drive.motor_torque(torque)[0] == pytest.approx(expected, abs=half)


@pytest.mark.parametrize(("gain", "stops"), [(0.003, False), (0.2, True)])
def test_a_joint_that_its_friction_holds_is_not_stuck(gain, stops):
    """Counts stand still while the reference goes 60 pulses, under P: 19 N m on joint 2, or as much
    as there is.

    Static friction of 13.4 N m holds a joint over a band of 26.7 N m; the guard waits for 40.
    """
    running = puma560.p_law((gain, gain)).start(RIG, (0, 0))
    for pulses in range(60):
        running.step((0, 0), RIG.to_angle(np.array([pulses + 0.5, 0.0])), ZERO, ZERO)
    assert running.stopped == stops
    if stops:
        assert running.status.startswith(
            "safe stop, ramp to zero: the encoder of joint q[0] stands still"
        )


def test_a_stop_at_the_arm_begins_with_the_law_as_new():
    """State after the call that stops: one step of the law from its initial state, on the arm,
    with nothing applied.
    """
    counts, motion = recorded()
    running, block = LAW.start(RIG, counts[0]), LAW.block(RIG)
    run(running, counts[:50], [x[:50] for x in motion])
    leap = motion.q[50] + (0.2, 0.0)
    running.step(counts[50], leap, motion.qd[50], motion.qdd[50])
    assert running.status.startswith("safe stop, holding: joint q[0] is 27")
    q, qd, qdd = (running._row(name) for name in ("q", "qd", "qdd"))
    np.testing.assert_allclose(q, RIG.cell_centre(counts[50]), rtol=1e-12)
    # three pulses of noise a sample, smoothed: 0.1 rad/s
    np.testing.assert_allclose(qd, motion.qd[50], atol=0.2)
    given = (q, qd, qdd, RIG.counts(q), counts[50], ZERO, RIG.period, block.values)
    asked, following = (x.full().ravel() for x in block.step(block.initial, *given))
    np.testing.assert_allclose(running.torque, np.clip(asked, -LIMIT, LIMIT), rtol=1e-9)
    np.testing.assert_allclose(running.state, following, rtol=1e-9, atol=1e-12)


def test_a_stop_at_the_arm_begins_in_the_state_with_which_the_controller_began(tmp_path):
    """Two like stops, of controllers that began in different states: a step of each state."""
    torques = []
    for state in (np.zeros(len(LAW.initial_state(2))), np.full(len(LAW.initial_state(2)), 0.5)):
        running = LAW.start(RIG, (0, 0))
        running.step((0, 0), (1.0, 0), ZERO, ZERO)
        assert running.stopped
        running.begin(state)
        assert not running.stopped  # the stop is of the run before
        parts = memory.view(running.core.memory, 2, 0)
        np.testing.assert_array_equal(parts.initial, state)
        running.step((0, 0), (1.0, 0), ZERO, ZERO)
        torques.append(running.torque)
        running.reset((0, 0))
        np.testing.assert_array_equal(running.state, state)
        assert not running.stopped
        running.to_c(tmp_path, name="arm")
        assert (".initial = {0.5" in (tmp_path / "arm.c").read_text()) == state.any()
    assert (torques[0] != torques[1]).any()


def test_what_is_wrong_now_and_then_does_not_add_up():
    """Every third sample is wrong, in turn by a late call, by NaN and by a jump: bridged each,
    thirty of them.
    """
    running, now = LAW.start(RIG, (0, 0), guards=Guards(patience=1)), 0.0
    for k in range(91):
        wrong = k // 3 % 3 if k and k % 3 == 0 else None
        now += RIG.period * (2 if wrong == 0 else 1)
        pulses = (500, 0) if wrong == 2 else (0, 0)
        running.step(pulses, np.full(2, np.nan) if wrong == 1 else ZERO, ZERO, ZERO, now=now)
        np.testing.assert_array_equal(running.pulses, (0, 0))
        np.testing.assert_array_equal(running.reference, ZERO)
    assert running.bridged == 30
    assert not running.stopped


def test_what_is_wrong_twice_in_a_row_stops_with_a_patience_of_one():
    late, gap, jump = (LAW.start(RIG, (0, 0), guards=Guards(patience=1)) for _ in range(3))
    for k in range(3):
        late.step((0, 0), ZERO, ZERO, ZERO, now=2 * k * RIG.period)
        gap.step((0, 0), np.full(2, np.nan if k else 0.0), ZERO, ZERO)
        jump.step((k, 500 + k if k else 0), ZERO, ZERO, ZERO)
    assert late.status == "safe stop, holding: a call that came 0.7 ms late, at call 3"
    assert (
        gap.status
        == "safe stop, holding: a reference that is no finite position, 2 times in a row, at call 3"
    )
    assert (
        jump.status
        == "safe stop, holding: a jump of 502 pulses of joint q[1], 2 times in a row, at call 3"
    )


def test_a_counter_that_has_jumped_has_lost_counts_and_one_that_stands_there_is_not_held_by():
    moving, standing = (LAW.start(RIG, (0, 0), guards=Guards(patience=1)) for _ in range(2))
    for k in range(6):
        moving.step((0, 500 + k if k > 2 else k), ZERO, ZERO, ZERO)
        standing.step((0, 500 if k > 2 else 0), ZERO, ZERO, ZERO)
    assert "holding: a jump" in moving.status
    assert abs(moving.pulses[1] - 5) <= 2  # as if there had been no jump
    assert "ramp to zero: a jump of 500" in standing.status
    np.testing.assert_array_equal(standing.pulses, (0, 0))


def test_a_joint_with_an_unlimited_amplifier_may_jump_by_a_tenth_of_a_turn():
    rig = direct_rig((0.1,), (0.1,))
    jump, stuck, error, friction = Guards().limits(rig)[:, 0]
    turn = rig.encoder.resolution[0]
    np.testing.assert_allclose((jump, stuck, error, friction), (turn / 10, turn / 40, turn, 0.3))


def test_the_default_bound_for_jumps_is_what_the_amplifier_can_do():
    """By hand for joint 2: J = 2e-4 * 107.8^2 and 2e-4 * 53.7^2, torques 12 A each, 13,725
    pulses per radian.
    """
    (J2, J3), (t2, t3) = 2e-4 * np.array([107.8, 53.7]) ** 2, LIMIT
    added = (t2 / J2 + t3 / np.sqrt(J2 * J3)) * 0.7e-3**2
    assert Guards().limits(RIG)[0, 0] == pytest.approx(8 + 4 * added * 107.8 * 800 / (2 * np.pi))


def test_all_motors_hold_a_joint_whatever_the_signs_of_its_coupling():
    """In a differential both motors bear either joint: their levels add up, also as 1 - 1."""
    drive = dataclasses.replace(RIG.drive, coupling=Coupling(matrix=((1, 1), (1, -1))))
    rig = dataclasses.replace(RIG, drive=drive)
    friction, limit = drive.joint_coulomb().sum(), LIMIT.sum()
    np.testing.assert_allclose(Guards().limits(rig)[3], 3 * friction)
    np.testing.assert_allclose(Guards().rest_band(rig), max(2.2 * friction, 0.1 * limit))


@pytest.mark.parametrize("periods", [0.25, 5])
def test_the_bounds_of_a_sample_are_those_of_the_laws_period(periods):
    """A jump may grow with the square of the period, a speed of two pulses with its inverse."""
    rig = dataclasses.replace(RIG, period=periods * RIG.period)
    law = dataclasses.replace(LAW, period=rig.period)
    joints = memory.view(law.start(RIG, (0, 0)).core.memory, 2, 0).joints
    np.testing.assert_array_equal(joints["jump"], Guards().limits(rig)[0])
    np.testing.assert_array_equal(joints["slack"], Guards().slack(rig))


# -- what cannot be ------------------------------------------------------------------------------
def started(**options):
    return LAW.start(RIG, (0, 0), **options)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: started().step(), "step takes .*; pulses is missing"),
        (lambda: started().step((0, 0), ZERO, ZERO), "qdd_r is missing"),
        (lambda: started().step((0, 0), ZERO, ZERO, qddr=ZERO), "Did you mean 'qdd_r'"),
        (
            lambda: started().step((0, 0), ZERO, ZERO, ZERO, time=1.0),
            "an argument of step must be one of",
        ),
        (
            lambda: started().step((0, 0), ZERO, ZERO, ZERO, now="soon"),
            "now must be a number; got 'soon'",
        ),
        (lambda: started().step(np.array([0.5, 0]), ZERO, ZERO, ZERO), "whole encoder counts"),
        (lambda: started().step(np.array([np.inf, 0]), ZERO, ZERO, ZERO), "pulses must be finite"),
        (
            lambda: started().step(np.zeros(3), ZERO, ZERO, ZERO),
            r"pulses must have shape \(2,\); got shape \(3,\)",
        ),
        (lambda: started().step(np.zeros((2, 1)), ZERO, ZERO, ZERO), "pulses must have shape"),
        (
            lambda: started().step((0, 0), ZERO, ZERO, np.array([0, np.nan])),
            "qdd_r must be finite; got nan at index 1",
        ),
        (lambda: started(guards="none"), "guards must be of type Guards"),
        (lambda: started(guard=None), "Did you mean 'guards'"),
        (lambda: started(torque_limit=(1.0,)), "torque_limit must have shape"),
        (lambda: started(torque_limit=(1.0, 0.0)), "torque_limit must be positive"),
        (lambda: started(guards=Guards(jump=(1, 2, 3))), r"jump must have shape \(2,\)"),
        (
            lambda: started(guards=Guards(stop="gravity")),
            "law without an arm; got 'gravity' for Filtered",
        ),
        (lambda: Guards(stop="brake"), "stop must be one of"),
        (lambda: Guards(patience=1.5), "patience must be a whole number"),
        (lambda: Guards(error=-1), "error must be positive"),
        (lambda: Guards(error=np.nan), "error must be positive"),
        (lambda: Guards(late=(1, 2)), "late must be one number"),
        (lambda: Guards(duration=0), "duration must be a positive number"),
        (lambda: Guards(jumps=3), "Did you mean 'jump'"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def test_without_guards_a_clock_that_stands_still_is_refused_and_changes_nothing():
    running = started(guards=None)
    running.step((0, 0), ZERO, ZERO, ZERO, now=1.0)
    before = running.core.memory.copy()
    for now in (1.0, 0.5):
        with pytest.raises(ValueError, match="now must be finite and advance"):
            running.step((1, 1), ZERO, ZERO, ZERO, now=now)
    np.testing.assert_array_equal(running.core.memory, before)
    running.step((0, 0), ZERO, ZERO, ZERO, now=1.0 + RIG.period)
    assert running.status == "running"
