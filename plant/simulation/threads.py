"""Parallel map over threads, with the same result for any number of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

__all__ = ["cores", "shared_out"]

T = TypeVar("T")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def shared_out(function: Callable[[Any], T], items: Sequence[Any], threads: int) -> list[T]:
    """[function(item) for item in items], by so many threads, of which this is one."""
    results: list[Any] = [None] * len(items)
    places = iter(range(len(items)))

    def work() -> None:
        for i in places:
            results[i] = function(items[i])

    others = min(threads, len(items)) - 1
    if others < 1:
        work()
        return results
    with ThreadPoolExecutor(others) as pool:
        running = [pool.submit(work) for _ in range(others)]
        work()
        for future in running:
            future.result()
    return results
