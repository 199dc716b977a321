"""The bias of rounding: a log that the model makes itself is the simulator's; without it
estimates are off alike.
"""

import dataclasses
import importlib

import numpy as np
import pytest

from identification import identify
from identification.replay import Prediction, experiment, gauss_newton
from identification.search import polish
from plant import PID, Jitter, Phase, Record, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
LAW = puma560.p_law((0.1, 0.08))


@pytest.mark.parametrize("reference", [PATH, None], ids=["reference", "counts"])
def test_the_log_that_the_model_makes_is_that_of_the_simulator(reference):
    """Same arm, same phase, 16 sub-steps; without its reference the path is known but for its
    rounding.
    """
    shift = np.array([0.2, -0.3])
    phased = dataclasses.replace(
        RIG, encoder=dataclasses.replace(RIG.encoder, phase=Phase(shift=shift))
    )
    record = simulate(ARM, RIG, LAW, PATH, duration=1.0)
    prediction = Prediction(ARM.dynamics, dataclasses.replace(record, reference=reference))
    (followed, values), *_ = prediction._each(np.append(ARM.f, prediction.nuisances))
    counts, again = followed.rounded(values, [shift, shift], threads=2, steps=16)
    np.testing.assert_array_equal(counts, again)
    expected = simulate(ARM, phased, LAW, PATH, duration=1.0, steps_per_sample=16).counts
    off = np.abs(counts - expected)
    assert off.max() <= (0 if reference is not None else 6)
    assert off.mean() < 0.8
    assert np.abs((counts - expected).mean(axis=0)).max() < 0.02


SLOWER = PID(
    gain=(0.1, 0.075),
    integral=(0.5, 0.4),
    derivative=(4e-4, 3e-4),
    filter=2000.0,
    period=3 * RIG.period,
)


@pytest.mark.parametrize("law", [LAW, SLOWER], ids=["P", "PID"])
def test_a_log_that_is_made_in_blocks_has_the_same_bits(law, monkeypatch):
    """Also where a block would not begin with a step of the law."""
    rig = dataclasses.replace(RIG, jitter=Jitter(share=0.1)) if law is not LAW else RIG
    record = simulate(ARM, rig, law, PATH, duration=0.3)
    followed = next(iter(Prediction(ARM.dynamics, record)._followed))
    values = np.append(ARM.f, followed.loop.correction.number_values()[:4])
    whole = followed.rounded(values, [np.zeros(2)], threads=1, steps=16)
    monkeypatch.setattr(experiment, "_AT_ONCE", 100 * 16)
    np.testing.assert_array_equal(
        followed.rounded(values, [np.zeros(2)], threads=1, steps=16), whole
    )


def test_innovations_in_parts_have_the_same_bits(monkeypatch):
    """Gaps lie in one part or across two."""
    record = simulate(ARM, RIG, LAW, PATH, duration=0.5)
    kept = np.ones(len(record), bool)
    kept[95:105] = kept[300:303] = False
    some = {name: getattr(record, name)[kept] for name in ("t", "reference_pulses", "error_pulses")}
    prediction = Prediction(ARM.dynamics, Record(**some, rig=RIG, law=LAW))
    values = [np.append(ARM.f * share, prediction.nuisances) for share in (1.0, 1.01)]
    whole = prediction.all_innovations(values)
    monkeypatch.setattr(importlib.import_module("plant.simulation.loop_kernel"), "_AT_ONCE", 100)
    np.testing.assert_array_equal(prediction.all_innovations(values), whole)
    assert np.isfinite(whole).all()


@pytest.mark.parametrize("steps", [16, 64])
def test_it_rounds_as_often_as_the_loop_of_the_log(steps):
    """A stiff loop hunts by counts, the less the more often it feels them."""
    record = simulate(
        ARM, RIG, puma560.p_law((1.5, 1.2)), PATH, duration=1.0, steps_per_sample=steps
    )
    prediction = Prediction(ARM.dynamics, record)
    values, shifts = (
        np.append(ARM.f, prediction.nuisances),
        np.random.default_rng(1).uniform(-0.5, 0.5, (4, 1, 2)),
    )
    found = polish._rounded(prediction, values, shifts, prediction.innovations(values))
    np.testing.assert_array_equal(found, prediction.of_rounded(values, shifts, steps))


def test_the_mean_of_simulated_logs_adds_its_own_variance(monkeypatch):
    """Of logs of white noise the covariance is right: it grows by 1 / logs. In a log of far more
    noise than rounding their scatter says nothing.
    """
    record = simulate(ARM, RIG, LAW, PATH, duration=0.7)
    prediction = Prediction(ARM.dynamics, record)
    steps = np.append(1e-3 * np.abs(ARM.f), prediction.nuisance_steps)
    bounds = np.vstack([np.full((9, 2), (-np.inf, np.inf)), prediction.nuisance_bounds])
    start = np.append(ARM.f, prediction.nuisances)
    solution = gauss_newton(prediction, start, steps, bounds)
    logs = np.random.default_rng(0).normal(size=(8, len(solution.residual)))
    monkeypatch.setattr(polish, "_rounded", lambda *_: list(logs))
    for factor, low, high in ((1, 0.95, 1.3), (100, 1.1249, 1.1251)):
        residual = factor * logs[0] * prediction.scales
        noisy = dataclasses.replace(solution, residual=residual)
        unbiased, mean, _ = polish._unbiased(prediction, noisy, bounds, 0)
        scale = np.diag(unbiased.covariance) / np.diag(solution.covariance)
        assert low < scale.min() <= scale.max() < high
        rounding = logs.mean(axis=0) * prediction.scales
        if factor == 100:  # the log has more of it
            np.testing.assert_allclose(mean, rounding)
        else:  # as much as the log has: nothing in its direction remains
            np.testing.assert_allclose(mean / rounding, mean[0] / rounding[0])
            assert 0 < mean[0] / rounding[0] < 1
            assert abs((residual - mean) @ mean) < 1e-9 * (mean @ mean)


@pytest.mark.slow
def test_estimates_have_no_bias():
    """Five logs from other phases: the mean of f6, whose bias is 1.3 standard deviations without
    the correction.
    """
    off = []
    for seed in range(5):
        shift = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
        robot = dataclasses.replace(
            RIG, encoder=dataclasses.replace(RIG.encoder, phase=Phase(shift=shift))
        )
        record = dataclasses.replace(simulate(ARM, robot, LAW, PATH, steps_per_sample=16), rig=RIG)
        found = identify(ARM.dynamics, record, method="prediction_error", progress=False)
        off.append((found.f - ARM.f) / np.sqrt(np.diag(found.fit.noise_covariance)))
    assert np.abs(np.mean(off, axis=0)).max() < 1.2
    assert np.sqrt(np.mean(np.square(off))) < 1.3
