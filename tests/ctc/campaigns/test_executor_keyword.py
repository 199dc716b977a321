"""`executor=` where work is a map over independent parts: the same bits as without."""

import campaign_tasks as work
import numpy as np
import pytest

from ctc import ComputedTorque, Uncertainty, certify, learn, tune
from identification import design_motion, spread
from plant import puma560, simulate
from plant.simulation import Executor, mapped

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()


def test_certify_gives_the_same_bits_on_processes(tmp_path):
    law = ComputedTorque(ARM, RIG, bandwidth=62)
    stated = Uncertainty(covariance=np.diag((0.02 * np.abs(ARM.f)) ** 2), dropped=0.01)
    options = {"samples": 700, "duration": 0.05, "steps_per_sample": 4, "progress": False}
    alone, there = (
        certify(ARM, RIG, law, PATH, stated, executor=each, **options) for each in (None, work.pool)
    )
    assert there == alone
    assert np.array_equal(there.runs.unrounded, alone.runs.unrounded)
    assert np.array_equal(there.runs.lost, alone.runs.lost)
    with pytest.raises(ValueError, match="checkpoint must be left out with an executor"):
        certify(
            ARM,
            RIG,
            law,
            PATH,
            stated,
            executor=work.pool,
            checkpoint=tmp_path / "c.json",
            **options,
        )


@pytest.mark.slow
def test_tune_gives_the_same_bits_on_processes(tmp_path):
    stated = Uncertainty(covariance=np.diag((0.01 * np.abs(ARM.f)) ** 2), friction=0.02)
    options = {"samples": 8, "duration": 0.05, "progress": False}
    alone, there = (
        tune(ARM, RIG, PATH, stated, executor=each, **options) for each in (None, work.pool)
    )
    assert there == alone
    with pytest.raises(ValueError, match="checkpoint must be left out with an executor"):
        tune(ARM, RIG, PATH, stated, executor=work.pool, checkpoint=tmp_path / "c.json", **options)


def test_learn_gives_the_same_bits_on_processes():
    law = ComputedTorque(ARM.dynamics.arm(1.03 * ARM.f), RIG)
    records = [simulate(ARM, RIG, law, PATH) for _ in range(2)]
    alone, there = (learn(law, RIG, PATH, records, executor=each) for each in (None, work.pool))
    assert there == alone


def test_an_executor_in_a_with_statement_serves_several_maps():
    made = []

    def factory():
        made.append(work.pool(1))
        return made[-1]

    with Executor(factory) as where:
        assert mapped(work.square, [1, 2], where) + mapped(work.square, [3], where) == [1, 4, 9]
    assert len(made) == 1
    with pytest.raises(RuntimeError, match="shutdown"):
        made[0].submit(work.square, 1)


def test_spread_gives_the_same_bits_on_processes():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.5)
    options = {"seeds": range(2), "method": "seeded", "progress": False}
    alone, there = (
        spread(ARM.dynamics, record, executor=each, **options) for each in (None, work.pool)
    )
    assert np.array_equal(alone.f, there.f)
    with pytest.raises(ValueError, match="seed must be"):
        spread(ARM.dynamics, record, seeds=(-1, -2), executor=work.pool, progress=False)


def test_design_motion_gives_the_same_bits_on_processes():
    limits = {"position": ((-1, 1), (-1, 1)), "velocity": (2, 2), "acceleration": (8, 8)}
    options = {"period": 4.0, "harmonics": 2, "starts": 2, "iterations": 20, **limits}
    alone, there = (
        design_motion(ARM, RIG, puma560.p_law(), executor=each, **options)
        for each in (None, work.pool)
    )
    assert alone == there
