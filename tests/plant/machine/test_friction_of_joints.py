"""Friction that real joints have: its equation, and its simulation against another integrator."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import NoTorque, direct_rig

from plant import (
    Chain,
    Dynamics,
    FrictionCurve,
    Link,
    LoggedTorque,
    PointToPoint,
    Record,
    puma560,
    replay,
    simulate,
)

GEAR = puma560.rig().drive.gear
CURVES = {
    "saturating": FrictionCurve(offset=(0, 0), saturation=(20.0, 40.0)),
    "by direction": FrictionCurve(offset=(0.02, -0.03), viscous_offset=(4e-4, -6e-4)),
    "both": FrictionCurve(
        offset=(0.02, -0.03), viscous_offset=(4e-4, -6e-4), saturation=(20.0, np.inf)
    ),
    "rising": FrictionCurve(offset=(0, 0), rise=(3.0, 0.0)),
}


def drive_with(curve, **fields):
    return dataclasses.replace(puma560.rig().drive, curve=curve, **fields)


def expected(curve, qd):
    """Motor side, from the definitions; then through the gear."""
    drive = puma560.rig().drive
    v = GEAR * qd
    b = drive.viscous + (0 if curve.viscous_offset is None else curve.viscous_offset * np.sign(v))
    s = curve.saturation
    s = np.full(2, 1e9) if s is None else np.minimum(s, 1e9)
    lubricant = s * np.arcsinh(v / s)
    rise = np.zeros(2) if curve.rise is None else curve.rise
    dry = np.where(v == 0, 0.0, v / np.maximum(np.abs(v) + rise, 1e-300))
    return GEAR * (b * lubricant + drive.coulomb * dry + curve.offset)


@pytest.mark.parametrize("name", CURVES)
def test_friction_is_that_of_its_definition_in_numbers_and_symbols(name):
    drive = drive_with(CURVES[name])
    qd = np.random.default_rng(0).normal(size=(50, 2))
    qd[0] = 0
    wanted = np.array([expected(CURVES[name], row) for row in qd])
    np.testing.assert_allclose(drive.friction(qd), wanted, rtol=1e-9, atol=1e-12)
    x = ca.SX.sym("qd", 2)
    symbolic = ca.Function("friction", [x], [drive.friction(x)])
    got = np.array([symbolic(row).full().ravel() for row in qd])
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)


def test_a_curve_without_them_is_the_same_to_the_bit():
    plain = FrictionCurve(offset=(0.02, -0.03), breakaway=(0.1, 0.1), speed=(5.0, 5.0))
    wide = dataclasses.replace(plain, saturation=(np.inf, np.inf), viscous_offset=(0, 0))
    qd = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_array_equal(
        drive_with(plain).friction(qd), drive_with(plain).friction(qd, 3 * qd)
    )
    np.testing.assert_allclose(drive_with(wide).friction(qd), drive_with(plain).friction(qd), 1e-9)


def test_load_raises_the_level_alone():
    drive = drive_with(None, load_friction=(0.1, 0.05))
    qd, load = np.array([[0.5, -0.4], [-0.2, 0.3]]), np.array([[10.0, -4.0], [-3.0, 2.0]])
    rise = drive.friction(qd, load) - drive.friction(qd)
    np.testing.assert_allclose(rise, np.array([0.1, 0.05]) * np.abs(load) * np.sign(qd), rtol=1e-12)
    np.testing.assert_array_equal(drive.friction(qd), drive_with(None).friction(qd))


@pytest.mark.parametrize("name", CURVES)
def test_the_simulation_is_that_of_another_integrator(name):
    """Torques in open loop that never let a joint stop, by Runge-Kutta of order 4."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    rig = dataclasses.replace(rig, drive=drive_with(CURVES[name], coulomb=(0, 0)))
    t = np.arange(0, 0.2, rig.period)
    torque = np.array([120.0, -60.0]) * np.sin(4 * t)[:, None] + np.array([60.0, 30.0])
    zero = np.zeros((len(t), 2))
    start = np.array([[-0.8, 0.8], [0.0, 0.0]])
    record = Record(
        t=t, reference_pulses=zero, error_pulses=zero, torque=torque, rig=rig, law=LoggedTorque(),
        initial=start,
    )  # fmt: skip
    got = rig.cell_centre(replay(arm, record, steps_per_sample=16).counts)

    def slope(state, held):
        q, qd = state
        curve = CURVES[name]
        # Without dry friction: the drive of this motion has none.
        viscous = expected(dataclasses.replace(curve, rise=None), qd)
        viscous = viscous - GEAR * puma560.rig().drive.coulomb * np.sign(GEAR * qd)
        return np.array([qd, arm.forward(q, qd, held - viscous)])

    # The torque is held for a sample: two steps of Runge-Kutta's fourth order in each.
    state, h, wanted = start, rig.period / 2, []
    for held in torque:
        wanted.append(state[0])
        for _ in range(2):
            k1 = slope(state, held)
            k2 = slope(state + h / 2 * k1, held)
            k3 = slope(state + h / 2 * k2, held)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(state + h * k3, held))
    assert np.ptp(np.array(wanted)[:, 0]) > 0.1
    np.testing.assert_allclose(got, wanted, atol=3e-4)


def test_a_level_that_rises_from_zero_speed_is_coulomb_s_to_the_bit():
    qd = np.random.default_rng(0).normal(size=(50, 2))
    jumps = drive_with(FrictionCurve(offset=(0, 0), rise=(0, 0)))
    np.testing.assert_array_equal(jumps.friction(qd), drive_with(None).friction(qd))
    np.testing.assert_array_equal(jumps.joint_coulomb(0 * qd[0]), drive_with(None).joint_coulomb())


def test_an_arm_coasts_under_friction_that_rises_as_its_equation_of_motion_has_it():
    """One joint without gravity: m v dv/dx = -c v / (v + r), so m (v + r) dv = -c dx."""
    dynamics = Dynamics.from_chain(
        Chain(links=(Link(name="slide", prismatic=True),), gravity=(0, 0, 0))
    )
    mass, level, rise, speed = 2.0, 0.5, 0.3, 0.4
    arm = dynamics.arm([mass])
    plain = direct_rig((level,), (0.0,))
    curve = FrictionCurve(offset=(0.0,), rise=(rise,))
    rig = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, curve=curve))
    still = PointToPoint(start=(0.0,), goal=(0.0,), duration=20.0)
    run = simulate(arm, rig, NoTorque(), still, initial=[[0.0], [speed]], steps_per_sample=8)
    way = mass / level * (speed**2 / 2 + rise * speed)
    np.testing.assert_allclose(run.true_q[-1, 0], way, rtol=5e-3)


def test_bad_curves_are_refused():
    with pytest.raises(ValueError, match="rise"):
        FrictionCurve(offset=(0, 0), rise=(-0.1, 1.0))
    with pytest.raises(ValueError, match="saturation"):
        FrictionCurve(offset=(0, 0), saturation=(0.0, 1.0))
