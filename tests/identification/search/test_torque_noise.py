"""Noise of a logged current: its size is estimated, and it is no defect of the model."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from driven_arm import CHAIN, DYNAMICS, LAW, PATH, RIG, TRUE
from random_rigs import log_of

from identification import identify
from identification.equation_error import (
    FADED,
    along_log,
    independent_noise,
    noise_of_torque,
    told_by_torque,
    white_noise,
)
from plant import LoggedCurrent
from plant.simulation import run_law

NOISE = 0.03  # of the current [A]: 0.3 % of its range


@cache
def exact(duration):
    """The log of another engine, its torque without noise."""
    return log_of(CHAIN, RIG, None, LAW, PATH, duration)


def log(rig=RIG, law=None, duration=6.0):
    """Seconds by another engine, whose current is known with noise; its law if stated."""
    record = exact(duration)
    current = RIG.drive.current(record.torque)
    current = current + np.random.default_rng(1).normal(size=current.shape) * NOISE
    law = law or LoggedCurrent()
    return dataclasses.replace(record, torque=None, current=current, law=law, rig=rig)


def test_noise_of_the_current_is_named_with_its_size_and_doubts_nothing():
    estimate = identify(DYNAMICS, log(duration=3.0), progress=False)
    # It is far beyond rounding, and the fit says why.
    assert estimate.fit.rms_innovation > 0.45
    assert estimate.doubts == []
    noise = RIG.drive.current(estimate.fit.torque_noise)
    np.testing.assert_allclose(noise, NOISE, rtol=0.1)
    assert "noise of the logged torque" in str(estimate)
    assert np.abs((estimate.fit.values - TRUE) / estimate.fit.std).max() < 3
    np.testing.assert_allclose(estimate.fit.values, TRUE, rtol=0.02, atol=0.005)


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("begin", "duration"), [(0.0, 3.0), pytest.param(0.83, 6.0, marks=pytest.mark.slow)]
)
def test_a_stated_law_gives_its_torque_without_the_noise(begin, duration):
    """Repeated with its noise, the current left 0.5 pulses, and deviations twenty times as wide."""
    record = log(law=LAW, duration=duration)
    record = record.cut(begin) if begin else record
    estimate = identify(DYNAMICS, record, progress=False)
    assert estimate.doubts == []
    assert estimate.fit.undetermined == ()
    assert estimate.fit.rms_innovation < 0.35
    noise = RIG.drive.current(estimate.fit.torque_noise)
    np.testing.assert_allclose(noise, NOISE, rtol=0.1)
    error = estimate.fit.values - TRUE
    assert np.abs(error / np.sqrt(np.diag(estimate.fit.noise_covariance))).max() < 4
    np.testing.assert_allclose(estimate.fit.values, TRUE, rtol=5e-4, atol=1e-3)


@pytest.mark.slow
def test_a_torque_that_is_not_the_laws_tells_no_state():
    assert told_by_torque(log(law=LAW)) is not None
    wrong = dataclasses.replace(LAW, speed=1.05 * LAW.speed)
    assert told_by_torque(log(law=wrong)) is None
    # A column without noise is as good as the law, and better where the law is wrong.
    assert told_by_torque(exact(2.0)) is None


def test_a_noisy_torque_tells_the_integral_of_a_law_that_was_at_work():
    record, begin = log(law=LAW), 830
    states = run_law(along_log(dataclasses.replace(record, current=None))).states
    told, memory = told_by_torque(record.cut((begin - 0.5) * RIG.period))
    # The filters of the first samples are those of a motion on a line, and leave it a little.
    difference = run_law(told).states[FADED] - states[begin + FADED]
    deviation = np.abs(memory.directions[:, 0])
    integral = int(np.argmax(deviation))
    assert memory.noise == pytest.approx(NOISE * RIG.drive.motor_gain * 50, rel=0.1)
    assert abs(difference[integral]) < 4 * deviation[integral]
    assert deviation[integral] < 0.01 * np.ptp(states[:, integral])


def test_chatter_of_a_stated_law_is_no_noise_of_its_torque():
    record = exact(2.0)
    assert white_noise(record.torque).item() > 1e-3 * np.std(record.torque)
    assert noise_of_torque(record).item() < 1e-6 * np.std(record.torque)
