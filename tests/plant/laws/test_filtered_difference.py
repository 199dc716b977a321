"""Rates of signals against what they are known to be."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.laws import SMOOTHED, filtered_difference


def rates(signal, pole, dt):
    """Rate of a sampled signal (N,), sample by sample."""
    memory, found = SMOOTHED.read(SMOOTHED.initial(1), 1), []
    for value in signal:
        rate, memory = filtered_difference(np.array([value]), memory, pole, dt)
        memory = type(memory)(*(np.array(part).ravel() for part in memory))
        found.append(float(rate))
    return np.array(found)


@given(st.floats(-1e4, 1e4), st.floats(-1e3, 1e3), st.floats(20, 1e5), st.floats(1e-5, 1e-2))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_ramp_has_its_slope_after_the_filter_has_settled(start, slope, pole, dt):
    """The rate is slope (1 - exp(-pole k dt)) at sample k, wherever the ramp starts.

    Roundings: of the signal, over dt.
    """
    k = np.arange(40)
    got = rates(start + slope * dt * k, pole, dt)
    size = abs(start) + 40 * abs(slope) * dt + 1
    np.testing.assert_allclose(
        got, slope * (1 - np.exp(-pole * dt * k)), rtol=1e-9, atol=1e-13 * size / dt
    )


def test_a_filter_far_above_the_sampling_is_the_backward_difference():
    signal = np.random.default_rng(0).normal(size=20)
    np.testing.assert_allclose(rates(signal, 1e6, 1e-3)[1:], np.diff(signal) / 1e-3, rtol=1e-12)


def test_a_sine_comes_out_as_its_derivative_through_one_pole():
    """Against j w / (1 + j w / pole) in steady state, at a step that is short against both: first
    order in dt.

    The difference looks dt / 2 back and the filter's own step adds as much: w dt and pole dt, 3e-3
    here.
    """
    w, pole, dt = 100.0, 300.0, 1e-5
    t = dt * np.arange(10_000)
    t, got = t[-2000:], rates(np.sin(w * t), pole, dt)[-2000:]
    expected = np.imag(1j * w / (1 + 1j * w / pole) * np.exp(1j * w * t))
    np.testing.assert_allclose(got, expected, rtol=0, atol=3e-3 * w)


@pytest.mark.parametrize("start", [0.0, 1e6])
def test_the_first_reading_is_no_jump(start):
    assert rates([start, start], 500.0, 1e-3).tolist() == [0.0, 0.0]
