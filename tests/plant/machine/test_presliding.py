"""Presliding friction of one joint against closed forms of Dahl's law, and Coulomb's law as its
limit.
"""

import dataclasses
import itertools

import casadi as ca
import numpy as np
import pytest
from closed_loops import Constant, NoTorque, direct_rig, joint

from ctc import ComputedTorque
from plant import FrictionCurve, P, PointToPoint, Presliding, puma560, simulate
from plant.machine import Bristles, smooth_bristle_impulse
from plant.mechanics import inverse
from plant.simulation import ClosedLoop

INERTIA, LEVEL, DISTANCE = 2.0, 0.5, 0.01
STIFFNESS = LEVEL / DISTANCE
H = 0.7e-3 / 4  # the default sub-step


def rig(distance=DISTANCE, damping=None, *, viscous=0.0, level=LEVEL):
    plain = direct_rig((level,), (viscous,))
    given = Presliding(distance=(distance,), damping=None if damping is None else (damping,))
    return dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, presliding=given))


def moved(rig, torque=0.0, *, speed=0.0, duration=1.0, steps=4, arm=None):
    """Time, angle and speed of a joint without gravity under a constant torque."""
    still = PointToPoint(start=(0.0,), goal=(0.0,), duration=duration)
    law = Constant(torque=torque, period=rig.period) if torque else NoTorque()
    arm = joint(0.0, 0.3, INERTIA) if arm is None else arm
    record = simulate(arm, rig, law, still, initial=[[0.0], [speed]], steps_per_sample=steps)
    return record.t, record.true_q[:, 0], record.true_qd[:, 0]


@pytest.mark.parametrize(
    ("share", "damping"), [(1e-3, None), (1e-3, 30.0), (0.5, None), (-0.9, 30.0)]
)
def test_a_torque_below_the_level_bends_the_bristles_and_no_more(share, damping):
    """Loaded slowly the way is -d ln(1 - T / level): T over the stiffness where T is small."""
    _, q, qd = moved(
        rig(damping=damping, viscous=30.0),
        share * LEVEL,
        duration=20.0 if abs(share) < 0.9 else 100.0,
    )
    assert q[-1] == pytest.approx(-np.sign(share) * DISTANCE * np.log1p(-abs(share)), rel=1e-3)
    assert abs(qd[-1]) < 1e-5 * DISTANCE
    if share == 1e-3:
        assert q[-1] == pytest.approx(share * LEVEL / STIFFNESS, rel=2e-3)


@pytest.mark.parametrize("share", [0.98, 1.02, -1.02])
def test_it_breaks_away_at_the_coulomb_level(share):
    distance, viscous = 1e-4, 200.0
    _, q, qd = moved(rig(distance, viscous=viscous), share * LEVEL, duration=30.0)
    if abs(share) < 1:
        assert abs(qd[-1]) < 1e-4 * distance
        assert q[-1] == pytest.approx(-distance * np.log1p(-share), rel=1e-3)
    else:
        assert qd[-1] == pytest.approx((share - np.sign(share)) * LEVEL / viscous, rel=1e-3)


@pytest.mark.parametrize("speed", [0.1, -0.1])
def test_a_coasting_joint_loses_the_energy_of_dahl_s_law(speed):
    """J (v0^2 - v^2) / 2 = level (s - d (1 - exp(-s / d))) on the way s."""
    _, q, qd = moved(rig(), speed=speed, duration=0.3)
    s = np.abs(q)
    expected = speed**2 - 2 * LEVEL / INERTIA * (s - DISTANCE * (1 - np.exp(-s / DISTANCE)))
    assert s[-1] > DISTANCE
    np.testing.assert_allclose(qd**2, expected, rtol=2e-3)


def test_the_step_is_of_first_order():
    errors = []
    for steps in (4, 8, 16):
        _, q, qd = moved(rig(), speed=0.1, duration=0.3, steps=steps)
        expected = 0.1**2 - 2 * LEVEL / INERTIA * (q - DISTANCE * (1 - np.exp(-q / DISTANCE)))
        errors.append(np.abs(qd**2 - expected).max())
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2, rtol=0.15)


def crossings(t, qd):
    """Times at which the speed passes through zero."""
    i = np.flatnonzero(qd[:-1] * qd[1:] < 0)
    return t[i] - qd[i] * (t[i + 1] - t[i]) / (qd[i + 1] - qd[i])


@pytest.mark.parametrize("damping", [None, 0.4])
def test_bristles_swing_with_their_stiffness_and_their_damping(damping):
    """A deflection far below the distance: a spring of level / d, damped by what is stated, at
    least by k h / 2.
    """
    stiff = rig(damping=damping)
    t, q, qd = moved(stiff, speed=1e-4 * DISTANCE, duration=6.0)
    omega = np.sqrt(STIFFNESS / INERTIA)
    found = np.pi / np.diff(crossings(t, qd)).mean()
    assert found == pytest.approx(omega, rel=2e-3)
    ratio = max(damping or 0.0, STIFFNESS * H / 2) / (2 * np.sqrt(STIFFNESS * INERTIA))
    at = crossings(t, qd)
    peaks = [np.abs(qd[(t > a) & (t < b)]).max() for a, b in itertools.pairwise(at)]
    decay = -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0] / np.pi
    assert decay == pytest.approx(ratio, rel=0.02)


def test_bristles_hold_a_weight_without_creep():
    """A hanging joint whose friction carries it, on bristles: it sinks by the way of the
    bristles, then stands.
    """
    arm = joint(0.1, 0.3, INERTIA)
    weight = arm.h([0.0], [0.0])[0]
    assert weight < LEVEL
    _, q, qd = moved(rig(viscous=30.0), arm=arm, duration=40.0)
    assert q[-1] == pytest.approx(DISTANCE * np.log1p(-weight / LEVEL), rel=1e-3)
    late = q[len(q) // 2 :]
    assert np.ptp(late) < 1e-3 * DISTANCE
    assert np.abs(qd[len(qd) // 2 :]).max() < 1e-4 * DISTANCE


@pytest.mark.parametrize(
    "law", [puma560.p_law(), ComputedTorque(puma560.arm(), puma560.rig())], ids=["P", "torque"]
)
def test_no_distance_is_coulomb_friction(law):
    arm, plain, path = puma560.arm(), puma560.rig(), puma560.reference()
    given = Presliding(distance=(0.0, 0.0))
    bristles = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, presliding=given))
    one, other = (simulate(arm, each, law, path, duration=0.7) for each in (plain, bristles))
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, rtol=0, atol=1e-9)


def test_a_joint_without_friction_or_distance_has_a_smooth_step_at_rest():
    mass = ca.SX(np.diag((2.0, 3.0)))
    zero = ca.SX.zeros(2)
    impulse, deflection = smooth_bristle_impulse(
        inverse(mass), zero, Bristles(zero, zero, None), zero, ca.SX(1e-3)
    )
    assert (np.array(ca.evalf(ca.horzcat(impulse, deflection))) == 0).all()


def test_a_short_distance_ends_in_coulomb_friction():
    """The way to a standstill: v^2 J / (2 level), and for each distance so much more."""
    stops = [
        moved(rig(distance), speed=0.1, duration=0.6)[1].max() for distance in (1e-4, 1e-6, 1e-12)
    ]
    coulomb = 0.1**2 * INERTIA / (2 * LEVEL)
    np.testing.assert_allclose(stops[1:], coulomb, rtol=1e-3)
    assert abs(stops[0] / coulomb - 1) < 2e-2


def test_a_drive_without_it_has_no_distance():
    distance, damping = puma560.rig().drive.joint_presliding()
    np.testing.assert_array_equal(distance, np.zeros(2))
    assert damping is None


@pytest.mark.parametrize("pulses", [1e-9, 1e-3, 0.1, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("damping", [None, (1e-2, 1e-2)])
def test_the_default_step_is_stable_at_any_distance(pulses, damping):
    """Errors of the P loop stay as they are with Coulomb friction, to within the way of the
    bristles.
    """
    arm, plain, path = puma560.arm(), puma560.rig(), puma560.reference()
    given = Presliding(distance=plain.encoder.to_angle(np.full(2, pulses)), damping=damping)
    bristles = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, presliding=given))
    one, other = (
        simulate(arm, each, puma560.p_law(), path, duration=1.0) for each in (plain, bristles)
    )
    assert np.abs(other.error_pulses).max() <= np.abs(one.error_pulses).max() + 2 * pulses + 2


def test_a_level_that_falls_with_speed_takes_the_bristles_with_it():
    """Sliding bristles carry the Stribeck curve: at constant speed their friction is the
    curve's.
    """
    curve = FrictionCurve(offset=(0.0,), breakaway=(0.3,), speed=(0.05,))
    given = rig(viscous=3.0)
    given = dataclasses.replace(given, drive=dataclasses.replace(given.drive, curve=curve))
    _, _, qd = moved(given, 0.9, duration=30.0)
    assert 0.9 - 3.0 * qd[-1] == pytest.approx(given.drive.joint_coulomb(qd[-1:])[0], rel=1e-6)


def smooth_run(rig, arm, count, **start):
    """Angle and speed after each of so many steps of the differentiable loop."""
    loop = ClosedLoop(
        dynamics=arm.dynamics, rig=rig, law=NoTorque(), steps_per_sample=4, smooth=True
    )
    state = loop.initial_state([0.0], [start.get("speed", 0.0)])
    row = np.append(np.zeros(len(loop.time_names) - 1), loop.h)
    columns = [ca.repmat(ca.DM(x), 1, count) for x in (row, loop.number_values(arm.f))]
    states = loop.substep.mapaccum("run", count)(state, *columns)[0].full()
    return states[[loop.state_names.index(name) for name in ("q[0]", "qd[0]")]]


def test_the_differentiable_step_has_the_same_bristles():
    q, qd = smooth_run(rig(), joint(0.0, 0.3, INERTIA), 1500, speed=0.1)
    expected = 0.1**2 - 2 * LEVEL / INERTIA * (q - DISTANCE * (1 - np.exp(-q / DISTANCE)))
    np.testing.assert_allclose(qd**2, expected, rtol=5e-3)


@pytest.mark.parametrize("distance", [1e-2, 1e-4, 1e-7, 1e-10])
def test_the_differentiable_step_holds_a_weight_at_any_distance(distance):
    """It comes to rest where its bristles carry it, but for what it falls in a few steps before
    they are bent.
    """
    arm = joint(0.1, 0.3, INERTIA)
    weight = arm.h([0.0], [0.0])[0]
    given = rig(distance, 4 * np.sqrt(LEVEL / distance * INERTIA))
    q, qd = smooth_run(given, arm, 40_000)
    expected, falls = distance * np.log1p(-weight / LEVEL), weight / INERTIA * H**2
    # of first order: viscous H / 2 J is 0.018
    assert q[-1] == pytest.approx(expected, rel=0.02, abs=10 * falls)
    assert np.abs(qd[-100:]).max() < 1e-4 * distance


def test_casadi_and_the_kernel_agree():
    arm, plain, path = puma560.arm(), puma560.rig(), puma560.reference()
    given = Presliding(distance=plain.encoder.to_angle(np.array([5.0, 5.0])), damping=(1e-3, 2e-3))
    bristles = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, presliding=given))
    one, other = (
        simulate(arm, bristles, P(gain=(0.2, 0.15)), path, duration=0.5, backend=b)
        for b in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Presliding(distance=(-0.1,)), "distance must not be negative"),
        (lambda: Presliding(distance=(0.1,), damping=(-0.1,)), "damping must not be negative"),
        (
            lambda: Presliding(distance=(0.1, 0.1), damping=(0.1,)),
            "damping of Presliding must have shape",
        ),
        (lambda: Presliding(distance=(np.nan,)), "distance of Presliding must be finite"),
        (
            lambda: dataclasses.replace(rig().drive, presliding=0.01),
            "presliding of Drive must be of type Presliding",
        ),
        (
            lambda: dataclasses.replace(rig().drive, presliding=Presliding(distance=(0.1, 0.1))),
            "presliding.distance must have 1 joints; got 2",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)
