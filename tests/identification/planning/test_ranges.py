"""Ranges of 3.6: the printed numbers first, then interval arithmetic against sampling, then
physical links at random.

Tolerances. The printed ranges have two decimals, so what is derived must round to them (0.005).
Interval ends are single products and sums of exact inputs: 1e-12 of the largest term is some
thousand roundings.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import LinkSize, ranges
from identification.planning import Interval, centre_range, greatest_inertia
from plant import Body, Drive, puma560

ROUNDING = 1e-12
PRINTED = 0.005  # two decimals
NAMES = puma560.dynamics().names


def gears(k2, k3):
    """A drive of which only the gears matter."""
    ones = (1.0, 1.0)
    return Drive(
        gear=(k2, k3),
        motor_inertia=(0, 0),
        viscous=(0, 0),
        coulomb=(0, 0),
        motor_gain=ones,
        current_limit=ones,
    )


# -- what the paper prints -----------------------------------------------------------------------
def test_greatest_inertias_of_3_6():
    """Izz2 <= 25 (0.25^2 + 0.07^2) = 1.685, printed 1.69, and Izz3 <= 10 0.25^2 = 0.625."""
    assert greatest_inertia(25, np.hypot(0.25, 0.07)) == pytest.approx(1.685, rel=ROUNDING)
    assert greatest_inertia(10, 0.25) == 0.625
    size = LinkSize(mass=(5, 25), x=(-0.24, 0.50), y=(-0.14, 0.14), motor_inertia=(1e-4, 1e-3))
    assert size.intervals(lambda motor_inertia: motor_inertia).Izz.high == pytest.approx(
        1.685, rel=ROUNDING
    )


def test_equation_5_gives_the_printed_centres_of_mass():
    extents = {"x2": (-0.24, 0.50), "y2": (-0.14, 0.14), "x3": (-0.08, 0.08), "y3": (-0.50, 0.0)}
    got = {name: centre_range(extent) for name, extent in extents.items()}
    assert got == {
        "x2": Interval(-0.12, 0.25),
        "y2": Interval(-0.07, 0.07),
        "x3": Interval(-0.04, 0.04),
        "y3": Interval(-0.25, 0.0),
    }


@pytest.mark.parametrize("name", ["f3", "f4", "f5", "f6", "f8", "f9"])
def test_ranges_printed_and_derived_are_the_same(name):
    i = NAMES.index(name)
    np.testing.assert_allclose(ranges()[i], puma560.PRINTED_RANGES[i], rtol=0, atol=ROUNDING)


def test_f1_is_the_printed_one_with_gear_53():
    """1e-4 53^2 = 0.2809 and 1e-3 53^2 + 10 (2 0.25^2 + 0.04^2) = 4.075: the print used 53 for
    53.7, and cut off.
    """
    f1 = ranges(drive=gears(107.8, -53.0))[0]
    np.testing.assert_allclose(f1, (0.2809, 4.075), rtol=ROUNDING)
    np.testing.assert_allclose(f1, puma560.PRINTED_RANGES[0], rtol=0, atol=PRINTED + ROUNDING)


def test_f2_and_f7_follow_from_the_inputs_and_not_from_the_print():
    """ERRATA: f2 [0, 1.27] (2.33 used Izz2 by mistake), f7 [1.25, 18.76]."""
    derived, printed = ranges(), np.array(puma560.PRINTED_RANGES)
    np.testing.assert_allclose(derived[1], (0.0, 1.27), rtol=0, atol=PRINTED)
    np.testing.assert_allclose(derived[6], (1.25, 18.76), rtol=0, atol=PRINTED)
    mistaken = 1.685 + 10 * (0.04**2 + 0.25**2)
    assert mistaken == pytest.approx(printed[1, 1], abs=PRINTED)
    assert np.abs(derived[6] - printed[6]).min() > 0.8


def test_f9_is_the_papers_worked_example():
    """3.6: f9_min = m2_max x2_min + m3_min a3_min."""
    assert ranges()[8, 0] == pytest.approx(25 * -0.12 + 1 * 0.3, rel=ROUNDING)
    assert ranges()[8, 1] == pytest.approx(25 * 0.25 + 10 * 0.5, rel=ROUNDING)


def test_the_sign_of_a_gear_does_not_matter():
    np.testing.assert_array_equal(
        ranges(drive=gears(107.8, 53.7)), ranges(drive=gears(-107.8, -53.7))
    )


# -- interval arithmetic against sampling --------------------------------------------------------
numbers = st.floats(-50, 50).map(lambda x: round(x, 3))
intervals = st.tuples(numbers, numbers).map(lambda ends: Interval(min(ends), max(ends)))
shares = st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), max_size=20)


def inside(interval, share):
    return interval.low + share * (interval.high - interval.low)


def enclose(result, values, attained):
    """Every sampled value lies inside, and each end is a value that is taken."""
    room = ROUNDING * max(1.0, abs(result.low), abs(result.high))
    assert min(values) >= result.low - room
    assert max(values) <= result.high + room
    assert min(attained) == pytest.approx(result.low, abs=room)
    assert max(attained) == pytest.approx(result.high, abs=room)


@given(intervals, intervals, shares)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_sum_and_product_hold_exactly_what_sampling_finds(a, b, points):
    # Bilinear functions take their extremes in corners, so the four corners attain the ends.
    corners = [(inside(a, i), inside(b, j)) for i in (0, 1) for j in (0, 1)]
    sampled = corners + [(inside(a, i), inside(b, j)) for i, j in points]
    enclose(a + b, [x + y for x, y in sampled], [x + y for x, y in corners])
    enclose(a * b, [x * y for x, y in sampled], [x * y for x, y in corners])


@given(intervals, st.integers(1, 4), st.lists(st.floats(0, 1), max_size=20))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_power_holds_exactly_what_sampling_finds(a, exponent, points):
    # A power is monotone on either side of zero: ends, and zero where it lies inside, attain the
    # range.
    extremes = [a.low, a.high] + ([0.0] if a.low <= 0 <= a.high else [])
    enclose(
        a**exponent,
        [inside(a, s) ** exponent for s in points] + extremes_of(extremes, exponent),
        extremes_of(extremes, exponent),
    )


def extremes_of(points, exponent):
    return [point**exponent for point in points]


@given(intervals, numbers)
@settings(max_examples=50, deadline=None, derandomize=True)
def test_numbers_are_points_from_either_side(a, x):
    assert x + a == a + x == a + Interval(x, x)
    assert x * a == a * x == a * Interval(x, x)
    assert Interval.of(x) == Interval(x, x)
    assert Interval.of(a) is a
    assert Interval.of((a.low, a.high)) == a


# -- physical links ------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_links_inside_the_intervals_have_f_inside_the_ranges(seed):
    random = np.random.default_rng(seed)
    k2, k3 = puma560.rig().drive.gear

    def within(low, high):
        # Ends are drawn too: a random choice of corners is the sharpest test of a range.
        return random.choice([low, high, random.uniform(low, high)])

    a3 = within(0.3, 0.5)
    link2 = SimpleNamespace(
        m=within(5, 25),
        x=within(-0.12, 0.25),
        y=within(-0.07, 0.07),
        Izz=within(0, 1.685),
        J=within(1e-4, 1e-3) * k2**2,
    )
    link3 = SimpleNamespace(
        m=within(1, 10),
        x=within(-0.04, 0.04),
        y=within(-0.25, 0),
        Izz=within(0, 0.625),
        J=within(1e-4, 1e-3) * k3**2,
    )
    f = np.array(list(puma560.equation_3(link2, link3, a3).values()))
    low, high = ranges().T
    room = ROUNDING * np.maximum(np.abs(low), np.abs(high))
    assert (f >= low - room).all()
    assert (f <= high + room).all()


def test_links_of_the_dynamics_have_f_inside_the_ranges():
    """The same with f from the derivation (`Dynamics.f` of bodies), not from equation (3); a3 is
    the arm's then.
    """
    random, dynamics = np.random.default_rng(5), puma560.dynamics()
    low, high = ranges().T
    room = ROUNDING * np.maximum(np.abs(low), np.abs(high))
    for _ in range(50):
        bodies = [
            Body(
                mass=random.uniform(*mass),
                com=(random.uniform(*x), random.uniform(*y), 0.0),
                inertia=(0, 0, 0, 0, 0, random.uniform(0, izz)),
                rotor=random.uniform(1e-4, 1e-3) * k**2,
            )
            for mass, x, y, izz, k in (
                ((5, 25), (-0.12, 0.25), (-0.07, 0.07), 1.685, 107.8),
                ((1, 10), (-0.04, 0.04), (-0.25, 0), 0.625, 53.7),
            )
        ]
        f = dynamics.f(bodies)
        assert (f >= low - room).all()
        assert (f <= high + room).all()


def test_a_narrower_robot_has_narrower_ranges():
    """Ranges are monotone in what they are derived from."""
    sizes = [
        LinkSize(mass=(5, 25), x=(-0.24, 0.50), y=(-0.14, 0.14), motor_inertia=(1e-4, 1e-3)),
        LinkSize(
            mass=(1, 10), x=(-0.08, 0.08), y=(-0.50, 0.0), motor_inertia=(1e-4, 1e-3), radius=0.25
        ),
    ]
    drive = puma560.rig().drive
    wide = ranges(puma560.equation_3, sizes, drive, a3=(0.3, 0.5))
    np.testing.assert_array_equal(wide, ranges())
    sizes[1] = LinkSize(
        mass=(2, 8), x=(-0.06, 0.06), y=(-0.40, -0.1), motor_inertia=(2e-4, 5e-4), radius=0.25
    )
    narrow = ranges(puma560.equation_3, sizes, drive, a3=(0.4, 0.45))
    assert (narrow[:, 0] >= wide[:, 0]).all()
    assert (narrow[:, 1] <= wide[:, 1]).all()
    assert (narrow != wide).any()


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Interval(1.0, 0.0), "low <= high"),
        (lambda: Interval(np.nan, 0.0), "finite"),
        (lambda: Interval(0.0, np.inf), "finite"),
        (lambda: Interval.of((1, 2, 3)), "interval"),
        (lambda: Interval(-1.0, 1.0) ** -1, "whole number"),
        (lambda: Interval(-1.0, 1.0) ** 0.5, "whole number"),
        (lambda: centre_range((0.0, -0.25)), "low <= high"),  # y3 as 3.6 prints it
        (lambda: centre_range((0.0, np.nan)), "index 1"),
        (lambda: centre_range((0.0, 0.1, 0.2)), "shape"),
        (
            lambda: ranges(puma560.equation_3, [LinkSize(mass=(1, 2), x=(0, 1), y=(0, 1), motor_inertia=(0, 1))] * 3,
                           puma560.rig().drive, a3=(0.3, 0.5)),
            "2",
        ),
        (lambda: LinkSize(mass=(1, 2), x=(0, 1), y=(0, 1), motor_inertai=(0, 1)), "motor_inertia"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)
