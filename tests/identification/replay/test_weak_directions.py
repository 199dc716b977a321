"""Directions in which the slopes of unknowns cancel, against a residual that is known exactly."""

import numpy as np
import pytest

from identification.replay import Batched, with_weak_directions


class Linear(Batched):
    """Innovations A x: their slopes are the columns of A."""

    dependent = 1e-4

    def __init__(self, matrix):
        self.matrix = matrix
        self.unknown = tuple("abc")
        self.weights = np.ones(len(matrix))
        self.scales = self.weights

    def all_innovations(self, vectors):
        return [self.matrix @ vector for vector in vectors]


@pytest.mark.parametrize("share", [3e-4, 1e-3])
def test_what_cancels_is_simulated_as_a_whole(share):
    """Columns a and b differ by little; each difference is exact to a thousandth alone."""
    random = np.random.default_rng(3)
    common, rest, other, error = random.normal(size=(4, 500))
    matrix = np.column_stack([common, common + share * rest, other])
    rough = matrix + 1e-3 * np.column_stack([error, 0 * error, 0 * error])
    step = np.array([0.1, 0.2, 0.3])
    slopes, undetermined = with_weak_directions(
        Linear(matrix), np.ones(3), step, np.arange(3), rough * step
    )
    difference = slopes @ np.array([1 / 0.1, -1 / 0.2, 0.0])
    np.testing.assert_allclose(difference, -share * rest, atol=0.02 * share)
    assert len(undetermined) == 0
    # As they were, the error of a thousandth passes for what is known of the difference.
    assert np.abs(rough[:, 0] - rough[:, 1] + share * rest).max() > 2 * share


def test_beside_a_state_before_the_log_slopes_are_less_exact():
    """A direction that no reading determines, whose rough slope is 3 % of its unknowns'."""
    random = np.random.default_rng(5)
    common, other, error = random.normal(size=(3, 500))
    matrix = np.column_stack([common, common, other])
    # The last row expects a value of the second unknown, and is no reading.
    matrix = np.vstack([matrix, [0.0, 1e-3, 0.0]])
    rough = matrix + 0.04 * np.column_stack([np.append(error, 0), np.zeros((501, 2))])
    residual = Linear(matrix)
    residual.weights = np.append(np.ones(500), 0.0)
    residual.dependent = 1e-12
    _, undetermined = with_weak_directions(residual, np.ones(3), np.ones(3), np.arange(3), rough)
    (direction,) = undetermined / np.abs(undetermined).max()
    np.testing.assert_allclose(np.abs(direction), [1, 1, 0], atol=1e-3)


def test_good_slopes_cost_no_simulation():
    matrix = np.random.default_rng(4).normal(size=(300, 3))
    residual = Linear(matrix)
    residual.all_innovations = None
    slopes, _ = with_weak_directions(residual, np.ones(3), np.ones(3), np.arange(3), matrix.copy())
    np.testing.assert_array_equal(slopes, matrix)
