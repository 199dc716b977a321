"""Slopes over whole deviations, against a residual whose short slopes mislead."""

import numpy as np
import pytest

from identification.replay import Batched, gauss_newton, over_whole_deviations

ROWS = 400
NOISE = 0.3


class Rippled(Batched):
    """Innovations of noise plus A x, and a ripple with x[0] that is small and steep."""

    dependent = 1e-4

    def __init__(self, ripple):
        random = np.random.default_rng(5)
        self.matrix = 0.05 * random.normal(size=(ROWS, 2))
        self.rough = ripple * random.normal(size=ROWS)
        self.error = NOISE * random.normal(size=ROWS)
        self.unknown = ("a", "b")
        self.weights = np.ones(ROWS)
        self.scales = self.weights

    def all_innovations(self, vectors):
        return [
            self.error + self.matrix @ vector + self.rough * np.sin(100 * vector[0])
            for vector in map(np.asarray, vectors)
        ]

    def lost(self, values):
        return ""

    @property
    def std(self):
        """Deviations of the values without the ripple; their truth is zero."""
        return NOISE * np.sqrt(np.diag(np.linalg.inv(self.matrix.T @ self.matrix)))


BOUNDS = np.array([[-10.0, 10.0]] * 2)


# Where the ripple is steepest: a search with short slopes makes no way from here.
STEEP = np.array([2 * np.pi * 16 / 100, 1.0])


def fit(residual, values, bounds=BOUNDS):
    """Covariance by short slopes, without a search."""
    return gauss_newton(residual, values, np.full(2, 1e-4), bounds, rounds=0)


def test_a_fit_between_two_jumps_moves_on_and_is_as_wide_as_it_must_be():
    residual = Rippled(ripple=2e-3)
    between = fit(residual, STEEP)
    deviation = np.sqrt(np.diag(between.covariance))
    assert deviation[0] < 0.4 * residual.std[0]
    assert abs(between.values[0]) > 5 * deviation[0]

    solution = over_whole_deviations(residual, between, BOUNDS)
    deviation = np.sqrt(np.diag(solution.covariance))
    np.testing.assert_allclose(deviation, residual.std, rtol=0.15)
    assert (np.abs(solution.values) < 3 * deviation).all()
    np.testing.assert_allclose(solution.residual, residual.innovations(solution.values))
    # The slopes are those over a deviation: those of A.
    np.testing.assert_allclose(solution.slopes, residual.matrix, atol=0.02)


def test_a_covariance_that_holds_stays_as_it_is():
    residual = Rippled(ripple=0.0)
    solution = gauss_newton(residual, np.ones(2), np.full(2, 1e-4), BOUNDS)
    assert over_whole_deviations(residual, solution, BOUNDS) is solution


@pytest.mark.parametrize("low", [0.99, 1.0])
def test_no_axis_leaves_the_bounds(low):
    """A value beside its bound has shorter axes; one on it stays there."""
    residual = Rippled(ripple=2e-3)
    bounds = np.array([[-10.0, 10.0], [low, 10.0]])
    between = fit(residual, STEEP, bounds)
    simulated = residual.all_innovations
    vectors = []
    residual.all_innovations = lambda rows: simulated(vectors.extend(rows) or list(rows))
    solution = over_whole_deviations(residual, between, bounds)
    assert len(vectors) > 0
    assert min(vector[1] for vector in vectors) >= low
    # What a bound holds has no axis; the other value is as free as before.
    assert (solution is between) == (low < 1.0)


def test_a_round_that_fails_leaves_what_the_rounds_before_it_have_shown():
    """The first covariance is known to claim too much, and does not come back."""
    residual = Rippled(ripple=2e-3)
    between = fit(residual, STEEP)
    simulated = residual.all_innovations
    calls = []
    residual.all_innovations = lambda rows: simulated(calls.append(1) or rows)
    over_whole_deviations(residual, between, BOUNDS)
    count = len(calls)

    def failing(rows):
        calls.append(1)
        if len(calls) == count:
            raise ValueError("the arm leaves the log")
        return simulated(rows)

    calls.clear()
    residual.all_innovations = failing
    solution = over_whole_deviations(residual, between, BOUNDS)
    assert len(calls) == count
    assert np.diag(solution.covariance)[0] > 2 * np.diag(between.covariance)[0]
