"""Consider covariance: against a fit that has the considered numbers as unknowns, and on logs
that contradict a rig.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from identification import Tolerances, identify
from identification.results import by_tolerances, consider, counted, priors
from plant import FrictionCurve, Phase, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()


def log(rig=RIG, seed=0):
    """Of a robot with another rig; its record states the usual one."""
    encoder = dataclasses.replace(
        rig.encoder, phase=Phase(shift=np.random.default_rng(seed).uniform(-0.5, 0.5, 2))
    )
    record = simulate(
        ARM,
        dataclasses.replace(rig, encoder=encoder),
        puma560.p_law((0.1, 0.08)),
        PATH,
        steps_per_sample=16,
    )
    return dataclasses.replace(record, rig=RIG, true_q=None, true_qd=None)


def test_without_prior_it_is_the_fit_of_both():
    """Change and covariance of two unknowns, if a third is fitted, whose prior says nothing."""
    random = np.random.default_rng(0)
    rows, residual = random.normal(size=(100, 3)), random.normal(size=100)
    residual -= rows[:, :2] @ np.linalg.lstsq(rows[:, :2], residual, rcond=None)[0]
    change, added, _ = consider(
        rows[:, :2].T, residual, {"third": np.inf}, {"third": rows[:, 2]}, 2.0
    )
    both = -np.linalg.lstsq(rows, residual, rcond=None)[0]
    np.testing.assert_allclose(change, both[:2], rtol=1e-9)
    apart = np.linalg.inv(rows.T @ rows)[:2, :2] - np.linalg.inv(rows[:, :2].T @ rows[:, :2])
    np.testing.assert_allclose(added, 2.0 * apart, rtol=1e-9)


def test_a_narrow_prior_leaves_all_as_it_is():
    random = np.random.default_rng(1)
    rows, residual = random.normal(size=(100, 3)), random.normal(size=100)
    change, added, _ = consider(
        rows[:, :2].T, residual, {"third": 1e-9}, {"third": rows[:, 2]}, 1.0
    )
    assert np.abs(change).max() < 1e-9
    assert np.abs(added).max() < 1e-15


def test_priors_are_those_of_the_tolerances():
    efforts = np.array([[2.0, 4.0], [10.0, 20.0]])
    names = ["gear[1]", "offset[0]", "viscous[1]", "coulomb[0]", "compliance[0]", "lag", "delay"]
    found = priors(
        Tolerances(gear=0.01, offset=0.05, friction=0.1, lag=0.0, delay=0.2), names, efforts
    )
    expected = {
        "gear[1]": 0.01,
        "offset[0]": 0.1,
        "viscous[1]": 0.02,
        "coulomb[0]": 0.2,
        "delay": 0.2,
    }
    assert found == pytest.approx(expected)
    assert not priors(Tolerances.none(), names, efforts)


def test_tolerances_are_refused_if_negative():
    with pytest.raises(ValueError, match=r"gear must not be negative; got -0\.1"):
        Tolerances(gear=-0.1)
    with pytest.raises(ValueError, match="tolerances must be of type Tolerances"):
        identify(ARM.dynamics, log(), tolerances=0.01)


@pytest.mark.slow
def test_intervals_count_an_offset_that_the_rig_lacks():
    """An eighth of the Coulomb friction puts f off by many standard deviations of noise; it is
    named, and counted.
    """
    curve = FrictionCurve(
        offset=0.125 * np.array(RIG.drive.coulomb), breakaway=(0.0, 0.0), speed=(1.0, 1.0)
    )
    record = log(dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve)))
    found = identify(ARM.dynamics, record, progress=False)
    off = np.abs(found.f - ARM.f)
    assert (off > 6 * np.sqrt(np.diag(found.fit.noise_covariance))).any()
    assert (off < 1.96 * found.fit.std).all()
    assert found.diagnostics.detection.names == ("offset",)
    values = found.diagnostics.detection.named[0].values
    np.testing.assert_allclose(
        [values[f"offset[{i}]"] for i in (0, 1)], curve.offset, rtol=0.35
    )  # the rest looks like weight
    assert any("torques have an offset that the rig lacks" in text for text in found.warnings)


@pytest.mark.slow
def test_a_right_rig_is_counted_too_unless_it_is_exact():
    wide = identify(ARM.dynamics, log(), progress=False)
    narrow = identify(ARM.dynamics, log(), progress=False, tolerances=Tolerances.none())
    np.testing.assert_array_equal(wide.f, narrow.f)
    assert (wide.fit.std > 0.999 * narrow.fit.std).all()
    assert (np.abs(narrow.f - ARM.f) < 2.6 * narrow.fit.std).all()
    assert "within gears 0.8 %" in wide.summary()
    assert "take the rig for exact" in narrow.summary()


@cache
def default():
    """With all tolerances and unknowns as they are by default."""
    return identify(ARM.dynamics, log(), method="prediction_error", progress=False)


def test_friction_that_is_unknown_is_not_friction_to_be_identified():
    """Its effect beside itself is a rounding error, and no deviation of 1e-12."""
    quick = {"method": "prediction_error", "progress": False}
    record = log()
    stated = default().diagnostics.detection.friction
    assert {name.partition("[")[0] for name in stated} == {"viscous", "coulomb"}
    assert min(stated.values()) > 1e-7
    some = identify(ARM.dynamics, record, unknown=["drive.coulomb[1]"], **quick)
    assert set(some.diagnostics.detection.friction) == {*stated} - {"coulomb[1]"}
    every = identify(ARM.dynamics, record, unknown="friction", **quick)
    assert every.diagnostics.detection.friction == {}


def test_the_summary_says_how_much_of_the_intervals_are_tolerances():
    """Of tolerances that were stated it does not say that they are defaults."""
    quick = {"method": "prediction_error", "progress": False}
    record = log()
    shares = by_tolerances(default())
    assert set(shares) == set(default().fit.unknown)
    assert all(0 <= share <= 1 for share in shares.values())
    # A gear that is exact leaves less of every variance.
    exact = identify(ARM.dynamics, record, tolerances=Tolerances(gear=0.0), **quick)
    assert np.mean(list(by_tolerances(exact).values())) < np.mean(list(shares.values()))
    assert "defaults" in counted(default())
    assert "defaults" not in counted(exact)
    none = identify(ARM.dynamics, record, tolerances=Tolerances.none(), **quick)
    assert "variance" not in counted(none)
