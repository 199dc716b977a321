"""Intervals of an identification from several records, with what differs between them: each record's own fit is it."""

import dataclasses

import numpy as np
import pytest

from identification import Identification, identify
from identification.results import model_error
from plant import Harmonics, Phase, puma560, simulate

ARM, RIG, LAW = puma560.literature_arm(1.5), puma560.rig(), puma560.p_law((0.1, 0.08))
KINDS = ("viscous", "coulomb")
UNKNOWN = (*ARM.dynamics.names, *(f"drive.{kind}[{i}]" for kind in KINDS for i in range(2)))
TRUTH = np.concatenate([ARM.f, RIG.drive.viscous, RIG.drive.coulomb])


def log(seed, drift):
    """Counts of a day on which each friction is off by so much, relative (standard deviation)."""
    random = np.random.default_rng(seed)
    friction = {kind: getattr(RIG.drive, kind) * (1 + drift * random.normal(size=2)) for kind in KINDS}
    path = Harmonics(period=2.5, offset=(0, 0), cosine=random.normal(0, 0.12, (2, 4)),
                     sine=random.normal(0, 0.12, (2, 4)))  # fmt: skip
    encoder = dataclasses.replace(RIG.encoder, phase=Phase(shift=random.uniform(-0.5, 0.5, 2)))
    drive = dataclasses.replace(RIG.drive, **friction)
    record = simulate(ARM, dataclasses.replace(RIG, drive=drive, encoder=encoder), LAW, path, duration=2.5)
    return dataclasses.replace(record, rig=RIG, torque=None, true_q=None, true_qd=None)


def quick(records, **options):
    return identify(
        ARM.dynamics, records, unknown=UNKNOWN, method="prediction_error", held_out=(), progress=False, **options
    )


@pytest.mark.filterwarnings("ignore::identification.IdentificationWarning")  # the records contradict each other
def test_friction_that_drifts_widens_the_intervals_that_then_hold_it(tmp_path):
    records = [log((5, i), 0.1) for i in range(3)]
    found, friction = quick(records), slice(9, 13)
    fit, between = found.fit, found.fit.between
    off = np.abs(fit.values - TRUTH)
    assert (off > 3 * np.sqrt(np.diag(fit.noise_covariance)))[friction].sum() >= 2
    assert (off < 1.96 * fit.std).sum() >= 12
    assert 0.03 < between.groups["drive.coulomb"] < 0.25
    assert not between.agree[friction].any()
    assert between.agree[:9].sum() >= 7
    alone = [quick(record).fit for record in records]
    for own, values, std in zip(alone, between.values, between.std, strict=True):
        np.testing.assert_allclose((values - own.values) / std, 0, atol=1.5)
        np.testing.assert_allclose(values[friction], own.values[friction], rtol=0.02)
    assert all(own.between is None for own in alone)
    said = " ".join(found.summary().split())
    assert f"{between.agree.sum()} of 13 intervals agree between runs; they differ in" in said
    assert "would halve the intervals" in said
    found.save(tmp_path / "found.json")
    assert Identification.load(tmp_path / "found.json").fit.between == between


def test_one_record_says_that_a_second_would_tell():
    found = quick(log((3, 0), 0.1))
    assert found.fit.between is None
    assert "by blocks of one log: what differs between runs is not in them" in " ".join(found.summary().split())


def test_a_prior_belongs_to_no_record():
    records = [log((5, i), 0.0) for i in range(2)]
    plain = quick(records)
    wide, narrow = (quick(records, prior=(1.05 * ARM.f, share)) for share in (1e3, 1e-3))
    np.testing.assert_allclose(wide.fit.between.values, plain.fit.between.values, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(wide.fit.std, plain.fit.std, rtol=0.2)
    assert (narrow.fit.std[:9] < 0.1 * plain.fit.std[:9]).any()


def test_a_variance_that_does_not_follow_is_an_error(monkeypatch):
    def refusing(*_):
        raise ValueError("the variance of f between runs must follow from the logs; it does not.")

    monkeypatch.setattr(model_error, "between_runs", refusing)
    with pytest.raises(ValueError, match="variance of f between runs must follow"):
        quick([log((5, i), 0.0) for i in range(2)])
