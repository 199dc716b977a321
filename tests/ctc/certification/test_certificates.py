"""A set of motions: its rows are the single calls, its samples one set, its sums what the rows
add up to.
"""

import dataclasses
import importlib

import numpy as np
import pytest
from uncertain import with_uncertainty

from ctc import (
    Certificate,
    ComputedTorque,
    ComputedTorquePID,
    Evaluation,
    Uncertainty,
    certify,
    compare,
    evaluate,
    tune,
)  # fmt: skip
from ctc.certification import Certificates, clopper_pearson, percent
from ctc.tuning import SearchSettings, families
from ctc.verdict import LowestResonance
from plant import PD, PointToPoint, puma560, simulate
from plant.simulation import Runs

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
CERTIFY = importlib.import_module("ctc.certification.certify")
TUNE = importlib.import_module("ctc.tuning.tune")
LAW = ComputedTorquePID(
    ARM, RIG, bandwidth=150.0, ratio=1.5, integral=40.0, roll_off=1000.0, roll_off_damping=0.8
)
START = PATH([0.0]).q[0]
PATHS = {
    "still": PointToPoint(start=START, goal=START, duration=0.05),
    "move": PointToPoint(start=START, goal=np.add(START, (0.02, -0.03)), duration=0.2),
    "mine": PATH,
}
COVARIANCE = np.diag((0.02 * puma560.PUBLISHED) ** 2)
USUAL = {
    "covariance": COVARIANCE,
    "samples": 70,
    "steps_per_sample": 4,
    "friction": 0.3,
    "duration": 0.05,
    "seed": 3,
}


def certified(path=PATHS, **options):
    return certify(ARM, RIG, LAW, path, **with_uncertainty(**USUAL | options, progress=False))


@pytest.fixture(scope="module")
def several():
    return certified(threads=2)


def test_rows_are_the_single_calls_to_the_bit(several):
    assert list(several) == list(PATHS)
    for name, path in PATHS.items():
        alone = certified(path)
        assert isinstance(alone, Certificate)
        assert several[name].runs == alone.runs
        assert several[name] == alone
        assert several[name].plants is several.plants


def test_the_samples_are_one_set(monkeypatch):
    drawn, draw = [], CERTIFY.draw
    monkeypatch.setattr(CERTIFY, "draw", lambda *some: drawn.append(some) or draw(*some))
    certified()
    assert len(drawn) == 1


def test_a_sample_fails_that_fails_in_any_motion(several):
    outside = np.array([each.runs.outside for each in several.values()])
    assert several.failures == (outside > 0).any(axis=0).sum()
    assert 70 > several.failures > max(each.failures for each in several.values())
    assert several.upper == clopper_pearson(several.failures, 70, 0.9)[1]
    assert several.probability == several.failures / 70
    samples = np.array([each.runs.samples for each in several.values()])
    chatter = np.array([each.runs.chatter for each in several.values()])
    np.testing.assert_allclose(
        several.runs.chatter, np.tensordot(samples / samples.sum(), chatter, 1)
    )
    np.testing.assert_array_equal(
        several.runs.peak, np.max([each.runs.peak for each in several.values()], axis=0)
    )
    assert several.worst == max(
        PATHS, key=lambda name: several[name].runs.outside.astype(bool).sum()
    )
    assert several.holds == (several.failures == 0)


def test_joined_runs_are_one_long_run():
    runs = certified(PATHS["move"]).runs
    assert Runs.joined([runs]) == runs
    twice = Runs.joined([runs, runs])
    assert twice.samples == 2 * runs.samples
    np.testing.assert_array_equal(twice.outside, 2 * runs.outside)
    np.testing.assert_array_equal(twice.first, runs.first)
    np.testing.assert_allclose(twice.chatter, runs.chatter, rtol=1e-15)
    wild = dataclasses.replace(
        runs, chatter=np.full_like(runs.chatter, np.inf), first=np.full(70, 0.01)
    )
    assert np.isinf(Runs.joined([runs, wild]).chatter).all()
    np.testing.assert_array_equal(Runs.joined([runs, wild]).first, np.fmin(runs.first, 0.01))


def test_what_is_left_out_is_counted_by_simulations_one_by_one():
    certificate = certified(PATHS["move"], after=0.02, samples=30)
    before, after = np.zeros(30, bool), np.zeros(30, bool)
    for i in range(30):
        plant = certificate.plant(i)
        record = simulate(plant.arm, plant.rig, LAW, PATHS["move"], duration=0.05)
        exceeds, late = (np.abs(record.error_pulses) > 1).any(axis=1), record.t >= 0.02 - 1e-9
        before[i], after[i] = exceeds[~late].any(), exceeds[late].any()
    assert 0 < before.sum() < 30
    assert 0 < after.sum() < (before | after).sum()
    assert (certificate.failures_before, certificate.failures) == (before.sum(), after.sum())
    assert certificate.failures_with_start == (before | after).sum()
    text = " ".join(str(certificate).split())
    assert "In the first 0.02 s, which do not count," in text
    shares = percent(before.mean()), percent((before | after).mean())
    assert "{} exceed it; then or later, {}.".format(*shares) in text
    assert f"samples that exceed it before 0.02 s {before.sum()} of 30" in text
    assert f"samples that exceed it at any time {(before | after).sum()} of 30" in text
    several = certified({name: PATHS[name] for name in ("move", "mine")}, after=0.02, samples=30)
    row = next(line for line in str(several).splitlines() if line.startswith("move"))
    assert row.split()[-2:] == [f"{before.sum()}", f"{(before | after).sum()}"]


def hardest(several):
    return max(several, key=lambda name: several[name].lowest_resonance)


def test_what_is_printed(several):
    text = str(several)
    assert several.verdict in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80
    for name, each in several.items():
        row = next(line for line in text.splitlines() if line.startswith(name)).split()
        assert row[1] == str(each.failures)
        assert float(row[-2]) == each.runs.peak.max(), row
    assert "everyday_motions(arm, rig) gives others" not in text
    assert "for this path alone: everyday_motions(arm, rig) gives others" in str(several["move"])
    words = " ".join(text.split())
    assert f"in all motions, {several[hardest(several)].on_gears}" in words
    assert f"{several.lowest_resonance:.3g} Hz" in words
    assert f"{several.failures} of 70" in repr(several)
    quiet = certified({"still": PATHS["still"]}, within=9)
    assert quiet.holds
    assert quiet.verdict.startswith(
        "None of 70 Monte Carlo samples exceeds ±9 pulses in any of 1 motions; with 95 %"
    )


def test_saved_and_read_back(several, tmp_path):
    several.save(tmp_path / "day.json")
    again = Certificate.load(tmp_path / "day.json")
    assert isinstance(again, Certificates)
    assert again == several
    assert again["mine"] == several["mine"]
    assert str(again) == str(several)
    with pytest.raises(ValueError, match=r"must hold a PD; it holds a 'ctc\.Certificates'"):
        PD.load(tmp_path / "day.json")


def test_a_checkpoint_of_a_set_goes_on_to_the_same_bits(several, tmp_path):
    kept = tmp_path / "kept"
    assert certified(checkpoint=kept) == several == certified(checkpoint=kept)
    with pytest.raises(ValueError, match="must be of the same reference"):
        certified({"mine": PATH}, checkpoint=kept)


def test_evaluations_are_the_single_calls():
    law = puma560.p_law()
    options = {"duration": 0.05, "steps_per_sample": 4, "backend": "numba"}
    found = evaluate(ARM, RIG, law, PATHS, **options)
    assert list(found) == list(PATHS)
    for name, path in PATHS.items():
        alone = evaluate(ARM, RIG, law, path, **options)
        assert isinstance(alone, Evaluation)
        assert found[name].record == alone.record
    peaks = {name: each.max_error_pulses.max() for name, each in found.items()}
    assert peaks[found.worst] == max(peaks.values()) == peaks["mine"]
    assert found.within(max(peaks.values()))
    assert not found.within(max(peaks.values()) - 1)
    assert not found.holds
    lines = str(found).splitlines()
    assert lines[0].endswith("motions within ±1 pulse at every sample; the worst is mine, 10")
    compared = compare(ARM, RIG, {"mine": law}, PATH, **options)
    own, other = (
        next(x for x in str(each).splitlines() if x.startswith("mine"))
        for each in (found, compared)
    )
    assert own.split() == other.split()


def test_a_controller_is_tuned_for_all_motions(monkeypatch):
    settings = SearchSettings(rounds=((1, np.inf),), quieter_searches=0, validation_samples=40)
    monkeypatch.setattr(TUNE, "SETTINGS", settings)  # 20 for each of two
    monkeypatch.setattr(TUNE, "families", lambda *some: families(*some)[1:2])
    paths = {name: PATHS[name] for name in ("move", "mine")}
    options = with_uncertainty(covariance=COVARIANCE, samples=8, duration=0.1, progress=False)
    tuning = tune(ARM, RIG, paths, **options)
    assert list(tuning.certificate) == list(paths)
    assert tuning.certificate.law is tuning.law
    trial = tuning.trials[0]
    rows = certify(
        ARM,
        RIG,
        tuning.law,
        paths,
        **options | {"samples": 20, "seed": 1, "after": 0.02, "steps_per_sample": 8},
    )
    assert trial.left == rows.failures  # the same samples: seed + 1
    np.testing.assert_allclose(trial.chatter, rows.runs.chatter.mean(axis=0), rtol=1e-9)


def test_a_set_from_a_hold_is_each_from_a_hold():
    law, paths = ComputedTorque(ARM, RIG), {name: PATHS[name] for name in ("still", "move")}
    both = certify(
        ARM, RIG, law, paths, Uncertainty(covariance=COVARIANCE), samples=32, progress=False
    )
    held = both.from_hold(samples=16)
    assert held["move"] == both["move"].from_hold(samples=16)
    assert len(held.plants) == 16
    assert "from a hold" in held.verdict
    assert "from a hold" not in both.verdict


def test_gears_that_are_unknown_in_one_motion_are_so_in_all():
    """A known resonance of another motion once was said to be that of all."""
    both = certified({"move": PATHS["move"], "mine": PATH}, samples=2, friction=0.0)
    for name, hz, reason in (("move", 40.0, ""), ("mine", np.nan, "heavy motors")):
        gears = LowestResonance(hz=hz, damping_ratio=0.01, within=1, reason=reason)
        both[name].__dict__["on_gears"] = gears
    said = " ".join(str(both).split())
    assert "in all motions, on elastic gears: cannot tell, heavy motors" in said
    assert "40 Hz" not in said


# -- bad input -----------------------------------------------------------------------------------
FAST = PATHS | {"quick": PointToPoint(start=START, goal=np.add(START, (1, -1)), duration=0.2)}
CALLS = {
    "certify": lambda motions: certified(motions),
    "evaluate": lambda motions: evaluate(ARM, RIG, LAW, motions),
    "tune": lambda motions: tune(
        ARM, RIG, motions, **with_uncertainty(covariance=COVARIANCE, samples=8)
    ),
}
WRONG = {
    "too fast": (
        FAST,
        r"motion 'quick' must be one that .* too fast by a factor of \d\.\d+\. Slow it down by",
    ),
    "nothing": ({}, "motions must have texts as names; got none"),
    "a number as name": ({3: PATH}, "motions must have texts as names; got 3"),
    "no reference": ({"a": RIG}, "motion 'a' must be of type Reference; got a value of type Rig"),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
@pytest.mark.parametrize(("motions", "message"), WRONG.values(), ids=WRONG)
def test_wrong_motions_are_refused_in_one_line(call, motions, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call(motions)
    assert "\n" not in str(refusal.value)


def test_a_misspelled_motion_knows_the_others(several):
    with pytest.raises(KeyError, match=r"'mve' is no motion of this set\. Did you mean 'move'"):
        several["mve"]
    assert several.get("mve") is None
    assert "mve" not in several


def test_a_motion_shorter_than_what_is_left_out_is_named():
    with pytest.raises(
        ValueError, match=r"motion 'still': after must be from 0 to 0\.0497 s, the last sample"
    ):
        certified(after=0.06, duration=None)
