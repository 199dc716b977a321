"""Counts that are read late: found, warned about, and corrected."""

import dataclasses

import numpy as np
import pytest

from identification import identify, without_delay
from plant import puma560, simulate

DYNAMICS, RIG = puma560.dynamics(), puma560.rig()
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()


@pytest.fixture(scope="module")
def record():
    return simulate(
        puma560.arm(), RIG, puma560.p_law((0.1, 0.08)), puma560.reference(), steps_per_sample=16
    )


def late(record, samples):
    """The same experiment, its counts read so many samples after the reference."""
    t = record.t - samples * RIG.period
    counts = np.trunc(
        RIG.position_in_pulses(
            np.column_stack([np.interp(t, record.t, q) for q in record.true_q.T])
        )
    )
    return dataclasses.replace(
        record, error_pulses=record.reference_pulses - counts, torque=None, current=None
    )


def quick(record, **options):
    return identify(DYNAMICS, record, method="prediction_error", progress=False, **options)


def test_a_log_in_time_is_not_warned_about(record):
    found = quick(record)
    assert abs(found.diagnostics.delay) < 0.01
    assert not any("samples late" in text for text in found.warnings)


@pytest.mark.parametrize(
    "samples",
    [
        0.1,
        pytest.param(-0.2, marks=pytest.mark.slow),
    ],
)
def test_delay_is_found_and_its_correction_brings_the_parameters_back(record, samples):
    """A tenth of a sample, 70 microseconds, throws f off by more than its whole range; the
    intervals say so.
    """
    found = identify(DYNAMICS, late(record, samples), progress=False)
    assert (np.abs(found.f - puma560.PUBLISHED) < 1.96 * found.fit.std).all()
    assert found.diagnostics.delay == pytest.approx(samples, abs=0.01)
    assert any(f"samples {'late' if samples > 0 else 'early'}" in text for text in found.warnings)
    again = quick(without_delay(late(record, samples), found.diagnostics.delay))
    off = [100 * np.abs(each.f - puma560.PUBLISHED).max() / WIDTH.min() for each in (found, again)]
    assert off[1] < 0.2 * off[0]
    assert (100 * np.median(np.abs(again.f - puma560.PUBLISHED) / WIDTH)) < 1.5
    assert abs(again.diagnostics.delay) < 0.02


@pytest.mark.slow
def test_unknown_friction_absorbs_the_delay_and_is_warned_about(record):
    unknown = (*DYNAMICS.names, "drive.viscous[0]", "drive.viscous[1]")
    found = quick(late(record, 0.1), unknown=unknown)
    assert found.rig.drive.viscous[0] > 1.5 * RIG.drive.viscous[0]
    assert any(
        "not separately identifiable from drive.viscous[0], drive.viscous[1]" in text
        for text in found.warnings
    )


def test_correction_moves_counts_along_their_motion(record):
    moved = without_delay(late(record, 0.5), 0.5)
    inside = slice(20, -20)
    difference = (moved.error_pulses - record.error_pulses)[inside]
    assert np.sqrt((difference**2).mean()) < 0.7  # two roundings
    np.testing.assert_allclose(difference.mean(axis=0), 0, atol=0.05)


def test_more_than_a_sample_is_refused(record):
    with pytest.raises(ValueError, match="samples must be within one; got 2"):
        without_delay(record, 2)
    with pytest.raises(ValueError, match="The order is record, samples"):
        without_delay(0.1, record)
