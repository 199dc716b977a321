"""A path in another time: the chain rule, slower motions, what happens after the end, and the
way through a file.
"""

import json

import numpy as np
import pytest

from plant import Harmonics, PointToPoint, Record, Spline, puma560, simulate
from plant.motion import Scaled
from plant.parts import from_plain

MOVE = PointToPoint(start=(0.1, -1.0), goal=(1.3, 0.5), duration=0.8)
SPLINE = Spline(times=(0, 0.4, 0.5, 1.1), points=((0.0, 1.0), (0.5, 0.2), (0.6, -0.3), (0.1, 0.4)))
WAVE = Harmonics(
    period=2.0, offset=(0.1, -0.2), cosine=((0.3, 0.1), (0.0, -0.2)), sine=((0.0, 0.2), (0.4, 0.0))
)
PATHS = [MOVE, SPLINE, WAVE]


def warped(path, stays=True):
    """s(t) = end (t / T + 0.1 sin(2 pi t / T)), T = 1.7, given at 25 times."""
    end, t = path.duration, np.linspace(0, 1.7, 25)
    w = 2 * np.pi / 1.7
    return Scaled(
        path=path,
        times=t,
        places=end * (t / 1.7 + 0.1 * np.sin(w * t)),
        stays=stays,
        speeds=end * (1 / 1.7 + 0.1 * w * np.cos(w * t)),
        accelerations=-end * 0.1 * w**2 * np.sin(w * t),
    )


@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_it_is_the_path_at_other_times(path):
    """Degree 5 between 25 points of a sine: its sixth derivative times (spacing / 2)^6 / 720,
    1e-9 of its size.
    """
    t = np.linspace(0, 1.7, 400)
    expected = path(path.duration * (t / 1.7 + 0.1 * np.sin(2 * np.pi / 1.7 * t)))
    np.testing.assert_allclose(warped(path)(t).q, expected.q, rtol=0, atol=1e-7)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_velocity_and_acceleration_are_derivatives(path):
    """Central differences with steps of 1e-5 of a motion whose third derivative is below 1e4:
    1e-10 / 6 * 1e4.
    """
    t, step = np.random.default_rng(0).uniform(0.01, 1.69, 60), 1e-5
    before, now, after = (warped(path)(t + k * step) for k in (-1, 0, 1))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, rtol=0, atol=1e-6)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * step), now.qdd, rtol=0, atol=1e-4)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_jerk_and_snap_are_derivatives(path):
    """Central differences with steps of 1e-5, away from the points of the time law, where they
    jump.
    """
    t, step, motion = np.random.default_rng(0).uniform(0.01, 1.69, 60), 1e-5, warped(path)
    corners = [*motion.times, *(motion.times[-1] * np.asarray(getattr(path, "times", (9.0,))))]
    t = t[[np.abs(np.array(corners) - x).min() > 1e-3 for x in t]]
    before, after = (motion(t + k * step).qdd for k in (-1, 1))
    jerk, snap = motion.higher(t)
    np.testing.assert_allclose(
        (after - before) / (2 * step), jerk, rtol=0, atol=1e-5 * np.abs(jerk).max()
    )
    before, after = (motion.higher(t + k * step)[0] for k in (-1, 1))
    np.testing.assert_allclose(
        (after - before) / (2 * step), snap, rtol=0, atol=1e-5 * np.abs(snap).max()
    )


def test_jerk_and_snap_beyond_the_ends():
    """At rest where the motion stays; along a path that goes on, those of the path at that
    speed.
    """
    t = np.array([-0.2, 1.9])
    assert not np.any(warped(WAVE).higher(t))
    on = WAVE.slowed(1.7)
    for k, (got, expected) in enumerate(
        zip(on.higher(t * 9), WAVE.higher(t * 9 / 1.7), strict=True), 3
    ):
        np.testing.assert_allclose(got, expected / 1.7**k, rtol=0, atol=1e-10)


@pytest.mark.parametrize("path", [*PATHS, warped(WAVE)], ids=lambda p: type(p).__name__)
@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_slowed_is_the_motion_in_another_time(path, factor):
    """Also before its start and long after its end; a polynomial of degree 5 rounds at 1e-15 of
    its coefficients.
    """
    got, t = path.slowed(factor), np.array([-0.3, 0.0, 0.2, 0.77, 1.0, 2.5, 7.3])
    expected = path(t / factor)
    assert got.duration == pytest.approx(path.duration * factor, rel=1e-15)
    np.testing.assert_allclose(got(t).q, expected.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got(t).qd, expected.qd / factor, rtol=0, atol=1e-11)
    np.testing.assert_allclose(got(t).qdd, expected.qdd / factor**2, rtol=0, atol=1e-9)


def test_slowed_twice_is_slowed_once():
    once, twice = warped(MOVE).slowed(6.0), warped(MOVE).slowed(2.0).slowed(3.0)
    assert isinstance(twice.path, PointToPoint)
    t = np.linspace(0, once.duration, 50)
    np.testing.assert_allclose(twice(t).qdd, once(t).qdd, atol=1e-12)


def test_trajectory_6_at_another_period_is_slowed():
    """Source: paper eq. (6): T = 2.0 s is T = 3.65 s in another time."""
    t = np.linspace(0, 5.0, 101)
    got, expected = puma560.reference(3.65).slowed(2.0 / 3.65)(t), puma560.reference(2.0)(t)
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-11)


def test_after_its_end_it_stays_or_goes_on():
    end, after = WAVE.duration, np.array([1.7, 1.8, 5.0])
    stays, goes_on = warped(WAVE)(after), warped(WAVE, stays=False)(after)
    np.testing.assert_allclose(stays.q, WAVE([end] * 3).q, atol=1e-13)
    np.testing.assert_array_equal(stays.qd[1:], 0)
    np.testing.assert_array_equal(stays.qdd[1:], 0)
    speed = end * (1 / 1.7 + 0.1 * 2 * np.pi / 1.7)
    expected = WAVE(end + speed * (after - 1.7))
    np.testing.assert_allclose(goes_on.q, expected.q, atol=1e-12)
    np.testing.assert_allclose(goes_on.qd, expected.qd * speed, atol=1e-12)


def test_after_its_end_nothing_accelerates():
    """A law that comes to rest with an acceleration drops it there, and keeps none of its
    polynomial's.
    """
    law = Scaled(path=WAVE, times=(0, 1), places=(0, 0.5), speeds=(0, 0), accelerations=(2, -2))
    assert np.abs(law([1.0]).qdd).max() > 0.1
    for motion in (law([1.001, 2.0]), law([-0.001, -2.0])):
        np.testing.assert_array_equal(motion.qd, 0)
        np.testing.assert_array_equal(motion.qdd, 0)


def test_it_goes_through_a_file(tmp_path):
    reference = warped(PointToPoint(start=(0.0, 0.0), goal=(-0.3, 0.2), duration=0.8))
    assert from_plain(json.loads(json.dumps(reference.describe()))) == reference
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), reference, duration=0.07)
    record.to_csv(tmp_path / "log.csv")
    again = Record.from_csv(tmp_path / "log.csv")
    assert again.reference == reference
    np.testing.assert_array_equal(again.error_pulses, record.error_pulses)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scaled(path=MOVE, times=(0, 1), places=(0, 1), speeds=(1,), accelerations=(0, 0)),
         r"speeds must have shape \(2,\); got shape \(1,\)"),
        (lambda: Scaled(path=MOVE, times=(1, 2), places=(0, 1), speeds=(1, 1), accelerations=(0, 0)), "from 0"),
        (lambda: Scaled(path=MOVE, times=(0, 2, 2), places=(0, 1, 1), speeds=(1,) * 3, accelerations=(0,) * 3),
         "times must increase; got 2.0 after 2.0 at index 2"),
        (lambda: Scaled(path=(0, 1), times=(0, 1), places=(0, 1), speeds=(1, 1), accelerations=(0, 0)),
         "path of Scaled must be of type Reference"),
        (lambda: MOVE.slowed(0.0), "factor must be a positive number"),
        (lambda: MOVE.slowed(factr=2.0), "Did you mean 'factor'"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(make, message):
    with pytest.raises(ValueError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: type(p).__name__)
def test_other_coordinates_turn_and_shift_a_motion(path):
    """The derivatives are those of its positions, by differences."""
    signs, offset = np.array((1.0, -1.0)), np.array((0.0, np.pi / 2))
    moved = path.moved(signs, offset)
    t = np.linspace(0.01, path.duration - 0.01, 7)
    np.testing.assert_array_equal(moved(t).q, signs * path(t).q + offset)
    step = 1e-5
    for order in (0, 1):
        rate = (moved(t + step)[order] - moved(t - step)[order]) / (2 * step)
        np.testing.assert_allclose(moved(t)[order + 1], rate, rtol=1e-5, atol=1e-5)
    back = moved.moved(signs, -signs * offset)
    np.testing.assert_allclose(back(t).q, path(t).q, atol=1e-15)


def test_other_coordinates_have_the_joints_of_the_motion():
    with pytest.raises(ValueError, match=r"signs must have 2 joints; got 3"):
        WAVE.moved((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
