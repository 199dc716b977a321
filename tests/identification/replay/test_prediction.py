"""Prediction error: innovations of the true arm, Gauss-Newton on a problem with a known answer,
honest refusals.
"""

import numpy as np
import pytest

from identification.replay import DEPENDENT, Prediction, gauss_newton, slopes
from plant import PointToPoint, puma560, simulate

NAMES = puma560.dynamics().names


@pytest.fixture(scope="module")
def record():
    return simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), steps_per_sample=16
    )


def test_the_innovations_of_the_true_arm_are_rounding_alone(record):
    """1 / sqrt(12) = 0.289 pulses, and hardly more; without memory, so that their squares are a
    likelihood.
    """
    prediction = Prediction(puma560.dynamics(), record)
    innovation = prediction.innovations(np.append(puma560.PUBLISHED, prediction.nuisances)).reshape(
        -1, 2
    )
    weight = prediction.weights.reshape(-1, 2)
    rms = np.sqrt((innovation**2).sum(axis=0) / (weight**2).sum(axis=0))
    assert ((rms > 0.28) & (rms < 0.32)).all()
    for column in innovation.T:
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 0.15


def test_samples_weigh_by_the_cells_they_cross():
    """Nothing moves: no reading but the first; many cells per sample: every sample one reading."""
    still = PointToPoint(start=(-0.5, 0.5), goal=(-0.5, 0.5), duration=0.2)
    held = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), still)
    weight = Prediction(puma560.dynamics(), held).weights.reshape(-1, 2)
    assert weight[-50:].max() < 0.3
    moving = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=1.0
    )
    weight = Prediction(puma560.dynamics(), moving).weights.reshape(-1, 2)
    assert weight[300:1000].min() == weight.max() == 1.0
    assert weight[0].max() < 1.0  # the reference starts at rest


def test_several_records_and_threads_give_the_same_innovations(record):
    short = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(2.5), duration=0.3
    )
    both = Prediction(puma560.dynamics(), [record, short], threads=1)
    values = np.append(puma560.PUBLISHED, both.nuisances)
    apart = [Prediction(puma560.dynamics(), each).innovations(values) for each in (record, short)]
    np.testing.assert_array_equal(both.innovations(values), np.concatenate(apart))
    many = [values * (1 + 0.01 * i) for i in range(5)]
    on_two = Prediction(puma560.dynamics(), [record, short], threads=2).all_innovations(many)
    np.testing.assert_array_equal(both.all_innovations(many), on_two)


def test_an_arm_that_is_none_has_infinite_innovations(record):
    prediction = Prediction(puma560.dynamics(), record)
    impossible = np.append(-puma560.PUBLISHED, prediction.nuisances)
    assert np.isinf(prediction.innovations(impossible)).all()
    with pytest.raises(ValueError, match="must start from an arm that follows the log"):
        gauss_newton(prediction, impossible, np.ones(13), np.array([(-np.inf, np.inf)] * 13))


class Curve:
    """y = a exp(-b t) + noise, as if it were a prediction; not linear in b."""

    unknown, dependent = ("a", "b", "c"), DEPENDENT

    def __init__(self, noise, seed=0):
        self.t = np.linspace(0, 3, 400)
        self.y = 2.0 * np.exp(-0.7 * self.t) + noise * np.random.default_rng(seed).normal(size=400)
        self.weights, self.scales = np.ones(400), np.ones(400)

    def innovations(self, x):
        return (
            self.y - x[0] * np.exp(-x[1] * self.t) + 0 * x[2] if x[1] < 5 else np.full(400, np.inf)
        )

    def all_innovations(self, many):
        return [self.innovations(x) for x in many]


EVERYWHERE = np.array([(-np.inf, np.inf)] * 3)


def test_gauss_newton_finds_the_smallest_sum_of_squares():
    fit = gauss_newton(Curve(0.0), (1.0, 0.1, 9.0), (1e-4, 1e-4, 0.0), EVERYWHERE, tolerance=1e-14)
    # a step of zero leaves c alone
    np.testing.assert_allclose(fit.values, (2.0, 0.7, 9.0), rtol=1e-6)
    assert (fit.covariance[2] == 0).all()


def test_its_covariance_is_the_scatter_of_repeated_noise():
    fits = [
        gauss_newton(Curve(0.1, seed), (1.0, 0.1, 0.0), (1e-4, 1e-4, 0.0), EVERYWHERE)
        for seed in range(80)
    ]
    scatter = np.std([fit.values[:2] for fit in fits], axis=0)
    said = np.median([np.sqrt(np.diag(fit.covariance))[:2] for fit in fits], axis=0)
    assert (np.abs(np.log(said / scatter)) < np.log(1.35)).all()
    assert np.median([fit.rms_innovation for fit in fits]) == pytest.approx(0.1, rel=0.05)


def test_values_stay_in_their_bounds_and_long_steps_are_shortened():
    bounds = np.array([(-np.inf, np.inf), (0.8, 4.9), (0, 1)])
    # a step of 4 from 2 is lost
    fit = gauss_newton(Curve(0.0), (1.0, 2.0, 0.0), (1e-4, 4.0, 0.0), bounds)
    assert fit.values[1] == 0.8


def test_unknowns_without_effect_are_named():
    with pytest.raises(ValueError, match="c does not"):
        gauss_newton(Curve(0.1), (1.0, 0.1, 0.0), (1e-4, 1e-4, 1e-4), EVERYWHERE)


def test_an_unknown_that_loses_the_log_however_small_its_change_is_named():
    class Edge(Curve):
        def innovations(self, x):
            return np.full(400, np.inf) if x[1] != 0.1 else super().innovations(x)

    with pytest.raises(ValueError, match="any change of b loses it"):
        gauss_newton(Edge(0.1), (1.0, 0.1, 0.0), (1e-4, 1e-4, 0.0), EVERYWHERE)


def test_steps_on_which_innovations_jump_to_one_side_are_shortened():
    """Beside an edge, slopes are those of the side with the values; without what holds there, of
    the jump.
    """

    class Cliff:
        unknown, weights = ("a", "b"), np.ones(3)

        def innovations(self, z):
            return np.array([3 * z[0], 2 * z[1], 5.0 * (z[0] > 1)])

        def all_innovations(self, many):
            return [self.innovations(z) for z in many]

    values, step = np.array([0.99, 0.0]), np.array([0.1, 0.1])
    made = slopes(Cliff(), values, step, np.arange(2), Cliff().innovations(values))
    np.testing.assert_allclose(made / step, [[3, 0], [0, 2], [0, 0]], rtol=1e-9)
    assert step[0] < 0.01 < 0.1 == step[1]
    plain = slopes(Cliff(), values, np.array([0.1, 0.1]), np.arange(2))
    assert plain[2, 0] == 2.5


def test_steady_leaves_out_slow_samples_and_those_after():
    """A joint that stands throughout is no bar."""
    rig = puma560.rig()
    moving = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), duration=1.0)
    held = PointToPoint(start=(-0.5, 0.5), goal=(0.3, 0.5), duration=1.0)
    for path, fast in ((None, True), (held, False)):
        log = (
            moving
            if path is None
            else simulate(puma560.arm(), rig, puma560.p_law(), path, duration=1.0)
        )
        weights = [
            Prediction(puma560.dynamics(), log, steady=steady).weights.reshape(-1, 2)
            for steady in (False, True)
        ]
        kept = weights[1].any(axis=1)
        np.testing.assert_array_equal(weights[1][kept], weights[0][kept])
        assert not kept[:40].any()  # it starts at rest
        assert 0.5 < kept.mean() < 0.95
        steps = np.abs(np.diff(log.counts[kept][:, 0]))
        assert steps[steps < 100].mean() > 1
        assert (weights[0][300:900, 1].min() > 0.9) == fast
