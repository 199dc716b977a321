"""The identification procedure of 3.2: a robot of known f, measured and found again, with the
paper's settings.

The quick tests look at two seeds; the study of ten, with medians and the order of the spread, is
marked slow (``pytest -m slow``). Bands come from FINDINGS, whose figures are those of another
program on the same problem.
"""

import dataclasses
import sys
from functools import cache

import numpy as np
import pytest

import plant
from identification import GeneticSettings, Objective, identify, spread
from plant import Dynamics, puma560, simulate

NAMES = puma560.dynamics().names
# as in test_objective, so that both share a kernel
UNKNOWN = ("drive.viscous[0]", *reversed(NAMES), "law.gain[1]")
TINY = GeneticSettings(individuals=6, subpopulations=2, generations=3)
RANGES = np.array(puma560.PRINTED_RANGES)


@cache
def measured():
    """The experiment of the paper: P = (0.2, 0.15), trajectory (6), the robot finer than any
    model.
    """
    return simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), steps_per_sample=16
    )


@cache
def short():
    return simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.35
    )


def quick(record=None, **options):
    options = {"settings": TINY, "progress": False, "method": "paper"} | options
    return identify(puma560.dynamics(), record or short(), **options)


@cache
def seeded(seed):
    return quick(seed=seed)


# -- the paper -----------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_paper_settings_reach_what_was_measured_before(seed):
    """FINDINGS: best of generation 0 18,000-32,500, after 40 generations 11,300-16,000, widened for
    single seeds.

    The paper's own run fell from 38,000-45,000 to 23,000-25,000, by a factor of 0.6.
    """
    found = identify(puma560.dynamics(), measured(), seed=seed, method="paper", progress=False)
    assert 18_000 <= found.initial_objective <= 32_500
    assert 7_000 <= found.objective <= 17_000
    assert found.objective <= 0.65 * found.initial_objective
    assert found.evaluations == 80 + 40 * 4 * 19 == 3120  # generation gap 0.94 of 20 is 19
    assert found.message == f"All 40 generations done. Best cost {found.objective:.6g}."
    # What it says is so: the objective of the arm it hands back, replayed on its own.
    assert Objective(puma560.dynamics(), measured())(found.f[None]) == [found.objective]
    assert (np.diff(found.history[:, 0]) <= 0).all()
    assert (found.history[0, 0], found.history[-1, 0]) == (found.initial_objective, found.objective)
    assert (found.f >= RANGES[:, 0]).all()
    assert (found.f <= RANGES[:, 1]).all()


@pytest.mark.slow
def test_ten_seeds():
    """FINDINGS: medians in the ranges, the result at most 0.65 of the start, f9 tightest of all
    (the paper: 3 %).
    """
    series = spread(
        puma560.dynamics(), measured(), published=puma560.PUBLISHED_ALTERATION, progress=False
    )
    first, last = (
        np.array([getattr(run, k) for run in series.runs])
        for k in ("initial_objective", "objective")
    )
    assert 18_000 <= np.median(first) <= 32_500
    assert 7_000 <= np.median(last) <= 17_000
    assert np.median(last) <= 0.65 * np.median(first)
    order = [NAMES[i] for i in series.alteration.argsort()]
    assert order[0] == "f9"
    # f3, f5 and f8 vary by more than their mean, as in the paper's f3 (80 %) and f8 (40 %).
    assert set(order[-3:]) == {"f3", "f5", "f8"}


# -- the result ----------------------------------------------------------------------------------
def test_the_result_says_all():
    found = seeded(4)
    np.testing.assert_array_equal(found.arm.f, found.f)
    np.testing.assert_array_equal(found.fit.values, found.f)
    assert found.arm.dynamics == puma560.dynamics()
    assert (found.rig, found.law) == (short().rig, short().law)
    assert found.fit.unknown == NAMES
    assert (found.search.seed, found.search.settings, found.versions["onepulse"]) == (
        4,
        TINY,
        plant.__version__,
    )
    assert found.initial_population.shape == (12, 9)
    assert found.history.shape == (4, 3)
    assert found.evaluations == 12 + 3 * 2 * 6  # generation gap 0.94 of 6 is 6
    assert found.seconds > 0
    assert "All 3 generations done" in found.message
    costs = Objective(puma560.dynamics(), short())(found.initial_population)
    assert costs.min() == found.initial_objective == found.history[0, 0]
    assert found.history[-1, 0] == found.objective <= found.initial_objective
    text = repr(found)
    assert f"{found.objective:.0f} pulses^2" in text
    assert f"{found.evaluations} evaluations" in text
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.objective = 0.0


def test_the_initial_population_is_drawn_from_the_ranges():
    found = quick(settings=GeneticSettings(individuals=100, subpopulations=2, generations=1))
    low, high = RANGES.T
    share = (found.initial_population - low) / (high - low)
    assert share.min() >= 0
    assert share.max() <= 1
    # Uniform: mean 1/2 with a standard error of 1/sqrt(12 * 200) = 0.02 per unknown; five of them
    # never come.
    np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.1)


def test_same_seed_same_bits_on_any_number_of_threads():
    one, two = (quick(seed=7, threads=threads) for threads in (1, 2))
    for name in ("f", "objective", "initial_objective", "history", "initial_population"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert (seeded(4).f != one.f).any()


def test_friction_and_gain_come_back_in_rig_and_law():
    """found.rig and found.law hold what was found, and everything else is as it was."""
    low_high = [(0.5e-3, 1.2e-3), *reversed(puma560.PRINTED_RANGES), (0.1, 0.2)]
    found = quick(unknown=UNKNOWN, ranges=low_high)
    by_name = dict(zip(UNKNOWN, found.fit.values, strict=True))
    assert [by_name[name] for name in NAMES] == found.f.tolist() == found.arm.f.tolist()
    viscous, gain = by_name["drive.viscous[0]"], by_name["law.gain[1]"]
    assert 0.5e-3 <= viscous <= 1.2e-3
    assert 0.1 <= gain <= 0.2
    given = short().rig
    assert found.rig == dataclasses.replace(
        given, drive=dataclasses.replace(given.drive, viscous=(viscous, given.drive.viscous[1]))
    )
    assert found.law == puma560.p_law((0.20, gain))
    # The same experiment with these, by the plant, costs what the result says.
    again = simulate(found.arm, found.rig, found.law, short().reference, duration=0.35)
    assert np.sum((again.error_pulses - short().error_pulses) ** 2) == found.objective


def test_a_range_of_one_point_is_found_exactly():
    """With the truth as the only candidate the objective is the truth's: zero with equal
    sub-steps.
    """
    found = quick(ranges=np.column_stack([puma560.PUBLISHED, puma560.PUBLISHED]))
    np.testing.assert_array_equal(found.f, puma560.PUBLISHED)
    assert found.objective == 0


def test_several_records():
    other = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(2.5), duration=0.35
    )
    found = identify(
        puma560.dynamics(), [short(), other], settings=TINY, method="paper", progress=False
    )
    assert Objective(puma560.dynamics(), [short(), other])(found.f[None]) == [found.objective]


def test_a_criterion_besides_the_number_of_generations():
    """Fig. 3: the cycle ends when the criterion is met."""
    settings = dataclasses.replace(TINY, target=1e9)
    found = quick(settings=settings)
    assert found.evaluations == 12
    assert "reached the target" in found.message


def test_progress_is_shown_on_request_only(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    quick(progress=False)
    assert capsys.readouterr().err == ""
    quick(progress=True)
    shown = capsys.readouterr().err
    assert "identify" in shown
    assert "pulses^2" in shown


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "papre"}, "'papre'.*'paper'"),
        ({"seeds": 3}, "Did you mean 'seed'"),
        ({"rangs": None}, "Did you mean 'ranges'"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"unknown": (*NAMES, "drive.viscous[0]")}, "ranges must be given"),
        ({"ranges": RANGES.T}, r"shape \(9, 2\); got shape \(2, 9\)"),
        ({"ranges": RANGES[:8]}, r"shape \(9, 2\); got shape \(8, 2\)"),
        ({"ranges": np.where(RANGES == 11.25, np.nan, RANGES)}, "8, 1"),
        ({"ranges": RANGES[:, ::-1]}, "must be \\(low, high\\); that of f1"),
        ({"threads": 0}, "threads"),
        ({"settings": "paper"}, "GeneticSettings"),
        ({"steps_per_sample": 2.5}, "steps_per_sample"),
    ],
)
def test_bad_input_is_refused_in_one_line(options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        quick(**options)
    assert "\n" not in str(refusal.value)


def test_ranges_must_come_from_somewhere():
    with pytest.raises(ValueError, match="ranges must be given for f1, f2"):
        identify(
            dataclasses.replace(puma560.dynamics(), ranges=None),
            short(),
            method="paper",
            progress=False,
        )


def test_no_possible_candidate_is_an_error_and_not_a_result():
    impossible = RANGES.copy()
    impossible[1] = 10.0, 11.0  # D12 far above sqrt(D11 D22)
    with pytest.raises(
        ValueError, match=r"all 48 diverged or had no sound inertia\. Widen"
    ) as refusal:
        quick(ranges=impossible)
    assert "\n" not in str(refusal.value)
    assert "Correct that first" not in str(refusal.value)


def test_a_search_in_vain_says_which_sign_is_wrong():
    down = Dynamics.from_chain(
        dataclasses.replace(puma560.dynamics().chain, gravity=(0.0, 0.0, 9.81))
    )
    impossible = np.tile((-11.0, -10.0), (down.p, 1))
    with pytest.raises(
        ValueError,
        match=r"^gravity acts the other way\. .* Correct that first; .* no sound inertia",
    ):
        identify(down, measured(), ranges=impossible, settings=TINY, progress=False, method="paper")


def test_a_rig_that_no_arm_has_is_told_beside_a_search_in_vain():
    record = short()
    drive = dataclasses.replace(record.rig.drive, motor_inertia=(2.0, 2.0))
    heavy = dataclasses.replace(record, rig=dataclasses.replace(record.rig, drive=drive))
    with pytest.raises(
        ValueError, match=r"^the motor of joint .* motor_inertia is in kg m\^2.* Correct that first"
    ):
        quick(heavy)


@pytest.mark.parametrize(("method", "least"), [("paper", 2), ("seeded", 1)])
def test_candidates_repeat_the_log_as_well_as_the_best_but_for_noise(method, least):
    """Best first, each once, all within five per cent."""
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.7
    )
    found = identify(puma560.dynamics(), record, method=method, progress=False)
    costs = Objective(puma560.dynamics(), record)(found.candidates)
    assert costs.max() <= 1.05 * costs[0]
    assert (np.diff(costs) >= 0).all()
    assert len(np.unique(found.candidates, axis=0)) == len(found.candidates) >= least
    np.testing.assert_array_equal(found.candidates[0], found.fit.values)
