"""Noise of a logged current: its size is estimated, and it is no defect of the model."""

import dataclasses

import numpy as np
import pytest
from driven_arm import CHAIN, DYNAMICS, LAW, PATH, RIG, TRUE
from random_rigs import log_of

from identification import identify
from identification.equation_error.torque_noise import independent_noise, white_noise
from plant import (
    LoggedCurrent,
)

NOISE = 0.03  # of the current [A]: 0.3 % of its range


def log(rig=RIG):
    """Six seconds by another engine, whose current alone is known, with noise."""
    record = log_of(CHAIN, RIG, None, LAW, PATH, 6.0)
    current = RIG.drive.current(record.torque)
    current = current + np.random.default_rng(1).normal(size=current.shape) * NOISE
    return dataclasses.replace(record, torque=None, current=current, law=LoggedCurrent(), rig=rig)


def test_noise_of_the_current_is_named_with_its_size_and_doubts_nothing():
    estimate = identify(DYNAMICS, log(), progress=False)
    # It is far beyond rounding, and the fit says why.
    assert estimate.fit.rms_innovation > 0.45
    assert estimate.doubts == []
    noise = RIG.drive.current(estimate.fit.torque_noise)
    np.testing.assert_allclose(noise, NOISE, rtol=0.1)
    assert "noise of the logged torque" in str(estimate)
    assert np.abs((estimate.fit.values - TRUE) / estimate.fit.std).max() < 3
    np.testing.assert_allclose(estimate.fit.values, TRUE, rtol=0.02, atol=0.005)


def test_noise_hides_no_wrong_friction():
    wrong = dataclasses.replace(RIG.drive, coulomb=RIG.drive.coulomb * 3)
    estimate = identify(DYNAMICS, log(dataclasses.replace(RIG, drive=wrong)), progress=False)
    assert estimate.doubts


def test_noise_is_told_from_motion_jumps_and_another_law():
    random = np.random.default_rng(2)
    t = 1e-3 * np.arange(5000)
    motion = np.column_stack([3 * np.sin(9 * t), np.sign(np.sin(4 * t))])
    noise = random.normal(size=motion.shape) * (0.05, 0.2)
    np.testing.assert_allclose(white_noise(motion + noise), (0.05, 0.2), rtol=0.05)
    held = (noise + np.roll(noise, 1, axis=0)) / 2
    expected = np.std(held, axis=0)
    np.testing.assert_allclose(white_noise(motion + held, held=True), expected, rtol=0.05)
    # What goes with the chatter of the command is a wrong gain, and no noise.
    chattering = motion + random.normal(size=motion.shape)
    wrong = independent_noise(1.1 * chattering, chattering, held=False)
    np.testing.assert_array_equal(wrong, 0)
    right = independent_noise(chattering + noise, chattering, held=False)
    assert right == pytest.approx((0.05, 0.2), rel=0.05)
