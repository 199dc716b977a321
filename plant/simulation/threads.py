"""Parallel map over threads, with the same result for any number of them."""

import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from plant.compiler.background import in_background

T = TypeVar("T")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def shared_out(function: Callable[[Any], T], items: Sequence[Any], threads: int) -> list[T]:
    """[function(item) for item in items], by so many threads; what raises, and Ctrl-C, ends them after their item."""
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
