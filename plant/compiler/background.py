"""Work on a thread of its own while the main thread waits: Ctrl-C comes through at once, whatever
runs there.

Machine code and LLVM do not look for signals. What is interrupted goes on by itself to its end, and
what it gives is dropped; a compilation is there for the next call.
"""

import contextvars
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar("T")

# time [s] after which the main thread looks for signals where a lock does not (Windows)
_WAIT = 0.2


def in_background(function: Callable[[], T], *, others: int = 0) -> list[T]:
    """What a function gives on 1 + `others` threads at once; only the main thread waits, another
    is one of them.
    """
    own = threading.current_thread() is not threading.main_thread()
    results: list[Any] = []
    failures: list[BaseException] = []
    done, lock, left = threading.Event(), threading.Lock(), 1 + others - own

    def run(context: contextvars.Context) -> None:
        nonlocal left
        try:
            results.append(context.run(function))
        except BaseException as error:  # handed to who waits
            failures.append(error)
        with lock:
            left -= 1
            if not left or failures:
                done.set()

    for _ in range(left):
        threading.Thread(target=run, args=(contextvars.copy_context(),), daemon=True).start()
    if own:
        results.append(function())
    while (not own or others) and not done.wait(_WAIT):
        pass
    if failures:
        raise failures[0]
    return results


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def shared_out(function: Callable[[Any], T], items: Sequence[Any], threads: int) -> list[T]:
    """[function(item) for item in items], by so many threads; what raises, and Ctrl-C, ends them
    after their item.
    """
    results: list[Any] = [None] * len(items)
    places = list(reversed(range(len(items))))

    def work() -> None:
        while places:
            try:
                i = places.pop()
            except IndexError:  # another thread took the last one
                return
            results[i] = function(items[i])

    try:
        in_background(work, others=max(min(threads, len(items)) - 1, 0))
    finally:
        places.clear()
    return results
