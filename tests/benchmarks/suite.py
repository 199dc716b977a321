"""What the tests cost, per module: ``python tests/benchmarks/suite.py [--tests] [PYTEST-ARGS]``.

Runs pytest from an empty kernel cache (or from ``--cache FOLDER``), and prints one line per module,
the dearest first: processor time of the tests and their fixtures, that of the processes they start,
and the kernels that they compiled, their number and the elapsed time. Elapsed time depends on what
else a machine does; processor time hardly does. ``--tests`` prints a line per test.
"""

import argparse
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = ("processor", "children", "kernels", "compiling")


class _Compiled(logging.Handler):
    """Counts the compilations of which the library's log speaks."""

    def __init__(self):
        super().__init__(logging.INFO)
        self.kernels, self.seconds = 0, 0.0

    def emit(self, record):
        if "compiled in" in record.msg:
            self.kernels += 1
            self.seconds += record.args[-1]


_COMPILED = _Compiled()


def _spent():
    times = os.times()
    used = times.user + times.system
    return used, times.children_user + times.children_system, _COMPILED.kernels, _COMPILED.seconds


def pytest_configure(config):
    log = logging.getLogger("onepulse.compiler")
    log.addHandler(_COMPILED)
    log.setLevel(logging.INFO)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    item.config.before = _spent()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    now = _spent()
    report.spent = [after - before for after, before in zip(now, item.config.before, strict=True)]
    item.config.before = now
    return report


def pytest_terminal_summary(terminalreporter, config):
    totals = defaultdict(lambda: [0.0] * len(COLUMNS))
    for reports in terminalreporter.stats.values():
        for report in reports:
            if hasattr(report, "spent"):
                name = report.nodeid if os.environ.get("SUITE_TESTS") else report.fspath
                totals[name] = [a + b for a, b in zip(totals[name], report.spent, strict=True)]
    totals["all"] = [sum(column) for column in zip(*totals.values(), strict=True)]
    terminalreporter.write_line("".join(f"{name:>11}" for name in COLUMNS))
    for name, spent in sorted(totals.items(), key=lambda pair: -sum(pair[1][:2])):
        terminalreporter.write_line("".join(f"{x:11.1f}" for x in spent) + f"  {name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tests", action="store_true", help="a line per test")
    parser.add_argument("--cache", help="folder of compiled kernels; without it, an empty one")
    options, rest = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | {"ONEPULSE_CACHE": options.cache or empty}
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        environment |= {"PYTHONPATH": path, "SUITE_TESTS": "1" if options.tests else ""}
        began = time.monotonic()
        command = [sys.executable, "-m", "pytest", "-p", "suite", *rest]
        status = subprocess.call(command, cwd=ROOT, env=environment)  # noqa: S603
        print(f"{time.monotonic() - began:.0f} s elapsed")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
