"""What a running controller makes of encoders, clocks and calls that lie, and of arguments that
cannot be.
"""

import dataclasses
import threading

import numpy as np
import pytest
from closed_loops import Filtered

from ctc import ComputedTorque
from plant import Guards, Limits, StatelessLaw, part, puma560, structure

RIG = puma560.rig()
DT, ZERO, LIMIT = RIG.period, np.zeros(2), RIG.drive.torque_limit()
LAW = Filtered(gain=(8.0, 6.0), rate=40.0, period=DT)


@part
class Played(StatelessLaw):
    """The reference's acceleration as torque."""

    period: float | None = structure(default=DT)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return setpoint.qdd, state


def played(torques, counts=None, **options):
    """Call of the stop, from 1, or None, and the controller."""
    running = Played().start(RIG, (0, 0), guards=Guards(**options))
    for k, torque in enumerate(torques):
        running.step(
            np.zeros(2) if counts is None else counts[k], ZERO, ZERO, np.array([torque, 0.0])
        )
        if running.stopped:
            return k + 1, running
    return None, running


# -- an encoder that dies at rest ----------------------------------------------------------------
def test_torque_beyond_friction_without_a_count_stops_at_rest():
    """Friction of 13.4 N m holds a band of 26.7: 60 N m of ramp leave a tenth more, without a
    reference.
    """
    ramp = np.minimum(60.0, 0.2 * np.arange(800))
    stop, running = played(ramp)
    assert "the encoder of joint q[0] stands still while its torque changed by" in running.status
    band = Guards().rest_band(RIG)[0]
    assert band == pytest.approx(max(2.2 * 13.367, 0.1 * LIMIT[0]), rel=1e-3)
    left = np.flatnonzero(ramp > band + 0.2 * 0.04 / DT)[0]  # what was asked when it had settled
    assert stop * DT < left * DT + 0.06


@pytest.mark.parametrize(
    ("torques", "options"),
    [
        (np.minimum(26.0, 0.2 * np.arange(800)), {}),  # what static friction bears
        (13.0 * (-1.0) ** np.arange(800), {}),
        (np.minimum(60.0, 0.2 * np.arange(800)), {"rest": np.inf}),
        (np.minimum(60.0, 0.2 * np.arange(800)), {"rest": (100.0, 1.0)}),
    ],
)
def test_torque_that_friction_bears_does_not(torques, options):
    assert played(torques, **options)[0] is None


def test_a_joint_that_moves_by_a_pulse_now_and_then_is_not_dead():
    counts = np.zeros((800, 2))
    counts[:, 0] = np.arange(800) // 60
    assert played(np.minimum(100.0, 0.2 * np.arange(800)), counts)[0] is None


def test_a_joint_whose_neighbour_needs_the_torque_is_not_dead():
    """The model of the law explains the change of torque: gravity of joint 2 while joint 3 goes
    by 1 rad.
    """
    law = ComputedTorque(puma560.arm(), RIG)
    running, q = law.start(RIG, RIG.counts(ZERO)), ZERO
    for k in range(1000):
        q = np.array([0.0, -k / 1000])
        speed = np.array([0.0, -1 / (1000 * DT)])
        running.step(RIG.counts(q), q, speed, ZERO)
    assert running.status == "running"


# -- a stop that drives --------------------------------------------------------------------------
def test_speed_that_rises_in_a_ramp_ends_in_no_torque_and_asks_for_the_brake():
    """Counts of a joint that runs away, with the sign against the damping."""
    running, counts = (
        LAW.start(RIG, (0, 0), guards=Guards(stop="zero", jump=np.inf, patience=0)),
        0.0,
    )
    running.step((0, 0), ZERO, ZERO, ZERO)
    running.step((0, 0), np.full(2, np.nan), ZERO, ZERO)
    assert (running.stopped, running.status.brake) == (True, False)
    speeds = []
    for k in range(600):
        counts += 0.5 * k
        torque = running.step(np.array([np.floor(counts), 0.0]), ZERO, ZERO, ZERO)
        speeds.append((abs(0.5 * k), np.abs(torque).max()))
    assert "no torque since joint q[0] grew faster in the stop" in running.status
    assert running.status.brake
    allowed = 8 * Guards().slack(RIG)[0] * DT  # a falling arm may reach as much
    assert all(torque == 0 for pulses, torque in speeds if pulses > allowed + 4)
    running.reset((0, 0))
    assert (str(running.status), running.status.brake) == ("running", False)


def test_torque_at_its_limit_in_a_hold_ends_after_the_stated_time():
    for braking in (0.02, 0.05):
        guards = Guards(saturation=None, chatter=None, braking=braking, patience=0, rest=np.inf)
        running, at = LAW.start(RIG, (0, 0), guards=guards), 0
        running.step((0, 0), ZERO, ZERO, ZERO)
        running.step((0, 0), np.array([np.nan, 0]), ZERO, ZERO)
        for k in range(500):  # pushed off by 0.05 rad, slowly enough
            torque = running.step(np.array([-min(2.0 * k, 700.0), 0.0]), ZERO, ZERO, ZERO)
            at += abs(torque[0]) >= LIMIT[0] * (1 - 1e-9)
        assert running.status.startswith(
            "safe stop, no torque since joint q[0] stayed at its torque limit: "
        )
        assert at * DT == pytest.approx(braking, abs=2 * DT)
        np.testing.assert_array_equal(torque, 0)


# -- clocks and calls ----------------------------------------------------------------------------
@pytest.mark.parametrize("wrong", [3600.0, -3600.0, np.inf, np.nan, 0.0], ids=str)
def test_one_glitch_of_the_clock_is_bridged_and_gives_the_torque_of_a_period(wrong):
    plain, glitched = LAW.start(RIG, (0, 0)), LAW.start(RIG, (0, 0))
    for k in range(20):
        now = k * DT if k != 10 else k * DT + wrong if wrong else 9 * DT
        given = np.array([k // 3, 0]), ZERO, ZERO, ZERO
        np.testing.assert_allclose(glitched.step(*given, now=now), plain.step(*given), rtol=1e-9)
    assert (glitched.bridged, glitched.stopped) == (1, False)
    assert "a clock that moved by" in glitched.status


@pytest.mark.parametrize(
    "clock",
    [lambda k: 0.0, lambda k: -k * DT, lambda k: 3600.0 * k],
    ids=["stands", "back", "fast"],
)
def test_a_clock_that_stays_wrong_stops_the_arm(clock):
    running = LAW.start(RIG, (0, 0))
    for k in range(6):
        running.step((0, 0), ZERO, ZERO, ZERO, now=clock(k))
    assert running.status.startswith("safe stop, holding: a clock that moved by")


@pytest.mark.parametrize(("pace", "said"), [(0.5, "0.5"), (2.0, "1.69"), (1.0, None)])
def test_calls_doubled_or_lost_are_seen_without_a_clock(pace, said):
    """A reference of time at 1 rad/s, called so many periods apart; 0.1 rad/s is below a pulse a
    sample.
    """
    for speed, seen in ((1.0, said), (0.05, None)):
        running = LAW.start(RIG, (0, 0), guards=Guards(error=1e6))
        for k in range(60):
            q = np.array([speed, 0]) * pace * k * DT
            running.step(RIG.counts(q), q, np.array([speed, 0]), ZERO)
        assert running.stopped == (seen is not None)
        assert (
            seen is None
            or f"calls lost or doubled: the reference moves at {seen}" in running.status
        )


# -- values never raise --------------------------------------------------------------------------
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300, 0.5], ids=str)
def test_counts_that_are_no_numbers_are_bridged_and_then_stop(wrong):
    running = LAW.start(RIG, (0, 0))
    running.step((0, 0), ZERO, ZERO, ZERO)
    for _ in range(3):
        assert np.isfinite(running.step((wrong, 0.0), ZERO, ZERO, ZERO)).all()
    assert "bridged counts of joint q[0] that are no whole numbers" in running.status
    for _ in range(10):
        assert np.isfinite(running.step((wrong, np.nan), ZERO, ZERO, ZERO)).all()
    assert running.status.startswith(
        "safe stop, ramp to zero: counts of joint q[0] that are no whole numbers, 4 times"
    )
    for name in ("counts", "speed", "angle", "q", "qd", "qdd", "reference", "commanded"):
        assert np.isfinite(running._row(name)).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (np.ma.array([1.0, 2.0], mask=[False, True]), "a masked array"),
        (np.array(["1", "2"]), "got <U1"),
        (["1", "2"], "got <U1"),
        (np.array([True, False]), "got bool"),
        ([True, False], "got bool"),
        (np.array([1 + 1j, 0]), "got complex128"),
        (np.array([None, 1]), "got object"),
        ([[1], [2, 3]], "pulses must be numbers of shape"),
    ],
    ids=str,
)
def test_a_wrong_kind_is_refused_in_one_line_and_the_next_call_goes_on(wrong, said):
    running = LAW.start(RIG, (0, 0))
    running.step((0, 0), ZERO, ZERO, ZERO)
    before = running.core.memory.copy()
    for place in range(4):
        given = [np.zeros(2) for _ in range(4)]
        given[place] = wrong
        with pytest.raises(ValueError, match="must be") as refusal:
            running.step(*given)
        assert "\n" not in str(refusal.value)
        assert place or said in str(refusal.value)
    np.testing.assert_array_equal(running.core.memory, before)
    assert np.isfinite(running.step((0, 0), ZERO, ZERO, ZERO)).all()


def test_a_second_thread_is_refused_while_the_first_is_in_a_step():
    running, refused = LAW.start(RIG, (0, 0)), []
    inside, leave, step = threading.Event(), threading.Event(), running._step

    def slow(*arguments):
        inside.set()
        leave.wait(5)
        return step(*arguments)

    running._step = slow
    first = threading.Thread(target=running.step, args=(ZERO, ZERO, ZERO, ZERO))
    first.start()
    inside.wait(5)
    try:
        running.step(ZERO, ZERO, ZERO, ZERO)
    except ValueError as refusal:
        refused.append(str(refusal))
    leave.set()
    first.join()
    assert refused == [
        "step must be called by one thread at a time; another is in it. Start one controller each."
    ]
    running.step(ZERO, ZERO, ZERO, ZERO)


# -- limits --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"position": ((-1, -1), (0.01, 1))}, "joint q[0] is outside its limits, at 0.01"),
        ({"speed": (0.5, 5)}, "joint q[0] is faster than its limit"),
        ({"position": ((-1, -1), (1, 1)), "speed": 2.0, "torque_rate": 1e6}, None),
    ],
)
def test_limits_of_position_and_speed_stop(options, said):
    running = LAW.start(RIG, (0, 0), guards=Guards(**options))
    for k in range(60):
        q = np.array([1.0, 0]) * k * DT
        running.step(RIG.counts(q), q, np.array([1.0, 0]), ZERO)
    assert running.stopped == (said is not None)
    assert said is None or said in running.status


def test_limits_of_a_model_file_are_guards():
    limits = Limits(lower=(-1, -1), upper=(0.01, 1), velocity=(0.9, np.inf), effort=(50, 50))
    assert np.array_equal(
        Guards(limits_of=limits).motion_limits(RIG)[:3], [[-1, -1], [0.01, 1], [0.9, np.inf]]
    )
    own = Guards(limits_of=limits, speed=2.0).motion_limits(RIG)
    np.testing.assert_array_equal(own[2], 2.0)
    assert Guards().motion_limits(RIG)[2].tolist() == [np.inf, np.inf]
    # A copy has the limits of its own file.
    other = Limits(lower=(-2, -2), upper=(2, 2), velocity=(0.1, 0.2), effort=(50, 50))
    copy = dataclasses.replace(Guards(limits_of=limits), limits_of=other).motion_limits(RIG)
    np.testing.assert_array_equal(copy[:3], [[-2, -2], [2, 2], [0.1, 0.2]])


def test_a_limit_of_the_torques_rate_is_kept_and_stops_if_it_is_needed_for_long():
    running, torque = (
        Played().start(RIG, (0, 0), guards=Guards(torque_rate=1e4, rest=np.inf)),
        [0.0],
    )
    for asked in (0.0, 15.0, 0.0, 0.0, 100.0, 100.0, 100.0):
        torque.append(running.step(ZERO, ZERO, ZERO, np.array([asked, 0.0]))[0])
    np.testing.assert_allclose(np.array(torque)[1:], (0, 7, 0, 0, 7, 14, 21), atol=1e-9)
    assert not running.stopped
    for _ in range(3):
        running.step(ZERO, ZERO, ZERO, np.array([100.0, 0.0]))
    assert "a torque of joint q[0] that changes by" in running.status


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rhythm": 1.5}, "rhythm must be below 1"),
        ({"limits_of": (1, 2)}, "limits_of must be"),
        ({"rhythm": np.nan}, "rhythm must be positive"),
        ({"position": ((1, 1), (0, 2))}, "position must be"),
        ({"speed": -1}, "speed must be positive"),
        ({"braking": 0}, "braking must be positive"),
        ({"rest": (1, -1)}, "rest must be positive"),
        ({"limits_of": Limits(lower=[0], upper=[0], velocity=[1], effort=[1])}, "position must be"),
        ({"limits_of": Limits(lower=[0], upper=[1], velocity=[0], effort=[1])}, "speed must be"),
    ],
)
def test_limits_that_cannot_be_are_refused(options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        Guards(**options)
    assert "\n" not in str(refusal.value)
