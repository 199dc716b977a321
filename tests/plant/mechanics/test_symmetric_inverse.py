"""The symbolic inverse and the pivots against numpy."""

import casadi as ca
import numpy as np
import pytest

from plant.mechanics import eliminated, inverse


def evaluated(matrix, right):
    """Everything that the inverse of a matrix offers, as numbers."""
    symbol, x = ca.SX.sym("matrix", *matrix.shape), ca.SX.sym("x", len(right))
    made = inverse(symbol)
    outputs = [made.diagonal, made.alone, made.share, ca.vertcat(*made.minors), made.solve(x)]
    lower, pivots = eliminated(symbol)
    function = ca.Function("f", [symbol, x], [*outputs, ca.vertcat(*pivots), lower])
    return [
        value.full().squeeze(axis=1) if value.shape[1] == 1 else value.full()
        for value in function(matrix, right)
    ]


@pytest.mark.parametrize("n", range(1, 8))
def test_inverse_of_a_positive_matrix(n):
    random = np.random.default_rng(n)
    root = random.normal(size=(n, n))
    matrix, right = root @ root.T + 0.1 * np.eye(n), random.normal(size=n)
    diagonal, alone, share, minors, solved, found, lower = evaluated(matrix, right)
    exact = np.linalg.inv(matrix)
    accuracy = 1e-14 * np.linalg.cond(matrix)
    np.testing.assert_allclose(diagonal, np.diag(exact), rtol=accuracy)
    np.testing.assert_allclose(alone, 1 / np.diag(exact), rtol=accuracy)
    expected = -exact / np.diag(exact)[:, None] + np.eye(n)
    np.testing.assert_allclose(
        np.reshape(share, (n, n)), expected, atol=accuracy * np.abs(expected).max()
    )
    np.testing.assert_allclose(
        solved, np.linalg.solve(matrix, right), atol=accuracy * np.abs(solved).max()
    )
    assert (minors > 0).all()
    lower = np.reshape(lower, (n, n))
    np.testing.assert_allclose(
        lower * found @ lower.T, matrix, atol=accuracy * np.abs(matrix).max()
    )
    assert (np.triu(lower) == np.eye(n)).all()
    np.testing.assert_allclose(
        np.cumprod(found), [np.linalg.det(matrix[:k, :k]) for k in range(1, n + 1)], rtol=1e-9
    )


@pytest.mark.parametrize("n", range(1, 8))
def test_minors_are_positive_only_for_a_positive_matrix(n):
    random = np.random.default_rng(n)
    rotation = np.linalg.qr(random.normal(size=(n, n)))[0]
    for negative in range(n):
        values = random.uniform(0.5, 2, n)
        values[negative] *= -1
        *_, minors, _, found, _ = evaluated(rotation @ np.diag(values) @ rotation.T, np.zeros(n))
        assert (minors < 0).any()
        assert (found < 0).any()
