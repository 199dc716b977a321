"""The oscillation of Figs. 10-11: its frequency, whose it is, and a filter without phase."""

import dataclasses

import numpy as np
import pytest

from identification import oscillation
from identification.results import mode_spans
from plant import puma560, simulate

ARM, RIG = puma560.arm(), puma560.rig()


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, RIG, puma560.p_law(), puma560.reference(), steps_per_sample=16)


def with_sine(record, frequency, amplitude):
    wave = amplitude * np.sin(2 * np.pi * frequency * record.t)[:, None]
    return dataclasses.replace(record, error_pulses=np.round(record.error_pulses + wave))


def test_the_loop_s_own_mode_is_recognised(record):
    found = oscillation(record, ARM)
    assert 22 < found.frequency < 30  # the paper saw 27-32 Hz, its gains are not printed
    assert found.own
    assert "keep it" in str(found)
    assert oscillation(record).own is None
    assert "pass an arm" in str(oscillation(record))


@pytest.mark.parametrize("frequency", [11.0, 70.0])
def test_a_foreign_frequency_is_found_within_five_per_cent_and_called_a_disturbance(
    record, frequency
):
    found = oscillation(with_sine(record, frequency, 4.0), ARM)
    assert found.frequency == pytest.approx(frequency, rel=0.05)
    assert found.own is False
    assert "disturbance" in str(found)
    np.testing.assert_allclose(found.amplitude, 4 / np.sqrt(2), rtol=0.15)


def test_filter_takes_the_oscillation_out_and_leaves_the_rest_in_place(record):
    shaken = with_sine(record, 70.0, 4.0)
    found = oscillation(shaken)
    inside = slice(200, -200)
    left = (found.removed(shaken.error_pulses) - found.removed(record.error_pulses))[inside]
    assert np.sqrt((left**2).mean()) < 0.35  # rounding of the sum
    slow = np.sin(2 * np.pi * 3.0 * record.t)[:, None] * (1, 2)
    np.testing.assert_allclose(found.removed(slow)[inside], slow[inside], atol=0.01)  # no phase


def test_figure_shows_errors_with_and_without_and_the_modes(record):
    import matplotlib

    matplotlib.use("Agg")
    axes = oscillation(record, ARM).plot()
    assert len(axes) == 3
    assert "modes of the linearised loop" in axes[-1].get_title(loc="left")
    matplotlib.pyplot.close("all")


def test_bad_input_is_refused(record):
    with pytest.raises(ValueError, match="The order is record, arm"):
        oscillation(ARM, record)
    with pytest.raises(ValueError, match=r"Pass found\.arm"):
        oscillation(record, ARM.dynamics)


def test_a_mode_that_some_poses_lack_is_not_mixed_with_another():
    poses = [np.array([10.0, 30.0]), np.array([34.0]), np.array([9.0, 29.0]), np.empty(0)]
    assert mode_spans(poses) == ((9.0, 10.0), (29.0, 34.0))
    assert mode_spans([np.empty(0)]) == ()


def test_an_oscillation_near_the_nyquist_frequency_is_taken_out(record):
    fast = dataclasses.replace(oscillation(record), frequency=0.4 / RIG.period)
    wave = np.sin(2 * np.pi * fast.frequency * record.t)[:, None] * (1.0, 1.0)
    assert np.abs(fast.removed(wave)[200:-200]).max() < 0.05
