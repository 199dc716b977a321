"""Doubt is loud: where it is found, in the repr, and in each law that is built on it; right logs are quiet."""

import dataclasses
import json
import warnings
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque, ComputedTorquePID, Uncertainty, certify, tune
from identification import Identification, IdentificationWarning, identify
from plant import P, puma560, simulate

RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()


@cache
def log():
    return simulate(puma560.arm(), RIG, LAW, PATH)


@cache
def wrong():
    stated = dataclasses.replace(log(), law=P(gain=[1.5 * gain for gain in LAW.gain]), torque=None, current=None)
    with pytest.warns(IdentificationWarning, match=r"identify: identified with \d+ warning") as caught:
        found = identify(puma560.dynamics(), stated, seed=1, method="equation_error", progress=False)
    assert len(caught) == 1  # of all lines
    assert caught[0].filename == __file__
    for line in found.warnings:
        assert f"- {line}" in str(caught[0].message)
    return found


def test_what_is_significant_and_not_named_asks_for_what_was_stated():
    detection = identify(puma560.dynamics(), log(), progress=False).diagnostics.detection
    assert "next to nothing" not in str(detection)
    signs = [dataclasses.replace(sign, threshold=-1.0) if sign.name == "gear" else sign for sign in detection.signs]
    said = str(dataclasses.replace(detection, signs=tuple(signs)))
    assert "significant, but explaining next to nothing: gear (are lengths and rig right?)" in said


def test_a_result_in_doubt_says_so_in_its_repr():
    assert f"{len(wrong().warnings)} warning" in repr(wrong())
    fallen = dataclasses.replace(wrong(), fit=dataclasses.replace(wrong().fit, fallback_reason="the fit is no arm"))
    assert "a fallback" in repr(fallen)


@pytest.mark.parametrize(
    ("law", "numbers"),
    [
        (ComputedTorque, {}),
        (
            ComputedTorquePID,
            {"bandwidth": 155, "ratio": 1.66, "integral": 40.6, "roll_off": 449, "roll_off_damping": 0.53},
        ),
    ],
)
def test_a_law_does_not_take_it_silently(law, numbers):
    with pytest.warns(IdentificationWarning, match=rf"{law.__name__}: identified with") as caught:
        law(wrong(), **numbers)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law(wrong().arm, wrong().rig, **numbers)  # accepted by whoever writes this


@pytest.mark.parametrize("study", [certify, tune])
def test_nor_does_a_study(study):
    law, found = () if study is tune else (P(gain=LAW.gain),), wrong()
    warnings.simplefilter("error", IdentificationWarning)
    with pytest.raises(IdentificationWarning, match=rf"{study.__name__}: identified with"):
        study(found, RIG, *law, PATH, Uncertainty(covariance=np.eye(found.fit.values.size)))


def test_a_file_has_the_warnings_and_what_is_read_from_it_warns_again(tmp_path):
    wrong().save(tmp_path / "found.json")
    assert json.loads((tmp_path / "found.json").read_text())["provenance"]["warnings"] == wrong().warnings
    with pytest.warns(IdentificationWarning, match="ComputedTorque: identified with"):
        ComputedTorque(Identification.load(tmp_path / "found.json"))


def test_a_right_log_is_quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = identify(puma560.dynamics(), log(), seed=1, progress=False)
        ComputedTorque(found)
    assert "warning" not in repr(found)
