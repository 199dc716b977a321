"""Work on a thread beside the main thread, so that Ctrl-C comes through at once.

Machine code and LLVM do not look for signals. Interrupted work goes on to its end, and its
result is dropped; a compilation is ready for the next call.
"""

import contextvars
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar("T")

# time [s] after which the main thread looks for signals where a lock does not (Windows)
_WAIT = 0.2


def in_background(function: Callable[[], T], *, extra: int = 0) -> list[T]:
    """Results of a function that runs on 1 + `extra` threads at once.

    The main thread only waits; any other thread is one of them.
    """
    # Signals reach the main thread alone, so only this one has to be free of work.
    is_worker = threading.current_thread() is not threading.main_thread()
    results: list[Any] = []
    failures: list[BaseException] = []
    done = threading.Event()
    lock = threading.Lock()
    remaining = 1 + extra - is_worker

    def run(context: contextvars.Context) -> None:
        nonlocal remaining
        try:
            results.append(context.run(function))
        except BaseException as error:  # handed to who waits
            failures.append(error)
        with lock:
            remaining -= 1
            if not remaining or failures:
                # Threads see the caller's context variables, such as numpy's treatment of errors.
                # They are daemons: the end of an interrupted program does not wait for them.
                done.set()

    for _ in range(remaining):
        threading.Thread(target=run, args=(contextvars.copy_context(),), daemon=True).start()
    if is_worker:
        results.append(function())
    # On Windows a wait without a limit does not let Ctrl-C through.
    while (not is_worker or extra) and not done.wait(_WAIT):
        pass
    if failures:
        raise failures[0]
    return results


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def shared_out(function: Callable[[Any], T], items: Sequence[Any], threads: int) -> list[T]:
    """[function(item) for item in items], on several threads.

    An exception, and Ctrl-C, end the threads after their item.
    """
    results: list[Any] = [None] * len(items)
    # `pop` takes from the end and needs no lock; the reversed order begins with the first item.
    places = list(reversed(range(len(items))))

    def work() -> None:
        while places:
            try:
                i = places.pop()
            except IndexError:  # another thread took the last one
                return
            results[i] = function(items[i])

    try:
        in_background(work, extra=max(min(threads, len(items)) - 1, 0))
    finally:
        # Threads that still run find no further item.
        places.clear()
    return results
