"""Friction that a drive leaves open is identified with f; what identifying it would give a
certificate.
"""

import dataclasses
import warnings

import numpy as np
import pytest

from ctc import ComputedTorque, Uncertainty, certify
from identification import identify
from identification.preparation import prepare
from plant import Drive, Rig, puma560, simulate
from plant.parts import class_of


def with_drive(rig, **changes):
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **changes))


@pytest.fixture(scope="module")
def record():
    return simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())


def found_of(record, **options):
    return identify(puma560.dynamics(), record, method="equation_error", progress=False, **options)


@pytest.mark.slow
def test_open_friction_is_what_unknown_friction_is(record):
    opened = dataclasses.replace(record, rig=with_drive(record.rig, viscous=None, coulomb=None))
    found, other = found_of(opened), found_of(record, unknown="friction")
    assert found.fit.unknown == other.fit.unknown
    assert found.fit.values == pytest.approx(other.fit.values, rel=1e-9)
    assert found.rig.drive.left_open == ()
    assert found.rig.drive.coulomb == pytest.approx(record.rig.drive.coulomb, rel=0.2)


def test_what_is_stated_is_taken_as_stated(record):
    found = found_of(dataclasses.replace(record, rig=with_drive(record.rig, coulomb=None)))
    assert [name for name in found.fit.unknown if "drive" in name] == [
        "drive.coulomb[0]",
        "drive.coulomb[1]",
    ]
    assert (found.rig.drive.viscous == record.rig.drive.viscous).all()


def held_still(record):
    """The record with an elbow that does not move."""
    reference, error = record.reference_pulses.copy(), record.error_pulses.copy()
    reference[:, 1], error[:, 1] = record.counts[0, 1], 0
    return dataclasses.replace(
        record, reference=None, reference_pulses=reference, error_pulses=error
    )


def further_unknowns(records, **options):
    """Unknowns of the drive, and what was said of friction, before a search."""
    options = {"unknown": None, "held_out": None, "ranges": None} | options
    records = [
        dataclasses.replace(each, rig=with_drive(each.rig, viscous=None, coulomb=None))
        for each in records
    ]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        problem = prepare(
            puma560.dynamics(),
            records,
            method="equation_error",
            settings=None,
            seed=0,
            zeros=False,
            options={},
            prior=(puma560.arm().f, 0.5),
            **options,
        )
    names = {name for name in problem.unknown if name.startswith("drive")}
    return names, [str(line.message) for line in said if "as zero" in str(line.message)]


OF_SHOULDER = {"drive.viscous[0]", "drive.coulomb[0]"}
OF_ELBOW = {"drive.viscous[1]", "drive.coulomb[1]"}


def test_a_record_set_aside_opens_no_friction(record):
    """The elbow moves in it alone."""
    names, said = further_unknowns([held_still(record), record])
    assert names == OF_SHOULDER
    assert len(said) == 1
    assert all(name in said[0] for name in OF_ELBOW)


def test_friction_that_is_unknown_by_name_is_not_taken_as_zero(record):
    names, said = further_unknowns([held_still(record)], unknown=("f", *OF_ELBOW))
    assert names == OF_SHOULDER | OF_ELBOW
    assert said == []


def test_ranges_of_f_leave_open_friction_out(record):
    """As friction by direction; with a row for each number it is unknown."""
    names, said = further_unknowns([record], ranges=puma560.PRINTED_RANGES)
    assert names == set()
    assert all(name in said[0] for name in OF_SHOULDER | OF_ELBOW)
    ranges = [*puma560.PRINTED_RANGES, *[(0, 1)] * 4]
    names, said = further_unknowns([record], ranges=ranges)
    assert names == OF_SHOULDER | OF_ELBOW
    assert said == []


def test_an_open_drive_is_no_plant():
    rig = with_drive(puma560.rig(), viscous=None)
    assert rig.drive.left_open == ("viscous",)
    for refused in (
        lambda: simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference()),
        lambda: ComputedTorque(puma560.arm(), rig),
    ):
        with pytest.raises(ValueError, match=r"leaves viscous open. Take found.rig"):
            refused()
    assert with_drive(rig, viscous=(1e-3, 1e-3)).drive.left_open == ()


def test_friction_that_is_0_is_known_where_it_is_said():
    rig = with_drive(puma560.rig(), viscous=None, coulomb=None)
    with_drive(rig, viscous=0.0, coulomb=0.0, left_open=()).drive.require_friction()
    assert rig.filled({"drive.coulomb[0]": 0.0}).drive.left_open == ("viscous",)
    assert rig.filled({"a.drive.coulomb[0]": 0.0}, "a.").drive.left_open == ("viscous",)
    assert rig.filled({"period": 0.0}).drive.left_open == ("viscous", "coulomb")


@pytest.mark.parametrize("opened", [("coulombs",), (None,)])
def test_a_field_that_cannot_be_open_is_refused(opened):
    with pytest.raises(ValueError, match="left_open of Drive must be one of 'viscous', 'coulomb'"):
        with_drive(puma560.rig(), left_open=opened)


def test_an_open_drive_is_saved_and_restored(tmp_path):
    rig = with_drive(puma560.rig(), viscous=None, coulomb=None)
    rig.save(tmp_path / "rig.json")
    assert class_of("plant.Rig") is Rig
    assert Rig.load(tmp_path / "rig.json") == rig
    assert isinstance(rig.drive, Drive)


def test_certificate_says_what_identified_friction_would_give(record):
    """Of friction that is stated to 50 %; the share is about that of a certificate with friction
    identified.
    """
    found = identify(puma560.dynamics(), record, method="prediction_error", progress=False)
    known = found.diagnostics.detection.friction
    better = identify(
        puma560.dynamics(), record, method="prediction_error", unknown="friction", progress=False
    )
    std = dict(zip(better.fit.unknown, np.sqrt(np.diag(better.fit.noise_covariance)), strict=True))
    for name, value in known.items():
        assert 0.5 < value / std[f"drive.{name}"] < 2
    law, options = (
        ComputedTorque(found, bandwidth=60),
        {"samples": 200, "duration": 1.0, "progress": False},
    )
    certificate = certify(
        found, found.rig, law, puma560.reference(), Uncertainty(friction=0.5), **options
    )
    assert certificate.probability > 0.5
    assert certificate.friction_known < 0.3
    assert 'identify(..., unknown="friction")' in " ".join(str(certificate).split())
    fine = certify(
        found, found.rig, law, puma560.reference(), Uncertainty(friction=0.02), **options
    )
    assert "unknown=" not in str(fine)
