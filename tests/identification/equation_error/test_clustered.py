"""Jackknife over groups: against its closed form for a mean, and how often its intervals hold
the truth.
"""

import numpy as np

from identification.equation_error import at_least, group_std, in_groups, run_std
from plant.parts import products


def test_of_a_mean_it_is_students_interval():
    """Of equal groups the jackknife of a mean is the standard error of the groups' means."""
    values = np.random.default_rng(0).normal(size=40)
    groups = np.repeat(np.arange(5), 8)
    means = values.reshape(5, 8).mean(axis=1)
    std = group_std(np.ones((40, 1)), values - values.mean(), groups)
    np.testing.assert_allclose(std, means.std(ddof=1) / np.sqrt(5) * 2.7764451 / 1.96, rtol=1e-6)


def test_intervals_hold_where_residuals_of_a_group_are_one_error():
    """Ten groups with an error of their own each: 95 % by groups, far less by independent
    residuals.
    """
    random, groups, held, taken = np.random.default_rng(1), np.repeat(np.arange(10), 20), 0, 0
    rows = np.column_stack([np.ones(200), np.linspace(-1, 1, 200)])
    for _ in range(400):
        target = rows @ (1.0, -2.0) + random.normal(size=10)[groups] + 0.1 * random.normal(size=200)
        values, rest, *_ = np.linalg.lstsq(rows, target, rcond=None)
        off = np.abs(values - (1.0, -2.0))
        held += np.sum(off < 1.96 * group_std(rows, target - rows @ values, groups))
        taken += np.sum(off < 1.96 * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)) * rest[0] / 198))
    assert held / 800 > 0.92
    assert taken / 800 < 0.7


def test_a_value_that_one_group_alone_determines_has_no_bound():
    rows, groups = np.zeros((6, 2)), np.repeat(np.arange(3), 2)
    rows[:, 0], rows[:2, 1] = 1.0, (1.0, -1.0)
    assert np.isinf(group_std(rows, np.ones(6), groups)).all()


def test_a_column_of_zeros_has_no_bound():
    rows = np.column_stack([np.ones(6), np.zeros(6)])
    assert np.isinf(group_std(rows, np.ones(6), np.repeat(np.arange(3), 2))).all()


def test_a_length_of_few_rows_has_no_empty_segments():
    """Empty ones would count as further groups, and narrow the intervals of a mean."""
    assert in_groups([3], 0, 10).tolist() == [0, 1, 2]
    assert in_groups([2, 7], 1, 10).tolist() == [-1, 0, 1, 2, 2, 3, 4, 4, 5, 6]
    values = np.array([0.3, -0.5, 1.1])
    std = group_std(np.ones((3, 1)), values - values.mean(), in_groups([3], 0, 10))
    np.testing.assert_allclose(std, values.std(ddof=1) / np.sqrt(3) * 4.3026527 / 1.96, rtol=1e-6)


def test_of_a_mean_over_unequal_runs_it_is_unbiased():
    """The variance of a mean of independent numbers, on average, where a jackknife is above it."""
    random, runs = np.random.default_rng(3), np.repeat(np.arange(4), (60, 20, 10, 10))
    rows, student = np.ones((100, 1)), 3.1824463 / 1.96
    found = np.array([
        [differ(rows, values - values.mean(), runs)[0] / student for differ in (run_std, group_std)]
        for values in random.normal(size=(4000, 100))
    ])  # fmt: skip
    by_runs, by_jackknife = np.mean(found**2, axis=0) * 100
    assert abs(by_runs - 1) < 0.05
    assert by_jackknife > 1.3


def test_what_one_run_alone_determines_does_not_spoil_the_rest():
    rows, runs = np.zeros((9, 2)), np.repeat(np.arange(3), 3)
    rows[:, 0], rows[:3, 1] = 1.0, (1.0, -1.0, 0.0)
    residual = np.random.default_rng(4).normal(size=9)
    residual -= rows @ np.linalg.lstsq(rows, residual, rcond=None)[0]
    assert np.isfinite(run_std(rows, residual, runs)).all()
    assert run_std(rows, residual, runs)[0] > 0


def test_at_least_never_narrows_any_combination():
    covariance = np.array([[4.0, 1.99], [1.99, 1.0]])
    wider = at_least(covariance, np.array([1.0, 3.0]))
    np.testing.assert_allclose(np.sqrt(np.diag(wider)), (2.0, 3.0))
    assert np.linalg.eigvalsh(wider - covariance).min() > -1e-12
    np.testing.assert_allclose(at_least(covariance, np.array([4.0, 2.0])), 4 * covariance)
    np.testing.assert_array_equal(at_least(covariance, np.array([np.inf, 0.0])), covariance)
    np.testing.assert_array_equal(at_least(np.zeros((1, 1)), np.ones(1)), 0)


def test_products_are_those_of_the_matrix():
    rows = np.random.default_rng(2).normal(size=(50, 3))
    np.testing.assert_allclose(products(rows), rows.T @ rows, rtol=1e-12)
