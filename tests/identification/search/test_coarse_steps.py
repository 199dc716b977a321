"""Logs on which the integration of the model in coarse steps shows."""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import Encoder, P, puma560, simulate


@pytest.mark.parametrize("counts", [pytest.param(4, marks=pytest.mark.slow), 16])
def test_a_fit_that_coarse_steps_bend_is_made_in_finer_ones(counts):
    """At 10 ms between samples 4 steps of the model put a value 27 deviations off, with no doubt.

    With a fine encoder the genetic algorithm's best, which repeats the errors in coarse steps,
    replaced the fit.
    """
    rig = puma560.rig()
    encoder = Encoder(resolution=counts * rig.encoder.resolution)
    rig = dataclasses.replace(rig, period=0.01, encoder=encoder)
    law = P(gain=puma560.p_law().gain / counts)
    path = puma560.reference()
    record = simulate(puma560.arm(), rig, law, path, duration=7.3, steps_per_sample=280)
    record = dataclasses.replace(record, torque=None, current=None)
    estimate = identify(puma560.dynamics(), record, progress=False)
    errors = (estimate.fit.values - puma560.arm().f) / estimate.fit.std
    assert np.abs(errors).max() < 4
    assert estimate.fit.fallback_reason is None
    assert not estimate.doubts
