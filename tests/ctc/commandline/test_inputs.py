"""Inputs of the commands: which motions a certificate is asked for."""

from types import SimpleNamespace

import pytest

from ctc.commandline import inputs


@pytest.fixture
def identification(monkeypatch):
    monkeypatch.setattr(inputs, "path_of", lambda found, path: f"path of {path}")
    monkeypatch.setattr(inputs, "everyday_motions", lambda arm, rig: {"creep": "slow"})
    return SimpleNamespace(arm=None, rig=None)


def test_a_path_joins_the_everyday_motions_by_the_name_of_its_file(identification):
    assert inputs.motions_asked(identification, None, everyday=True) == {"creep": "slow"}
    motions = inputs.motions_asked(identification, "work/weld.csv", everyday=True)
    assert motions == {"creep": "slow", "weld": "path of work/weld.csv"}
    assert inputs.motions_asked(identification, "weld.csv", everyday=False) == "path of weld.csv"
