"""Measure the processor time of each test, and list the slow tests in `tests/slow.txt`.

    python tests/benchmarks/slow.py [--longest 2.5] [--case 0.7] [--workers 2]

The script runs the whole suite, with the slow tests, and replaces the table. The table names

- each test or case whose call takes at least `--longest` seconds of processor time, and
- each case that takes at least `--case` seconds, except the quickest case of its test.

The processor time includes that of child processes, but not that of fixtures. `pytest` leaves out
what the table names, `pytest -m slow` runs it, and each run of CI takes a part of it
(`--slow-part`).
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests" / "slow.txt"
HEADER = """\
# Tests that `pytest` leaves out, since they take long: `pytest -m slow` runs them, and CI a part.
# Written by tests/benchmarks/slow.py from the processor time of each test.
"""
TIMES = "ONEPULSE_TEST_TIMES"
"""The environment variable that names the folder in which workers write their tests' times."""


def processor_seconds():
    """Processor time [s] of this process and of the children that it has waited for."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Append the processor time of a test's call to the file of this process."""
    begun = processor_seconds()
    try:
        return (yield)
    finally:
        seconds = processor_seconds() - begun
        with (Path(os.environ[TIMES]) / str(os.getpid())).open("a") as file:
            file.write(f"{seconds:.3f} {item.nodeid}\n")


def measured(workers):
    """Processor time [s] of the call of every test that ran, by the name of the test."""
    with tempfile.TemporaryDirectory() as folder:
        places = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {TIMES: folder, "PYTHONPATH": os.pathsep.join(places)}
        command = [sys.executable, "-m", "pytest", "-p", "slow", "-m", "", "-n", str(workers)]
        done = subprocess.run(command, cwd=ROOT, env=environment, check=False)  # noqa: S603
        if done.returncode not in (0, 1):  # 1: tests failed, and have times all the same
            raise SystemExit(f"pytest ended with {done.returncode}; the table stays as it is.")
        rows = [row for file in Path(folder).iterdir() for row in file.read_text().splitlines()]
    return {name: float(seconds) for seconds, name in (row.split(" ", 1) for row in rows)}


def slow(seconds, longest, case):
    """Sorted names of the tests that the table lists, from the times [s] by name."""
    names = {name for name, time in seconds.items() if time >= longest}
    cases = {}
    for name in seconds:
        if "[" in name:
            cases.setdefault(name.partition("[")[0], []).append(name)
    for of_test in cases.values():
        _, *others = sorted(of_test, key=seconds.get)
        names.update(name for name in others if seconds[name] >= case)
    return sorted(names)


def main():
    """Measure the tests, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--longest", type=float, default=2.5)
    parser.add_argument("--case", type=float, default=0.7)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seconds = measured(options.workers)
    names = slow(seconds, options.longest, options.case)
    TABLE.write_text(HEADER + "".join(f"{name}\n" for name in names), encoding="utf-8")
    apart = sum(seconds[name] for name in names)
    print(f"{len(names)} of {len(seconds)} tests, {apart:.0f} of {sum(seconds.values()):.0f} s")


if __name__ == "__main__":
    main()
