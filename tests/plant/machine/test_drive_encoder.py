"""Drive, encoder and rig: the paper's numbers, signs across the gear, and casadi = numpy."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import Drive, Encoder, Rig, puma560
from plant.machine import fix

RIG = puma560.rig()
DRIVE = RIG.drive


def symbolic(function, x):
    """The same method on a casadi column."""
    symbol = ca.SX.sym("x", len(x))
    return ca.Function("f", [symbol], [function(symbol)])(x).full().ravel()


# -- encoder -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("x", "whole"), [(0.0, 0), (0.99, 0), (-0.99, 0), (1.0, 1), (-1.0, -1), (2.7, 2), (-2.7, -2)]
)
def test_fix_rounds_towards_zero(x, whole):
    assert fix(np.array([x]))[0] == whole
    assert symbolic(fix, np.array([x]))[0] == whole


@settings(derandomize=True)
@given(st.floats(-1e9, 1e9))
def test_fix_of_casadi_is_fix_of_numpy(x):
    assert symbolic(fix, np.array([x]))[0] == fix(np.array([x]))[0] == int(x)


def test_cell_around_zero_is_two_pulses_wide_and_the_others_one():
    position = np.arange(-4000, 4001) / 1000.0
    counts, sizes = np.unique(
        RIG.encoder.counts(position[:, None] * 2 * np.pi / [800.0, 1000.0])[:, 0],
        return_counts=True,
    )
    np.testing.assert_array_equal(counts, np.arange(-4, 5))
    # Edges themselves may fall to either side (2 pi is rounded): a point or two of 1,000.
    np.testing.assert_allclose(sizes[1:-1], [1000, 1000, 1000, 1999, 1000, 1000, 1000], atol=2)


def test_one_pulse_is_as_large_as_the_errata_say():
    turn = 2 * np.pi / np.abs(RIG.position_in_pulses(np.ones(2))) / (2 * np.pi)
    # printed with two and three digits
    np.testing.assert_allclose(turn, [7.3e-5, 1.17e-4], rtol=5e-3)
    np.testing.assert_allclose(
        turn, [2 * np.pi / (107.8 * 800), 2 * np.pi / (53.7 * 1000)], rtol=1e-15
    )


def test_gear_sign_is_in_the_pulses():
    np.testing.assert_array_equal(np.sign(RIG.counts(np.array([0.1, 0.1]))), [1, -1])
    turns = 0.5 / (2 * np.pi)
    whole = [np.trunc(turns * 107.8 * 800), -np.trunc(turns * 53.7 * 1000)]
    np.testing.assert_array_equal(RIG.counts(np.array([0.5, 0.5])), whole)


@settings(derandomize=True)
@given(st.integers(-(10**6), 10**6))
def test_angle_is_the_middle_of_the_cell(count):
    counts = np.array([count, -count], float)
    angle = RIG.cell_centre(counts)
    np.testing.assert_array_equal(RIG.counts(angle), counts)
    position = RIG.position_in_pulses(angle)
    middle = counts + 0.5 * np.sign(counts)
    np.testing.assert_allclose(position, middle, rtol=1e-14)  # three products
    np.testing.assert_allclose(symbolic(RIG.cell_centre, counts), angle, rtol=1e-15)
    width = RIG.cell_centre(np.array([1.0, 1.0])) - RIG.cell_centre(np.array([2.0, 2.0]))
    if count:
        for side in (-0.499, 0.499):
            np.testing.assert_array_equal(RIG.counts(angle + side * width), counts)


def test_angle_at_count_zero_is_zero():
    np.testing.assert_array_equal(RIG.cell_centre(np.zeros(2)), [0, 0])


@settings(max_examples=200, deadline=None)
@given(st.floats(-1e4, 1e4), st.sampled_from(["floor", "round"]))
def test_counters_have_cells_of_one_width(position, rounding):
    """No cell is wider, also around zero; the angle of a count is the middle of its cell; casadi
    counts alike.
    """
    encoder = Encoder(resolution=(1000,), rounding=rounding)
    begin = {"floor": 0.0, "round": -0.5}[rounding]
    x = np.array([position])
    count = encoder.quantised(x)
    assert count + begin <= x < count + begin + 1
    assert encoder.half_cell(count) == 0.5
    assert count == float(ca.evalf(encoder.quantised(ca.SX(x))))
    middle = encoder.position_in_pulses(encoder.cell_centre(count))
    np.testing.assert_allclose(middle, count + begin + 0.5, atol=1e-9)
    np.testing.assert_allclose(
        float(ca.evalf(encoder.cell_centre(ca.SX(count)))),
        encoder.cell_centre(count)[0],
        rtol=1e-12,
    )


def test_counters_round_down_by_default_and_the_paper_rig_towards_zero():
    assert Encoder(resolution=(1000,)).quantised(np.array([-0.25])) == -1
    assert puma560.rig().encoder.quantised(np.array([-0.25, -0.25])).tolist() == [0, 0]
    np.testing.assert_array_equal(puma560.rig().encoder.half_cell(np.array([0, 3])), [1, 0.5])
    with pytest.raises(ValueError, match="Did you mean 'floor'"):
        Encoder(resolution=(1000,), rounding="flor")


def test_smooth_encoder_counts_fractions_and_angle_inverts_it():
    encoder = Encoder(resolution=(800, 1000), smooth=True)
    x = np.array([0.123, -4.5])
    np.testing.assert_allclose(encoder.counts(x), x * [800, 1000] / (2 * np.pi), rtol=1e-15)
    np.testing.assert_allclose(encoder.cell_centre(encoder.counts(x)), x, rtol=1e-15)


# -- drive ---------------------------------------------------------------------------------------
def test_friction_is_positive_on_the_joint_side_whatever_the_gear_sign():
    np.testing.assert_allclose(
        DRIVE.joint_viscous(), [0.817e-3 * 107.8**2, 1.38e-3 * 53.7**2], rtol=1e-15
    )
    # FINDINGS 1: "9.5 of friction"
    np.testing.assert_allclose(DRIVE.joint_viscous()[0], 9.5, rtol=1e-2)
    np.testing.assert_allclose(DRIVE.joint_coulomb(), [0.124 * 107.8, 0.146 * 53.7], rtol=1e-15)
    qd = np.array([0.7, 0.7])
    np.testing.assert_allclose(
        symbolic(DRIVE.friction, qd), DRIVE.joint_viscous() * qd + DRIVE.joint_coulomb(), rtol=1e-15
    )
    np.testing.assert_allclose(
        symbolic(DRIVE.friction, -qd), -symbolic(DRIVE.friction, qd), rtol=1e-15
    )
    np.testing.assert_array_equal(symbolic(DRIVE.friction, np.zeros(2)), [0, 0])


def test_power_is_the_same_on_both_sides_of_the_gear():
    tau, q = np.array([3.0, -5.0]), np.array([0.2, 0.3])
    np.testing.assert_allclose(DRIVE.motor_torque(tau) * DRIVE.motor_angle(q), tau * q, rtol=1e-15)
    np.testing.assert_allclose(DRIVE.joint_torque(DRIVE.motor_torque(tau)), tau, rtol=1e-15)
    np.testing.assert_allclose(DRIVE.joint_angle(DRIVE.motor_angle(q)), q, rtol=1e-15)


def test_amplifier_limits_the_torque_at_its_current():
    limit = DRIVE.torque_limit()
    np.testing.assert_allclose(limit, [0.228 * 12 * 107.8, 0.238 * 12 * 53.7], rtol=1e-15)
    np.testing.assert_allclose(np.abs(DRIVE.current(limit)), 12, rtol=1e-15)
    asked = np.array([1e4, -1e4])
    np.testing.assert_allclose(symbolic(DRIVE.limited, asked), np.sign(asked) * limit, rtol=1e-15)
    np.testing.assert_array_equal(symbolic(DRIVE.limited, np.array([5.0, -5.0])), [5, -5])


def test_unlimited_amplifier():
    drive = Drive(
        gear=2.0 * np.ones(2),
        motor_inertia=np.zeros(2),
        viscous=np.zeros(2),
        coulomb=np.zeros(2),
        motor_gain=np.ones(2),
        current_limit=(np.inf, 1.0),
    )
    np.testing.assert_array_equal(symbolic(drive.limited, np.array([1e9, 1e9])), [1e9, 2])


def test_reflected_inertia_is_jm_k_squared():
    np.testing.assert_allclose(
        DRIVE.reflected_inertia(), [2e-4 * 107.8**2, 2e-4 * 53.7**2], rtol=1e-15
    )
    np.testing.assert_allclose(
        DRIVE.reflected_inertia(1e-4), [1e-4 * 107.8**2, 1e-4 * 53.7**2], rtol=1e-15
    )


FIELDS = {
    "gear": (1, 1),
    "motor_inertia": (0, 0),
    "viscous": (0, 0),
    "coulomb": (0, 0),
    "motor_gain": (1, 1),
    "current_limit": (1, 1),
}


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("gear", (1, 0), r"gear must not be zero; got 0.0 at joint q\[1\]"),
        ("viscous", (-1, 0), r"viscous must not be negative; got -1.0 at joint q\[0\]"),
        ("coulomb", (0, -1), r"coulomb must not be negative; got -1.0 at joint q\[1\]"),
        ("motor_gain", (0, 1), r"motor_gain must be positive; got 0.0 at joint q\[0\]"),
        (
            "current_limit",
            (1, -np.inf),
            r"current_limit must be positive; got -inf at joint q\[1\]",
        ),
        ("current_limit", (1, np.nan), r"current_limit of Drive must be numbers; got NaN"),
        ("coulomb", (0, np.inf), r"coulomb of Drive must be finite; got inf at index 1"),
        ("coulomb", (0, 0, 0), r"coulomb of Drive must have shape \(2,\); got shape \(3,\)"),
        ("viscous", "much", r"viscous of Drive must be numbers of shape \(2,\); got 'much'"),
        ("joints", 5, "joints must be 2 different names, or none; got 5"),
        ("joints", ("a", "a"), "joints must be 2 different names, or none; got"),
        ("left_open", 5, "left_open of Drive must be one of 'viscous', 'coulomb'; got 5"),
    ],
)
def test_bad_numbers_are_refused_with_their_place(field, value, message):
    with pytest.raises(ValueError, match=message):
        Drive(**FIELDS | {field: value})


def test_rig_needs_a_period_and_as_many_encoders_as_drives():
    for period in (0.0, -1.0, np.nan, np.inf, "fast", None):
        with pytest.raises(ValueError, match=r"period .*must be a (positive|finite) number"):
            Rig(drive=DRIVE, encoder=RIG.encoder, period=period)
    with pytest.raises(ValueError, match="encoder must have 2 joints like the drive; got 3"):
        Rig(drive=DRIVE, encoder=Encoder(resolution=(1, 2, 3)), period=1e-3)
    with pytest.raises(ValueError, match="resolution must be positive"):
        Encoder(resolution=(1, -2))


@pytest.mark.parametrize(
    ("what", "value"),
    [("current", (1, 2, 3)), ("counts", (0, 0, 0)), ("current", "a"), ("counts", 0.1)],
)
def test_numbers_of_other_joints_are_refused_in_one_line(what, value):
    rig = puma560.rig()
    with pytest.raises(
        ValueError, match=r"(torque|q) must (have|be numbers of) shape .*Give one number per joint"
    ) as error:
        (rig.drive if what == "current" else rig).__getattribute__(what)(value)
    assert "\n" not in str(error.value)


def test_numbers_of_many_samples_are_taken_as_before():
    rig, q = puma560.rig(), np.linspace(-1, 1, 12).reshape(3, 2, 2)
    np.testing.assert_array_equal(rig.counts(q)[1, 0], rig.counts(q[1, 0]))
    np.testing.assert_array_equal(rig.drive.current(q)[2], rig.drive.current(q[2]))


def test_one_number_stands_for_all_joints_where_it_is_written_so():
    """A scalar, not a list of one: that is a mistake in the number of joints."""
    drive = Drive(**FIELDS | {"viscous": 0.5})
    assert drive == Drive(**FIELDS | {"viscous": (0.5, 0.5)})
    rig = Rig(drive=drive, encoder=Encoder(resolution=4096), period=1e-3)
    assert rig == Rig(drive=drive, encoder=Encoder(resolution=(4096, 4096)), period=1e-3)
    assert Encoder(resolution=4096).to_angle(1024) == pytest.approx(np.pi / 2)
    with pytest.raises(
        ValueError, match=r"viscous of Drive must have shape \(2,\); got shape \(1,\)"
    ):
        Drive(**FIELDS | {"viscous": (0.5,)})
    with pytest.raises(ValueError, match="encoder must have 2 joints like the drive; got 1"):
        Rig(drive=drive, encoder=Encoder(resolution=(4096,)), period=1e-3)
    with pytest.raises(ValueError, match=r"gear of Drive must have shape \(n,\)"):
        Drive(**dict.fromkeys(FIELDS, 1.0))
