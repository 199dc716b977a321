"""Ctrl-C comes through while threads work; what they raise, and their context, comes through as
well.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from plant.compiler import in_background, shared_out

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


@pytest.fixture(autouse=True)
def raised():
    """Ctrl-C raises, also where whoever started the tests ignores it, as a shell does for what
    runs behind it.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt_after(seconds):
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.daemon = True
    timer.start()


def test_an_interrupt_comes_through_while_the_work_goes_on():
    ended, waiting = threading.Event(), threading.Event()
    interrupt_after(0.05)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        in_background(lambda: (waiting.wait(5), ended.set()))
    assert time.monotonic() - began < 0.5
    assert not ended.is_set()
    waiting.set()
    assert ended.wait(5)


def test_interrupted_items_stop_after_those_at_hand():
    done, hold = [], threading.Event()

    def item(i):
        hold.wait(5)
        done.append(i)

    interrupt_after(0.05)
    with pytest.raises(KeyboardInterrupt):
        shared_out(item, range(100), 2)
    hold.set()
    time.sleep(0.05)
    assert sorted(done) == [0, 1]
    assert shared_out(lambda i: i * i, range(7), 3) == [0, 1, 4, 9, 16, 25, 36]


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_every_item_is_done_once_and_the_first_error_is_raised(threads):
    assert shared_out(str, range(50), threads) == [str(i) for i in range(50)]
    assert shared_out(str, [], threads) == []

    def item(i):
        if i == 3:
            raise LookupError("the third")
        return i

    with pytest.raises(LookupError, match="the third"):
        shared_out(item, range(50), threads)


def test_within_a_thread_the_work_is_done_by_that_thread():
    where = in_background(lambda: in_background(threading.get_ident)[0] == threading.get_ident())
    assert where == [True]
    assert len(set(in_background(lambda: in_background(threading.get_ident, extra=2))[0])) <= 3


def test_the_context_of_the_caller_is_that_of_the_work():
    with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
        in_background(lambda: np.ones(1) / np.zeros(1))


SCRIPT = """
import os, signal, threading
import casadi as ca, numpy as np
from plant.compiler import kernel_cache
from plant.compiler.intrinsics import MapKernel
signal.signal(signal.SIGINT, signal.default_int_handler)
x = ca.SX.sym("x", 30)
y = x
for _ in range(12):
    y = ca.sin(y) + y[::-1] * x
kernel = MapKernel(ca.Function("f", [x], [y]))
point = np.linspace(0, 1, 30)[:, None]
timer = threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT))
timer.start()
try:
    kernel(point)
    interrupted = False
except KeyboardInterrupt:
    interrupted = True
np.testing.assert_allclose(kernel(point).ravel(), ca.Function("f", [x], [y])(point).full().ravel(), rtol=1e-9)
print(f"interrupted {interrupted}, noted {kernel._kernel._noted() != {}}")
"""


def test_an_interrupted_compilation_leaves_no_half_written_cache(tmp_path):
    """Called again it works, in this process and in the next."""
    for _ in range(2):
        said = subprocess.run(  # noqa: S603 - the script above
            [sys.executable, "-c", SCRIPT],
            env={
                **os.environ,
                "ONEPULSE_CACHE": str(tmp_path / "cache"),
                "PYTHONPATH": str(Path(__file__).parents[3]),
            },
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert said.returncode == 0, said.stderr
        assert said.stdout.strip() == "interrupted True, noted True"
