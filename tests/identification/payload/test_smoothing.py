"""The smooth kernel: exact on polynomials, one filter for both sides, and its noise by
simulation.
"""

import numpy as np
import pytest

from identification.payload import Smoothing

SMOOTHING = Smoothing(0.04, 0.7e-3)


def test_parabolas_keep_their_rates_and_accelerations():
    t = np.arange(200) * 0.7e-3
    x = np.column_stack([1 + 2 * t, 3 * t**2])
    q, qd, qdd = SMOOTHING.motion(x)
    inside = t[len(t) - len(q) :] - (SMOOTHING.samples - 1) / 2 * 0.7e-3
    np.testing.assert_allclose(qdd, np.column_stack([0 * inside, 6 + 0 * inside]), atol=1e-8)
    np.testing.assert_allclose(qd, np.column_stack([2 + 0 * inside, 6 * inside]), atol=1e-10)
    np.testing.assert_allclose(q[:, 0], 1 + 2 * inside, atol=1e-12)


def test_both_sides_pass_one_filter():
    """Smoothed accelerations are the accelerations of the smoothed samples, also of noise."""
    x = np.random.default_rng(0).normal(size=(300, 1))
    q, _, qdd = SMOOTHING.motion(x)
    np.testing.assert_allclose(qdd[1:-1], np.diff(q, 2, axis=0) / 0.7e-3**2, rtol=1e-6, atol=1e-6)


def test_noise_of_the_acceleration():
    noise = np.random.default_rng(1).uniform(-0.5, 0.5, (100_000, 1))
    qdd = SMOOTHING.motion(noise)[2][:, 0]
    assert qdd.std() == pytest.approx(SMOOTHING.of_rounding / np.sqrt(12), rel=0.03)
    # a quarter of what the kernel's cosine needs to repeat is 2 pi times this
    apart = round(SMOOTHING.per_independent)
    assert abs(np.corrcoef(qdd[: -2 * apart], qdd[2 * apart :])[0, 1]) < 0.5
