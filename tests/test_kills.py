"""Long work that is killed goes on and ends in the same bits; 20 kills of each kind:
tests/benchmarks/kills.py.
"""

import os

import pytest
from killed_work import KINDS, Server

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills need processes that fork")


@pytest.fixture(scope="module")
def server():
    with Server(0.4, 400) as server:
        yield server


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.slow] if kind == "certify" else []) for kind in KINDS],
)
def test_killed_work_goes_on_to_the_same_bits(server, tmp_path, kind):
    expected, alone = server.run(kind, None, tmp_path / "out")
    assert len(expected) == 64
    server.run(kind, tmp_path / "checkpoint.json", tmp_path / "out", 0.6 * alone)
    again, _ = server.run(kind, tmp_path / "checkpoint.json", tmp_path / "out")
    assert again == expected
    finished, _ = server.run(kind, tmp_path / "checkpoint.json", tmp_path / "out")
    assert finished == expected
