"""Offset and Stribeck friction: closed forms of one joint, casadi beside the kernel, and what
may not be.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import NoTorque, direct_rig

from plant import Body, Chain, Dynamics, FrictionCurve, Link, PointToPoint, puma560, simulate

INERTIA, LEVEL = 2.0, 0.5


def turntable():
    """One link about a vertical axis: no gravity, inertia 2 kg m^2."""
    chain = Chain(
        links=(Link(name="1"),),
        bodies=(Body(mass=1.0, com=(0, 0, 0), inertia=(1, 0, 0, 1, 0, 1), rotor=1.0),),
    )
    dynamics = Dynamics.from_chain(chain)
    return dynamics.arm(dynamics.f())


def rig(**curve):
    given = {"offset": (0.0,), "breakaway": (0.0,), "speed": (1.0,)} | curve
    plain = direct_rig((LEVEL,), (0.0,))
    return dataclasses.replace(
        plain, drive=dataclasses.replace(plain.drive, curve=FrictionCurve(**given))
    )


def coasted(rig, speed, duration=2.0):
    """Angle and speed of a turntable that is pushed and let go."""
    still = PointToPoint(start=(0.0,), goal=(0.0,), duration=duration)
    record = simulate(
        turntable(), rig, NoTorque(), still, initial=[[0.0], [speed]], steps_per_sample=8
    )
    return record.true_q[:, 0], record.true_qd[:, 0]


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_unequal_friction_stops_a_joint_sooner_one_way_than_the_other(speed):
    """From speed v against a level c the way is v^2 I / (2 c), with c + offset forwards and c -
    offset backwards.
    """
    q, qd = coasted(rig(offset=(0.2,)), speed, duration=3.0)
    level = LEVEL + 0.2 * np.sign(speed)
    np.testing.assert_allclose(q[-1], np.sign(speed) * speed**2 * INERTIA / (2 * level), rtol=1e-3)
    assert qd[-1] == pytest.approx(0, abs=1e-12)


def test_an_offset_below_the_level_moves_nothing_and_one_above_it_does():
    assert np.abs(coasted(rig(offset=(0.49,)), 0.0)[0]).max() < 1e-12
    q, _ = coasted(rig(offset=(0.6,)), 0.0, duration=1.0)
    # a constant push backwards
    np.testing.assert_allclose(q[-1], -(0.6 - LEVEL) / INERTIA / 2, rtol=5e-3)


def test_an_offset_alone_needs_no_stribeck_curve_and_is_in_no_equation_of_one():
    alone = rig(offset=(0.2,), breakaway=None, speed=None)
    np.testing.assert_array_equal(coasted(alone, 0.4), coasted(rig(offset=(0.2,)), 0.4))
    assert [name for name in alone.number_names() if "curve" in name] == ["drive.curve.offset[0]"]


def test_more_friction_at_rest_holds_what_the_level_would_not():
    """An offset of 0.6 against 0.5 in motion and 0.7 at rest: held, until it is pushed faster
    than Stribeck's speed.
    """
    curve = {"offset": (-0.6,), "breakaway": (0.2,), "speed": (0.05,)}
    assert np.abs(coasted(rig(**curve), 0.0)[0]).max() < 1e-12
    _, qd = coasted(rig(**curve), 0.5)
    np.testing.assert_allclose(qd[-1] - qd[0], (0.6 - LEVEL) / INERTIA * 2.0, rtol=1e-2)


def test_level_falls_with_the_square_of_the_motor_s_speed():
    drive = rig(breakaway=(0.2,), speed=(0.05,)).drive
    for qd, share in ((0.0, 1.0), (0.05, np.exp(-1)), (-0.05, np.exp(-1)), (0.1, np.exp(-4))):
        np.testing.assert_allclose(
            drive.joint_coulomb(np.array([qd])), LEVEL + 0.2 * share, rtol=1e-14
        )
        expected = np.sign(qd) * (LEVEL + 0.2 * share)
        np.testing.assert_allclose(drive.friction(np.array([qd])), expected, rtol=1e-14)


def test_gears_carry_the_offset_with_their_sign_and_the_level_without():
    plain = puma560.rig()
    curve = FrictionCurve(offset=(0.01, 0.02), breakaway=(0.05, 0.03), speed=(5.0, 6.0))
    drive = dataclasses.replace(plain.drive, curve=curve)
    np.testing.assert_allclose(drive.joint_offset(), drive.gear * (0.01, 0.02), rtol=1e-15)
    expected = (plain.drive.coulomb + np.array([0.05, 0.03])) * np.abs(drive.gear)
    np.testing.assert_allclose(drive.joint_coulomb(), expected, rtol=1e-15)


def test_casadi_and_the_kernel_agree_and_the_numbers_have_names():
    plain = puma560.rig()
    curve = FrictionCurve(offset=(0.01, 0.02), breakaway=(0.05, 0.03), speed=(5.0, 6.0))
    curved = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, curve=curve))
    assert "drive.curve.breakaway[1]" in curved.number_names()
    arm, law, path = puma560.arm(), puma560.p_law(), puma560.reference()
    one, other = (
        simulate(arm, curved, law, path, duration=0.5, backend=b) for b in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    assert not np.array_equal(
        one.error_pulses, simulate(arm, plain, law, path, duration=0.5).error_pulses
    )


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: rig(breakaway=(-0.1,)), "breakaway must not be negative"),
        (lambda: rig(speed=(0.0,)), "speed must be positive"),
        (lambda: rig(speed=None), "breakaway and speed must be given together"),
        (
            lambda: rig(offset=(0.0, 0.1), breakaway=(0.0, 0.0), speed=(1.0, 1.0)),
            "curve.offset must have 1 joints",
        ),
        (
            lambda: dataclasses.replace(puma560.rig().drive, curve=0.3),
            "curve of Drive must be of type FrictionCurve",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)
