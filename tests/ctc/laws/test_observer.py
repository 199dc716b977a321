"""Observer and regulator of one joint: exact prediction, poles where they belong, gains beside
Riccati's equations.
"""

import casadi as ca
import numpy as np
import pytest
from error_loops import tustin
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from ctc.laws import DRIFT, correct, filter_gains, predict, regulator_gains, triple_pole

PERIOD = 0.7e-3
ORDERS = np.arange(3)
finite = st.floats(-10, 10)
RATES = pytest.mark.parametrize("omega", [50.0, 220 * 1.5, 3 * 220 * 1.5])
PERIODS = pytest.mark.parametrize("dt", [PERIOD, 1e-4])


@given(finite, finite, finite, finite, st.floats(1e-5, 0.1))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_prediction_is_exact_for_constant_v_and_disturbance(error, rate, disturbance, v, dt):
    """Against the matrix exponential of edd = x3 - v, x3' = 0, v' = 0. Tolerance: some ten
    roundings of terms < 30.
    """
    system = np.zeros((4, 4))
    system[0, 1] = 1
    system[1, 2:] = 1, -1
    expected = expm(system * dt) @ [error, rate, disturbance, v]
    np.testing.assert_allclose(
        predict(error, rate, disturbance, v, dt), expected[:3], rtol=0, atol=1e-13
    )


def numbers(gains, omega, dt):
    """Gains of the observer, or of the regulator, as floats."""
    return np.array([float(ca.evalf(x)) for x in gains(ca.SX(omega), ca.SX(dt))])


def error_dynamics(gains, dt):
    """Matrix (3, 3) that takes the observer's own error across one sample: predict, then correct by
    the truth.

    In comparable units (rad, rad per sample, rad per sample^2), which leaves eigenvalues alone.
    """
    estimate, truth, v = ca.SX.sym("estimate", 3), ca.SX.sym("truth", 3), ca.SX.sym("v")
    true = predict(*ca.vertsplit(truth), v, dt)
    predicted = predict(*ca.vertsplit(estimate), v, dt)
    after = correct(*predicted, true[0] - predicted[0], list(gains), dt)
    wrong = ca.vertcat(*true) - ca.vertcat(*after)
    matrices = ca.Function(
        "J", [estimate, truth, v], [ca.jacobian(wrong, x) for x in (truth, estimate, v)]
    )
    by_truth, by_estimate, by_v = (m.full() * (dt**ORDERS)[:, None] for m in matrices(0, 0, 0))
    # The observer's error obeys its own dynamics: what the joint does and what acts on it cancel
    # out.
    np.testing.assert_allclose(by_truth / dt**ORDERS, -by_estimate / dt**ORDERS, rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_v, 0, rtol=0, atol=1e-12)
    return by_truth / dt**ORDERS


def kalman_poles(omega):
    """Of the continuous filter, by Riccati's equation: white torque of bandwidth omega, drift of
    DRIFT times that.

    Time in units of 1 / omega, the rounding's density 1: acceleration noise omega^4, disturbance's
    (DRIFT omega)^6.
    """
    A, seen = np.eye(3, k=1), np.array([[1.0, 0.0, 0.0]])
    spread = solve_continuous_are(A.T, seen.T, np.diag([0, 1, DRIFT**6]), np.eye(1))
    return omega * np.linalg.eigvals(A - spread @ seen.T @ seen)


@RATES
@PERIODS
def test_the_filters_poles_are_those_of_the_kalman_filter(omega, dt):
    """By two ways that know nothing of the closed form: the stable zeros of s^6 + w^4 s^2 - (DRIFT
    w)^6, and Riccati.

    Compared by the coefficients of the sampled characteristic polynomial. Riccati's solver has ten
    digits.
    """
    zeros = np.roots([1, 0, 0, 0, omega**4, 0, -((DRIFT * omega) ** 6)])
    stable = zeros[zeros.real < 0]
    assert len(stable) == 3
    got = np.poly(error_dynamics(numbers(filter_gains, omega, dt), dt))
    np.testing.assert_allclose(got, np.poly(tustin(stable * dt)).real, rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        got, np.poly(tustin(kalman_poles(omega) * dt)).real, rtol=0, atol=1e-9
    )


def test_the_filters_gains_are_those_of_the_sampled_kalman_filter_for_short_periods():
    """Against the discrete Riccati equation with the exactly sampled noise: by the square of the
    period, or more.
    """
    omega, off, A, seen = 300.0, [], np.eye(3, k=1), np.array([[1.0, 0.0, 0.0]])
    units = omega**ORDERS
    for share in (0.08, 0.04, 0.02):  # of the period, in 1 / omega
        # Noise of one sample: the integral of white acceleration, and of the disturbance's random
        # walk (Van Loan).
        noise = np.diag([0, 1, DRIFT**6])
        both = expm(np.block([[-A, noise], [np.zeros((3, 3)), A.T]]) * share)
        step = both[3:, 3:].T
        spread = solve_discrete_are(step.T, seen.T, step @ both[:3, 3:], np.eye(1) / share)
        expected = (spread @ seen.T / (seen @ spread @ seen.T + 1 / share)).ravel() * units
        got = numbers(filter_gains, omega, share / omega) / (share / omega) ** ORDERS
        off.append((got / expected - 1).tolist())
    off = np.abs(off)
    assert (off[-1] < 1e-4).all()
    np.testing.assert_allclose(np.log2(off[:-1] / off[1:]), [(2, 2, 3)] * 2, atol=0.15)


@RATES
@PERIODS
def test_a_triple_pole_is_one(omega, dt):
    """Eigenvalues at z = exp(-omega dt), three times; a triple pole moves by the cube root of a
    rounding, 1e-5.
    """
    z = np.exp(-omega * dt)
    matrix = error_dynamics(numbers(triple_pole, omega, dt), dt)
    np.testing.assert_allclose(np.linalg.eigvals(matrix), z, rtol=0, atol=1e-4)
    # The coefficients of (x - z)^3 are well conditioned: rounding only.
    np.testing.assert_allclose(np.poly(matrix), [1, -3 * z, 3 * z**2, -(z**3)], rtol=0, atol=1e-12)
    # A triple pole in one chain: the matrix is nilpotent around z after three steps and not before.
    rest = matrix - z * np.eye(3)
    np.testing.assert_allclose(np.linalg.matrix_power(rest, 3), 0, rtol=0, atol=1e-12)
    assert np.abs(rest @ rest).max() > 1e-3 * (1 - z) ** 2


@RATES
@PERIODS
def test_the_regulators_poles_are_where_they_were_placed(omega, dt):
    """A double integrator under a held -(k1 e + k2 edot): magnitude omega, damping 1/sqrt(2),
    sampled exactly.
    """
    k = numbers(regulator_gains, omega, dt) * (dt * dt, dt)
    loop = np.array([[1, 1], [0, 1]]) - np.outer([1 / 2, 1], k)
    poles = omega * np.array([-1 + 1j, -1 - 1j]) / np.sqrt(2)
    np.testing.assert_allclose(np.poly(loop), np.poly(tustin(poles * dt)).real, rtol=0, atol=1e-12)


def test_the_regulator_is_the_linear_quadratic_one_for_short_periods():
    """Of the cost omega^4 e^2 + v^2, by Riccati's equation; the hold is worth half a period, of
    omega dt = 2e-3.
    """
    omega, dt = 200.0, 1e-5
    A, B = np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]])
    best = B.T @ solve_continuous_are(A, B, np.diag([1.0, 0]), np.eye(1))
    np.testing.assert_allclose(
        numbers(regulator_gains, omega, dt) / (omega**2, omega), best[0], rtol=2e-3
    )


@pytest.mark.parametrize("gains", [filter_gains, triple_pole])
def test_it_finds_a_constant_disturbance_from_the_error_alone(gains):
    """edd = 3 - v(t) for a v that changes every sample. The slowest pole of both is at 0.295 omega:
    after 400 samples of omega dt = 0.28, e^-33 is left of 3 rad/s^2, and roundings of numbers of
    some units.
    """
    random, omega = np.random.default_rng(2), 400.0
    truth, estimate, chosen = (
        np.array([1e-3, -0.02, 3.0]),
        np.zeros(3),
        numbers(gains, omega, PERIOD),
    )
    for _ in range(400):
        v = random.normal()
        truth = np.array(predict(*truth, v, PERIOD))
        predicted = predict(*estimate, v, PERIOD)
        estimate = np.array(
            [float(x) for x in correct(*predicted, truth[0] - predicted[0], chosen, PERIOD)]
        )
    np.testing.assert_allclose(estimate, truth, rtol=0, atol=1e-7)


def test_a_measurement_that_agrees_changes_nothing():
    gains = numbers(filter_gains, 400.0, PERIOD)
    assert [float(x) for x in correct(0.1, 0.2, 0.3, 0.0, gains, PERIOD)] == [0.1, 0.2, 0.3]
