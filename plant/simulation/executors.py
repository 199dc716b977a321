"""Calls on an executor of any kind, a bounded number at a time, which survive killed workers.

An executor keeps the contract of `concurrent.futures.Executor`; a Dask client gives one. A factory
makes another after a worker was killed: the open calls then run one at a time, which shows the one
that kills.
"""

import functools
import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Self, TypeVar

from plant.compiler import cores
from plant.parts import several
from plant.version import __version__

T = TypeVar("T")

# Calls given at once to an executor that does not say how many workers it has.
_UNKNOWN = 256

_ADVICE = "Give a concurrent.futures.Executor, a Dask Client, or a function that makes one."
_KILLS = "its worker was killed, or ran out of memory"


@dataclass(frozen=True, repr=False)  # Dask would write out all arguments for a name
class _Work:
    """A call as it is sent to a worker; `number` distinguishes equal calls."""

    function: Callable[..., Any]
    args: Sequence[Any]
    kwargs: Mapping[str, Any]
    number: tuple[int, int]
    version: str = __version__

    def __call__(self):
        if self.version != __version__:
            # Another version may give other bits, which no result would show.
            raise OtherVersionError(
                f"workers must have onepulse {self.version}; one has {__version__}. Install it."
            )
        return self.function(*self.args, **self.kwargs)


class OtherVersionError(ValueError):
    """A worker with another version of the library: its bits may differ."""


class Executor:
    """The user's `executor=`, or one from the user's factory, replaced if a worker dies.

    In a ``with`` statement it serves several maps, and ends with it.
    """

    def __init__(self, executor: Any) -> None:
        self._held = False
        if executor is None:
            executor = functools.partial(ThreadPoolExecutor, cores())
        # A class has `submit`, too, but it makes executors.
        submits = hasattr(executor, "submit")
        self._has_factory = callable(executor) and (isinstance(executor, type) or not submits)
        if not self._has_factory and not submits:
            kind = type(executor).__name__
            raise ValueError(f"executor must take calls; got a value of type {kind}. {_ADVICE}")
        self._given: Any = executor
        self._renew()

    def __enter__(self) -> Self:
        # Maps inside the statement leave the executor open.
        self._held = True
        return self

    def __exit__(self, *_: object) -> None:
        self._held = False
        self.close()

    def _renew(self):
        executor = self._given() if self._has_factory else self._given
        if not hasattr(executor, "submit"):
            raise ValueError(
                f"executor must make an executor; it made a {type(executor).__name__}. {_ADVICE}"
            )
        # A Dask client is no executor, but gives one.
        self._client = executor if hasattr(executor, "get_executor") else None
        self._pool = executor if self._client is None else executor.get_executor(pure=False)
        # Two calls per worker, so that the next is there when one ends.
        self.window = 2 * (getattr(self._pool, "_max_workers", None) or _UNKNOWN // 2)

    def outlive(self, names: Sequence[str]) -> None:
        """Replace the executor, a worker of which was killed while these calls were open."""
        if not self._has_factory:
            raise ValueError(
                f"executor must be one whose workers live; one was killed while {several(names, 5)}"
                " ran. Give a function that makes executors, such as lambda:"
                " ProcessPoolExecutor(2), which then makes another."
            )
        # Closed in any case, but still held by the statement around it.
        held = self._held
        self._held = False
        self.close()
        self._held = held
        self._renew()

    def submit(self, work: _Work) -> Future[Any]:
        """Begin a call; refuse one on a closed executor."""
        try:
            return self._pool.submit(work)
        except BrokenExecutor:
            raise
        except Exception as error:
            # Executors have no common error for being closed, only the word.
            text = str(error).lower()
            status = getattr(getattr(self._pool, "_client", None), "status", "running")
            if "shutdown" in text or "closed" in text or status != "running":
                raise ValueError(
                    f"executor must be open; it is closed ({_line(error)}). Give one that runs."
                ) from None
            # Any other error, as of arguments that cannot be sent, belongs to this call alone.
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def close(self, wait: bool = True) -> None:
        """Close an executor that the factory made; the user's stays open."""
        if self._held or not self._has_factory:
            return
        if self._client is not None:
            self._client.close()
        else:
            self._pool.shutdown(wait=wait)


@dataclass(eq=False)
class _Call:
    """A call of a function, waiting or running."""

    # The caller's name for it, and its place among the calls.
    key: Any
    number: int
    # Function, arguments and keyword arguments.
    parts: tuple[Callable[..., Any], Sequence[Any], Mapping[str, Any]]
    # Tries that failed so far.
    tries: int = 0
    # Whether nothing else may run beside it, since it may kill its worker.
    alone: bool = False


def finished(
    calls: Iterable[tuple[T, tuple[Callable[..., Any], Sequence[Any], Mapping[str, Any]]]],
    executor: Executor,
    retries: int = 0,
) -> Iterator[tuple[T, Any, BaseException | None]]:
    """(key, result, error) of each call, in the order in which they end.

    A call is (key, (function, args, kwargs)).

    Calls are taken as there is room for them. One that raises, or kills its worker, is tried again
    `retries` times.
    """
    source = enumerate(calls)
    ended = SimpleQueue[Future[Any]]()
    waiting = deque[_Call]()  # to be tried again
    suspects = deque[_Call]()  # open when a worker was killed
    running = dict[Future[Any], _Call]()
    broken = False

    def following() -> _Call | None:
        """The next call for which there is room; while suspects are tried there is room for one."""
        full = len(running) >= executor.window
        if broken or full or any(call.alone for call in running.values()):
            return None
        if suspects:
            return None if running else suspects.popleft()
        if waiting:
            return waiting.popleft()
        # Calls are made one by one: there may be more than fit in memory.
        for number, (key, parts) in itertools.islice(source, 1):
            return _Call(key, number, parts)
        return None

    try:
        while True:
            # 1. Begin calls while there is room.
            while (call := following()) is not None:
                try:
                    future = executor.submit(_Work(*call.parts, (call.number, call.tries)))
                except BrokenExecutor:
                    waiting.append(call)
                    broken = True
                    break
                running[future] = call
                future.add_done_callback(ended.put)
            if not running and not broken:
                return

            # 2. Take the next call that ends.
            if running:
                future = ended.get()
                call, error = running.pop(future), _error_of(future)
                _require_same_library(error)
                # A pool breaks as a whole; Dask replaces its worker itself.
                broken |= isinstance(error, BrokenExecutor)
                if error is None:
                    yield call.key, future.result(), None
                elif _killed(error) and not call.alone:
                    # This call killed the worker, or one beside it.
                    call.alone = True
                    suspects.append(call)
                elif call.tries < retries and type(error).__name__ != "KilledWorker":
                    # Dask itself has tried again the call of a KilledWorker.
                    call.tries += 1
                    (suspects if call.alone else waiting).append(call)
                else:
                    yield call.key, None, error

            # 3. A broken executor is replaced once all its calls have ended.
            if broken and not running:
                executor.outlive([str(call.key) for call in suspects])
                broken = False
    finally:
        for future in running:
            # The caller stopped, or a call failed: what has not begun need not run.
            future.cancel()
        executor.close(wait=not running)


def mapped(function: Callable[[Any], T], items: Sequence[Any], executor: Any) -> list[T]:
    """[function(item) for item in items] on the user's executor; the first failure is raised."""
    results: list[Any] = [None] * len(items)
    calls: Any = ((i, (function, (item,), {})) for i, item in enumerate(items))
    if not isinstance(executor, Executor):
        executor = Executor(executor)
    # Calls end in any order; the number of each puts its result in place.
    for i, result, error in finished(calls, executor):
        # A refusal of the work itself has its own message.
        if isinstance(error, ValueError):
            raise error
        if error is not None:
            raise ValueError(
                f"executor must do each part of the work; one failed: {reason(error)}"
            ) from error
        results[i] = result
    return results


def reason(error: BaseException) -> str:
    """The reason for which a call failed, in one line."""
    line = _line(error)
    if _killed(error):
        return f"{_KILLS} ({line})"
    if "pickle" in f"{type(error).__name__} {error}".lower() or "serialize" in str(error).lower():
        return (
            f"it cannot be sent to another process: {line}. Give functions and arguments of"
            " modules."
        )
    return line


def _killed(error):
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def _line(error):
    # Messages of executors may have many lines, and whole tracebacks.
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text:.300}" if text else type(error).__name__


def _error_of(future):
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _require_same_library(error):
    """Stop if workers lack the library or have another version: every call would fail there."""
    if isinstance(error, OtherVersionError):
        raise error
    if isinstance(error, ModuleNotFoundError) and error.name in ("plant", "identification", "ctc"):
        raise ValueError(
            f"workers must have onepulse {__version__}; one has none. Install it there."
        )
