"""An identification kept in a file: equal, with the same bits out of what is made of it."""

import dataclasses
import json
import re

import pytest
from uncertain import with_uncertainty

from ctc import Certificate, ComputedTorque, certify
from identification import Identification, identify
from identification.results import identification
from plant import puma560, simulate

RIG, PATH = puma560.rig(), puma560.reference()


@pytest.fixture(scope="module")
def found():
    record = simulate(puma560.arm(), RIG, puma560.p_law(), PATH, duration=1.0)
    return identify(puma560.dynamics(), record, seed=1, progress=False)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "found.json"


def test_it_comes_back_equal_and_is_saved_again_in_the_same_bytes(found, path, tmp_path):
    found.save(path)
    again = Identification.load(path)
    assert again == found
    assert again.summary() == found.summary()
    assert again.seconds == found.seconds
    assert ComputedTorque(again) == ComputedTorque(found)
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def test_a_certificate_of_what_was_loaded_has_the_same_bits_and_is_kept_likewise(
    found, path, tmp_path
):
    found.save(path)
    again, options = (
        Identification.load(path),
        {"samples": 80, "duration": 0.05, "steps_per_sample": 4},
    )
    certificate = certify(
        found, found.rig, ComputedTorque(found), PATH, **with_uncertainty(**options)
    )
    assert (
        certify(again, again.rig, ComputedTorque(again), PATH, **with_uncertainty(**options))
        == certificate
    )
    certificate.save(tmp_path / "certificate.json")
    kept = Certificate.load(tmp_path / "certificate.json")
    assert kept == certificate
    assert str(kept) == str(certificate)
    assert kept.plant(7).arm == certificate.plant(7).arm
    with pytest.raises(
        ValueError,
        match=r"must hold a Identification; it holds a 'ctc.Certificate'. Use Certificate.load",
    ):
        Identification.load(tmp_path / "certificate.json")


def test_the_file_says_where_it_comes_from_and_a_changed_log_is_seen(found, path):
    found.save(path)
    data = json.loads(path.read_text())
    said = data["provenance"]
    assert (said["seed"], said["method"]) == (1, "seeded")
    assert re.fullmatch("[0-9a-f]{64}", said["records"][0])
    assert {"onepulse", "numpy", "casadi"} <= set(said["versions"])
    data["content"]["records"][0]["error_pulses"]["array"][3][0] += 1
    path.write_text(json.dumps(data))
    with pytest.raises(
        ValueError, match="must have the records that its head says; it has been changed"
    ):
        Identification.load(path)


def test_a_file_keeps_the_warnings_as_they_were(found, path, monkeypatch):
    """Nothing checks the logs again; a file of before has no digest, and is checked again."""
    late = dataclasses.replace(found, diagnostics=dataclasses.replace(found.diagnostics, delay=0.5))
    assert late.doubts
    assert set(late.doubts) <= set(late.warnings)
    late.save(path)
    checked = []
    computed = identification.warnings_of
    monkeypatch.setattr(
        identification, "warnings_of", lambda result: checked.append(result) or computed(result)
    )
    again = Identification.load(path)
    assert (again.warnings, again.doubts) == (late.warnings, late.doubts)
    assert not checked
    data = json.loads(path.read_text())
    before = {
        name: value
        for name, value in data["provenance"].items()
        if name not in ("doubts", "digest")
    }
    path.write_text(json.dumps(data | {"provenance": before}))
    assert Identification.load(path).doubts == late.doubts
    assert checked


@pytest.mark.parametrize("change", ["a warning goes", "a doubt goes", "another value"])
def test_warnings_stand_under_their_own_values_alone(found, path, change):
    late = dataclasses.replace(found, diagnostics=dataclasses.replace(found.diagnostics, delay=0.5))
    late.save(path)
    data = json.loads(path.read_text())
    if change == "another value":
        data["content"]["fit"]["values"]["array"][0] *= 1.5
    elif change == "a doubt goes":
        data["provenance"]["doubts"] = []
    else:
        data["provenance"] |= {"warnings": [], "doubts": []}
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="must have the digest that its head says"):
        Identification.load(path)
