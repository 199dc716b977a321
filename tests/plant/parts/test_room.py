"""What does not fit into memory is refused before the work, with the number that would."""

import re

import pytest

import plant.parts.room as room
from identification import identify
from plant import puma560, simulate

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()


def test_some_memory_is_free():
    assert 1e6 < room.free_memory() < 1e15


def test_a_simulation_that_does_not_fit_says_what_would(monkeypatch):
    with pytest.raises(
        ValueError, match=r"simulation of 1,428,571,428,\d\d\d samples must fit .* GB are free"
    ):
        simulate(ARM, RIG, LAW, PATH, duration=1e9)
    monkeypatch.setattr(room, "free_memory", lambda: 1e6)
    with pytest.raises(ValueError, match="samples or fewer") as refused:
        simulate(ARM, RIG, LAW, PATH)
    most = int(re.search("Simulate ([0-9,]+)", str(refused.value))[1].replace(",", ""))
    assert len(simulate(ARM, RIG, LAW, PATH, duration=most * RIG.period)) == most


def test_an_identification_that_does_not_fit_says_what_would(monkeypatch):
    record = simulate(ARM, RIG, LAW, PATH, duration=0.3)
    monkeypatch.setattr(room, "free_memory", lambda: 0.2e9 / 0.9 + 4.5e5)
    with pytest.raises(
        ValueError, match="429 samples of 2 joints with 9 unknowns must fit"
    ) as refused:
        identify(puma560.dynamics(), record, progress=False)
    most = int(re.search("Give ([0-9,]+)", str(refused.value))[1].replace(",", ""))
    assert 0 < most < 429
    assert identify(
        puma560.dynamics(), record, method="equation_error", progress=False
    ).arm.f.shape == (9,)
