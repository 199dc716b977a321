"""Profile likelihood: a linear problem by hand, a curved valley against brute force, and what it
meets on the way.
"""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from identification.replay import Profile, slopes

RANDOM = np.random.default_rng(1)
A, NOISE = RANDOM.normal(size=(400, 3)), RANDOM.normal(size=400)
TRUTH = np.array([1.0, -2.0, 0.5])


class Model:
    """Innovations of a function of three coordinates."""

    def __init__(self, function):
        self.unknown, self.weights, self.function = ("a", "b", "c"), np.ones(400), function

    def innovations(self, z):
        return self.function(z)

    def all_innovations(self, many):
        return [self.function(z) for z in many]


def profile(function, best, place=0, bounds=(-50, 50)):
    model, step = Model(function), np.full(3, 1e-4)
    change = slopes(model, best, step, np.arange(3))
    return Profile(model, best, change, step, np.tile(bounds, (3, 1)), place)


def linear(z):
    return A @ (z - TRUTH) - NOISE


LEAST = TRUTH + np.linalg.lstsq(A, NOISE, rcond=None)[0]


def curved(z):
    """The second coordinate's valley bends with the first."""
    return A @ np.array([z[0], z[1] - 3 * z[0] ** 2, z[2]]) - A @ [0.2, 0.1, 0.3] - 0.5 * NOISE


@pytest.mark.parametrize("place", [0, 1, 2])
def test_the_ends_of_a_linear_problem_are_its_standard_deviations(place):
    std = np.sqrt(np.linalg.inv(A.T @ A)[place, place])
    found = profile(linear, LEAST, place)
    assert found.rise(LEAST[place] + 2 * std, 4.0) == pytest.approx(4, rel=1e-6)
    for sign, limit in ((1, 50), (-1, -50)):
        end = found.end(0.7 * std, 3.84, limit)
        # to a tenth of the level
        assert end == pytest.approx(LEAST[place] + sign * 1.96 * std, abs=0.1 * std)
    assert found.better is None


def test_an_end_beyond_the_limit_is_the_limit():
    assert profile(linear, LEAST).end(0.01, 1e3, LEAST[0] + 0.02) == LEAST[0] + 0.02


def test_a_flat_sum_ends_at_the_limit():
    flat = profile(lambda z: linear(np.array([TRUTH[0], *z[1:]])), LEAST)
    assert flat.end(1e-3, 3.84, 50) == 50


def test_the_side_of_an_end_is_that_of_its_limit():
    found = profile(linear, LEAST)
    assert found.end(-0.1, 3.84, -50) == found.end(0.1, 3.84, -50) < LEAST[0]
    with pytest.raises(ValueError, match=r"distance.*nan"):
        found.end(np.nan, 3.84, 50)


def test_what_lies_on_its_bound_is_fitted_again():
    """Friction, whose negative acts like positive: a central difference about zero vanishes."""
    B = A + np.outer(1.8 * A[:, 0], [0, 1, 0])
    noise = NOISE - B @ np.linalg.lstsq(B, NOISE, rcond=None)[0]

    def innovations(z):
        return B @ np.array([z[0], abs(z[1]), z[2]]) - noise

    bounds = np.array([(-50, 50), (0, 50), (-50, 50)], float)
    model, step, best = Model(innovations), np.full(3, 1e-4), np.zeros(3)
    change = slopes(model, best, step, np.arange(3), None, bounds)
    # Without bounds, too: the profile takes slopes of its own.
    for given in (change, slopes(model, best, step, np.arange(3))):
        found = Profile(model, best, given, step, bounds, 0)
        ends = [found.end(sign * 0.1, 3.84, sign * 50) for sign in (-1, 1)]
        # Down the friction grows and makes up for it; up it stays at zero.
        std = [np.linalg.inv(C.T @ C)[0, 0] ** 0.5 for C in (B, B[:, ::2])]
        np.testing.assert_allclose(ends, 1.96 * np.array([-std[0], std[1]]), rtol=0.05)


def test_a_curved_valley_is_followed():
    """Against the minimum over the others by another solver; the curvature at the best fit would
    say another end.
    """

    def least(a):
        rest = A[:, 1:]
        target = curved(np.array([a, 0.0, 0.0]))
        return np.sum((target + rest @ np.linalg.lstsq(rest, -target, rcond=None)[0]) ** 2)

    a = minimize_scalar(least, bounds=(-1, 1), method="bounded", options={"xatol": 1e-12}).x
    others = np.linalg.lstsq(A[:, 1:], -curved(np.array([a, 0.0, 0.0])), rcond=None)[0]
    best = np.array([a, *others])
    found, level = profile(curved, best), 40.0
    for value in (a + 0.3, a - 1.0):
        assert found.rise(value, level) == pytest.approx(least(value) - least(a), rel=0.05)
    truth = brentq(lambda x: least(x) - least(a) - level, a, a + 5)
    assert found.end(0.1, level, a + 50) == pytest.approx(truth, rel=0.06)


def test_a_lower_sum_on_the_way_is_kept():
    """Begun beside the best fit, the walk meets it."""
    wrong = LEAST + np.array([0.5, 0.0, 0.0])
    found = profile(linear, wrong)
    found.end(0.1, 3.84, -50)
    assert found.better is not None
    assert np.sum(linear(found.better) ** 2) < np.sum(linear(wrong) ** 2)


def test_a_higher_sum_does_not_replace_a_lower_one():
    found = profile(linear, LEAST + np.array([0.5, 0.0, 0.0]))
    found.rise(LEAST[0], 3.84)
    lowest = found.better
    assert found.rise(LEAST[0] + 0.2, 3.84) < 0
    np.testing.assert_array_equal(found.better, lowest)


def test_what_diverges_has_no_finite_rise():
    def lost(z):
        return linear(z) if z[0] < LEAST[0] + 0.3 else np.full(400, np.inf)

    found = profile(lost, LEAST)
    assert found.rise(LEAST[0] + 1, 4.0) == np.inf
    assert found.end(1.0, 1e4, 50) == pytest.approx(LEAST[0] + 0.3, abs=0.05)  # where it is lost
