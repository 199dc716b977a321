"""Real logs, in the folder CTC_DATA where there is one; examples/5_real_tx40.py says where the originals are."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

DATA = os.environ.get("CTC_DATA")
EXAMPLES = Path(__file__).parent.parent / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def folder(name):
    if not DATA:
        pytest.skip("CTC_DATA is not set: no real logs to fit")
    path = Path(DATA) / name
    if not path.is_dir():
        pytest.skip(f"CTC_DATA holds no folder {name}")
    return path


def test_tx40_fit_is_the_published_one():
    """At least 55 of the 60 published values within one published standard deviation, all within 3; error <= 5.4 %."""
    table, found = example("5_real_tx40").compare(folder("staubli_tx40"))
    off = np.array([abs(ours - value) / std for _, ours, value, std in table])
    assert len(off) == 60
    assert (off <= 1).sum() >= 55
    assert off.max() <= 3
    assert found.relative_error <= 0.054


def test_tx40_example_says_where_the_log_is_when_there_is_none(monkeypatch, capsys):
    monkeypatch.delenv("CTC_DATA", raising=False)
    assert example("5_real_tx40").main() == 0
    assert "CTC_DATA is not set" in capsys.readouterr().out
