"""The linear algebra library (BLAS) on one thread, while this library works.

Its own threads pay for large matrices alone. The matrices here are as long as a log and narrow:
shared out, their products wait for the slowest thread, a hundred times longer on a busy machine
(``tests/benchmarks/waiting.py``), and the order of a sum then depends on the number of threads.
"""

import contextlib
import functools
import sys
import threading
from collections.abc import Iterator
from typing import Any

from threadpoolctl import OpenBLASController, ThreadpoolController


class _OneThread(contextlib.ContextDecorator):
    """A context, and a decorator, in which BLAS has one thread; contexts may be nested."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            # The limit is the process's: the outermost context of all threads sets it.
            if not self._inside:
                controller = _controller("scipy.linalg" in sys.modules)
                with _controlling():
                    self._limit = controller.limit(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                with _controlling():
                    self._limit.restore_original_limits()


@contextlib.contextmanager
def _controlling() -> Iterator[None]:
    """A context in which this thread may set the limit, whichever thread has set it before."""
    OpenBLASController.clear_controlling_thread(force=True)
    yield
    OpenBLASController.clear_controlling_thread(force=True)


@functools.cache
def _controller(with_scipy: bool) -> Any:
    """Controller of the libraries that are loaded; scipy has one of its own, and is loaded late."""
    return ThreadpoolController()


one_thread = _OneThread()
