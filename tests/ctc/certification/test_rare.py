"""Subset simulation: exact probabilities within the stated spread, and samples of the
distribution of certify.
"""

import dataclasses

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import ks_2samp

from ctc import ComputedTorque, Uncertainty, certify
from ctc.certification import Normals, Rare, Task, draw, subset_simulation
from plant import QuadratureError, puma560

LIMIT = 4.753424308822899  # ndtr(-LIMIT) = 1e-6
STATED = Uncertainty(
    covariance=np.diag((0.02 * np.abs(puma560.arm().f)) ** 2), friction=0.1, delay=(0, 1e-4)
)


def linear(u):
    """A normal response of mean 0 and variance 1, of all numbers alike."""
    return u.sum(axis=1) / np.sqrt(u.shape[1])


@pytest.mark.parametrize("numbers", [2, 30])
def test_one_in_a_million_within_the_stated_spread(numbers):
    """Over 20 seeds the ratio of variances is within the 99.8 % range of chi-squared with 19
    degrees of freedom.
    """
    assert ndtr(-LIMIT) == pytest.approx(1e-6)
    found = [subset_simulation(linear, LIMIT, numbers, 1e-9, seed) for seed in range(20)]
    probability, stated = (
        np.array([each.probability for each in found]),
        np.mean([each.variation for each in found]),
    )
    assert 0.25 < stated < 0.32
    assert abs(probability.mean() - 1e-6) < 3.1 * stated * 1e-6 / np.sqrt(20)
    assert 0.28 < np.log(probability).var(ddof=1) / np.log1p(stated**2) < 2.3
    assert sum(each.upper < 1e-6 for each in found) <= 4  # of 20 bounds at 95 %
    assert all(each.evaluations < 14_000 and not each.below and not each.met for each in found)


def test_it_ends_where_failure_is_commoner_or_rarer_than_asked():
    common = subset_simulation(linear, 1.0, 3, 1e-6, 0)
    assert common.evaluations == 1000
    assert common.probability == pytest.approx(ndtr(-1.0), abs=4 * common.variation * ndtr(-1.0))
    assert not common.met
    rare = subset_simulation(linear, 9.0, 3, 1e-4, 0)
    assert rare.below
    assert rare.met
    assert rare.upper <= 1e-4 < 10 * rare.probability * 1.1
    assert "rarer than 0.0001" in str(rare)


def test_what_cannot_be_is_left_out():
    """Half of the plane cut away: P(x > 2 | y > -1) of independent x, y is P(x > 2)."""
    found = subset_simulation(lambda u: np.where(u[:, 1] > -1, u[:, 0], -np.inf), 2.0, 2, 1e-6, 0)
    assert found.probability == pytest.approx(ndtr(-2.0), abs=4 * found.variation * ndtr(-2.0))
    with pytest.raises(ValueError, match="samples must be arms"):
        subset_simulation(lambda u: np.where(u[:, 1] > 1, u[:, 0], -np.inf), 2.0, 2, 1e-6, 0)


def test_chance_that_no_number_decides_is_said():
    """A response that a change of any size draws anew: chains cannot climb, and the bound is
    that of the last level.
    """

    def simulated(asked):
        chance = np.random.default_rng(1)
        return subset_simulation(lambda u: chance.standard_normal(len(u)), 9.0, 2, asked, 0)

    found = simulated(1e-6)
    assert found.stuck
    assert not found.met
    assert 1e-4 < found.probability < found.upper < 0.05
    assert "rounding decides" in str(found)
    # Chains that end at a level rare enough have shown what was asked.
    shown = simulated(1.01 * found.upper)
    assert shown.upper == found.upper
    assert shown.below is True
    assert shown.stuck is False


@pytest.mark.parametrize(
    ("response", "level", "probability"),
    [
        (lambda u: np.ones(len(u)), 1.0, 1.0),
        (lambda u: np.minimum(u[:, 0], 0.5), 0.5, 0.31),
        (lambda u: np.where(u[:, 0] > 1.645, 1.0, 0.0), 1.0, 0.05),
        # The midpoint of these two is rounded to the upper one.
        (lambda u: np.where(u[:, 0] > 1.645, 0.7, np.nextafter(0.7, 0)), 0.7, 0.05),
    ],
    ids=["all equal", "equal at the top", "equal below", "neighbours"],
)
def test_equal_errors_end_it_with_their_probability(response, level, probability):
    """An error that saturates has no level above it, and its probability stays a number."""
    result = subset_simulation(response, 2.0, 2, 1e-6, 0)
    assert result.stuck
    assert not result.met
    assert result.levels[-1] == level
    assert result.probability == pytest.approx(probability, rel=0.3)
    assert result.probability <= result.upper <= 1


def test_a_level_below_infinite_responses_is_finite():
    """99 of 995 arms fail: fewer than a tenth of them, and as many as a level lets through."""
    u = np.random.default_rng((0, 4)).standard_normal((1000, 2))[:, 0]
    fifth, first = np.sort(u)[[5, -99]]

    def response(u):
        finite = np.where(u[:, 0] < fifth, -np.inf, u[:, 1] - 10)
        return np.where(u[:, 0] < first, finite, np.inf)

    result = subset_simulation(response, 2.0, 2, 1e-6, 0)
    assert np.isfinite(result.levels).all()
    assert result.probability == pytest.approx(99 / 995, rel=0.05)


@pytest.mark.parametrize("nan_from", [1.0, 3.0], ids=["first population", "chains"])
def test_a_response_that_is_no_number_is_refused(nan_from):
    with pytest.raises(ValueError, match="got NaN"):
        subset_simulation(lambda u: np.where(u[:, 0] > nan_from, np.nan, u[:, 0]), 4.0, 2, 1e-6, 0)


def test_samples_of_normals_have_the_distribution_of_certify():
    arm, rig = puma560.arm(), puma560.rig()
    grown = Normals(np.empty((3000, 0)), np.random.default_rng(5))
    ours, theirs = draw(STATED, arm, rig, 3000, 1, normals=grown), draw(STATED, arm, rig, 3000, 2)
    assert ours.names == theirs.names
    for one, other in zip(ours.values.T, theirs.values.T, strict=True):
        assert ks_2samp(one, other).pvalue > 1e-4
    again = draw(STATED, arm, rig, 3000, 9, normals=Normals(grown.u))  # a function of u alone
    assert np.array_equal(again.values, ours.values)


@pytest.mark.slow
def test_a_certificate_has_it_for_one_motion_or_several():
    """With a controller that is too slow, f decides; to 1e-4, against 40,000 samples:
    tests/benchmarks/campaign.py.
    """
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law = ComputedTorque(arm, rig, bandwidth=62)
    options = {
        "samples": 2000,
        "duration": 0.05,
        "steps_per_sample": 4,
        "progress": False,
        "rare": 1e-4,
    }
    certificate = certify(arm, rig, law, path, STATED, within=1.3, **options)
    share, rare = (certificate.runs.unrounded.max(axis=1) > 1.3).mean(), certificate.rare
    assert 0.001 < share < 0.1
    assert abs(share - rare.probability) < 4 * np.hypot(
        np.sqrt(share / 2000), rare.variation * rare.probability
    )
    assert " ".join(str(rare).split()) in " ".join(str(certificate).split())
    assert certificate.holds is False
    both = certify(
        arm, rig, law, {"a": path, "b": path}, STATED, within=1.0, **options | {"samples": 10}
    )
    assert both["a"].rare is None
    assert both.rare.evaluations <= 3000
    assert both.rare.probability > rare.probability


def test_what_is_drawn_at_every_instant_is_refused(monkeypatch):
    """Before anything is fitted or simulated."""
    monkeypatch.delattr(Task, "sampled")
    arm, rig = puma560.arm(), puma560.rig()
    law, options = (
        ComputedTorque(arm, rig, bandwidth=150),
        {"samples": 10, "duration": 0.05, "progress": False},
    )
    for rare, uncertainty, said in (
        (
            1e-3,
            Uncertainty(covariance=STATED.covariance, dropped=0.01),
            "rare needs uncertainties with one number for each sample",
        ),
        (1e-3, Uncertainty(plants=[arm.f]), "Leave out plants or rare"),
        (2.0, STATED, "rare must be between 0 and 1"),
    ):
        with pytest.raises(ValueError, match=said):
            certify(arm, rig, law, puma560.reference(), uncertainty, rare=rare, **options)


@pytest.mark.parametrize("own", [False, True], ids=["stated", "of the rig"])
def test_an_error_within_a_period_is_none_before_rounding(monkeypatch, own):
    """By it counts exceed the limit where the error before rounding does not."""
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law = ComputedTorque(arm, rig, bandwidth=62)
    stated = dataclasses.replace(STATED, quadrature=0.0 if own else 0.4)
    if own:
        error = QuadratureError(amplitude=(0.4, 0.4), phase=(0, 0))
        rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, quadrature=error))
    options = {"duration": 0.05, "steps_per_sample": 4, "progress": False}
    runs = certify(arm, rig, law, path, stated, samples=64, **options).runs
    assert ((runs.peak.max(axis=1) > 1) & (runs.unrounded.max(axis=1) <= 1)).any()
    monkeypatch.delattr(Task, "sampled")
    with pytest.raises(ValueError, match="rare needs an encoder without an error within"):
        certify(arm, rig, law, path, stated, samples=2, rare=1e-3, **options)


def test_a_stuck_simulation_names_the_highest_level_that_it_reached():
    stuck = Rare(
        asked=1e-6,
        probability=1e-4,
        variation=0.3,
        upper=2e-4,
        below=False,
        stuck=True,
        levels=np.array([0.61, 0.72, 0.83]),
        evaluations=3000,
    )
    assert "beyond 0.83 pulses" in str(stuck)
    assert "not shown to be as rare as 1e-06" in str(stuck)


def test_a_checkpoint_is_of_one_confidence(tmp_path):
    """A failure in every other sample: the first population is all of the simulation."""
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law = ComputedTorque(arm, rig, bandwidth=150)

    def certified(confidence, rare=1e-3):
        return certify(
            arm,
            rig,
            law,
            path,
            STATED,
            samples=2,
            duration=0.005,
            within=0.1,
            steps_per_sample=1,
            progress=False,
            confidence=confidence,
            rare=rare,
            checkpoint=tmp_path / f"{rare}",
        )

    assert certified(0.95).rare == certified(0.95).rare
    with pytest.raises(ValueError, match="must be of the same settings"):
        certified(0.99)
    # The bounds of plain counts are made of the runs, whatever the confidence.
    assert certified(0.95, rare=None).runs == certified(0.99, rare=None).runs
