"""The fastest motion along a path: what is known by hand, limits by inverse dynamics, the same
path, and pulses.
"""

import dataclasses
import functools

import numpy as np
import pytest
from demands import joint_torque, one_joint
from packaged_arms import planar

from ctc import ComputedTorque, evaluate
from plant import (
    Coupling,
    Dynamics,
    Harmonics,
    Held,
    Limits,
    PointToPoint,
    Spline,
    Table,
    fastest,
    puma560,
)

ARM, RIG = puma560.arm(), puma560.rig()
MOVE = PointToPoint(start=(0.0, 0.0), goal=(-1.0, 1.0), duration=1.0)
SPLINE = Spline(times=(0, 0.5, 1, 1.5), points=((0, 0), (-0.5, 0.8), (-1, 0.2), (-0.3, 1.0)))
WAVE = Harmonics(
    period=2.0, offset=(-0.5, 0.2), cosine=((0.3, 0.1), (0.0, -0.2)), sine=((0.0, 0.2), (0.4, 0.0))
)
PATHS = [puma560.reference(), MOVE, SPLINE, WAVE]
REST = (MOVE, SPLINE)
ONE = PointToPoint(start=(0.2,), goal=(1.7,), duration=1.0)


@functools.cache
def quick(path, **options):
    """On 60 intervals."""
    return fastest(ARM, RIG, path, intervals=60, **options)


# -- by hand -------------------------------------------------------------------------------------
def test_one_joint_is_bang_bang():
    """Source: 2 sqrt(d I / tau); from above, nearer with every refinement, and within 1 % at the
    default.
    """
    arm, inertia, rig = one_joint(limit=10.0)
    known = 2 * np.sqrt(1.5 * inertia / (0.9 * 10.0))
    ratio = [fastest(arm, rig, ONE, intervals=k).duration / known for k in (15, 30, 60, 120)]
    assert ratio[-1] > 1
    assert (np.diff(ratio) < 0).all()
    assert ratio[-1] < 1.01


def test_dry_friction_brakes_with_the_motor():
    """Accelerates with tau - C, brakes with tau + C: T = sqrt(2 d (1 / a + 1 / b)). The wrong sign
    changes nothing in T, but the torque: the peak must be at both signs of the motor.
    """
    arm, inertia, rig = one_joint(limit=10.0, coulomb=4.0)
    law = fastest(arm, rig, ONE)
    known = np.sqrt(2 * 1.5 * inertia * (1 / (9.0 - 4.0) + 1 / (9.0 + 4.0)))
    assert 1 < law.duration / known < 1.01
    motion = law(np.linspace(0, law.duration, 2001)[1:-1])
    assert motion.qdd.max() == pytest.approx(5.0 / inertia, rel=0.01)
    assert motion.qdd.min() == pytest.approx(-13.0 / inertia, rel=0.01)


def test_a_speed_limit_makes_a_trapezoid():
    """Source: T = d / v + v / a, where v^2 < a d."""
    arm, inertia, rig = one_joint(limit=10.0)
    v, a = 2.0, 9.0 / inertia
    assert v**2 < a * 1.5
    law = fastest(arm, rig, ONE, motor_speed=(50 * v,))
    assert 1 < law.duration / (1.5 / v + v / a) < 1.01
    assert np.abs(law(np.linspace(0, law.duration, 5000)).qd).max() <= v * (1 + 1e-6)


def test_limits_of_a_model_file_are_those_of_its_joints():
    """Speed and effort as by motor_speed and by an amplifier of that torque; a position is
    refused where it is left.
    """
    arm, _, rig = one_joint(limit=10.0)
    limits = Limits(lower=(0.0,), upper=(2.0,), velocity=(1.2,), effort=(6.0,))
    weaker = dataclasses.replace(rig, drive=rig.drive.limited_to((6.0,)))
    expected = fastest(arm, weaker, ONE, motor_speed=(1.2 * abs(rig.drive.gear[0]),), intervals=30)
    got = fastest(arm, rig, ONE, limits=limits, intervals=30)
    assert got.duration == pytest.approx(expected.duration, rel=1e-9)
    assert got.duration > 1.05 * fastest(arm, rig, ONE, intervals=30).duration
    with pytest.raises(
        ValueError, match=r"path must stay within the limits; .* exceeds \[0, 1.6\] by 0.1"
    ):
        fastest(arm, rig, ONE, limits=dataclasses.replace(limits, upper=(1.6,)))
    with pytest.raises(ValueError, match="limits must have 1 joints like the rig; got 2"):
        fastest(
            arm,
            rig,
            ONE,
            limits=Limits(**dict.fromkeys(("lower", "upper", "velocity", "effort"), (1, 1))),
        )


def test_four_times_the_torque_is_twice_as_fast():
    """Without gravity and friction; both problems are one, scaled, and Ipopt stops at 1e-7."""
    dynamics = Dynamics.from_chain(dataclasses.replace(planar(2), gravity=(0.0, 0.0, 0.0)))
    drive = dataclasses.replace(RIG.drive, viscous=(0, 0), coulomb=(0, 0))
    weak, strong = (
        dataclasses.replace(RIG, drive=dataclasses.replace(drive, current_limit=(k, 0.6 * k)))
        for k in (1.0, 4.0)
    )
    arm = dynamics.arm(dynamics.f())
    slow, fast = (fastest(arm, rig, SPLINE, intervals=60) for rig in (weak, strong))
    assert slow.duration == pytest.approx(2 * fast.duration, rel=1e-5)


# -- limits --------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_the_torque_keeps_its_limit_everywhere(path):
    """By inverse dynamics at 2,000 random times; the share was held at 4,001 points, between
    them it is 1e-3 larger.
    """
    law = quick(path)
    t = np.random.default_rng(0).uniform(0, law.duration, 2000)
    share = np.abs(RIG.drive.current(joint_torque(ARM, RIG, law(t)))).max(axis=1) / 12
    assert share.max() < 0.9 * (1 + 1e-3)
    assert share.max() > 0.88
    assert np.median(share) > 0.8  # most of the time some motor gives all it may


def test_the_limit_of_coupled_motors_is_that_of_their_currents():
    belt = Coupling(matrix=((1, 0), (1, 1)))
    dynamics = Dynamics.from_chain(planar(2).coupled(belt))
    arm, rig = (
        dynamics.arm(dynamics.f()),
        dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, coupling=belt)),
    )
    law = fastest(arm, rig, MOVE, intervals=60)
    current = rig.drive.current(joint_torque(arm, rig, law(np.linspace(0, law.duration, 1501))))
    assert np.abs(current).max() / 12 == pytest.approx(0.9, rel=1e-3)


def test_the_torque_changes_no_faster_than_asked():
    """But for dry friction; between the points where it is held the rate is a few per cent
    larger.
    """
    smooth = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, coulomb=(0, 0)))
    bound = np.array([5e3, 3e3])
    free, law = (
        fastest(ARM, smooth, SPLINE, torque_rate=rate, intervals=60) for rate in (None, bound)
    )
    assert law.duration > free.duration

    def rate(law):
        t = np.linspace(0, law.duration, 2001)
        return np.abs(np.gradient(joint_torque(ARM, smooth, law(t)), t, axis=0)).max(axis=0)

    assert (rate(law) < 1.05 * bound).all()
    assert (rate(free) > 4 * bound).any()


# -- the motion ----------------------------------------------------------------------------------
def test_a_line_stays_a_line():
    q = (law := fastest(ARM, RIG, MOVE))(np.linspace(0, law.duration, 777)).q
    np.testing.assert_allclose(q[:, 0], -q[:, 1], atol=1e-15)
    np.testing.assert_allclose(q[[0, -1]], [MOVE.start, MOVE.goal], atol=1e-12)


def test_trajectory_6_stays_on_its_curve():
    """Source: paper eq. (6): with c = 1 + 4 q2 / pi, the cosine of the phase, q3 = pi/4 - pi/4
    (2 c^2 - 1).
    """
    law = quick(PATHS[0])
    q = law(np.linspace(0, law.duration, 777)).q
    c = 1 + 4 * q[:, 0] / np.pi
    np.testing.assert_allclose(q[:, 1], np.pi / 2 * (1 - c**2), atol=1e-13)
    # both ways, all of it
    assert np.ptp(q, axis=0) == pytest.approx([np.pi / 2, np.pi / 2], rel=1e-4)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_it_goes_from_rest_to_rest_without_a_jump(path):
    """Where the acceleration moves most between 2,001 times, it moves 100 times less in a
    1,000th of the step.
    """
    law = quick(path)
    t = np.linspace(0, law.duration, 2001)
    motion = law(t)
    np.testing.assert_allclose(motion.qd[[0, -1]], 0, atol=1e-9 * np.abs(motion.qd).max())
    if path in REST:
        np.testing.assert_allclose(motion.qdd[[0, -1]], 0, atol=1e-6 * np.abs(motion.qdd).max())
    np.testing.assert_allclose(
        law([0.0, law.duration, 9.0]).q, path([0.0, path.duration, path.duration]).q, atol=1e-12
    )
    move = np.abs(np.diff(motion.qdd, axis=0)).max(axis=1)
    k = np.argmax(move)
    closer = law(np.linspace(t[k], t[k + 1], 1001)).qdd
    assert np.abs(np.diff(closer, axis=0)).max() < move[k] / 20


def test_with_a_torque_rate_the_acceleration_rises_no_faster_than_that():
    """At the start of a motion from rest, D changes little: 5 kN m/s over D22, at least 1.4 kg
    m^2 for joint 3.
    """
    law = quick(MOVE, torque_rate=(5e3, 5e3))
    t = np.linspace(0, law.duration, 4001)
    assert np.abs(np.gradient(law(t).qdd, t, axis=0)).max() < 5e3 / 1.4


@pytest.mark.parametrize("seed", range(5))
def test_it_is_never_slower_than_uniform_scaling(seed):
    random = np.random.default_rng(seed)
    points = np.cumsum(random.uniform(-0.6, 0.6, (5, 2)), axis=0)
    path = Spline(times=np.linspace(0, 2, 5), points=points)
    law = fastest(ARM, RIG, path, intervals=60)
    assert law.duration < fastest(ARM, RIG, path, uniform=True).duration
    assert law.torque_share(ARM, RIG).max() <= 0.9 * (1 + 1e-9)


# -- pulses --------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", PATHS[:3], ids=lambda p: type(p).__name__)
def test_it_is_tracked_within_one_pulse_where_the_uniform_motion_of_its_duration_is_not(path):
    law = ComputedTorque(ARM, RIG, bandwidth=150)
    fast = quick(path, torque_rate=(5e3, 5e3))
    uniform = path.slowed(fast.duration / path.duration)
    assert uniform.torque_share(ARM, RIG).max() > 1.1
    assert evaluate(ARM, RIG, law, fast, backend="numba").within(1)
    lost = evaluate(ARM, RIG, law, uniform, backend="numba")
    assert lost.saturation.max() > 0.3
    assert lost.max_error_pulses.max() > 100


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"share": 0.1},
            (
                r"path must be one along which the drives can hold the arm and creep; joint 2"
                r" \(q\[0\]\) needs"
            ),
        ),
        ({"motor_speed": (100, 0)}, "motor_speed must be positive"),
        ({"motor_speed": 100}, r"motor_speed must have shape \(2,\)"),
        ({"torque_rate": (1e4, -1)}, "torque_rate must be positive"),
        ({"torque_rate": (1e4, np.nan)}, "torque_rate must be positive"),
        ({"intervals": 2}, "intervals must be a whole number of at least 4"),
        ({"shares": 0.5}, "Did you mean 'share'"),
    ],
)
def test_bad_options_are_refused_in_one_line(options, message):
    with pytest.raises(ValueError, match=message) as refusal:
        fastest(ARM, RIG, MOVE, **options)
    assert "\n" not in str(refusal.value)


TABLE = Table(times=(0, 1), points=((0, 0), (1, 1)))
CORNERS = {
    "table": TABLE,
    "held": Held(times=(0, 1), points=((0, 0), (1, 1))),
    "slowed": TABLE.slowed(1.0).slowed(2.0),
    "later": TABLE.later(0.0),
    "moved": TABLE.moved((1, 1), (0, 0)).later(0.1),
}


@pytest.mark.parametrize("path", CORNERS.values(), ids=CORNERS)
def test_a_path_with_corners_is_refused(path):
    with pytest.raises(ValueError, match="a Table has corners"):
        fastest(ARM, RIG, path)


def test_a_path_without_length_is_refused():
    with pytest.raises(ValueError, match="must meet a limit somewhere"):
        fastest(ARM, RIG, PointToPoint(start=(0, 0), goal=(0, 0), duration=1.0))


BELT = dataclasses.replace(
    RIG, drive=dataclasses.replace(RIG.drive, coupling=Coupling(matrix=((1, 0), (1, 1))))
)
FREE = {"lower": (-9, -9), "upper": (9, 9), "velocity": (np.inf,) * 2, "effort": (np.inf,) * 2}


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((RIG, ARM, MOVE), {"limits": Limits(**FREE)}, "^arm must be of type Arm"),
        ((ARM, MOVE, RIG), {}, "^rig must be of type Rig"),
        ((ARM, RIG, MOVE), {"uniform": True, "motor_speed": np.ones(2)}, "under torque limits"),
        (
            (ARM, RIG, MOVE),
            {"limits": Limits(**FREE | {"velocity": (np.inf, 0)})},
            r"limits\.velocity of 0 .*joint 3 \(q\[1\]\) moves by 1\.",
        ),
        (
            (ARM, RIG, MOVE),
            {"limits": Limits(**FREE | {"effort": (np.inf, 0)})},
            r"limits\.effort must be positive; got 0 at joint 3 \(q\[1\]\)",
        ),
        (
            (ARM, BELT, MOVE),
            {"limits": Limits(**FREE | {"effort": (90, 90)})},
            r"limits\.effort must be inf where motors are coupled; got 90 at joint 2 \(q\[0\]\)",
        ),
    ],
    ids=["swapped", "swapped rig", "array", "still joint", "no effort", "coupled efforts"],
)
def test_wrong_calls_are_refused_by_the_argument(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        fastest(*arguments, **options)


def test_a_joint_that_stands_still_may_have_a_speed_limit_of_zero():
    path = PointToPoint(start=(0, 0), goal=(1, 0), duration=1.0)
    free, still = (
        fastest(ARM, RIG, path, intervals=10, limits=Limits(**FREE | {"velocity": (np.inf, v)}))
        for v in (np.inf, 0)
    )
    assert still.duration == free.duration


def test_the_effort_of_a_joint_whose_shaft_turns_no_other_joint_is_kept():
    """The belt turns shaft 2 with joint 1, so that joint 2 alone has the torque of its shaft."""
    dynamics = Dynamics.from_chain(planar(2).coupled(BELT.drive.coupling))
    arm = dynamics.arm(dynamics.f())
    free, weak = (
        fastest(
            arm, BELT, SPLINE, intervals=10, limits=Limits(**FREE | {"effort": (np.inf, effort)})
        )
        for effort in (np.inf, 0.5 * BELT.drive.torque_limit()[1])
    )
    assert weak.duration > 1.01 * free.duration


def test_a_stop_that_is_passed_between_the_points_of_the_search_is_seen():
    """No point of nine intervals is where the cosine has its largest value, 1."""
    arm, _, rig = one_joint(limit=10.0)
    path = Harmonics(period=2.0, offset=(0.0,), cosine=((-1.0,),), sine=((0.0,),))
    limits = Limits(lower=(-9.0,), upper=(1 - 1e-5,), velocity=(99.0,), effort=(99.0,))
    with pytest.raises(ValueError, match=r"exceeds \[-9, 1\] by"):
        fastest(arm, rig, path, intervals=9, limits=limits)
