"""Order of the files: the longest first, so that no worker begins one of them when the other is
done.

Files go to workers as a whole (`--dist loadfile` in pyproject.toml): fixtures of a module are made
once. Each worker is one thread for linear algebra: two that wait for each other on a shared core
take twice the time of an identification.

numba makes so many objects that Python's search for cycles takes a sixth of its time, at the usual
threshold and over all tests that were collected: it is done seldom, and leaves those out.
"""

import gc
import os
from pathlib import Path
from zlib import crc32

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is loaded

LONGEST = (
    "test_stepwise",
    "test_commandline",
    "test_examples_of_the_reference",
    "test_methods",
    "test_tune",
    "test_any_rig",
    "test_effects",
    "test_plots",
    "test_c_running",
    "test_springs",
    "test_logged_load",
    "test_gears",
    "test_elastic",
    "test_heavy_load",
    "test_between_records",
    "test_undetermined",
    "test_guards",
    "test_replayed",
    "test_model_laws",
    "test_certify",
    "test_coupling",
    "test_real_data",
    "test_any_arm",
    "test_stick_slip_reference",
    "test_pid",
    "test_report",
    "test_procedure",
    "test_conditions",
    "test_learn",
)
"""By processor time from an empty kernel cache; those not named take less than 20 s each."""

gc.set_threshold(50_000, 20, 50)


SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").splitlines())
"""Tests that take long, by `tests/benchmarks/slow.py`."""


def pytest_addoption(parser):
    parser.addoption(
        "--slow-part", metavar="K/N", help="run the K-th of N parts of slow.txt alone, K from 0"
    )


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(config, items):
    part = config.getoption("--slow-part")
    if part:
        k, n = map(int, part.split("/"))
        chosen = [
            item for item in items if item.nodeid in SLOW and crc32(item.name.encode()) % n == k
        ]
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = chosen
    else:
        for item in items:
            if item.nodeid in SLOW:
                item.add_marker(pytest.mark.slow)
    # Without workers the order of the command line stays.
    if not hasattr(config, "workerinput"):
        return
    place = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


def pytest_collection_finish():
    gc.freeze()
