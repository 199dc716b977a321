"""What a log of an elastic arm says of f, on gears of stated resonances."""

import dataclasses
import importlib
import sys

import numpy as np
import pytest
from uncertain import with_uncertainty

from ctc import ComputedTorque, Uncertainty, certify, sweep_resonance
from ctc.certification import draw, refits
from identification import Tolerances, identify
from plant import Elasticity, puma560, simulate

fits_on_gears = importlib.import_module("ctc.certification.identified")

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH(np.zeros(1)).q[0]
HZ, RATIO = 60.0, 0.02


def taken_for_rigid(duration, **options):
    """The identification of an elastic arm from a log of so many seconds."""
    gears = Elasticity.from_resonance(ARM, HZ, RATIO, drive=RIG.drive, q=START)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    log = simulate(ARM, rig, puma560.p_law(), PATH, duration=duration, steps_per_sample=16)
    log = dataclasses.replace(log, rig=RIG)
    return identify(ARM.dynamics, log, seed=1, progress=False, **options)


@pytest.fixture(scope="module")
def found():
    """From as much as the values of the fits need, of a rig whose numbers are exact."""
    exact = Tolerances(gear=0.0, offset=0.0, friction=0.0)
    return taken_for_rigid(PATH.duration, tolerances=exact)


@pytest.fixture(scope="module")
def brief():
    """For what is asked of any fits."""
    return taken_for_rigid(1.5)


@pytest.fixture(scope="module")
def again(found):
    return refits(found, ((0.9 * HZ, 1.1 * HZ),), (RATIO, RATIO), START)


@pytest.mark.slow
def test_the_fit_at_the_resonance_of_the_robot_is_nearest_to_it(found, again):
    deviation = np.sqrt(np.diag(again.covariances[again.nearest(np.array([0.5]))[0]]))
    rigid, true = (
        np.abs(f - ARM.f) / deviation for f in (found.arm.f, again.centres(np.array([0.5]))[0])
    )
    assert rigid.max() > 8
    assert true.max() < 4

    away = [np.abs(row - ARM.f).sum() for row in again.values]
    assert np.argmin(away) == len(again.places) // 2


def test_tolerances_of_the_rig_hold_on_gears_as_well(brief):
    """Gears that are stated make no arm better known."""
    ranges = ((0.9 * HZ, 1.1 * HZ),), (RATIO, RATIO), START
    exact = taken_for_rigid(1.5, tolerances=Tolerances(gear=0.0, offset=0.0, friction=0.0))
    wide, narrow = (
        np.diagonal(refits(found, *ranges).covariances, axis1=1, axis2=2)
        for found in (brief, exact)
    )
    assert (wide > 0.999 * narrow).all()
    assert (wide > 2 * narrow).any()


@pytest.mark.slow
def test_plants_have_the_f_of_their_resonance_and_laws_that_of_the_middle(found, again):
    stated = Uncertainty(resonance=(0.9 * HZ, 1.1 * HZ), damping_ratio=RATIO)
    plants = draw(stated, found, RIG, 400, 0, START)
    np.testing.assert_allclose(plants.arm.f, again.centres(np.array([0.5]))[0], rtol=1e-9)

    hz = plants.values[:, plants.names.index("resonance")]
    low, high = np.quantile(hz, (0.2, 0.8))
    ends = again.centres(np.array([0.0, 1.0]))
    moved = plants.f[hz > high].mean(axis=0) - plants.f[hz < low].mean(axis=0)
    most = np.argmax(np.abs(ends[1] - ends[0]) / np.sqrt(np.diag(again.covariances[1])))
    assert moved[most] / (ends[1] - ends[0])[most] == pytest.approx(0.8, abs=0.25)


@pytest.mark.slow
def test_what_follows_from_the_resonance_is_no_sensitivity_to_f(found, again):
    stated = {
        "resonance": (0.9 * HZ, 1.1 * HZ),
        "damping_ratio": RATIO,
        "samples": 400,
        "duration": 0.3,
    }
    law = ComputedTorque(found, bandwidth=150)
    certificate = certify(found, RIG, law, PATH, **with_uncertainty(**stated, friction=0.0))
    plants, shares = (
        certificate.plants,
        {each.name: each.share for each in certificate.sensitivities},
    )
    hz = plants.values[:, plants.names.index("resonance")]
    own = [plants.names.index(name) for name in ARM.dynamics.names]

    def followed(values):
        return max(abs(np.corrcoef(hz, values[:, i])[0, 1]) for i in own)

    assert followed(plants.values) > 0.8
    assert followed(plants.values - plants.expected) < 0.2  # four standard deviations of chance
    assert shares["resonance"] > 0.5
    assert max(shares[name] for name in ARM.dynamics.names) < 0.1
    np.testing.assert_array_equal(plants.first(7).expected, plants.expected[:7])


@pytest.mark.slow
def test_loops_on_gears_take_an_identification_for_its_arm(found):
    law, options = ComputedTorque(found, bandwidth=60), {"duration": 0.1, "damping_ratio": RATIO}
    one, other = (
        sweep_resonance(arm, RIG, {"a": law}, PATH, hz=[40, 80], **options)
        for arm in (found, found.arm)
    )
    assert one == other


@pytest.mark.slow
def test_where_no_resonance_can_be_fitted_there_are_none(found):
    assert refits(found, ((0.3, 0.3),), (RATIO, RATIO), START) is None
    with pytest.raises(
        ValueError, match=r"what the records allow; .* fitted on gears of 2 to 2 Hz"
    ):
        certify(
            found,
            RIG,
            ComputedTorque(found),
            PATH,
            Uncertainty(resonance=(2.0, 2.0)),
            samples=8,
            progress=False,
        )


def results(certificate):
    """Bits of all that was drawn and simulated."""
    plants, runs = certificate.plants, certificate.runs
    return [
        each.tobytes()
        for each in (plants.f, plants.values, plants.derived, runs.peak, runs.unrounded)
    ]


def test_fits_are_made_once_for_a_range_and_change_no_bit(brief, monkeypatch, capsys):
    made, fit = [], fits_on_gears._on_gears
    monkeypatch.setattr(
        fits_on_gears, "_on_gears", lambda *given: made.append(given) or fit(*given)
    )
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    stated = {"resonance": (HZ, HZ), "damping_ratio": RATIO, "samples": 24, "duration": 0.1}
    slow, fast = (ComputedTorque(brief, bandwidth=bandwidth) for bandwidth in (40, 60))

    certify(brief, RIG, slow, PATH, **with_uncertainty(**stated))
    assert len(made) == 2
    assert "fits on gears" in capsys.readouterr().err
    kept = certify(brief, RIG, fast, PATH, **with_uncertainty(**stated))
    assert len(made) == 2
    capsys.readouterr()

    monkeypatch.setattr(fits_on_gears, "_STORE", {})
    assert results(
        certify(brief, RIG, fast, PATH, **with_uncertainty(**stated, progress=False))
    ) == results(kept)
    assert len(made) == 4
    assert capsys.readouterr().err == ""


def test_other_fits_are_made_where_anything_that_they_depend_on_differs(brief, monkeypatch):
    made = []
    monkeypatch.setattr(fits_on_gears, "_STORE", {})
    monkeypatch.setattr(fits_on_gears, "_on_gears", lambda *given: made.append(given))
    usual, pair = (brief, ((50.0, 50.0),), (0.02, 0.02), START), (50.0, 50.0)
    other = dataclasses.replace(brief, arm=brief.arm.dynamics.arm(1.01 * brief.f))
    searched = dataclasses.replace(brief.search, ranges=np.outer(brief.f, (0.9, 1.1)))
    for given in (
        usual,
        (brief, ((50.0, 51.0),), *usual[2:]),
        (brief, (pair, pair), *usual[2:]),
        (*usual[:2], (0.02, 0.03), START),
        (*usual[:3], START + 0.1),
        (other, *usual[1:]),
        (dataclasses.replace(brief, search=searched), *usual[1:]),
    ):
        before = len(made)
        refits(*given)
        assert len(made) > before, given[1:]
        before = len(made)
        assert refits(*given) is None  # kept as well
        assert len(made) == before


def test_so_many_ranges_are_kept_and_no_more(brief, monkeypatch):
    monkeypatch.setattr(fits_on_gears, "_STORE", {})
    monkeypatch.setattr(fits_on_gears, "_on_gears", lambda *given: None)
    for hz in range(20, 40):
        refits(brief, ((hz, hz),), (0.02, 0.02), START)
    (kept,) = fits_on_gears._STORE.values()
    assert len(kept) == fits_on_gears.SETTINGS.stored


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"resonance": (50, 70), "backlash": 0.1}, "backlash must be within one turn of the motor"),
        ({"resonance": (50, 70), "jitter": 5}, "share must be from 0 to 0.5"),
        ({"resonance": [(50, 70)] * 3}, "resonance must be one pair, or 2; got 3"),
    ],
)
def test_what_no_rig_has_is_refused_before_anything_is_fitted(brief, monkeypatch, stated, message):
    fitted = []
    monkeypatch.setattr(fits_on_gears, "_on_gears", lambda *given: fitted.append(given))
    with pytest.raises(ValueError, match=message):
        certify(
            brief,
            RIG,
            ComputedTorque(brief, bandwidth=60),
            PATH,
            **with_uncertainty(samples=10, duration=0.1, **stated),
        )
    assert fitted == []
