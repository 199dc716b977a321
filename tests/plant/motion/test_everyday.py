"""Everyday motions: inside limits and torque by another engine, from rest to rest, one joint
alone, for any arm.
"""

import dataclasses

import numpy as np
import pytest
from demands import joint_torque, one_joint
from hypothesis import given, settings
from hypothesis import strategies as st
from packaged_arms import planar, puma560_rig
from packaged_arms import puma560 as whole_puma560

from plant import (
    Coupling,
    Dynamics,
    Limits,
    LoadError,
    PointToPoint,
    everyday_motions,
    puma560,
    read_robot,
    simulate,
)
from plant.motion import motions_of, naming, slowing

ARM, RIG = puma560.arm(), puma560.rig()
MOTIONS = everyday_motions(ARM, RIG)
OTHERS = ["all slowly", "creep", "far and fast", "ten pulses", "there and back", "move and hold"]
WIDE = {"lower": (-3, -3), "upper": (3, 3), "velocity": (9, 9), "effort": (999, 999)}


def sampled(motion, points=1001):
    return motion(np.linspace(0, motion.duration, points))


def weak(share):
    """A rig whose amplifiers give this share of their current."""
    drive = dataclasses.replace(RIG.drive, current_limit=share * RIG.drive.current_limit)
    return dataclasses.replace(RIG, drive=drive)


def test_what_each_motion_is():
    assert list(MOTIONS) == ["joint 2 (q[0]) alone", "joint 3 (q[1]) alone", *OTHERS]
    start = sampled(MOTIONS["creep"]).q[0]
    for name, motion in MOTIONS.items():
        q, qd, qdd = sampled(motion)
        np.testing.assert_allclose(q[0], start, atol=1e-12, err_msg=name)
        for end in (0, -1):  # 1e-9 of a pulse at a sample
            np.testing.assert_allclose(qd[end], 0, atol=1e-9, err_msg=name)
            np.testing.assert_allclose(qdd[end], 0, atol=1e-9, err_msg=name)
    for i in range(2):
        moved = np.ptp(sampled(list(MOTIONS.values())[i]).q, axis=0)
        assert moved[i] == pytest.approx(0.5)
        assert moved[1 - i] == 0
    creep = MOTIONS["creep"]
    assert np.ptp(sampled(creep).q, axis=0) / creep.duration == pytest.approx(np.radians([1, 1]))
    pulses = RIG.position_in_pulses(sampled(MOTIONS["ten pulses"]).q)
    np.testing.assert_allclose(np.abs(pulses[-1] - pulses[0]), 10)
    there = sampled(MOTIONS["there and back"]).q
    np.testing.assert_allclose(there, there[::-1], atol=1e-12)
    assert (np.diff(there[:501, 0]) > -1e-12).all()
    held = sampled(MOTIONS["move and hold"]).q
    assert np.ptp(held[500:], axis=0).max() < 1e-12 < np.ptp(held[:500], axis=0).min()


def test_where_the_middle_of_the_limits_cannot_be_held_they_begin_elsewhere():
    limits = Limits(lower=(-1.4, -1.4), upper=(1.4, 1.4), velocity=(9, 9), effort=(999, 999))
    rig = weak(0.35)  # 103 N m at the shoulder, of which 83 are taken; level the arm weighs 99
    assert np.array_equal(everyday_motions(ARM, RIG, limits=limits)["creep"]([0.0]).q[0], (0, 0))
    for motion in everyday_motions(ARM, rig, limits=limits).values():
        along = sampled(motion)
        assert (np.abs(along.q) < 1.4).all()
        assert (np.abs(joint_torque(ARM, RIG, along)) < 0.35 * RIG.drive.torque_limit()).all()


def test_gravity_loads_the_pose_of_an_arm_without_limits():
    poses = np.random.default_rng(5).uniform(-np.pi / 2, np.pi / 2, (2000, 2))
    largest = np.abs([ARM.h(pose, (0, 0)) for pose in poses]).max(axis=0)
    share = np.abs(ARM.h(MOTIONS["creep"]([0.0]).q[0], (0, 0))) / largest
    # a quarter, and what the largest of other poses differs by
    assert (np.abs(share - 0.5) < 0.27).all()


def test_the_same_motions_whatever_the_log():
    """Of f that differ by the deviations of an identification the rows of two tables are
    comparable.
    """
    robot, random = read_robot("ur5e"), np.random.default_rng(0)
    start = everyday_motions(robot.arm, robot.rig)["creep"]([0.0]).q
    for _ in range(2):
        f = robot.arm.f * (1 + 0.01 * random.standard_normal(len(robot.arm.f)))
        found = everyday_motions(robot.dynamics.arm(f), robot.rig)["creep"]
        np.testing.assert_array_equal(found([0.0]).q, start)


def test_torques_by_pinocchio_and_limits_of_a_chain_of_six():
    pin = pytest.importorskip("pinocchio")
    from pinocchio_arm import pinocchio_model

    chain, rig = whole_puma560(), puma560_rig()
    rng = np.random.default_rng(1)
    middle, half = rng.uniform(-1, 1, 6), rng.uniform(0.1, 0.8, 6)
    effort = (60.0, 130.0, 60.0, 12.0, 12.0, 12.0)
    limits = Limits(
        lower=middle - half, upper=middle + half, velocity=(0.2, 0.5, 1, 1, 0.1, 2), effort=effort
    )
    dynamics = Dynamics.from_chain(dataclasses.replace(chain, limits=limits).with_rotors(rig.drive))
    motions = everyday_motions(dynamics.arm(dynamics.f()), rig)
    assert len(motions) == 12
    model = pinocchio_model(chain, chain.bodies)
    data, rotors = model.createData(), rig.drive.reflected_inertia()
    for name, motion in motions.items():
        q, qd, qdd = sampled(motion, 201)
        np.testing.assert_allclose(q[0], middle, atol=1e-12)
        assert (np.abs(q - middle) <= 0.9 * half + 1e-9).all(), name
        # planned at 4,000 instants
        assert (np.abs(qd) <= 0.8 * limits.velocity * (1 + 1e-6)).all(), name
        torque = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
        torque += rotors * qdd + rig.drive.friction(qd)
        allowed = np.minimum(effort, rig.drive.torque_limit())
        assert (np.abs(torque) <= 0.8 * allowed + 1e-6).all(), name


def test_weak_drives_make_them_slow_and_short():
    """At 0.23 of the current joint 2 can be held at the pose, but not far from it."""
    rig = weak(0.23)
    motions = everyday_motions(ARM, rig)
    limit = rig.drive.torque_limit()
    for name, motion in motions.items():
        assert (np.abs(joint_torque(ARM, RIG, sampled(motion, 201))) <= 0.8 * limit + 1e-6).all(), (
            name
        )
    assert np.ptp(sampled(motions["far and fast"]).q[:, 0]) < 1.2
    assert motions["far and fast"].duration >= MOTIONS["far and fast"].duration
    fast = everyday_motions(ARM, RIG, limits=Limits(**WIDE | {"velocity": (0.1, 9)}))[
        "far and fast"
    ]
    assert np.abs(sampled(fast).qd).max(axis=0)[0] == pytest.approx(0.08)


def test_the_amplifiers_stay_below_their_limits_in_a_simulation():
    from ctc import ComputedTorque

    law = ComputedTorque(ARM, RIG, bandwidth=95)
    log = simulate(ARM, RIG, law, MOTIONS["far and fast"])
    assert (np.abs(log.current) < RIG.drive.current_limit).all()
    assert np.abs(log.error_pulses).max() <= 2


@given(st.integers(1, 5), st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_any_arm_stays_inside_its_limits(n, seed):
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-2, 0, n)
    limits = Limits(
        lower=lower,
        upper=lower + rng.uniform(0, 3, n),
        velocity=rng.uniform(0.05, 3, n),
        effort=np.full(n, np.inf),
    )
    dynamics = Dynamics.from_chain(planar(n))
    drive = type(RIG.drive)(
        gear=(-90.0,) * n,
        motor_inertia=(1e-4,) * n,
        viscous=(1e-4,) * n,
        coulomb=(0.05,) * n,
        motor_gain=(0.2,) * n,
        current_limit=(60.0,) * n,
    )
    rig = dataclasses.replace(RIG, drive=drive, encoder=type(RIG.encoder)(resolution=(1000,) * n))
    for name, motion in everyday_motions(dynamics.arm(dynamics.f()), rig, limits=limits).items():
        q, qd, _ = sampled(motion, 301)
        assert (q >= limits.lower - 1e-9).all(), name
        assert (q <= limits.upper + 1e-9).all(), name
        assert (np.abs(qd) <= limits.velocity).all(), name


def test_limits_beyond_a_turn_are_no_middle():
    robot = read_robot("ur5e")
    start = next(iter(everyday_motions(robot.arm, robot.rig).values()))([0.0]).q[0]
    assert np.abs(start).max() <= np.pi / 2
    assert np.abs(start[1:3]).min() > 0.1  # 0 is an arm stretched out, gravity at its largest


def sliding():
    chain = planar(2)
    links = (chain.links[0], dataclasses.replace(chain.links[1], prismatic=True))
    dynamics = Dynamics.from_chain(dataclasses.replace(chain, links=links))
    return dynamics.arm(dynamics.f())


@pytest.mark.parametrize(
    ("arm", "lower", "upper", "travel"),
    [(sliding(), 0, np.inf, 0.1), (ARM, 0, 6.4, 0.5), (ARM, -6.4, 0, 0.5)],
    ids=["slide", "above", "below"],
)
def test_a_joint_whose_limit_lies_at_zero_moves(arm, lower, upper, travel):
    """Alone by 0.5 rad, or a fifth of it in metres."""
    limits = Limits(**WIDE | {"lower": (-9, lower), "upper": (9, upper)})
    motions = everyday_motions(arm, RIG, limits=limits)
    alone = sampled(list(motions.values())[1]).q[:, 1]
    assert np.ptp(alone) == pytest.approx(travel)
    for motion in motions.values():
        q = sampled(motion).q[:, 1]
        assert lower < q.min()
        assert q.max() < upper


def test_a_joint_whose_speed_limit_is_zero_stands_still():
    limits = Limits(**WIDE | {"velocity": (9, 0)})
    for name, motion in everyday_motions(ARM, RIG, limits=limits).items():
        assert motion.duration == MOTIONS[name].duration
        assert np.ptp(sampled(motion).q[:, 1]) == 0


# -- what a user gives ---------------------------------------------------------------------------
FAR = PointToPoint(start=(0, 0), goal=(1.0, -1.0), duration=0.2)
LIMITED = dataclasses.replace(
    ARM.dynamics.chain, limits=Limits(**WIDE | {"upper": (0.5, 3), "velocity": (1, 9)})
)


def limited():
    dynamics = Dynamics.from_chain(dataclasses.replace(planar(2), limits=LIMITED.limits))
    return dynamics.arm(dynamics.f())


def test_the_factor_that_is_named_is_the_one_that_is_needed():
    with pytest.raises(
        ValueError, match=r"motion 'quick' must be .* Slow it down by \.slowed\("
    ) as refusal:
        motions_of(ARM, RIG, {"quick": FAR}, "")
    factor = float(str(refusal.value).split("slowed(")[1].rstrip(")."))
    assert factor > 1.1
    torque = joint_torque(ARM, RIG, sampled(FAR.slowed(factor), 4001))
    assert (np.abs(torque) / RIG.drive.torque_limit()).max() == pytest.approx(1, abs=2e-3)
    assert list(motions_of(ARM, RIG, {"quick": FAR.slowed(factor)}, "")) == ["quick"]


def coupled():
    belt = Coupling(matrix=((1, 0), (1, 1)))
    dynamics = Dynamics.from_chain(planar(2).coupled(belt))
    drive = dataclasses.replace(RIG.drive, coupling=belt)
    return dynamics.arm(dynamics.f()), dataclasses.replace(RIG, drive=drive)


@pytest.mark.parametrize(("velocity", "needed"), [(np.inf, 1.0), (0.01, None)])
def test_a_weight_that_viscous_friction_carries_is_too_heavy_at_low_speed(velocity, needed):
    """The arm sinks from above to below: level, it weighs more than the drive holds."""
    dynamics = Dynamics.from_chain(planar(1))
    arm, (_, _, rig) = dynamics.arm(dynamics.f()), one_joint()
    up = np.pi / 2
    path = PointToPoint(start=(up,), goal=(-up,), duration=4.0)
    weight = abs(arm.h((0.0,), (0.0,))[0])
    speed = np.abs(sampled(path).qd).max()
    viscous = weight / speed / rig.drive.gear[0] ** 2
    drive = dataclasses.replace(rig.drive, viscous=(viscous,))
    rig = dataclasses.replace(rig, drive=drive.limited_to((0.8 * weight,)))
    limits = Limits(lower=(-9,), upper=(9,), velocity=(velocity,), effort=(np.inf,))
    if needed:
        assert slowing(arm, rig, path, limits) == needed
    else:
        with pytest.raises(ValueError, match=r"joint 1 \(q\[0\]\) needs 1\.2. times as much"):
            slowing(arm, rig, path, limits)


def test_a_factor_above_a_thousand_is_enough():
    quick = PointToPoint(start=(0, 0), goal=(0.4, 0), duration=1.3e-4)
    with pytest.raises(ValueError, match=r"slowed\(\d{4,}\.\d+\)") as refusal:
        motions_of(limited(), RIG, {"quick": quick}, "")
    factor = float(str(refusal.value).split("slowed(")[1].rstrip(")."))
    assert slowing(limited(), RIG, quick.slowed(factor), LIMITED.limits) == 1


def test_an_error_keeps_its_kind_unless_it_takes_more_than_a_text():
    for error, kind in (
        (LoadError("x"), LoadError),
        (UnicodeDecodeError("a", b"", 0, 1, "x"), None),
    ):
        with pytest.raises(ValueError, match=r"motion 'quick': .*x") as named, naming("quick"):
            raise error
        assert type(named.value) is (kind or ValueError)


WRONG = {
    "limits of another arm": (
        lambda: everyday_motions(
            ARM, RIG, limits=Limits(lower=(0,), upper=(1,), velocity=(1,), effort=(1,))
        ),
        "limits must have 2 joints like the rig; got 1",
    ),
    "no limits": (lambda: everyday_motions(ARM, RIG, limits=3), "limits must be of type Limits"),
    "swapped": (lambda: everyday_motions(RIG, ARM), "The order is arm, rig"),
    "too heavy": (
        lambda: everyday_motions(ARM, weak(0.05)),
        "motion '.*': path must be one along which the drives can hold the arm",
    ),
    "no motions": (
        lambda: motions_of(ARM, RIG, {}, ""),
        "motions must have texts as names; got none",
    ),
    "no name": (lambda: motions_of(ARM, RIG, {"": FAR}, ""), "motions must have texts as names"),
    "no reference": (
        lambda: motions_of(ARM, RIG, {"a": 3}, ""),
        "motion 'a' must be of type Reference",
    ),
    "other joints": (
        lambda: motions_of(ARM, RIG, {"a": PointToPoint(start=(0,), goal=(1,), duration=1)}, ""),
        "motion 'a': reference must have 2 joints",
    ),
    "beyond a stop": (
        lambda: motions_of(limited(), RIG, {"near": FAR.slowed(40), "far": FAR.slowed(50)}, ""),
        r"motion 'near': path must stay within the limits; joint 1 \(q\[0\]\) exceeds",
    ),
    "a joint that may not move": (
        lambda: slowing(ARM, RIG, FAR, Limits(**WIDE | {"velocity": (9, 0)})),
        r"limits\.velocity of 0 .*joint 3 \(q\[1\]\) moves by 1",
    ),
    "no effort": (
        lambda: everyday_motions(ARM, RIG, limits=Limits(**WIDE | {"effort": (0, 999)})),
        r"limits\.effort must be positive; got 0 at joint 2 \(q\[0\]\)",
    ),
    "efforts of coupled motors": (
        lambda: everyday_motions(*coupled(), limits=Limits(**WIDE)),
        r"limits\.effort must be inf where motors are coupled; got 999 at joint 1 \(q\[0\]\)",
    ),
    "too fast for a joint": (
        lambda: motions_of(
            limited(), RIG, {"a": PointToPoint(start=(0, 0), goal=(0.4, 0), duration=0.5)}, ""
        ),
        r"too fast by a factor of 1\.5\. ",
    ),
}


@pytest.mark.parametrize(("call", "message"), WRONG.values(), ids=WRONG)
def test_wrong_calls_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)
