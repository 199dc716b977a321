"""Variance between runs: against the analysis of variance of a balanced design, and where it
does not follow.
"""

import dataclasses

import numpy as np
import pytest

from identification import fit_torque
from identification.equation_error import between_runs, further_logs, restricted, runs_agree
from plant import Harmonics, puma560, simulate

RUNS, EACH = 6, 40


def one_way(deviation, seed=0, values=3):
    """Rows, residual, run and block of a fit of a mean per parameter, in runs that differ; and
    the samples.
    """
    random = np.random.default_rng(seed)
    samples = random.normal(size=(RUNS, EACH, values)) + deviation * random.normal(
        size=(RUNS, 1, values)
    )
    rows = np.tile(np.eye(values), (RUNS * EACH, 1))
    runs = np.repeat(np.arange(RUNS), EACH * values)
    blocks = np.repeat(np.arange(RUNS * 10), EACH * values // 10)
    mean = samples.mean(axis=(0, 1))
    return rows, (samples - mean).ravel(), runs, blocks, samples, mean


@pytest.mark.parametrize("deviation", [0.0, 0.3, 2.0])
def testrestricted_likelihood_is_the_analysis_of_variance(deviation):
    """Of a balanced design: (mean square between - mean square within) / samples of a run, or 0."""
    *_, samples, _ = one_way(deviation, values=1)
    means = samples[..., 0].mean(axis=1)
    within = samples[..., 0].var(axis=1, ddof=1).mean()
    analysis = max(0.0, (EACH * means.var(ddof=1) - within) / EACH)
    std = np.full((RUNS, 1), np.sqrt(within / EACH))
    found = restricted("f", means[:, None], std, np.ones((RUNS, 1)))
    assert found == pytest.approx(analysis, rel=1e-6, abs=1e-12)
    assert (found > 0.05) == (deviation > 0)


def test_parameters_of_a_group_share_a_variance():
    means = np.random.default_rng(1).normal(size=(5, 4)) * 3
    std = np.full((5, 4), 0.5)
    assert restricted("f", means, std, np.ones((5, 4))) == pytest.approx(
        means.var(axis=0, ddof=1).mean() - 0.25
    )


def test_the_covariance_of_a_mean_is_that_of_the_runs():
    """As wide as Student's for the degrees of freedom of the group, about the mean square
    between runs.
    """
    rows, residual, runs, blocks, samples, mean = one_way(2.0, values=1)
    found, covariance = between_runs(
        ("a",), mean, np.eye(1) / (RUNS * EACH), rows, residual, runs, blocks
    )
    between = samples.mean(axis=1).var(axis=0, ddof=1)[0] / RUNS
    assert covariance[0, 0] == pytest.approx(between * (2.5706 / 1.96) ** 2, rel=0.01)
    np.testing.assert_allclose(found.values, samples.mean(axis=1))
    assert not found.agree.any()
    assert "0 of 1 intervals agree" in str(found)
    assert 5 < found.further < 3 * RUNS + 1


def test_runs_that_do_not_tell_a_value_are_no_degrees_of_freedom():
    """Logs of another joint's motion must not narrow what two logs say."""
    rows, residual, runs, blocks, _, mean = one_way(2.0, values=1)
    rows[runs > 1] *= 1e-9
    found, _ = between_runs(("a",), mean, np.eye(1), rows, residual, runs, blocks)
    assert np.isfinite(found.std[:, 0]).sum() == 2
    assert found.freedom == pytest.approx(1.0)


def test_runs_that_do_not_differ_agree():
    held = [0, 0]
    for seed in range(40):
        rows, residual, runs, blocks, _, mean = one_way(0.0, seed)
        found, covariance = between_runs(
            ("a", "b", "c"), mean, np.eye(3) / (RUNS * EACH), rows, residual, runs, blocks
        )
        held[0] += found.agree.sum()
        held[1] += (np.abs(mean) < 1.96 * np.sqrt(np.diag(covariance))).sum()
    assert 0.93 < held[0] / 120 <= 1
    assert 0.9 < held[1] / 120 <= 1


def test_agreement_is_cochrans_test():
    each, std = np.array([[0.0, 0.0], [2.7, 2.9]]), np.ones((2, 2))
    np.testing.assert_array_equal(runs_agree(each, std), [True, False])  # 1.96 sqrt(2) = 2.77


def test_a_variance_that_does_not_follow_is_refused():
    with pytest.raises(ValueError, match=r"variance of drive\.coulomb between runs must follow"):
        restricted(
            "drive.coulomb", np.array([[0.0], [1.0]]), np.array([[np.nan], [1.0]]), np.ones((2, 1))
        )
    with pytest.raises(ValueError, match="must follow from the logs"):
        restricted("f", np.array([[0.0], [1.0]]), np.ones((2, 1)), np.full((2, 1), 1e-9))
    assert restricted("f", np.ones((2, 1)), np.ones((2, 1)), np.ones((2, 1))) == 0


def test_what_differs_needs_three_times_as_many_logs_to_halve():
    """Without the gain of Student's quantile: 4 n logs halve; with it fewer, of a few."""
    assert further_logs(np.ones(3), np.zeros(3), np.full(3, 1e6), 5) == 15
    assert further_logs(np.zeros(3), np.ones(3), np.full(3, 1.0), 2) < 6


def test_what_no_further_log_reduces_is_told():
    rows, residual, runs, blocks, _, mean = one_way(0.0)
    given = (("a", "b", "c"), mean, np.eye(3) / (RUNS * EACH), rows, residual, runs, blocks)
    some, every = (
        between_runs(*given, np.array(common))[0] for common in ([0.0, 0.0, 9.0], [9.0, 9.0, 9.0])
    )
    assert (some.never, every.never) == (1, 3)
    assert some.further == between_runs(*given)[0].further
    assert "; what a rig may state wrongly makes half or more of 1 of the 3" in " ".join(
        str(some).split()
    )
    assert "no number of further logs would halve the intervals" in " ".join(str(every).split())


def test_a_number_of_logs_beyond_the_last_that_was_tried_is_no_fact():
    rows, residual, runs, blocks, _, mean = one_way(0.0)
    given = (("a", "b", "c"), mean, np.eye(3) / (RUNS * EACH), rows, residual, runs, blocks)
    variance = np.diag(between_runs(*given)[1])
    # So close to a third of the rest that hardly any of it may remain.
    many = between_runs(*given, 0.3333 * variance)[0]
    assert many.further == 1000
    assert "1000 or more further logs would halve" in " ".join(str(many).split())


def test_values_that_no_log_halves_stay_so_among_others():
    rows, residual, runs, blocks, _, mean = one_way(0.0)
    given = (("a", "b", "c"), mean, np.eye(3) / (RUNS * EACH), rows, residual, runs, blocks)
    every = between_runs(*given, np.full(3, 9.0))[0].among(np.arange(3), 5)
    text = " ".join(str(every).split())
    assert "no number of further logs would halve the intervals" in text
    assert "3 of the 5" in text


def test_rows_of_no_log_count_in_the_fit_alone():
    """A prior as narrow as six logs halves what each of these moves the values by, and what they
    say alone stays.
    """
    rows, residual, runs, blocks, samples, mean = one_way(2.0, values=1)
    prior = np.full((1, 1), np.sqrt(RUNS * EACH))
    rows, residual = np.vstack([prior, rows]), np.append(0.0, residual)
    runs, blocks = np.append(-1, runs), np.append(-1, blocks)
    found, covariance = between_runs(
        ("a",), mean, np.eye(1) / (2 * RUNS * EACH), rows, residual, runs, blocks
    )
    np.testing.assert_allclose(found.values, samples.mean(axis=1))
    plain = between_runs(
        ("a",), mean, np.eye(1) / (RUNS * EACH), rows[1:], residual[1:], runs[1:], blocks[1:]
    )[1]
    assert np.sqrt(covariance / plain) == pytest.approx(0.5, rel=0.1)


def test_exact_logs_agree_and_one_that_is_not_heard_is_none():
    random = np.random.default_rng(2)
    rows, runs, blocks = (
        random.normal(size=(120, 2)),
        np.repeat([0, 1], 60),
        np.repeat(np.arange(20), 6),
    )
    values = np.array([1.0, -3.0])
    found, covariance = between_runs(
        ("a", "b"), values, 1e-32 * np.eye(2), rows, np.zeros(120), runs, blocks
    )
    assert found.agree.all()
    assert (np.diag(covariance) < 1e-16).all()
    assert found.groups == {"f": 0}
    rows[runs == 1] *= 1e-9
    residual = np.where(runs == 1, 5.0, 0.1) * random.normal(size=120)
    assert not between_runs(("a", "b"), values, np.eye(2), rows, residual, runs, blocks)[
        0
    ].compared.any()


# -- an arm whose friction drifts ----------------------------------------------------------------
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(2))


def drifting(seed, drift):
    """A log with noise in its torque, whose friction is off by so much, relative."""
    arm, rig, random = puma560.literature_arm(1.5), puma560.rig(), np.random.default_rng(seed)
    friction = {
        kind: getattr(rig.drive, kind) * (1 + drift * random.normal(size=2))
        for kind in ("viscous", "coulomb")
    }
    path = Harmonics(period=4.0, offset=(0, 0), cosine=random.normal(0, 0.12, (2, 4)),
                     sine=random.normal(0, 0.12, (2, 4)))  # fmt: skip
    machine = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **friction))
    record = simulate(arm, machine, puma560.p_law((0.1, 0.08)), path, duration=8.0)
    torque = record.torque + 0.3 * random.normal(size=record.torque.shape)
    return dataclasses.replace(record, torque=torque, rig=rig, law=None, reference=None)


def test_friction_that_drifts_is_told_and_its_intervals_hold_it():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    records = [drifting((7, i), 0.1) for i in range(4)]
    fit = fit_torque(
        arm.dynamics, records, unknown=(*arm.dynamics.names, *FRICTION), band=5.0, every=50
    )
    truth = np.concatenate([arm.f, rig.drive.viscous, rig.drive.coulomb])
    assert 0.04 < fit.between.groups["drive.coulomb"] < 0.25
    assert not fit.between.agree[-2:].any()
    assert (np.abs(fit.values - truth) < 1.96 * fit.std).sum() >= 11
    assert fit.std[-1] / fit.values[-1] > 0.02
    one = fit_torque(
        arm.dynamics, records[0], unknown=(*arm.dynamics.names, *FRICTION), band=5.0, every=50
    )
    assert one.between is None
    assert "by blocks of one log" in " ".join(str(one).split())
    assert "intervals agree between runs" in " ".join(str(fit).split())
