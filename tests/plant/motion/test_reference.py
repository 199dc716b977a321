"""References: derivatives by complex steps and differences, the paper's equation (6), rest at
the ends, bad input.
"""

import dataclasses
import pickle

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import Harmonics, PointToPoint, Spline, Table, puma560

HARMONICS = Harmonics(
    period=2.0,
    offset=(0.1, -0.2, 0.3),
    cosine=((0.3, 0.1), (0.0, -0.2), (0.05, 0.0)),
    sine=((0.0, 0.2), (0.4, 0.0), (0.1, 0.1)),
)
MOVE = PointToPoint(start=(0.1, -1.0), goal=(1.3, 0.5), duration=0.8)
SPLINE = Spline(times=(0, 0.4, 0.5, 1.1), points=((0.0, 1.0), (0.5, 0.2), (0.6, -0.3), (0.1, 0.4)))
TABLE = Table(times=(0.0, 0.5, 0.6, 1.0), points=((0.0, 1.0), (1.0, 0.0), (1.1, 0.5), (0.7, 0.5)))
ALL = [HARMONICS, MOVE, SPLINE, TABLE]


def test_equation_6():
    """Source: paper eq. (6), q_r2 = -pi/4 + pi/4 cos(2 pi t / T), q_r3 = pi/4 - pi/4 cos(4 pi t
    / T); T = 3.65 s.
    """
    reference = puma560.reference()
    t = np.linspace(0, 3.65, 41)
    w = 2 * np.pi / 3.65
    motion = reference(t)
    quarter = np.pi / 4
    # The amplitude is below 4 w^2 pi/4 = 9.3: a few roundings.
    np.testing.assert_allclose(
        motion.q,
        np.c_[-quarter + quarter * np.cos(w * t), quarter - quarter * np.cos(2 * w * t)],
        atol=1e-14,
    )
    np.testing.assert_allclose(
        motion.qd,
        np.c_[-quarter * w * np.sin(w * t), 2 * quarter * w * np.sin(2 * w * t)],
        atol=1e-14,
    )
    np.testing.assert_allclose(
        motion.qdd,
        np.c_[-quarter * w**2 * np.cos(w * t), 4 * quarter * w**2 * np.cos(2 * w * t)],
        atol=1e-13,
    )
    np.testing.assert_allclose(motion.q[0], 0, atol=1e-15)
    assert reference.duration == 3.65
    assert puma560.reference(2.0).duration == 2.0


def test_harmonics_have_the_derivatives_of_their_complex_extension():
    t, step = np.linspace(-1, 5, 61), 1e-20
    w = 2 * np.pi / 2.0

    def q(time):
        total = np.asarray(HARMONICS.offset) + 0 * time[:, None]
        for j in range(2):
            c, s = np.cos((j + 1) * w * time), np.sin((j + 1) * w * time)
            total = total + np.outer(c, np.asarray(HARMONICS.cosine)[:, j])
            total = total + np.outer(s, np.asarray(HARMONICS.sine)[:, j])
        return total

    motion = HARMONICS(t)
    np.testing.assert_allclose(motion.q, q(t), atol=1e-14)
    # exact: no subtraction
    np.testing.assert_allclose(motion.qd, q(t + 1j * step).imag / step, atol=1e-13)
    # goes on after its period
    np.testing.assert_allclose(HARMONICS(t + 2.0).q, motion.q, atol=1e-13)


# Central differences with steps of 1e-4 of a motion of size 1 and time scale 0.1: 1e-8 / 6 * third
# derivative (1e3).
@pytest.mark.parametrize("reference", ALL, ids=lambda r: type(r).__name__)
def test_velocity_and_acceleration_are_derivatives(reference):
    random = np.random.default_rng(0)
    t, step = random.uniform(0.01, reference.duration - 0.01, 50), 1e-4
    # no corners
    t = t[[np.abs(np.asarray(getattr(reference, "times", (9.0,))) - x).min() > 2 * step for x in t]]
    before, now, after = (reference(t + k * step) for k in (-1, 0, 1))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, rtol=0, atol=2e-5)
    if reference is TABLE:
        np.testing.assert_array_equal(now.qdd, 0)  # by definition: straight lines
    else:
        np.testing.assert_allclose((after.qd - before.qd) / (2 * step), now.qdd, rtol=0, atol=1e-3)


# Central differences with steps of 1e-5: rounding, and 1e-10 / 6 times the second derivative of
# what they are of.
@pytest.mark.parametrize("reference", [HARMONICS, MOVE, SPLINE], ids=lambda r: type(r).__name__)
def test_jerk_and_snap_are_derivatives(reference):
    t, step = np.random.default_rng(0).uniform(0.01, reference.duration - 0.01, 50), 1e-5
    t = t[[np.abs(np.asarray(getattr(reference, "times", (9.0,))) - x).min() > 2 * step for x in t]]
    before, after = (reference(t + k * step).qdd for k in (-1, 1))
    jerk, snap = reference.higher(t)
    np.testing.assert_allclose(
        (after - before) / (2 * step), jerk, rtol=0, atol=1e-6 * np.abs(jerk).max()
    )
    before, after = (reference.higher(t + k * step)[0] for k in (-1, 1))
    np.testing.assert_allclose(
        (after - before) / (2 * step), snap, rtol=0, atol=1e-6 * np.abs(snap).max()
    )
    assert np.abs(snap).max() > 10


def test_a_table_has_no_jerk():
    with pytest.raises(
        ValueError,
        match=r"Table gives none. Put a Spline through its points, or define Table.higher",
    ):
        TABLE.higher(np.zeros(1))


@pytest.mark.parametrize("reference", [MOVE, SPLINE], ids=lambda r: type(r).__name__)
def test_motion_begins_and_ends_at_rest_and_stays(reference):
    end = reference.duration
    first, last = np.asarray(getattr(reference, "start", None) or reference.points[0]), np.asarray(
        getattr(reference, "goal", None) or reference.points[-1])  # fmt: skip
    motion = reference(np.array([0.0, end, end + 1, 100.0, -1.0]))
    np.testing.assert_allclose(motion.q, [first, last, last, last, first], atol=1e-13)
    # a quintic's derivatives at its last knot: cancelling terms
    np.testing.assert_allclose(motion.qd, 0, atol=1e-11)
    np.testing.assert_allclose(motion.qdd, 0, atol=1e-9)


def test_point_to_point_is_half_way_at_half_time_and_fastest_there():
    motion = MOVE(np.array([0.4]))
    np.testing.assert_allclose(motion.q[0], [0.7, -0.25], rtol=1e-14)
    # 15/8 of the mean speed
    np.testing.assert_allclose(motion.qd[0], 15 / 8 * np.array([1.2, 1.5]) / 0.8, rtol=1e-14)
    np.testing.assert_allclose(motion.qdd[0], 0, atol=1e-12)


def test_spline_goes_through_its_points():
    np.testing.assert_allclose(SPLINE(np.asarray(SPLINE.times)).q, SPLINE.points, atol=1e-13)


def test_table_is_straight_between_its_points_and_rests_outside():
    motion = TABLE(np.array([0.25, 0.5, 0.55, 1.0, 3.0, -1.0]))
    np.testing.assert_allclose(
        motion.q, [[0.5, 0.5], [1, 0], [1.05, 0.25], [0.7, 0.5], [0.7, 0.5], [0, 1]], atol=1e-15
    )
    np.testing.assert_allclose(
        motion.qd, [[2, -2], [1, 5], [1, 5], [0, 0], [0, 0], [0, 0]], atol=1e-13
    )


@settings(derandomize=True, max_examples=30)
@given(st.lists(st.floats(-1, 5), min_size=1, max_size=5), st.sampled_from(range(4)))
def test_shapes_and_independence_of_the_other_times(times, which):
    reference = ALL[which]
    motion = reference(times)
    for value in motion:
        assert value.shape == (len(times), reference.n)
        assert value.flags.c_contiguous
    for i, t in enumerate(times):
        for value, alone in zip(motion, reference([t]), strict=True):
            np.testing.assert_allclose(value[i], alone[0], atol=1e-14)


# -- files and bad input -------------------------------------------------------------------------
def test_table_from_csv(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text(
        "# a comment, of items 2, 1\nt [s],q_1,q_2\n\n0,0.0,1e0\n0.5, 1.0"
        " ,0\n0.6,1.1,0.5\n1.0,0.7,0.5\n"
    )
    assert Table.from_csv(path) == TABLE


JOINTS = ("shoulder", "elbow")
TWO_ROWS = "\n0,1,2\n1,2,3\n"


@pytest.mark.parametrize(
    "heading",
    [
        "time,shoulder,elbow",
        "t [s],shoulder [rad],elbow [m]",
        "t [sec],shoulder [radians],elbow",
        "seconds,q[0],q[1]",
        "# q in rad, not in deg",
        "# recorded by us, in May",
        "# run 7, 2024, 11",
        "# t in s, q in rad, no deg",
        "# t, q in rad",
        "timestamp,left_1,right_1",
    ],
)
def test_headings_and_comments_of_a_table(tmp_path, heading):
    path = tmp_path / "path.csv"
    path.write_text(heading + TWO_ROWS)
    assert Table.from_csv(path, joints=JOINTS).points[0] == (1, 2)


@pytest.mark.parametrize(
    ("heading", "message"),
    [
        ("time,elbow,shoulder", r"in order; its columns are time, elbow, shoulder\. Reorder them"),
        ("t [s],elbow [rad],shoulder [rad]", r"in order; its columns are t \[s\], elbow"),
        ("t,elbow,wrist", "in order"),
        ("t,q_2 [rad],q_1 [rad]", "in order"),
        ("shoulder,elbow,wrist", "once.*behind t"),
        ("q_1,q_2,q_3", "once.*behind t"),
        ("t,q_1,q_1", "once"),
        ("t,q_1,qd_1", "once"),
        ("t [ms],shoulder,elbow", r"'t \[ms\]'"),
        ("t [ns],shoulder,elbow", r"'t \[ns\]'"),
        ("t [min],shoulder,elbow", r"'t \[min\]'"),
        ("t [rad],shoulder,elbow", r"'t \[rad\]'"),
        ("t,shoulder [mrad],elbow", r"'shoulder \[mrad\]'"),
        ("t,shoulder,elbow [gon]", r"'elbow \[gon\]'"),
        ("t,q_1,q_2 [rev]", r"'q_2 \[rev\]'"),
        ("t,q_1,q_2 [mm]", r"'q_2 \[mm\]'"),
        ("# time [s],q_1,q_2 [rad/s]", r"'q_2 \[rad/s\]'"),
    ],
)
def test_a_table_with_another_heading_is_refused(tmp_path, heading, message):
    path = tmp_path / "path.csv"
    path.write_text(heading + TWO_ROWS)
    with pytest.raises(ValueError, match=rf"path\.csv .*{message}"):
        Table.from_csv(path, joints=JOINTS)


@pytest.mark.parametrize("joints", ["a", "abc"])
def test_a_table_has_a_column_per_joint(tmp_path, joints):
    path = tmp_path / "path.csv"
    path.write_text("0,1,2\n1,2,3\n")
    with pytest.raises(ValueError, match="it has 2 columns beside t"):
        Table.from_csv(path, joints=list(joints))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1\n1,two\n", r"line 2 must be numbers; got 'two' in column 2"),
        ("0,1\n1\n", r"line 2 must have 2 cells; got 1"),
        ("0\n1\n", r"must have t and angles; got 1 cells"),
        ("t,q\n", r"must hold samples; got no row of numbers"),
        ("0,1\n0,2\n", r"path\.csv times must increase; got 0.0 after 0.0 at index 1"),
        ("0,1\n1,nan\n", r"points must be finite; got nan at index \(1, 0\)"),
        ("0,1\n", r"times must be two or more; got 1"),
        (
            "t,q_2,q_1\n0,1,2\n1,2,3\n",
            r"must have the joints in order; its columns are t, q_2, q_1",
        ),
        (
            "# t_ms,q_1,q_2\n0,1,2\n1,2,3\n",
            r"must be in s and rad; its heading has 't_ms'\. Convert it",
        ),
        ("t,q1 [deg]\n0,1\n1,2\n", r"its heading has 'q1 \[deg\]'"),
    ],
)
def test_bad_table_file_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "path.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        Table.from_csv(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Harmonics(period=0, offset=(0,), cosine=((1,),), sine=((0,),)),
            "period .*must be a (positive|finite) number",
        ),
        (
            lambda: Harmonics(period=1, offset=(0, 0), cosine=((1,),), sine=((0,),)),
            r"cosine must have shape \(2, H\)",
        ),
        (
            lambda: Harmonics(period=1, offset=(0,), cosine=((1,),), sine=((0, 1),)),
            r"sine must have shape \(1, 1\)",
        ),
        (
            lambda: Harmonics(period=1, offset=(np.nan,), cosine=((1,),), sine=((0,),)),
            "offset must be finite",
        ),
        (lambda: PointToPoint(start=(0, 0), goal=(1,), duration=1), r"goal must have shape \(2,\)"),
        (
            lambda: PointToPoint(start=(0,), goal=(1,), duration="1"),
            "duration .*must be a (positive|finite) number",
        ),
        (
            lambda: PointToPoint(start=(0,), goal=(1,), duration=-1),
            "duration .*must be a (positive|finite) number",
        ),
        (
            lambda: Spline(times=(0, 2, 1), points=((0,), (1,), (2,))),
            "times must increase; got 1.0 after 2.0 at index 2",
        ),
        (lambda: Spline(times=(1, 2), points=((0,), (1,))), r"times must be two or more, from 0"),
        (
            lambda: Spline(times=(0, 1), points=((0,), (1,)), at_rest=False),
            r"points must be 6 or more",
        ),
        (lambda: Spline(times=(0, 1), points=((0,), (1,)), at_rest=2), r"at_rest"),
        (
            lambda: Spline(times=(0, 1), points=((0,),)),
            r"points must have shape \(2, n\)",
        ),
        (lambda: Table(times=(0, 1), points=(0, 1)), "points must have shape"),
        (lambda: HARMONICS([0.0, np.inf]), "t must be finite; got inf at index 1"),
        (lambda: HARMONICS(0.0), r"t must have shape \(N,\)"),
    ],
)
def test_bad_reference_is_refused(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


def test_a_spline_is_solved_once(monkeypatch):
    """A controller asks for one time per sample, of a spline that may have thousands of points."""
    solve, solved = scipy.interpolate.make_interp_spline, []
    monkeypatch.setattr(
        scipy.interpolate,
        "make_interp_spline",
        lambda *points, **options: solved.append(points) or solve(*points, **options),
    )
    spline = dataclasses.replace(SPLINE)
    for time in (0.1, 0.2):
        np.testing.assert_array_equal(spline([time]).q, SPLINE([time]).q)
        spline.higher(np.array([time]))
    assert len([points for points in solved if points[0] is spline.times]) == 1
    # It is no part of a copy.
    assert pickle.loads(pickle.dumps(spline)) == spline == SPLINE  # noqa: S301 - our own bytes


def test_a_spline_whose_ends_are_free_goes_on_as_its_points_do():
    """A quintic polynomial, which does not begin at rest, is its own spline."""
    t = np.linspace(0, 2, 9)
    polynomials = [
        np.polynomial.Polynomial(c)
        for c in ((1, 2, -1, 0.3, 0.1, -0.05), (0, -1, 0.5, 0, 0.2, 0.01))
    ]
    spline = Spline(times=t, points=np.column_stack([p(t) for p in polynomials]), at_rest=False)
    asked = np.linspace(0, 2, 33)
    for order, got in enumerate(spline(asked)):
        expected = np.column_stack(
            [p.deriv(order)(asked) if order else p(asked) for p in polynomials]
        )
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
