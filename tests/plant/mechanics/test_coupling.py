"""Couplings between motors and joints: power, decoupled rotors as an exact solution, the gate,
bad input.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import Filtered, NoTorque, direct_rig
from packaged_arms import planar
from random_arms import random_chain
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import (
    Body,
    Chain,
    Coupling,
    Drive,
    Dynamics,
    Encoder,
    FrictionCurve,
    Harmonics,
    Link,
    P,
    Record,
    Rig,
    linearise,
    p_gains,
    simulate,
)
from plant.machine import least_inertia_margin
from plant.parts import from_plain
from plant.simulation import followed_path

MATRIX = ((1.0, 0.0, 0.0), (0.4, 1.0, 0.0), (0.3, -0.7, 1.0))
WRIST = Coupling(matrix=MATRIX)
C = np.array(MATRIX)


def rig_of(coupling=WRIST, *, n=3, smooth=False, curve=True, current=20.0):
    excess = FrictionCurve(offset=(0.01, -0.02, 0.005)[:n], breakaway=(0.05,) * n, speed=(3.0,) * n)
    drive = Drive(
        gear=(80.0, -60.0, 50.0)[:n],
        motor_inertia=(2e-4,) * n,
        viscous=(1e-3, 2e-3, 1e-3)[:n],
        coulomb=(0.1, 0.08, 0.05)[:n],
        motor_gain=(0.2,) * n,
        current_limit=(current,) * n,
        coupling=coupling,
        curve=excess if curve else None,
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,) * n, smooth=smooth), period=0.7e-3)


def path_of(matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1)), *, period=3.0):
    matrix, offset = np.array(matrix), np.array([0.3, -0.2, 0.1])
    cosine = np.array([[-0.5, -0.1, 0.2], [0.4, -0.5, 0.1], [0.3, 0.4, -0.6]])
    sine = np.array([[0.3, 0.2, -0.3], [-0.4, 0.3, 0.2], [0.5, -0.2, 0.3]])
    return Harmonics(
        period=period, offset=matrix @ offset, cosine=matrix @ cosine, sine=matrix @ sine
    )


# -- the two sides -------------------------------------------------------------------------------
def test_motor_angles_are_gear_times_matrix_times_joints():
    """The TX40's wrist: motor = R q with R = diag(N) but for R[6, 5] = 32; tau = R^T u."""
    gear = np.array([32, 32, 45, -48, 45, 32.0])
    R = np.diag(gear)
    R[5, 4] = 32
    matrix = np.eye(6)
    matrix[5, 4] = 1
    drive = Drive(
        gear=gear, motor_inertia=(0,) * 6, viscous=(0,) * 6, coulomb=(0,) * 6, motor_gain=(1,) * 6,
        current_limit=(np.inf,) * 6, coupling=Coupling(matrix=matrix),
    )  # fmt: skip
    random = np.random.default_rng(0)
    q, u = random.normal(size=(2, 40, 6))
    np.testing.assert_allclose(drive.motor_angle(q), q @ R.T, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(drive.joint_torque(u), u @ R, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(drive.joint_angle(drive.motor_angle(q)), q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(drive.motor_torque(drive.joint_torque(u)), u, rtol=0, atol=1e-14)


def test_casadi_and_numpy_cross_alike():
    drive, random = rig_of().drive, np.random.default_rng(1)
    crossings = (
        drive.motor_angle,
        drive.joint_angle,
        drive.joint_torque,
        drive.motor_torque,
        drive.current,
        drive.limited,
        drive.friction,
        rig_of(smooth=True).counts,
        rig_of(smooth=True).cell_centre,
    )
    for crossing in crossings:
        for scale in (1.0, 1e3):
            x, column = scale * random.normal(size=3), ca.SX.sym("x", 3)
            symbolic = ca.Function("f", [column], [crossing(column)])(x).full().ravel()
            np.testing.assert_allclose(symbolic, crossing(x), rtol=1e-13, atol=1e-13)


def test_power_is_the_same_on_both_sides():
    drive, random = rig_of().drive, np.random.default_rng(2)
    qd, tau_m = random.normal(size=(2, 3))
    np.testing.assert_allclose(
        qd @ drive.joint_torque(tau_m), drive.motor_angle(qd) @ tau_m, rtol=1e-13
    )


def test_friction_takes_the_power_that_the_motors_lose():
    drive = rig_of(curve=False).drive
    for qd in np.random.default_rng(3).normal(size=(20, 3)):
        speed = drive.gear * (C @ qd)
        np.testing.assert_allclose(
            qd @ drive.friction(qd), drive.viscous @ speed**2 + drive.coulomb @ abs(speed)
        )


def test_amplifiers_limit_motors_not_joints():
    drive = rig_of(current=1.0).drive
    limited = drive.limited(np.array([50.0, -1.0, 2.0]))
    assert np.abs(drive.current(limited)).max() == pytest.approx(1.0)
    np.testing.assert_allclose(drive.limited(limited), limited, rtol=1e-13)


# -- the equations of motion ---------------------------------------------------------------------
@pytest.mark.parametrize("seed", [0, 1])
def test_motor_inertias_move_with_the_shafts(seed):
    """Their kinetic energy is sum of J (C q)_i^2 / 2, so D gains C^T diag(J) C and nothing else
    changes.
    """
    plain = random_chain(3, seed, frames=False)
    coupled = plain.coupled(WRIST)
    random = np.random.default_rng(seed)
    rotor = random.uniform(0.5, 2, 3)
    bodies = [
        dataclasses.replace(body, rotor=value)
        for body, value in zip(plain.bodies, rotor, strict=True)
    ]
    without = [dataclasses.replace(body, rotor=0.0) for body in plain.bodies]
    alone, together = Dynamics.from_chain(plain), Dynamics.from_chain(coupled)
    q, qd, qdd = random.normal(size=(3, 3))
    expected = alone.arm(alone.f(without)).inverse(q, qd, qdd) + C.T @ (rotor * (C @ qdd))
    got = together.arm(together.f(bodies)).inverse(q, qd, qdd)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def rotors_alone(coupling):
    """Three joints without links: all inertia is in the motors, so every shaft turns on its own."""
    links = tuple(Link(name=str(i + 1)) for i in range(3))
    bodies = tuple(
        Body(mass=0.0, com=(0, 0, 0), inertia=(0,) * 6, rotor=j) for j in (1.5, 1.0, 0.7)
    )
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies, coupling=coupling))
    return dynamics.arm(dynamics.f())


@pytest.mark.parametrize("smooth", [False, True])
def test_shafts_without_links_turn_as_if_there_were_no_coupling(smooth):
    """Exact: in shaft angles y = C q the coupled loop is three loops that know nothing of each
    other.
    """
    law = P(gain=(0.1, 0.08, 0.05))
    start = np.array([[0.1, 0.0, -0.1], [0.2, -0.3, 0.1]])
    options = {"steps_per_sample": 4, "duration": 0.5, "sweeps": 1}
    coupled = simulate(
        rotors_alone(WRIST), rig_of(smooth=smooth), law, path_of(), initial=start, **options
    )
    single = Coupling()
    plain = simulate(
        rotors_alone(single),
        rig_of(single, smooth=smooth),
        law,
        path_of(C),
        initial=start @ C.T,
        **options,
    )
    assert np.abs(plain.error_pulses).max() > 20  # it moves, sticks and saturates
    np.testing.assert_allclose(
        coupled.error_pulses, plain.error_pulses, rtol=0, atol=1e-6 if smooth else 1
    )
    np.testing.assert_allclose(coupled.true_q @ C.T, plain.true_q, rtol=0, atol=2e-5)
    if smooth:
        np.testing.assert_allclose(coupled.true_q @ C.T, plain.true_q, rtol=0, atol=1e-9)
        np.testing.assert_allclose(coupled.current, plain.current, rtol=0, atol=1e-6)


def coupled_planar(seed):
    """A planar arm of random bodies with motors that turn with several joints, and what is
    guessed of it.
    """
    random, rig = np.random.default_rng(seed), rig_of()
    chain = planar(3).coupled(WRIST)
    rotors = rig.drive.reflected_inertia()
    guess = [
        dataclasses.replace(b, rotor=float(j)) for b, j in zip(chain.bodies, rotors, strict=True)
    ]
    bodies = [
        dataclasses.replace(body, mass=body.mass * random.uniform(0.6, 1.4)) for body in guess
    ]
    dynamics = Dynamics.from_chain(chain)
    return dynamics, rig, dynamics.f(bodies), dynamics.f(guess)


def test_free_coupled_arm_moves_as_its_equations_say():
    """No torque, no friction: the loop's steps, taken on the shafts, against the joints' own
    equations integrated.
    """
    dynamics, rig, f, _ = coupled_planar(6)
    zero = (0.0, 0.0, 0.0)
    drive = dataclasses.replace(rig.drive, coulomb=zero, viscous=zero, curve=None)
    arm, start = dynamics.arm(f), np.array([[0.3, -0.4, 0.5], [2.0, -3.0, 1.5]])
    rig = dataclasses.replace(rig, drive=drive)
    record = simulate(
        arm, rig, NoTorque(), path_of(), duration=0.4, initial=start, steps_per_sample=16
    )
    exact = solve_ivp(
        lambda t, x: np.append(x[3:], arm.forward(x[:3], x[3:], np.zeros(3))),
        (0, 0.4), start.ravel(), method="DOP853", rtol=1e-10, atol=1e-10, t_eval=record.t[::50],
    ).y.T  # fmt: skip
    np.testing.assert_allclose(
        np.hstack([record.true_q, record.true_qd])[::50], exact, rtol=0, atol=1e-5
    )


def test_casadi_referees_the_kernel_of_a_coupled_arm():
    dynamics, rig, f, _ = coupled_planar(0)
    laws = (
        P(gain=(0.1, 0.08, 0.05)),
        Filtered(gain=(1.0, 1.0, 1.0), rate=300.0, period=rig.period),
        ComputedTorque(dynamics.arm(f), rig),
    )
    for law in laws:
        fast, slow = (
            simulate(dynamics.arm(f), rig, law, path_of(), duration=0.1, backend=backend)
            for backend in ("numba", "casadi")
        )
        np.testing.assert_array_equal(fast.error_pulses, slow.error_pulses)
        np.testing.assert_allclose(fast.true_q, slow.true_q, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_coupled_arm_of_random_truth_is_identified_and_tracked_within_one_pulse():
    dynamics, rig, f, guess = coupled_planar(1)
    width = np.maximum(0.5 * np.abs(guess), 0.1)
    measured = simulate(
        dynamics.arm(f), rig, P(gain=(0.1, 0.08, 0.05)), path_of(), steps_per_sample=16
    )
    found = identify(
        dynamics, measured, ranges=np.column_stack([guess - width, guess + width]), progress=False
    )
    report = evaluate(
        dynamics.arm(f), rig, ComputedTorque(found.arm, found.rig), path_of(), backend="numba"
    )
    assert report.within(1), report
    assert (report.saturation == 0).all()


def test_p_loop_of_a_coupled_arm_linearised_swings_as_simulated():
    """Small deviations without friction: the linear model's first swing against the
    simulation's.
    """
    dynamics, rig, f, _ = coupled_planar(2)
    zero = (0.0, 0.0, 0.0)
    drive = dataclasses.replace(rig.drive, coulomb=zero, curve=None)
    rig, law = dataclasses.replace(rig, drive=drive), P(gain=(0.1, 0.08, 0.05))
    rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
    arm, pose = dynamics.arm(f), np.array([0.2, -0.3, 0.4])
    stiffness = (
        C.T @ np.diag(law.gain * drive.gear * rig.encoder.position_in_pulses(drive.gear)) @ C
    )
    goal = pose + np.linalg.solve(stiffness, arm.h(pose, np.zeros(3)))
    still = Harmonics(period=0.1, offset=goal, cosine=np.zeros((3, 1)), sine=np.zeros((3, 1)))
    deviation = np.array([1e-5, -2e-5, 1e-5, 0, 0, 0])
    record = simulate(
        arm,
        rig,
        law,
        still,
        initial=(np.append(pose, zero) + deviation).reshape(2, 3),
        duration=0.05,
    )
    system = linearise(arm, rig, law, pose)
    expected = [expm(system.A * t) @ deviation for t in record.t]
    got = np.hstack([record.true_q - pose, record.true_qd])
    assert (np.abs(got - expected).max(axis=0) < 0.02 * np.abs(expected).max(axis=0)).all()
    np.testing.assert_allclose(
        system.C[:, :3] @ deviation[:3], -rig.position_in_pulses(deviation[:3]), rtol=1e-13
    )


def test_p_gains_of_a_coupled_arm_keep_the_stated_peak():
    dynamics, rig, f, _ = coupled_planar(3)
    law = p_gains(dynamics.arm(f), rig, path_of(), peak=15)
    errors = np.abs(simulate(dynamics.arm(f), rig, law, path_of()).error_pulses)
    assert (errors.max(axis=0) <= 15).all()
    assert (errors.max(axis=0) >= 10).all()


def test_gate_looks_at_the_shafts():
    """The smallest pivot is negative exactly where D - C^T diag(least) C is indefinite
    somewhere.
    """
    dynamics, rig, f, _ = coupled_planar(4)
    least = 0.5 * rig.drive.reflected_inertia()
    random = np.random.default_rng(0)
    candidates = f * random.uniform(0.0, 1.5, (60, 1)) * random.uniform(0.9, 1.1, (60, dynamics.p))
    margins = least_inertia_margin(dynamics, rig, candidates)
    poses = random.uniform(-np.pi, np.pi, (300, 3))
    smallest = [
        min(
            np.linalg.eigvalsh(dynamics.D(q, one).full() - C.T @ np.diag(least) @ C)[0]
            for q in poses
        )
        for one in candidates
    ]
    clear = np.abs(smallest) > 0.02
    assert 10 < (margins[clear] < 0).sum() < clear.sum() - 10
    np.testing.assert_array_equal(margins[clear] < 0, np.array(smallest)[clear] < 0)


def test_record_without_reference_replays_its_counts():
    dynamics, rig, f, _ = coupled_planar(5)
    law = P(gain=(0.1, 0.08, 0.05))
    made = simulate(dynamics.arm(f), rig, law, path_of(), duration=0.3)
    counted = Record(
        t=made.t,
        reference_pulses=made.reference_pulses,
        error_pulses=made.error_pulses,
        rig=rig,
        law=law,
    )
    path = followed_path.path_of(counted)
    motion, pulses = path(made.t)
    np.testing.assert_array_equal(pulses, made.reference_pulses)
    np.testing.assert_allclose(
        rig.position_in_pulses(motion.q), made.reference_pulses, rtol=0, atol=1e-8
    )
    moved = dataclasses.replace(counted, error_pulses=made.error_pulses + np.array([0, 0, 30]))
    q, _ = followed_path.start_of(moved, path)
    off = rig.position_in_pulses(q) - made.reference_pulses[0]
    # only the joints behind motor 3 start elsewhere
    np.testing.assert_allclose(off, [0, 0, -30], atol=0.6)


# -- bad input -----------------------------------------------------------------------------------
def test_identity_is_no_coupling():
    assert Coupling(matrix=np.eye(3)) == Coupling()
    assert Coupling().shaft(3.0) == 3.0


def test_coupling_survives_its_description():
    assert from_plain(rig_of().describe()) == rig_of()
    assert from_plain(planar(3).coupled(WRIST).describe()).coupling == WRIST


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (((1, 0), (1, 0)), "must not be singular"),
        (((1, 0, 0), (0, 1, 0)), r"must be \(n, n\)"),
        (((1, np.nan), (0, 1)), "must be finite; got nan"),
        ((1, 2), r"must have shape \(n, n\)"),
        ((("a", 2), (1, 1)), "must be numbers"),
        (((1, 2), (1,)), "must be numbers"),
    ],
)
def test_matrix_that_couples_nothing_is_refused(matrix, says):
    with pytest.raises(ValueError, match=says):
        Coupling(matrix=matrix)


def test_arm_and_drive_must_agree():
    dynamics, rig, f, _ = coupled_planar(0)
    plain = rig_of(Coupling())
    with pytest.raises(ValueError, match="the same Coupling"):
        simulate(dynamics.arm(f), plain, P(gain=(0.1,) * 3), path_of(), duration=0.01)
    with pytest.raises(ValueError, match="the same Coupling"):
        ComputedTorque(dynamics.arm(f), plain)
    with pytest.raises(ValueError, match=r"coupling of the drive must be \(2, 2\)"):
        rig_of(WRIST, n=2)
    with pytest.raises(ValueError, match=r"coupling of the chain must be \(2, 2\)"):
        planar(2).coupled(WRIST)
    with pytest.raises(ValueError, match="must be of type Coupling"):
        planar(3).coupled(MATRIX)


def test_direct_rig_has_no_coupling():
    assert direct_rig((0.0,), (0.0,)).drive.coupling.matrix == ()
