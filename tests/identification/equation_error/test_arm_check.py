"""A fit of the torque says where its parameters are those of no arm, or of another drive."""

import dataclasses

import numpy as np
import pytest

from identification import fit_torque
from identification.equation_error import FittedArm
from plant import Body, Chain, Drive, Dynamics, Encoder, Harmonics, Link, Rig

CHAIN = Chain(
    links=(Link(name="lift", alpha=-np.pi / 2), Link(name="swing", a=0.3)),
    bodies=(
        Body(mass=3.0, com=(0.15, 0.0, 0.02), inertia=(0.01, 0.0, 0.0, 0.04, 0.0, 0.04)),
        Body(mass=1.2, com=(0.12, 0.02, 0.0), inertia=(0.002, 0.0, 0.0, 0.01, 0.0, 0.01)),
    ),
)
ROTOR = np.array([4e-5, 2e-5])
RIG = Rig(
    drive=Drive(
        gear=(80.0, 60.0),
        motor_inertia=ROTOR,
        viscous=(1e-4, 1e-4),
        coulomb=(0.004, 0.003),
        motor_gain=(0.11, 0.07),
        current_limit=(50.0, 50.0),
    ),
    encoder=Encoder(resolution=(2.0**18, 2.0**18)),
    period=4e-3,
)
DYNAMICS = Dynamics.from_chain(CHAIN.with_rotors(RIG.drive))
ARM = DYNAMICS.arm(DYNAMICS.f())
UNKNOWN = (
    *DYNAMICS.names,
    *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1)),
)


@pytest.fixture(scope="module")
def motion():
    """Positions (N, n) of a motion, and the torques (N, n) of the arm with a little noise."""
    path = Harmonics(
        period=5.0,
        offset=(0.2, -0.3),
        cosine=((0.5, -0.3, 0.1), (0.4, 0.3, -0.1)),
        sine=((-0.4, 0.1, 0.1), (0.5, -0.2, 0.1)),
    )
    times = RIG.period * np.arange(3000)
    q, qd, qdd = path(times)[:3]
    torque = np.array([np.ravel(ARM.inverse(*state)) for state in zip(q, qd, qdd, strict=True)])
    shaft = qd * RIG.drive.gear
    friction = RIG.drive.viscous * shaft + RIG.drive.coulomb * np.sign(shaft)
    torque += RIG.drive.gear * friction
    return q, torque + 0.02 * np.random.default_rng(1).standard_normal(torque.shape)


def test_the_torques_of_an_arm_are_doubted_by_nothing(motion):
    q, torque = motion
    fit = fit_torque(DYNAMICS, q, torque, rig=RIG)
    assert (fit.causes, fit.doubts) == ((), ())


def test_torques_of_the_other_sign_are_those_of_no_arm(motion):
    q, torque = motion
    fit = fit_torque(DYNAMICS, q, -torque, rig=RIG, unknown=UNKNOWN)
    assert [cause.name for cause in fit.causes] == ["sign of the torques"]
    (negative,) = fit.doubts
    assert "D(q) is negative" in negative
    assert "Change the sign of the torque" in negative


def test_a_joint_of_the_other_sign_is_no_matter_of_all_torques(motion):
    q, torque = motion
    fit = fit_torque(DYNAMICS, q, torque * (1, -1), rig=RIG, unknown=UNKNOWN)
    assert [(cause.name, cause.joints) for cause in fit.causes] == [("torque sign", (1,))]
    assert not any("Change the sign of the torque" in doubt for doubt in fit.doubts)


def test_exchanged_torques_are_named(motion):
    q, torque = motion
    cause, *_ = fit_torque(DYNAMICS, q, torque[:, ::-1], rig=RIG).causes
    assert (cause.name, cause.joints) == ("exchanged torques", (0, 1))


def test_torques_without_gravity_are_named(motion):
    """A driver that compensates gravity may log what is left."""
    q, torque = motion
    weight = np.array([np.ravel(ARM.h(pose, np.zeros(2))) for pose in q])
    cause, *_ = fit_torque(DYNAMICS, q, torque - weight, rig=RIG).causes
    assert cause.name == "gravity removed"


def test_currents_that_are_taken_for_torques_contradict_the_rotors(motion):
    """N m per ampere at the joint: 8.8 and 4.2, so the inertias look smaller than the rotors'."""
    q, torque = motion
    current = RIG.drive.current(torque)
    fit = fit_torque(DYNAMICS, q, current, rig=RIG, unknown=UNKNOWN)
    assert fit.doubts
    assert all("is below that of its rotor" in doubt for doubt in fit.doubts)
    (cause,) = fit.causes
    assert cause.name == "torque scale"
    # A chain that states its bodies tells the unit of the torque, between those of the joints.
    factors = 1 / np.abs(RIG.drive.joint_torque(np.ones(2)) * RIG.drive.motor_gain)
    assert factors.min() < cause.size < factors.max()
    assert fit.warnings[: 1 + len(fit.doubts)] == [cause.line, *fit.doubts]


def test_a_rotor_that_is_stated_too_large_is_named(motion):
    q, torque = motion
    drive = dataclasses.replace(RIG.drive, motor_inertia=ROTOR * (1, 30))
    (doubt,) = fit_torque(DYNAMICS, q, torque, rig=dataclasses.replace(RIG, drive=drive)).doubts
    assert doubt.startswith("the inertia of joint swing (q[1])")


def rounded(rig):
    """The true parameters, with variances that rounding has made slightly negative."""
    return FittedArm(
        dynamics=DYNAMICS,
        rig=rig,
        f=ARM.f,
        covariance=-1e-20 * np.eye(len(ARM.f)),
        q=np.zeros((1, 2)),
        fitted=DYNAMICS.names,
        rough=False,
    )


def test_a_variance_that_is_negative_by_rounding_is_zero():
    assert list(rounded(RIG).doubts()) == []
    # Nor does it hide a doubt.
    drive = dataclasses.replace(RIG.drive, motor_inertia=ROTOR * (1, 30))
    assert list(rounded(dataclasses.replace(RIG, drive=drive)).doubts())
