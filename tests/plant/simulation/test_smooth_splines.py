"""The smooth motion through commanded counts, against scipy's least squares; law runs in blocks,
against one by one.
"""

import importlib

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from plant import PID, Record, Resumed, puma560
from plant.laws import resumed
from plant.parts import evaluated
from plant.simulation import run_law

smooth_splines = importlib.import_module("plant.motion.smooth_splines")


@pytest.mark.parametrize("pieces", [1, 7, 60])
def test_splines_are_those_of_a_qr_decomposition(pieces):
    t = np.sort(np.random.default_rng(0).uniform(0, 3, 700))
    columns = np.round(np.column_stack([300 * np.sin(t), 50 * np.cos(5 * t)])) + 0.5
    knots = np.pad(np.linspace(t[0], t[-1], pieces + 1), 5, "edge")
    splines, left = smooth_splines._least_squares_splines(t, columns, knots)
    for spline, square, column in zip(splines, left, columns.T, strict=True):
        expected = make_lsq_spline(t, column, knots, k=5)
        np.testing.assert_allclose(spline(t), expected(t), atol=1e-6)
        assert square == pytest.approx(np.mean((expected(t) - column) ** 2), rel=1e-6)


def test_a_function_without_copies_gives_what_a_call_gives():
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y")
    function = ca.Function(
        "f", [x, y], [y * x[:2], ca.densify(ca.vertcat(x[0], 0, x[2] ** 2))]
    ).map(5)
    values, factors = np.random.default_rng(0).normal(size=(5, 3)), np.arange(5.0)[:, None]
    for got, expected in zip(
        evaluated(function, values, factors), function(values.T, factors.T), strict=True
    ):
        np.testing.assert_array_equal(got, expected.full().T)
    with pytest.raises(RuntimeError, match="not large enough"):
        evaluated(function, values[:4], factors)


def log(samples):
    """Counts and commanded counts under a PID that has been at work; they need not be a robot's."""
    rig, t = puma560.rig(), puma560.rig().period * np.arange(samples)
    reference = np.round(np.column_stack([400 * np.sin(t), 300 * np.cos(2 * t)]))
    pid = PID(
        gain=(0.1, 0.07),
        derivative=(4e-4, 3e-4),
        filter=3000.0,
        integral=(0.5, 0.4),
        period=rig.period,
    )
    law = Resumed(law=pid, state=pid.initial_state(2)).along(rig)
    errors = np.round(5 * np.column_stack([np.cos(9 * t), np.sin(7 * t)]))
    return Record(t=t, rig=rig, law=law, reference_pulses=reference, error_pulses=errors)


def test_a_law_in_blocks_remembers_across_them(monkeypatch):
    """Blocks of 1000 steps, the last one filled up, and blocks of 7 give the same; the length
    stays the log's.
    """
    whole = run_law(log(2345))
    resumed._repeated.cache_clear()
    resumed._prepared.cache_clear()
    monkeypatch.setattr(resumed, "_STEPS_PER_CALL", 7)
    parts = run_law(log(2345))
    resumed._repeated.cache_clear()
    resumed._prepared.cache_clear()
    assert whole.given.shape == (2345, 2)
    np.testing.assert_array_equal(parts.given, whole.given)
    np.testing.assert_array_equal(parts.states, whole.states)
    assert np.ptp(whole.given, axis=0).min() > 0


def test_splines_of_one_log_are_made_once(monkeypatch):
    made = []
    monkeypatch.setattr(smooth_splines, "_FOUND", {})
    fewest = smooth_splines._fewest_knots
    monkeypatch.setattr(
        smooth_splines, "_fewest_knots", lambda *given: made.append(1) or fewest(*given)
    )
    for _ in range(3):
        run_law(log(500))
    assert len(made) == 1
    run_law(log(501))
    assert len(made) == 2
