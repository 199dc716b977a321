"""Friction impulses: against closed forms, against enumeration of the complementarity, and as an
invariant.
"""

from itertools import product

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.machine import REGULARISATION, friction_impulse, smooth_impulse
from plant.mechanics import inverse


def impulse_function(n, sweeps):
    inertia, qd, impulse, bound = (
        ca.SX.sym(name, *shape)
        for name, shape in (("inertia", (n, n)), ("qd", (n,)), ("impulse", (n,)), ("bound", (n,)))
    )
    mobility = inverse(inertia)
    given = friction_impulse(mobility, -mobility.alone * qd, impulse, bound, sweeps)
    return ca.Function("f", [inertia, qd, impulse, bound], [given, qd + mobility.solve(given)])


FUNCTIONS = {
    (n, sweeps): impulse_function(n, sweeps) for n, sweeps in ((1, 1), (1, 3), (2, 3), (2, 200))
}


def friction(mobility, qd, bound, impulse=None, sweeps=3):
    n = len(qd)
    given = np.zeros(n) if impulse is None else impulse
    return [
        x.full().ravel() for x in FUNCTIONS[n, sweeps](np.linalg.inv(mobility), qd, given, bound)
    ]


def enumerated(inverse, qd, bound):
    """The impulses of all joints by trying out who stops and who slides which way; exactly one
    choice is consistent.
    """
    solutions = []
    for choice in product((0, 1, -1), repeat=len(qd)):
        modes = np.array(choice)
        impulse, stops = -bound * modes, modes == 0
        free = qd + inverse @ np.where(stops, 0, impulse)
        if stops.any():
            impulse[stops] = -np.linalg.solve(inverse[np.ix_(stops, stops)], free[stops])
        following = qd + inverse @ impulse
        if (np.abs(impulse) <= bound + 1e-12).all() and (modes * following >= -1e-12)[~stops].all():
            solutions.append((impulse, following))
    assert solutions
    return solutions[0]


@pytest.mark.parametrize("sweeps", [1, 3])
@pytest.mark.parametrize("start", [0.0, 0.3, -5.0])
def test_one_joint_is_stopped_or_gets_the_largest_impulse_against_its_motion(sweeps, start):
    mass, bound = 2.0, np.array([0.5])
    for qd, expected in (
        (0.1, -0.2),
        (-0.2, 0.4),
        (0.25, -0.5),
        (1.0, -0.5),
        (-3.0, 0.5),
        (0.0, 0.0),
    ):
        impulse, following = friction(
            np.array([[1 / mass]]), np.array([qd]), bound, np.array([start]), sweeps
        )
        # A handful of additions and products of numbers near 1.
        np.testing.assert_allclose(impulse, expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(following, qd + expected / mass, rtol=0, atol=1e-15)


def test_frictionless_joint_gets_no_impulse():
    impulse, following = friction(
        np.eye(2), np.array([1.0, -2.0]), np.zeros(2), np.array([3.0, 3.0])
    )
    np.testing.assert_array_equal(impulse, [0, 0])
    np.testing.assert_array_equal(following, [1, -2])


speeds = st.floats(-3, 3).map(lambda x: 0.0 if abs(x) < 1e-6 else x)


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.tuples(speeds, speeds), st.tuples(st.floats(0.01, 2), st.floats(0.01, 2)), st.floats(-0.9, 0.9),
       st.floats(0.2, 5), st.tuples(speeds, speeds))  # fmt: skip
def test_two_joints_converge_to_the_only_consistent_choice(qd, bound, coupling, ratio, start):
    inverse = np.array([[1.0, coupling * np.sqrt(ratio)], [coupling * np.sqrt(ratio), ratio]])
    qd, bound = np.array(qd), np.array(bound)
    expected, following = enumerated(inverse, qd, bound)
    got = friction(inverse, qd, bound, np.array(start), sweeps=200)
    # Gauss-Seidel gains coupling^2 <= 0.81 per sweep: 0.81^200 is 1e-18; what is left is rounding.
    np.testing.assert_allclose(got[0], expected, atol=1e-12)
    np.testing.assert_allclose(got[1], following, atol=1e-12)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.tuples(speeds, speeds), st.floats(-0.9, 0.9), st.tuples(speeds, speeds))
def test_impulses_stay_within_bounds_take_energy_and_change_the_speed_by_momentum(
    qd, coupling, start
):
    inverse, qd, bound = (
        np.array([[1.0, coupling], [coupling, 1.0]]),
        np.array(qd),
        np.array([0.4, 0.7]),
    )
    impulse, following = friction(inverse, qd, bound, np.array(start))
    assert (np.abs(impulse) <= bound).all()
    np.testing.assert_allclose(following, qd + inverse @ impulse, atol=1e-14)
    # From a cold start every projection lowers the kinetic energy: friction never drives.
    impulse, following = friction(inverse, qd, bound)
    D = np.linalg.inv(inverse)
    assert following @ D @ following <= qd @ D @ qd * (1 + 1e-12)


def test_right_impulse_is_kept_when_the_sweeps_start_from_it():
    """A held arm stays held: the friction of the last step is a fixed point, whatever the
    coupling.
    """
    inverse = np.array([[1.0, 0.95], [0.95, 1.0]])
    push = np.array([0.3, -0.2])
    held = -np.linalg.solve(inverse, push)
    impulse, following = friction(inverse, push, np.array([20.0, 20.0]), held)
    np.testing.assert_allclose(impulse, held, rtol=1e-14)
    np.testing.assert_allclose(following, 0, atol=1e-15)
    cold = friction(inverse, push, np.array([20.0, 20.0]))[1]
    assert np.abs(cold).max() > 0.1  # three sweeps from zero are far from it: the start matters


def test_smooth_impulse_saturates_and_has_the_slope_of_tanh():
    qd = ca.SX.sym("qd")
    mobility = inverse(ca.SX(2.0))
    impulse = smooth_impulse(mobility, -mobility.alone * qd, ca.SX(0.2))
    function = ca.Function("f", [qd], [impulse, mobility.solve(ca.SX(1)), ca.jacobian(impulse, qd)])
    np.testing.assert_allclose(float(function(1.0)[0]), -0.2, rtol=1e-15)
    np.testing.assert_allclose(float(function(-1.0)[1]), 0.5, rtol=1e-15)
    np.testing.assert_allclose(float(function(REGULARISATION)[0]), -0.2 * np.tanh(1), rtol=1e-15)
    np.testing.assert_allclose(float(function(0.0)[2]), -0.2 / REGULARISATION, rtol=1e-15)
