"""The genetic algorithm against hand-worked tables, its textbook's formulas, and its invariants."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import GeneticSettings, minimize_genetic
from identification.search import (
    crossover,
    decode,
    encode,
    migrate,
    mutate,
    rank_linear,
    rank_nonlinear,
    reinsert,
    select,
)

NAN, INF = float("nan"), float("inf")
BOX = [(-2.0, 2.0)] * 4


def sphere(x):
    return np.sum((x - 0.7) ** 2, axis=1)


def rosenbrock(x):
    return np.sum(100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2, axis=1)


def partly_bad(x):
    """A sphere with NaN in a third of the box and infinity in another: the optimum is in
    neither.
    """
    return np.where(x[:, 0] < -0.5, NAN, np.where(x[:, 1] < -0.5, INF, sphere(x)))


def one_subpopulation(**changes):
    return GeneticSettings.paper(subpopulations=1, generations=5, **changes)


# -- coding ----------------------------------------------------------------------------------------
BITS_OF_3 = [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]]


@pytest.mark.parametrize(
    ("coding", "whole"), [("binary", range(8)), ("gray", [0, 1, 3, 2, 7, 6, 4, 5])]
)
def test_decode_table_of_three_bits(coding, whole):
    # By hand: bounds (0, 7) make the value the integer itself; Gray 110 -> parities 1, 0, 0 -> 4.
    np.testing.assert_array_equal(decode(BITS_OF_3, [(0, 7)], 3, coding)[:, 0], list(whole))


def test_decode_scales_each_variable_with_its_own_bits():
    # By hand: 10 of 2 bits is 2/3 of (-1, 2) = 1; 0110 of 4 bits is 6/15 of (10, 20) = 14; 1 of 1
    # bit is the bound.
    x = decode([[1, 0, 0, 1, 1, 0, 1]], [(-1, 2), (10, 20), (5, 6)], (2, 4, 1))
    np.testing.assert_allclose(x, [[1, 14, 6]], rtol=1e-15)  # three roundings of 1 ulp at most


def test_decode_reaches_and_never_leaves_the_bounds():
    bounds = [(-0.1, 0.3), (0.28, 4.07), (-2.7, 11.25), (5, 5)]  # -0.1 + 0.4 rounds above 0.3
    x = decode(np.vstack([np.zeros(212), np.ones(212)]), bounds, 53)
    np.testing.assert_allclose(x.T, bounds, rtol=1e-15)
    assert x[1, 0] <= 0.3
    assert (x[:, 3] == 5).all()


def test_53_bits_are_exact():
    odd = np.zeros((1, 53))
    odd[0, [0, -1]] = 1  # 2^52 + 1
    assert decode(odd, [(0, 2**53 - 1)], 53)[0, 0] == 2**52 + 1


def test_neighbours_in_gray_code_differ_in_one_bit():
    bits = encode(np.arange(64)[:, None], [(0, 63)], 6, "gray")
    np.testing.assert_array_equal(np.abs(np.diff(bits.astype(int), axis=0)).sum(axis=1), 1)


@given(
    st.integers(0, 2**32),
    st.sampled_from(["binary", "gray"]),
    st.lists(st.integers(1, 40), min_size=1, max_size=5),
)
def test_encode_inverts_decode(seed, coding, widths):
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, (7, sum(widths)), dtype=np.uint8)
    lower = rng.uniform(-1, 1, len(widths))
    code = np.column_stack([lower, lower + rng.uniform(0.5, 2, len(widths))]), tuple(widths), coding
    np.testing.assert_array_equal(encode(decode(bits, *code), *code), bits)


@pytest.mark.parametrize("coding", ["binary", "gray"])
def test_encode_is_nearest_and_clips(coding):
    bounds, step = [(-1, 2), (3, 4)], np.array([3, 1]) / (2**6 - 1)
    x = np.random.default_rng(0).uniform([-1, 3], [2, 4], (200, 2))
    error = np.abs(decode(encode(x, bounds, 6, coding), bounds, 6, coding) - x)
    assert (error <= step / 2 * (1 + 1e-12)).all()  # rounding of the decoded value
    np.testing.assert_array_equal(
        decode(encode([(-9, 9)], bounds, 6, coding), bounds, 6, coding), [(-1, 4)]
    )


# -- ranking ---------------------------------------------------------------------------------------
def test_linear_ranking_by_hand():
    # N = 5, pressure 2: 0, 0.5, 1, 1.5, 2 from worst to best; pressure 1.5: 0.5, 0.75, 1, 1.25,
    # 1.5.
    np.testing.assert_allclose(
        rank_linear([30.0, 10, 50, 20, 40], 2.0), [1, 2, 0, 1.5, 0.5], rtol=1e-15
    )
    np.testing.assert_allclose(
        rank_linear([30.0, 10, 50, 20, 40], 1.5), [1, 1.5, 0.5, 1.25, 0.75], rtol=1e-15
    )


def test_equal_costs_share_and_nan_is_worse_than_infinity():
    # Positions worst first: NaN 0, NaN 0.4, inf 0.8, (7, 7) 1.2 and 1.6, best 2; each tie gets its
    # mean.
    fitness = rank_linear([7, NAN, INF, 7, -1, NAN], 2.0)
    np.testing.assert_allclose(fitness, [1.4, 0.2, 0.8, 1.4, 2, 0.2], rtol=1e-14)


def test_nonlinear_ranking_by_hand():
    # N = 3, pressure 1.5: -1.5 X^2 + 1.5 X + 1.5 = 0, so X is the golden ratio g, and F = 1.5
    # (g^-2, g^-1, 1).
    g = (1 + 5**0.5) / 2
    np.testing.assert_allclose(
        rank_nonlinear([2.0, 3, 1], 1.5), [1.5 / g, 1.5 / g**2, 1.5], rtol=1e-14
    )


@pytest.mark.parametrize(
    ("n", "pressure"), [(2, 1), (3, 2), (20, 1), (20, 2), (20, 5.5), (20, 19), (100, 2)]
)
def test_nonlinear_ranking_sums_to_n_in_a_constant_ratio_up_to_the_pressure(n, pressure):
    fitness = rank_nonlinear(np.arange(n, dtype=float), pressure)
    assert fitness.max() == pytest.approx(pressure, rel=1e-12)
    assert fitness.sum() == pytest.approx(n, rel=1e-10)  # np.roots of degree 99 leaves some 1e-13
    np.testing.assert_allclose(fitness[1:] / fitness[:-1], fitness[1] / fitness[0], rtol=1e-9)
    ties = rank_nonlinear(np.zeros(n), pressure)
    np.testing.assert_allclose(ties, 1, rtol=1e-10)


@given(st.lists(st.sampled_from([NAN, INF, -3.0, 0.0, 1.0, 2.5, 7.0]), min_size=4, max_size=30))
def test_fitness_sums_to_n_and_follows_the_costs(costs):
    for fitness in (rank_linear(costs, 1.8), rank_nonlinear(costs, 2.5)):
        assert fitness.sum() == pytest.approx(len(costs), rel=1e-10)
        order = np.argsort(costs, kind="stable")  # NaN last
        assert (np.diff(fitness[order]) <= 1e-15).all()


# -- selection -------------------------------------------------------------------------------------
@given(
    st.lists(st.floats(0, 5), min_size=1, max_size=25), st.integers(1, 40), st.integers(0, 2**32)
)
def test_each_gets_floor_or_ceil_of_its_expected_copies(fitness, number, seed):
    fitness = np.round(fitness, 3)
    if fitness.sum() == 0:
        fitness[0] = 1
    expected = number * fitness / fitness.sum()
    copies = np.bincount(
        select(fitness, number, np.random.default_rng(seed)), minlength=len(fitness)
    )
    assert copies.sum() == number
    # an expectation that is whole but for rounding
    assert (copies >= np.floor(expected - 1e-9)).all()
    assert (copies <= np.ceil(expected + 1e-9)).all()
    assert (copies[fitness == 0] == 0).all()


class Scripted:
    """A generator whose `random` is given and whose `permutation` changes nothing."""

    def __init__(self, value):
        self.random = lambda: value
        self.permutation = np.asarray


@pytest.mark.parametrize("offset", [0.0, 1 - 2**-53])
def test_the_ends_of_the_wheel_never_point_to_zero_fitness(offset):
    # 18 + (1 - 2^-53) rounds to 19: the last pointer would be the total itself, past everybody.
    chosen = select([0, 1, 2, 0.5, 0], 19, Scripted(offset))
    assert chosen.min() >= 1
    assert chosen.max() <= 3


def test_selection_is_unbiased_and_shuffled():
    rng, fitness = np.random.default_rng(5), rank_linear(np.arange(8.0), 2.0)
    draws = np.array([select(fitness, 5, rng) for _ in range(4000)])
    share = np.bincount(draws.ravel(), minlength=8) / draws.size
    # 5 sigma of 20,000 draws at share 0.25 are 0.015
    np.testing.assert_allclose(share, fitness / 8, atol=0.01)
    # each place the same: 5 sigma 0.13
    np.testing.assert_allclose(draws.mean(axis=0), draws.mean(), atol=0.15)


# -- recombination and mutation --------------------------------------------------------------------
@given(st.integers(0, 12), st.integers(1, 20), st.floats(0, 1), st.integers(0, 2**32))
def test_crossover_keeps_the_columns_of_each_pair(rows, length, probability, seed):
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, (rows, length), dtype=np.uint8)
    before = bits.copy()
    children = crossover(bits, probability, rng)
    np.testing.assert_array_equal(bits, before)
    even = rows // 2 * 2
    np.testing.assert_array_equal(
        children[:even:2] + children[1:even:2], bits[:even:2] + bits[1:even:2]
    )
    np.testing.assert_array_equal(children[even:], bits[even:])  # an odd last row


def test_crossover_cuts_once_everywhere_and_as_often_as_told():
    rng, length, pairs = np.random.default_rng(2), 6, 30_000
    bits = np.tile(np.array([[0], [1]], dtype=np.uint8), (pairs, length))
    first = crossover(bits, 0.6, rng)[::2]
    assert (first[:, 0] == 0).all()  # heads stay
    assert (np.diff(first.astype(int), axis=1) >= 0).all()  # zeros, then ones: one cut
    # how many bits came from the partner
    share = np.bincount(first.sum(axis=1), minlength=length + 1) / pairs
    # 5 sigma: 0.014
    np.testing.assert_allclose(share, [0.4, 0.12, 0.12, 0.12, 0.12, 0.12, 0], atol=0.015)


def test_mutation_rate():
    rng, bits = np.random.default_rng(3), np.tile(np.array([0, 1], dtype=np.uint8), (1000, 100))
    flipped = mutate(bits, 0.05, rng) != bits
    assert flipped.mean() == pytest.approx(0.05, abs=0.0025)  # 5 sigma of 200,000 bits: 0.0024
    # both ways alike
    assert flipped[:, ::2].mean() == pytest.approx(flipped[:, 1::2].mean(), abs=0.005)
    np.testing.assert_array_equal(mutate(bits, 0.0, rng), bits)
    np.testing.assert_array_equal(mutate(bits, 1.0, rng), 1 - bits)


def test_mutation_is_by_default_07_per_chromosome():
    # Without selection pressure and crossover, 64-bit offspring differ from the nearest parent by
    # 0.7 bits on average.
    states = []
    changes = {
        "pressure": 1.0,
        "crossover_probability": 0,
        "generations": 1,
        "individuals": 400,
        "generation_gap": 0.5,
    }
    minimize_genetic(sphere, BOX, GeneticSettings.paper(**changes), callback=states.append)
    new, old = (
        states[0].chromosomes[:400].astype(int),
        first_chromosomes(400 * 4, 64)[:400].astype(int),
    )
    distance = np.abs(new[:, None] - old).sum(axis=2).min(axis=1)
    assert distance.sum() / 200 == pytest.approx(0.7, abs=0.3)  # 200 offspring: 5 sigma 0.3


def first_chromosomes(size, length):
    """The first draw of a run with seed 0, without points of the caller."""
    return np.random.default_rng(0).integers(0, 2, (size, length), dtype=np.uint8)


# -- reinsertion -----------------------------------------------------------------------------------
def rows(*names):
    """Chromosomes that carry their own number."""
    return np.array(names)[:, None]


def test_offspring_overwrite_the_worst_parents_uncompared():
    parents, costs = rows(0, 1, 2, 3, 4), np.array([5.0, NAN, 1.0, INF, 7.0])
    new, new_costs = reinsert(parents, costs, rows(10, 11, 12), np.array([NAN, 99.0, 98.0]))
    assert sorted(new[:, 0]) == [0, 2, 10, 11, 12]  # NaN, infinity and 7 are gone, though 7 < 98
    assert dict(zip(new[:, 0].tolist(), new_costs.tolist(), strict=True))[11] == 99
    np.testing.assert_array_equal(parents, rows(0, 1, 2, 3, 4))
    # NaN goes first
    assert sorted(reinsert(parents, costs, rows(10), np.array([0.0]))[0][:, 0]) == [0, 2, 3, 4, 10]


def test_all_parents_are_overwritten_only_if_not_safe():
    arguments = (
        rows(0, 1, 2),
        np.array([3.0, 1.0, 2.0]),
        rows(10, 11, 12),
        np.array([9.0, NAN, 8.0]),
    )
    safe, costs = reinsert(*arguments)
    # the best parent stays, the worst offspring is left out
    assert sorted(safe[:, 0]) == [1, 10, 12]
    assert sorted(costs) == [1, 8, 9]
    assert sorted(reinsert(*arguments, safe=False)[0][:, 0]) == [10, 11, 12]


# -- migration -------------------------------------------------------------------------------------
def test_migration_in_a_complete_net():
    # Three sub-populations of 5; the individuals are numbered, and their cost decides who may
    # travel.
    costs = np.array([5.0, 1, 4, 2, 3, 20, 60, NAN, 30, 10, 300, 100, 200, INF, 400])
    chromosomes, best = np.arange(15)[:, None], ({1, 3}, {9, 5}, {11, 12})
    arrivals = set()
    for seed in range(200):
        moved, moved_costs = migrate(chromosomes, costs, 3, 0.4, np.random.default_rng(seed))
        # costs travel with their chromosomes
        np.testing.assert_array_equal(moved_costs, costs[moved[:, 0]])
        for own, worst in enumerate(({0, 2}, {7, 6}, {13, 14})):
            group = set(range(5 * own, 5 * own + 5))
            present = set(moved[5 * own : 5 * own + 5, 0].tolist())
            assert present & group == group - worst
            new = present - group
            assert len(new) == 2  # without replacement
            assert new <= set().union(*(best[other] for other in range(3) if other != own))
            arrivals |= {(own, each) for each in new}
    assert len(arrivals) == 12  # from each of the others, each of its best came at some time
    np.testing.assert_array_equal(chromosomes[:, 0], np.arange(15))


def test_migrants_overwrite_the_first_rows_only_if_not_safe():
    costs = np.array([1.0, 2, 3, 10, 20, 30])  # sorted: the first rows are the best
    moved = migrate(np.arange(6)[:, None], costs, 2, 0.34, np.random.default_rng(0), safe=False)[0][
        :, 0
    ]
    np.testing.assert_array_equal(moved, [3, 1, 2, 0, 4, 5])
    moved = migrate(np.arange(6)[:, None], costs, 2, 1.0, np.random.default_rng(0), safe=False)[0][
        :, 0
    ]
    assert (set(moved[:3].tolist()), set(moved[3:].tolist())) == ({3, 4, 5}, {0, 1, 2})


@pytest.mark.parametrize(
    ("n", "rate", "number"),
    [(10, 0.3, 3), (10, 0.39, 3), (100, 0.29, 29), (10, 0.01, 1), (10, 1, 9), (10, 0, 0)],
)
def test_number_of_migrants(n, rate, number):
    # 100 * 0.29 is 28.999999999999996; rate 1 leaves the best where it is.
    moved = migrate(
        np.arange(2 * n)[:, None], np.arange(2.0 * n), 2, rate, np.random.default_rng(0)
    )[0][:, 0]
    assert np.count_nonzero(moved[:n] >= n) == np.count_nonzero(moved[n:] < n) == number
    assert moved[0] == 0


def test_one_subpopulation_has_no_migrants():
    moved, costs = migrate(rows(0, 1, 2), np.arange(3.0), 1, 0.3, np.random.default_rng(0))
    np.testing.assert_array_equal(moved, rows(0, 1, 2))
    np.testing.assert_array_equal(costs, np.arange(3))


# -- the run ---------------------------------------------------------------------------------------
def test_the_settings_of_the_paper():
    paper = dataclasses.asdict(GeneticSettings.paper())
    printed = {
        "individuals": 20,
        "pressure": 2.0,
        "crossover_probability": 0.6,
        "subpopulations": 4,
    }
    printed |= {"migration_rate": 0.3, "generation_gap": 0.94, "generations": 40}
    fixed_here = {
        "ranking": "linear",
        "coding": "binary",
        "bits_per_variable": 16,
        "mutation_probability": None,
    }
    fixed_here |= {"migration_interval": 20, "safe": True, "target": None}
    assert paper == printed | fixed_here
    assert GeneticSettings() == GeneticSettings.paper()
    assert GeneticSettings.paper(individuals=30).individuals == 30


def test_a_run_of_the_paper_is_3120_evaluations_in_41_calls():
    calls = []
    found = minimize_genetic(lambda x: calls.append(x.shape) or sphere(x), BOX, seed=1)
    assert calls == [(80, 4)] + 40 * [(76, 4)]
    assert found.evaluations == 3120
    assert found.history.shape == (41, 3)
    assert found.message.startswith("All 40 generations done. Best cost ")


@pytest.mark.parametrize(
    ("n", "gap", "offspring"), [(20, 0.94, 19), (25, 0.5, 13), (20, 1, 20), (20, 0, 2), (2, 0.5, 2)]
)
def test_offspring_per_subpopulation(n, gap, offspring):
    assert GeneticSettings.paper(individuals=n, generation_gap=gap).offspring == offspring


def test_the_result_agrees_with_itself_and_with_what_was_evaluated():
    seen = {}

    def objective(x):
        costs = partly_bad(x)
        seen.update(zip(map(tuple, x.tolist()), costs.tolist(), strict=True))
        return costs

    found = minimize_genetic(objective, BOX, seed=3)
    assert seen[tuple(found.x.tolist())] == found.cost == np.nanmin(list(seen.values()))
    for population, costs in (
        (found.initial_population, found.initial_costs),
        (found.final_population, found.final_costs),
    ):
        assert population.shape == (80, 4)
        np.testing.assert_array_equal([seen[tuple(x)] for x in population.tolist()], costs)
        assert (np.abs(population) <= 2).all()
    assert found.initial_cost == np.nanmin(found.initial_costs) == found.history[0, 0]
    best_at_once = minimize_genetic(sphere, BOX, GeneticSettings.paper(target=99))
    assert not np.shares_memory(best_at_once.x, best_at_once.initial_population)
    for row, costs in ((0, found.initial_costs), (-1, found.final_costs)):
        finite = costs[np.isfinite(costs)]
        np.testing.assert_allclose(
            found.history[row], [finite.min(), finite.mean(), finite.max()], rtol=1e-15
        )
    assert (found.seed, found.settings) == (3, GeneticSettings.paper())


HARSH = {
    "generation_gap": 1,
    "migration_rate": 1,
    "migration_interval": 1,
    "mutation_probability": 0.3,
}


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 7), st.integers(1, 4), st.booleans())
def test_safe_mode_never_loses_the_best(seed, individuals, subpopulations, harsh):
    changes = {"individuals": individuals, "subpopulations": subpopulations, "generations": 15}
    states = []
    changes |= HARSH if harsh else {"migration_interval": 2}
    found = minimize_genetic(
        partly_bad, BOX, GeneticSettings.paper(**changes), seed, callback=states.append
    )
    assert (np.diff(found.history[:, 0][np.isfinite(found.history[:, 0])]) <= 0).all()
    if np.isfinite(found.cost):
        assert found.cost == found.history[-1, 0] == np.nanmin(found.final_costs)
    for old, new in itertools.pairwise(states):  # nor does a sub-population, against itself
        best = [
            np.fmin.reduce(s.costs.reshape(subpopulations, -1), axis=1, initial=INF)
            for s in (old, new)
        ]
        assert (best[1] <= best[0]).all()


def test_the_original_mode_may_lose_the_best_but_the_result_does_not():
    found = minimize_genetic(sphere, BOX, GeneticSettings.paper(safe=False, **HARSH), seed=1)
    assert (np.diff(found.history[:, 0]) > 0).any()
    # migrants may overwrite a newborn best
    assert found.cost <= found.history[:, 0].min() < found.history[-1, 0]


def test_nan_never_survives_over_finite_parents():
    def bad_at_first(x):
        return np.where(np.arange(len(x)) % 2, NAN, sphere(x)) if len(x) == 80 else sphere(x)

    found = minimize_genetic(
        bad_at_first, BOX, GeneticSettings.paper(generation_gap=0.5, generations=1)
    )
    assert np.isnan(found.initial_costs).sum() == 40
    assert np.isfinite(found.final_costs).all()  # the 10 NaN of each sub-population were its worst


@pytest.mark.parametrize("safe", [True, False])
@pytest.mark.parametrize("bad", [INF, NAN])
def test_no_finite_candidate(bad, safe):
    chosen = GeneticSettings.paper(generations=3, safe=safe, migration_interval=1)
    found = minimize_genetic(lambda x: np.full(len(x), bad), BOX, chosen)
    assert found.message == "All 3 generations done. No candidate had a finite cost."
    assert found.x in found.initial_population
    assert not np.isfinite(found.cost)
    assert (found.history == INF).all()


def test_a_hopeless_start_recovers():
    found = minimize_genetic(lambda x: sphere(x) if len(x) == 76 else np.full(len(x), NAN), BOX)
    assert np.isnan(found.initial_cost)
    assert found.cost < 0.1


def identical(a, b):
    for name in (
        "x",
        "cost",
        "initial_population",
        "final_population",
        "final_costs",
        "history",
        "message",
    ):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    return True


def test_each_setting_of_an_operator_reaches_it():
    plain = minimize_genetic(sphere, BOX, one_subpopulation())
    for name, value in {
        "ranking": "nonlinear",
        "pressure": 1.5,
        "coding": "gray",
        "mutation_probability": 0.1,
    }.items():
        assert not np.array_equal(
            plain.x, minimize_genetic(sphere, BOX, one_subpopulation(**{name: value})).x
        ), name


def test_same_seed_same_bits_whatever_the_order_of_evaluation():
    def backwards(x):
        np.random.default_rng().random(5)
        return np.array([partly_bad(row[None])[0] for row in x[::-1]])[::-1]

    found = minimize_genetic(partly_bad, BOX, seed=7)
    assert identical(found, minimize_genetic(partly_bad, BOX, seed=np.int64(7)))
    assert identical(found, minimize_genetic(backwards, BOX, seed=7))
    assert not np.array_equal(found.x, minimize_genetic(partly_bad, BOX, seed=8).x)


def test_an_objective_that_overwrites_its_arrays_changes_nothing():
    buffer = np.empty(80)

    def vandal(x):
        costs = buffer[: len(x)]  # the same memory each time
        costs[:] = sphere(x)
        x[:] = NAN
        return costs

    assert identical(minimize_genetic(vandal, BOX), minimize_genetic(sphere, BOX))


def test_initial_points_are_the_first_rows():
    points = np.array([(0.5, -0.5, 1, -1), (3, 0, 0, 0), (0.7, 0.7, 0.7, 0.7)])
    with_points, without = (
        minimize_genetic(sphere, BOX, one_subpopulation(), initial=i) for i in (points, None)
    )
    half_step = 4 / (2**16 - 1) / 2
    np.testing.assert_allclose(
        with_points.initial_population[:3], np.minimum(points, 2), atol=half_step * (1 + 1e-9)
    )
    np.testing.assert_array_equal(
        with_points.initial_population[3:], without.initial_population[3:]
    )
    assert with_points.cost <= 4 * half_step**2


@pytest.mark.filterwarnings("error")
def test_equal_bounds_fix_a_variable():
    np.testing.assert_array_equal(
        encode([(1, 0.25), (0, 9)], [(0, 1), (0.25, 0.25)], 2), [(1, 1, 0, 0), (0, 0, 0, 0)]
    )
    found = minimize_genetic(sphere, [(-2, 2), (0.25, 0.25), (-2, 2)], seed=1)
    assert (found.final_population[:, 1] == 0.25).all()
    assert found.cost == pytest.approx(0.45**2, abs=0.02)


# -- convergence -----------------------------------------------------------------------------------
@pytest.mark.parametrize(("objective", "factor"), [(sphere, 10), (rosenbrock, 3)])
@pytest.mark.parametrize(
    "changes", [{}, {"coding": "gray"}, {"ranking": "nonlinear", "pressure": 3}, {"safe": False}]
)
def test_clearly_better_than_random_search_of_the_same_budget(objective, factor, changes):
    box, found, blind = [(-2.0, 2.0)] * 6, [], []
    for seed in range(5):
        found.append(minimize_genetic(objective, box, GeneticSettings.paper(**changes), seed).cost)
        blind.append(objective(np.random.default_rng(seed).uniform(-2, 2, (3120, 6))).min())
    assert np.median(found) < np.median(blind) / factor  # measured: 24 to 129, and 9.6 to 17


# -- stopping --------------------------------------------------------------------------------------
def test_stops_at_the_target():
    found = minimize_genetic(sphere, BOX, GeneticSettings.paper(target=0.05))
    done = len(found.history) - 1
    assert found.cost <= 0.05 < found.history[-2, 0]
    assert found.message.startswith(
        f"Stopped in generation {done}: the best cost reached the target 0.05. Best cost"
    )
    assert len(minimize_genetic(sphere, BOX, GeneticSettings.paper(target=99)).history) == 1


def test_callback_sees_each_generation_and_stops():
    states = []
    minimize_genetic(sphere, BOX, one_subpopulation(), callback=states.append)
    assert [s.generation for s in states] == [1, 2, 3, 4, 5]
    assert [s.evaluations for s in states] == [20 + 19 * k for k in range(1, 6)]
    assert [len(s.history) for s in states] == [2, 3, 4, 5, 6]
    assert not np.array_equal(states[0].chromosomes, states[1].chromosomes)  # each state is its own
    for s in states:
        np.testing.assert_array_equal(sphere(decode(s.chromosomes, BOX, 16)), s.costs)
        assert sphere(s.best_x[None])[0] == s.best_cost == np.nanmin(s.history[:, 0])
    found = minimize_genetic(sphere, BOX, callback=lambda s: s.generation == 3)
    assert len(found.history) == 4
    assert found.message.startswith("Stopped in generation 3 by the callback. Best cost")


def test_the_order_of_a_generation_migrates_at_its_interval():
    # With rate 1 and without safety a migration exchanges the two sub-populations whole.
    changes = {
        "subpopulations": 2,
        "safe": False,
        "migration_rate": 1,
        "migration_interval": 3,
        "generations": 6,
    }
    states = []
    minimize_genetic(
        lambda x: np.arange(float(len(x))),
        BOX,
        GeneticSettings.paper(**changes),
        callback=states.append,
    )
    swapped = [bool(s.costs[:20].mean() > s.costs[20:].mean()) for s in states]
    assert swapped == [False, False, True, False, False, True]


# -- bad input -------------------------------------------------------------------------------------
BAD_SETTINGS = [
    {"individuals": 1},
    {"individuals": 20.0},
    {"generations": True},
    {"subpopulations": 0},
    {"generations": 0},
    {"generations": None},
    {"bits_per_variable": 0},
    {"bits_per_variable": 54},
    {"bits_per_variable": 8.0},
    {"bits_per_variable": "16"},
    {"bits_per_variable": ()},
    {"bits_per_variable": (8, 0)},
    {"coding": "grey"},
    {"ranking": "raw"},
    {"pressure": 2.1},
    {"pressure": 0.9},
    {"pressure": NAN},
    {"pressure": 20, "ranking": "nonlinear"},
    {"crossover_probability": 1.1},
    {"crossover_probability": None},
    {"mutation_probability": -0.1},
    {"generation_gap": 1.01},
    {"generation_gap": NAN},
    {"migration_rate": -0.1},
    {"migration_rate": "a third"},
    {"migration_interval": 0},
    {"safe": 1},
    {"target": NAN},
]


def refused(function, name):
    """The call raises a ValueError of one line in three parts that names `name`."""
    with pytest.raises(ValueError, match=f"^{re.escape(name)} must ") as caught:
        function()
    message = str(caught.value)
    assert "\n" not in message
    assert re.fullmatch(r".+ must .+; (got|it raised) .+\. .+\.", message), message
    return message


@pytest.mark.parametrize("changes", BAD_SETTINGS, ids=str)
def test_bad_settings(changes):
    message = refused(lambda: GeneticSettings.paper(**changes), next(iter(changes)))
    value = next(iter(changes.values()))
    assert "got 0." in message if isinstance(value, tuple) else f"got {value!r}." in message


def test_settings_are_frozen_and_lists_become_tuples():
    chosen = GeneticSettings.paper(bits_per_variable=[3, 4])
    assert chosen.bits_per_variable == (3, 4)
    assert hash(chosen) == hash(GeneticSettings.paper(bits_per_variable=np.array([3, 4])))
    with pytest.raises(dataclasses.FrozenInstanceError):
        chosen.generations = 3


BAD_BOUNDS = [
    [(0, NAN)],
    [(0, 1), (2, 1)],
    [(0, INF)],
    [(-1.7e308, 1.7e308)],
    [0, 1],
    [(0, 1, 2)],
    [],
    [("a", "b")],
    [(0, 1), (0,)],
    None,
]


@pytest.mark.parametrize("bounds", BAD_BOUNDS, ids=str)
def test_bad_bounds(bounds):
    refused(lambda: minimize_genetic(sphere, bounds), "bounds")
    refused(lambda: decode(np.zeros((1, 16)), bounds, 16), "bounds")
    refused(lambda: encode(np.zeros((1, 1)), bounds, 16), "bounds")


def test_other_bad_arguments():
    refused(lambda: minimize_genetic(sphere, BOX, {"individuals": 3}), "settings")
    refused(
        lambda: minimize_genetic(sphere, BOX, GeneticSettings.paper(bits_per_variable=(8, 8))),
        "bits_per_variable",
    )
    for seed in (-1, 1.5, None, "0"):
        refused(lambda seed=seed: minimize_genetic(sphere, BOX, seed=seed), "seed")
    refused(lambda: minimize_genetic(sphere, BOX, initial=np.zeros((81, 4))), "initial")
    for points in (np.zeros(4), np.zeros((2, 3)), np.full((1, 4), NAN), "middle"):
        refused(lambda points=points: minimize_genetic(sphere, BOX, initial=points), "initial")
        refused(lambda points=points: encode(points, BOX, 6), "points")
    for bits in (np.zeros((2, 5)), np.zeros(6), 3):
        refused(lambda bits=bits: decode(bits, [(0, 1)], 6), "bits")
    refused(lambda: decode(np.zeros((2, 6)), [(0, 1)], 6, "grey"), "coding")
    refused(lambda: encode(np.zeros((2, 1)), [(0, 1)], 6, "grey"), "coding")
    refused(lambda: minimize_genetic(sphere, np.empty((0, 2))), "bits_per_variable")


@pytest.mark.parametrize(
    ("objective", "named"),
    [
        (lambda x: sphere(x)[:-1], "(79,)"),
        (lambda x: sphere(x)[:, None], "(80, 1)"),
        (lambda x: 3.0, "()"),
        (lambda x: sphere(x) + 0j, "complex128"),
        (lambda x: [None] * len(x), "object"),
        (lambda x: ["a"] * len(x), "<U1"),
        (lambda x: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda x: np.linalg.solve(x, x), "LinAlgError"),
        (lambda x: (_ for _ in ()).throw(RuntimeError("two\nlines")), "RuntimeError: two lines"),
        (None, "TypeError"),
    ],
)
def test_bad_objectives(objective, named):
    assert named in refused(lambda: minimize_genetic(objective, BOX), "objective")


def test_an_interrupt_is_not_swallowed():
    def interrupted(x):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimize_genetic(interrupted, BOX)
