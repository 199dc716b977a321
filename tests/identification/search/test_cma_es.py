"""CMA-ES: functions whose minimum is known, the same interface as the genetic algorithm, its refusals."""

import sys

import numpy as np
import pytest

from identification import GeneticSettings, identify
from identification.search.cma_es import minimize_cma
from plant import puma560, simulate

PAPER = GeneticSettings.paper()
TARGET = np.array([0.3, -2.0, 5.0, 1.0])
BOX = np.array([[-1.0, 1.0], [-3.0, 0.0], [4.0, 6.0], [1.0, 1.0]])


def valley(x):
    """A quadratic of condition 1e4, its axes turned, least at TARGET."""
    moved = x - TARGET
    return (moved**2).sum(axis=1) + 1e4 * (moved[:, 0] - moved[:, 1] + moved[:, 2]) ** 2


def test_the_minimum_of_a_turned_quadratic():
    found = minimize_cma(valley, BOX, PAPER, 1)
    np.testing.assert_allclose(found.x, TARGET, atol=1e-4)
    assert found.cost == valley(found.x[None])[0]
    assert found.evaluations <= 3120
    assert (np.diff(found.history[:, 0]) <= 0).all()


def test_the_same_seed_gives_the_same_bits_and_leaves_numpys_own_generator():
    np.random.seed(5)  # noqa: NPY002 - it is the one that must not change
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one, two, other = (minimize_cma(valley, BOX, PAPER, seed) for seed in (1, 1, 2))
    assert (one.x == two.x).all()
    assert (one.history == two.history).all()
    assert (one.x != other.x).any()
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_bad_candidates_are_the_worst_and_the_box_holds():
    seen = []

    def half(x):
        seen.append(x)
        return np.where(x[:, 0] > 0.5, np.inf, valley(x))

    found = minimize_cma(half, BOX, PAPER, 1)
    np.testing.assert_allclose(found.x, TARGET, atol=1e-3)
    tried = np.vstack(seen)
    assert ((tried >= BOX[:, 0]) & (tried <= BOX[:, 1])).all()


def test_a_target_ends_it_and_the_callback_counts_generations_of_the_genetic_algorithm():
    shown = []
    found = minimize_cma(valley, BOX, PAPER, 1, shown.append)
    assert len(shown) == (found.evaluations - 80) // 76
    assert shown == sorted(shown, reverse=True)
    assert minimize_cma(valley, BOX, GeneticSettings(target=1.0), 1).evaluations < 3120


def test_identify_takes_it():
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    found = identify(puma560.dynamics(), record, method="cma", seed=3, progress=False)
    ranges = np.array(puma560.PRINTED_RANGES)
    assert ((found.f >= ranges[:, 0]) & (found.f <= ranges[:, 1])).all()
    assert found.objective < found.initial_objective
    assert 2000 < found.search.evaluations <= 3120


def test_one_unknown_and_a_missing_package_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="two unknowns or more; got 1"):
        minimize_cma(valley, np.array([[0, 1], [2, 2]]), PAPER, 1)
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(ValueError, match=r'pip install "onepulse\[cma\]"'):
        minimize_cma(valley, BOX, PAPER, 1)
