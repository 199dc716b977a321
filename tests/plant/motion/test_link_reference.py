"""Motors' motion for the sake of links: by hand for a pendulum, by differences, in the limit of
stiff gears.
"""

import dataclasses
import types

import numpy as np
import pytest
from closed_loops import NoTorque, joint
from hypothesis import given, settings
from hypothesis import strategies as st
from packaged_arms import planar

from plant import (
    Coupling,
    Drive,
    Dynamics,
    Elasticity,
    Encoder,
    Harmonics,
    LinkReference,
    PointToPoint,
    Record,
    Reference,
    Rig,
    Spline,
    Table,
    fastest,
    part,
    puma560,
    simulate,
)
from plant.motion import Scaled
from plant.parts import from_plain
from plant.simulation import ClosedLoop

RIG, ARM, PATH = puma560.rig(), puma560.literature_arm(1.5), puma560.reference()
MOTOR, LINK, MASS, RADIUS = 1.2, 0.8, 4.0, 0.3


def on_gears(rig=RIG, **numbers):
    given = {"stiffness": (2e5, 8e4), "damping": (40.0, 20.0), **numbers}
    return dataclasses.replace(
        rig, drive=dataclasses.replace(rig.drive, elasticity=Elasticity(**given))
    )


def pendulum(stiffness):
    """A link that lifts its mass, on a gear, with its motor's inertia in f."""
    arm = joint(MASS, RADIUS, MOTOR + LINK)
    gear = Elasticity(stiffness=(stiffness,), damping=(0.0,))
    drive = Drive(
        gear=(50.0,),
        motor_inertia=(MOTOR / 2500,),
        motor_gain=(0.2,),
        current_limit=(np.inf,),
        viscous=(0.0,),
        coulomb=(0.0,),
        elasticity=gear,
    )
    return arm, Rig(drive=drive, encoder=Encoder(resolution=(1000,), smooth=True), period=0.7e-3)


def test_it_is_the_pendulum_s_worked_out_by_hand():
    """q = a sin(w t): k (theta - q) = J qdd + m g r cos(q), and its two derivatives in time."""
    k, a, w, weight = 5e3, 0.4, 9.0, MASS * 9.81 * RADIUS
    arm, rig = pendulum(k)
    path = Harmonics(period=2 * np.pi / w, offset=(0.0,), cosine=((0.0,),), sine=((a,),))
    t = np.linspace(0, 2, 77)
    s, c = np.sin(w * t), np.cos(w * t)
    q, qd, qdd, jerk, snap = a * s, a * w * c, -a * w**2 * s, -a * w**3 * c, a * w**4 * s
    carried = LINK * qdd + weight * np.cos(q)
    rate = LINK * jerk - weight * np.sin(q) * qd
    bend = LINK * snap - weight * (np.cos(q) * qd**2 + np.sin(q) * qdd)
    got = LinkReference(arm, rig, path)(t)
    np.testing.assert_allclose(got.q[:, 0], q + carried / k, rtol=0, atol=1e-14)
    np.testing.assert_allclose(got.qd[:, 0], qd + rate / k, rtol=0, atol=1e-13)
    np.testing.assert_allclose(got.qdd[:, 0], qdd + bend / k, rtol=0, atol=1e-11)


def wound_time(path):
    t = np.linspace(0, 1.7, 9)
    s, w = path.duration / 1.7, 2 * np.pi / 1.7
    return Scaled(
        path=path,
        times=t,
        places=s * (t + 0.1 * np.sin(w * t)),
        speeds=s * (1 + 0.1 * w * np.cos(w * t)),
        accelerations=-s * 0.1 * w**2 * np.sin(w * t),
    )


MOTIONS = [
    PATH,
    PointToPoint(start=(0.0, 0.2), goal=(-1.2, 1.1), duration=0.9),
    Spline(times=(0, 0.4, 0.5, 1.1), points=((0.0, 1.0), (0.5, 0.2), (0.6, -0.3), (0.1, 0.4))),
    wound_time(PATH),
]


@pytest.mark.parametrize("path", MOTIONS, ids=lambda each: type(each).__name__)
def test_speed_and_acceleration_are_derivatives(path):
    """Central differences with steps of 1e-5, away from where the jerk jumps; as accurate as
    those of q_r itself.
    """
    motors, step = LinkReference(ARM, on_gears(stiffness=(2e4, 8e3)), path), 1e-5
    t = np.random.default_rng(0).uniform(0.01, path.duration - 0.01, 60)
    t = t[[np.abs(np.asarray(getattr(path, "times", (9.0,))) - x).min() > 2 * step for x in t]]
    before, now, after = (motors(t + k * step) for k in (-1, 0, 1))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, rtol=0, atol=1e-6)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * step), now.qdd, rtol=0, atol=1e-4)
    assert np.abs(now.qdd - path(t).qdd).max() > 0.02  # there is something to differ from


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.floats(1e2, 1e12))
def test_the_deflection_is_inverse_to_the_stiffness(scale):
    """So the limit of stiff gears is the links' own motion; 1e-15 of a turn is what rounding
    leaves.
    """
    t = np.linspace(0, 3, 9)
    own = PATH(t)
    soft, stiff = (LinkReference(ARM, on_gears(stiffness=(k, k)), PATH)(t) for k in (1e2, scale))
    for k, q in enumerate(own):
        np.testing.assert_allclose(
            stiff[k] - q, (soft[k] - q) * 1e2 / scale, rtol=1e-9, atol=1e-13 * 10**k
        )


def test_motors_that_stand_there_hold_their_links_on_the_reference():
    """At rest, with motors that move several joints: links hang where they were asked to be."""
    coupling = Coupling(matrix=((1.0, 0.0, 0.0), (0.4, 1.0, 0.0), (0.3, -0.7, 1.0)))
    drive = Drive(
        gear=(80.0, -60.0, 50.0),
        motor_inertia=(2e-4,) * 3,
        viscous=(1e-3,) * 3,
        coulomb=(0.1,) * 3,
        motor_gain=(0.2,) * 3,
        current_limit=(20.0,) * 3,
        coupling=coupling,
        elasticity=Elasticity(stiffness=(9e3, 5e3, 2e3), damping=(1.0,) * 3),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(1000,) * 3), period=0.7e-3)
    dynamics = Dynamics.from_chain(planar(3).coupled(coupling))
    arm = dynamics.arm(dynamics.f())
    pose = np.array([0.3, -0.4, 0.9])
    motors = LinkReference(arm, rig, PointToPoint(start=pose, goal=pose, duration=1.0))([0.0])
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=NoTorque(), steps_per_sample=1)
    state = loop.initial_state(motors.q[0], np.zeros(3), loop.number_values(arm.f))
    at = loop.state_names.index("link[0]")
    assert np.abs(motors.q[0] - pose).min() > 1e-4
    np.testing.assert_allclose(state[at : at + 3], pose, rtol=0, atol=1e-12)


def test_a_simulation_starts_with_motors_there_and_links_off_by_what_the_start_takes():
    """q_r begins with an acceleration: the link hangs at rest, off by its inertia times that
    over k.
    """
    arm, rig = pendulum(5e3)
    path = Harmonics(period=1.0, offset=(0.5,), cosine=((-0.1,),), sine=((0.0,),))
    motors = LinkReference(arm, rig, path)
    record = simulate(arm, rig, NoTorque(), motors, duration=0.01)
    assert record.error_pulses[0, 0] == pytest.approx(0, abs=1e-9)
    ahead = LINK * path([0.0]).qdd[0, 0] / 5e3
    # the weight changes with the angle by this share
    slope = MASS * 9.81 * RADIUS * np.sin(0.5) / 5e3
    assert record.true_q[0, 0] - path([0.0]).q[0, 0] == pytest.approx(ahead / (1 - slope), rel=1e-3)


def test_it_takes_an_identification_for_arm_and_rig():
    found = types.SimpleNamespace(arm=ARM, rig=on_gears())
    assert LinkReference(found, reference=PATH) == LinkReference(ARM, on_gears(), PATH)
    other = on_gears(stiffness=(2e4, 8e3))
    assert LinkReference(found, other, PATH) == LinkReference(ARM, other, PATH)


def test_it_survives_its_description_and_its_record(tmp_path):
    motors = LinkReference(ARM, on_gears(), PATH)
    assert from_plain(motors.describe()) == motors
    assert motors.links is PATH
    assert PATH.links is PATH
    record = simulate(ARM, on_gears(), puma560.p_law(), motors, duration=0.02)
    record.to_csv(tmp_path / "log.csv")
    again = Record.from_csv(tmp_path / "log.csv")
    assert again.reference == motors
    assert motors.motion(np.empty(0))[2].shape == (0, 2)


@part
class Bare(Reference):
    """A user's reference that gives what it must."""

    n = 2
    duration = 1.0

    def motion(self, t):
        return (np.zeros((len(t), 2)),) * 3


PLAY = on_gears(backlash=(0.0, 1e-4))
SEEN = dataclasses.replace(on_gears(), encoder=dataclasses.replace(RIG.encoder, side="link"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: LinkReference(ARM, RIG, PATH),
            "rig of LinkReference must have elastic gears; got rigid ones",
        ),
        (
            lambda: LinkReference(ARM, PLAY, PATH),
            "LinkReference must be without backlash; got 0.0001 rad",
        ),
        (
            lambda: LinkReference(ARM, SEEN, PATH),
            "LinkReference must be on the motors; got the links'",
        ),
        (
            lambda: LinkReference(types.SimpleNamespace(arm=ARM, rig=on_gears()), PATH),
            (
                "rig of LinkReference must be of type Rig; got a value of type Harmonics. Pass arm,"
                " rig and reference="
            ),
        ),
        (lambda: LinkReference(RIG, ARM, PATH), "arm of LinkReference must be of type Arm"),
        (
            lambda: LinkReference(ARM, on_gears(), "(6)"),
            "reference of LinkReference must be of type Reference",
        ),
        (
            lambda: LinkReference(ARM, on_gears(), Table(times=(0, 1), points=((0, 0), (1, 1)))),
            (
                r"must have its third and fourth derivative here; Table gives none. Put a Spline"
                r" through its points, or"
            ),
        ),
        (
            lambda: LinkReference(ARM, on_gears(), Bare()),
            r"Bare gives none. .* define Bare.higher\(t\)",
        ),
        (
            lambda: LinkReference(ARM, on_gears(), LinkReference(ARM, on_gears(), PATH)),
            "must be the motion of the links; got LinkReference, of motors",
        ),
        (
            lambda: LinkReference(ARM, on_gears(), fastest(ARM, RIG, MOTIONS[1], intervals=20)),
            (
                r"must be smooth, with a bounded snap; at t = 0.\d+ s the motor of joint . .* needs"
                r" .* of 295 N m to wind"
            ),
        ),
        (
            lambda: LinkReference(ARM, on_gears(), PATH).slowed(2.0),
            "path must be the motion of the links",
        ),
        (
            lambda: LinkReference(ARM, on_gears(), PointToPoint(start=(0,), goal=(1,), duration=1)),
            "reference must have 2 joints like the rig; got 1",
        ),
        (
            lambda: LinkReference(pendulum(1e3)[0], on_gears(), PATH),
            "rig must have 1 joints like the arm; got 2",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


def test_no_backlash_is_a_backlash_of_zero():
    t = np.linspace(0, 1, 5)
    plain, zero = (
        LinkReference(ARM, on_gears(**each), PATH)(t) for each in ({}, {"backlash": (0.0, 0.0)})
    )
    np.testing.assert_array_equal(plain.q, zero.q)
