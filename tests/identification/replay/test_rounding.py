"""The bias of rounding: a log that the model makes itself is the simulator's; without it estimates are off alike."""

import dataclasses

import numpy as np
import pytest

from identification import identify
from identification.replay.prediction import Prediction
from plant import Phase, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
LAW = puma560.p_law((0.1, 0.08))


@pytest.mark.parametrize("reference", [PATH, None], ids=["reference", "counts"])
def test_the_log_that_the_model_makes_is_that_of_the_simulator(reference):
    """Same arm, same phase, 16 sub-steps; without its reference the path is known but for its rounding."""
    shift = np.array([0.2, -0.3])
    phased = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, phase=Phase(shift=shift)))
    record = simulate(ARM, RIG, LAW, PATH, duration=1.0)
    prediction = Prediction(ARM.dynamics, dataclasses.replace(record, reference=reference))
    (followed, values), *_ = prediction._each(np.append(ARM.f, prediction.nuisances))
    followed.rounded(values, shift)
    counts = followed._rounding.counts(*followed._start(values), followed.loop.number_names, shift)
    expected = simulate(ARM, phased, LAW, PATH, duration=1.0, steps_per_sample=16).counts
    off = np.abs(counts - expected)
    assert off.max() <= (0 if reference is not None else 6)
    assert off.mean() < 0.8
    assert np.abs((counts - expected).mean(axis=0)).max() < 0.02


def test_estimates_have_no_bias():
    """Five logs from other phases: the mean of f6, whose bias is 1.3 standard deviations without the correction."""
    off = []
    for seed in range(5):
        shift = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
        robot = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, phase=Phase(shift=shift)))
        record = dataclasses.replace(simulate(ARM, robot, LAW, PATH, steps_per_sample=16), rig=RIG)
        found = identify(ARM.dynamics, record, method="prediction_error", progress=False)
        off.append((found.f - ARM.f) / np.sqrt(np.diag(found.fit.noise_covariance)))
    assert np.abs(np.mean(off, axis=0)).max() < 1.2
    assert np.sqrt(np.mean(np.square(off))) < 1.3
