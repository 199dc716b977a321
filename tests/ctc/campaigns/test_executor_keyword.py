"""`executor=` where work is a map over independent parts: the same bits as without."""

import campaign_tasks as work
import numpy as np
import pytest

from ctc import ComputedTorque, Uncertainty, certify
from identification import design_motion, spread
from plant import puma560, simulate

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()


def test_certify_gives_the_same_bits_on_processes(tmp_path):
    law = ComputedTorque(ARM, RIG, bandwidth=62)
    stated = Uncertainty(covariance=np.diag((0.02 * np.abs(ARM.f)) ** 2), dropped=0.01)
    options = {"samples": 700, "duration": 0.05, "steps_per_sample": 4, "progress": False}
    alone, there = (certify(ARM, RIG, law, PATH, stated, executor=each, **options) for each in (None, work.pool))
    assert there == alone
    assert np.array_equal(there.runs.unrounded, alone.runs.unrounded)
    assert np.array_equal(there.runs.lost, alone.runs.lost)
    with pytest.raises(ValueError, match="checkpoint must be left out with an executor"):
        certify(ARM, RIG, law, PATH, stated, executor=work.pool, checkpoint=tmp_path / "c.json", **options)


def test_spread_gives_the_same_bits_on_processes():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.5)
    options = {"seeds": range(2), "method": "seeded", "progress": False}
    alone, there = (spread(ARM.dynamics, record, executor=each, **options) for each in (None, work.pool))
    assert np.array_equal(alone.f, there.f)
    with pytest.raises(ValueError, match="seed must be"):
        spread(ARM.dynamics, record, seeds=(-1, -2), executor=work.pool, progress=False)


def test_design_motion_gives_the_same_bits_on_processes():
    limits = {"position": ((-1, 1), (-1, 1)), "velocity": (2, 2), "acceleration": (8, 8)}
    options = {"period": 4.0, "harmonics": 2, "starts": 2, "iterations": 20, **limits}
    alone, there = (design_motion(ARM, RIG, puma560.p_law(), executor=each, **options) for each in (None, work.pool))
    assert alone == there
