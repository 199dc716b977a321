"""Laws that repeat a log: an analytic motion, the same torque again, uneven time stamps, and two
evaluations.
"""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Link,
    LoggedCurrent,
    LoggedTorque,
    PointToPoint,
    Record,
    Rig,
    puma560,
    replay,
    simulate,
)  # fmt: skip

INERTIA = 0.3
REST = PointToPoint(start=(0,), goal=(0,), duration=1)


def free_joint():
    """A joint of known inertia about a vertical axis, without friction."""
    dynamics = Dynamics.from_chain(Chain(links=(Link(name="1"),)))
    rig = Rig(
        drive=Drive(
            gear=(-50,),
            motor_inertia=(0,),
            viscous=(0,),
            coulomb=(0,),
            motor_gain=(0.2,),
            current_limit=(1e3,),
        ),
        encoder=Encoder(resolution=(1000,), smooth=True),
        period=0.002,
    )
    assert dynamics.p == 1
    return dynamics.arm([INERTIA]), rig


def uneven(count, seed=3):
    """Times of samples, some of them after a gap."""
    lengths = 0.002 * np.random.default_rng(seed).uniform(0.93, 1.07, count)
    lengths[[10, 25]] *= 4
    return np.append(0, np.cumsum(lengths))[:count]


def record(rig, t, torque, **changes):
    return Record(
        t=t,
        error_pulses=np.zeros((len(t), 1)),
        torque=torque,
        rig=rig,
        **{"law": LoggedTorque()} | changes,
    )


def test_a_torque_that_is_held_between_samples_moves_a_free_joint_as_it_must():
    """Under piecewise constant torque the motion is known, and the step is exact for it. A gap of
    four periods is taken in three steps, the torque a third of the way further in each.
    """
    arm, rig = free_joint()
    t = uneven(200)
    torque = np.random.default_rng(1).normal(size=(200, 1))
    q, qd = np.zeros(200), np.zeros(200)
    qd[0], q[0] = 0.7, 0.2
    for k, whole in enumerate(np.diff(t)):
        steps = int(np.ceil(whole / (1.5 * rig.period)))
        h, q[k + 1], qd[k + 1] = whole / steps, q[k], qd[k]
        for j in range(steps):
            a = (torque[k, 0] + j / steps * (torque[k + 1, 0] - torque[k, 0])) / INERTIA
            q[k + 1], qd[k + 1] = q[k + 1] + h * qd[k + 1] + h * h / 2 * a, qd[k + 1] + h * a
    made = replay(arm, record(rig, t, torque, initial=[[0.2], [0.7]]))
    np.testing.assert_allclose(made.true_q[:, 0], q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(made.true_qd[:, 0], qd, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        made.counts[:, 0], rig.position_in_pulses(q[:, None])[:, 0], rtol=1e-9
    )
    np.testing.assert_array_equal(made.t, t)
    np.testing.assert_array_equal(made.torque, torque)


def test_a_torque_of_a_faster_loop_is_on_straight_lines_between_its_samples():
    """Its impulse is that of the trapezoids, so that the speed of a free joint is exact."""
    arm, rig = free_joint()
    t = np.arange(100) * rig.period
    torque = np.random.default_rng(1).normal(size=(100, 1))
    law = LoggedTorque(held=False)
    made = replay(arm, record(rig, t, torque, initial=[[0.2], [0.7]], law=law))
    impulses = rig.period * (torque[1:, 0] + torque[:-1, 0]) / 2
    qd = 0.7 + np.append(0, np.cumsum(impulses)) / INERTIA
    np.testing.assert_allclose(made.true_qd[:, 0], qd, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(made.torque, torque)


def test_a_current_gives_the_torque_of_the_motor():
    arm, rig = free_joint()
    t, current = uneven(40), np.random.default_rng(2).normal(size=(40, 1))
    log = record(rig, t, None, current=current, initial=[[0], [0]], law=LoggedCurrent())
    made = replay(arm, log)
    np.testing.assert_allclose(made.torque, -50 * 0.2 * current, rtol=1e-14)


@pytest.mark.parametrize(
    "law", [LoggedTorque(), ComputedTorque(puma560.arm(), puma560.rig())], ids=["logged", "law"]
)
def test_both_evaluations_agree_at_uneven_times(law):
    """A law with the period of the log takes one step per sample, a logged torque is held."""
    rig = puma560.rig()
    first = simulate(
        puma560.arm(), rig, ComputedTorque(puma560.arm(), rig), puma560.reference(), duration=0.2
    )
    t = first.t + 0.1 * rig.period * np.sin(np.arange(len(first)))
    t[100:] += 2.2 * rig.period
    t -= t[0]
    path = puma560.reference()
    log = dataclasses.replace(
        first, t=t, law=law, reference=path, reference_pulses=rig.counts(path(t).q)
    )
    numba, casadi = (replay(puma560.arm(), log, backend=backend) for backend in ("numba", "casadi"))
    np.testing.assert_array_equal(numba.error_pulses, casadi.error_pulses)
    np.testing.assert_allclose(numba.true_q, casadi.true_q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("reference", [True, False])
def test_a_replay_with_the_same_arm_is_the_same_log(reference):
    """Also where only counts and torque are left, as of a robot whose controller nobody knows."""
    arm, rig = puma560.arm(), puma560.rig()
    made = simulate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.4)
    if reference:
        np.testing.assert_array_equal(replay(arm, made).error_pulses, made.error_pulses)
        return
    start = np.array([made.true_q[0], made.true_qd[0]])
    bare = Record(
        t=made.t,
        error_pulses=-made.counts,
        torque=made.torque,
        rig=rig,
        law=LoggedTorque(),
        initial=start,
    )
    np.testing.assert_array_equal(replay(arm, bare).counts, made.counts)


def test_without_a_start_the_first_counts_give_one():
    arm, rig = free_joint()
    t = uneven(30)
    counts = rig.position_in_pulses(0.3 + 1.5 * t[:, None])
    made = replay(arm, dataclasses.replace(record(rig, t, np.zeros((30, 1))), error_pulses=-counts))
    np.testing.assert_allclose(made.counts, counts, rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda arm, log: dataclasses.replace(log, torque=None),
            "LoggedTorque needs the record's torque; it has none",
        ),
        (
            lambda arm, log: dataclasses.replace(log, law=LoggedCurrent()),
            "LoggedCurrent needs the record's current",
        ),
        (
            lambda arm, log: replay(arm, log, law=LoggedCurrent()),
            "LoggedCurrent needs the record's current",
        ),
        (
            lambda arm, log: LoggedCurrent().replayed(log),
            "LoggedCurrent needs the record's current",
        ),
        (lambda arm, log: replay(arm, dataclasses.replace(log, law=None)), "law"),
        (lambda arm, log: replay(log, arm), "The order is arm, record"),
        (lambda arm, log: replay(arm, log, backend="c"), "backend"),
        (
            lambda arm, log: LoggedTorque().start(log.rig, [0]),
            "must be a controller; LoggedTorque repeats a log",
        ),
        (lambda arm, log: simulate(arm, log.rig, LoggedTorque(), REST, duration=0.1), "replay"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    arm, rig = free_joint()
    with pytest.raises(ValueError, match=said) as refusal:
        call(arm, record(rig, uneven(30), np.zeros((30, 1))))
    assert "\n" not in str(refusal.value)
