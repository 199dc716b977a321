"""The observer of one joint: exact prediction, a triple pole where it was placed, and what follows from both."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ctc.laws.observer import correct, predict

PERIOD = 0.7e-3
finite = st.floats(-10, 10)


@given(finite, finite, finite, finite, st.floats(1e-5, 0.1))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_prediction_is_exact_for_constant_v_and_disturbance(error, rate, disturbance, v, dt):
    """Against the matrix exponential of edd = x3 - v, x3' = 0, v' = 0. Tolerance: some ten roundings of terms < 30."""
    system = np.zeros((4, 4))
    system[0, 1] = 1
    system[1, 2:] = 1, -1
    expected = expm(system * dt) @ [error, rate, disturbance, v]
    np.testing.assert_allclose(predict(error, rate, disturbance, v, dt), expected[:3], rtol=0, atol=1e-13)


def error_dynamics(omega, dt):
    """Matrix (3, 3) that takes the observer's own error across one sample: predict, then correct by the truth."""
    estimate, truth, v = ca.SX.sym("estimate", 3), ca.SX.sym("truth", 3), ca.SX.sym("v")
    true = predict(*ca.vertsplit(truth), v, dt)
    after = correct(*predict(*ca.vertsplit(estimate), v, dt), true[0], omega, dt)
    wrong = ca.vertcat(*true) - ca.vertcat(*after)
    matrices = ca.Function("J", [estimate, truth, v], [ca.jacobian(wrong, x) for x in (truth, estimate, v)])
    by_truth, by_estimate, by_v = (m.full() for m in matrices(0, 0, 0))
    # The observer's error obeys its own dynamics: what the joint does and what acts on it cancel out. The rows have
    # gains up to 1/dt^2, so roundings are measured against the entries.
    np.testing.assert_allclose(by_truth, -by_estimate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(by_v, 0, rtol=0, atol=1e-6)
    return by_truth


@pytest.mark.parametrize("omega", [50.0, 220 * 1.8, 3 * 220 * 1.8])
@pytest.mark.parametrize("dt", [PERIOD, 1e-4])
def test_the_poles_are_a_triple_one(omega, dt):
    """Eigenvalues at z = exp(-omega dt), three times; a triple pole moves by the cube root of a rounding, 1e-5."""
    z = np.exp(-omega * dt)
    matrix = error_dynamics(omega, dt)
    # Scaled to comparable units (rad, rad per sample, rad per sample^2), which leaves eigenvalues alone.
    scale = dt ** np.arange(3)
    matrix = matrix * scale[:, None] / scale
    np.testing.assert_allclose(np.linalg.eigvals(matrix), z, rtol=0, atol=1e-4)
    # The coefficients of (x - z)^3 are well conditioned: rounding only.
    np.testing.assert_allclose(np.poly(matrix), [1, -3 * z, 3 * z**2, -(z**3)], rtol=0, atol=1e-12)
    # A triple pole in one chain: the matrix is nilpotent around z after three steps and not before.
    rest = matrix - z * np.eye(3)
    np.testing.assert_allclose(np.linalg.matrix_power(rest, 3), 0, rtol=0, atol=1e-12)
    assert np.abs(rest @ rest).max() > 1e-3 * (1 - z) ** 2


def test_it_finds_a_constant_disturbance_from_the_error_alone():
    """edd = 3 - v(t) for a v that changes every sample; after 100 samples of omega dt = 0.28 the rest is e^-28 100^2.

    That is 1e-8 of the start, 3 rad/s^2.
    """
    random, omega = np.random.default_rng(2), 400.0
    truth, estimate = np.array([1e-3, -0.02, 3.0]), np.zeros(3)
    for _ in range(100):
        v = random.normal()
        truth = np.array(predict(*truth, v, PERIOD))
        estimate = np.array([float(x) for x in correct(*predict(*estimate, v, PERIOD), truth[0], omega, PERIOD)])
    np.testing.assert_allclose(estimate, truth, rtol=0, atol=1e-7)


def test_a_measurement_that_agrees_changes_nothing():
    assert [float(x) for x in correct(0.1, 0.2, 0.3, 0.1, 400.0, PERIOD)] == [0.1, 0.2, 0.3]
