"""Calls on an executor of any kind, a bounded number at a time: results as they come, killed
workers outlived.

An executor keeps the contract of `concurrent.futures.Executor`; a Dask client gives one. A factory
makes another after a worker was killed: the calls that were open then run one at a time, until it
is known which of them kills.
"""

import functools
import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Self, TypeVar

from plant.compiler.background import cores
from plant.parts.arguments import several
from plant.version import __version__

T = TypeVar("T")

_UNKNOWN = 256  # calls given at once to an executor that does not say how many workers it has

_ADVICE = "Give a concurrent.futures.Executor, a Dask Client, or a function that makes one."
_KILLS = "its worker was killed, or ran out of memory"


@dataclass(frozen=True, repr=False)  # Dask would write out all arguments for a name
class _Work:
    """What is sent to a worker; `number` makes calls differ that are alike."""

    function: Callable[..., Any]
    args: Sequence[Any]
    kwargs: Mapping[str, Any]
    number: tuple[int, int]
    version: str = __version__

    def __call__(self) -> Any:
        if self.version != __version__:
            raise OtherVersionError(
                f"workers must have onepulse {self.version}; one has {__version__}. Install it."
            )
        return self.function(*self.args, **self.kwargs)


class OtherVersionError(ValueError):
    """A worker with another version of the library: its bits may differ."""


class Executor:
    """What a user gave as `executor=`: submits, and is made anew by its factory.

    In a ``with`` statement it serves several maps, and ends with it.
    """

    def __init__(self, given: Any) -> None:
        self._factory: Any
        self._held = False
        self._own = given is None or (
            callable(given) and (isinstance(given, type) or not hasattr(given, "submit"))
        )
        self._factory = functools.partial(ThreadPoolExecutor, cores()) if given is None else given
        if not self._own and not hasattr(given, "submit"):
            raise ValueError(
                f"executor must take calls; got a value of type {type(given).__name__}. {_ADVICE}"
            )
        self._renew()

    def __enter__(self) -> Self:
        self._held = True
        return self

    def __exit__(self, *_: object) -> None:
        self._held = False
        self.close()

    def _renew(self) -> None:
        executor = self._factory() if self._own else self._factory
        if not hasattr(executor, "submit"):
            raise ValueError(
                f"executor must make an executor; it made a {type(executor).__name__}. {_ADVICE}"
            )
        self._client = executor if hasattr(executor, "get_executor") else None
        self._pool = executor if self._client is None else executor.get_executor(pure=False)
        self.window = 2 * (getattr(self._pool, "_max_workers", None) or _UNKNOWN // 2)

    def outlive(self, names: Sequence[str]) -> None:
        """Another executor in place of one whose worker was killed while these calls were open."""
        if not self._own:
            raise ValueError(
                f"executor must be one whose workers live; one was killed while {several(names, 5)}"
                " ran. Give a function that makes executors, such as lambda:"
                " ProcessPoolExecutor(2), which then makes another."
            )
        held = self._held
        self._held = False
        self.close()
        self._held = held
        self._renew()

    def submit(self, work: _Work) -> Future[Any]:
        """A call begun; of a closed executor a refusal."""
        try:
            return self._pool.submit(work)
        except BrokenExecutor:
            raise
        except Exception as error:
            said = str(error).lower()
            client = getattr(self._pool, "_client", None)
            if (
                "shutdown" in said
                or "closed" in said
                or getattr(client, "status", "running") != "running"
            ):
                raise ValueError(
                    f"executor must be open; it is closed ({_said(error)}). Give one that runs."
                ) from None
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def close(self, wait: bool = True) -> None:
        """Give up an executor that was made here; the user's own stays open."""
        if self._held:
            return
        if self._own and self._client is not None:
            self._client.close()
        elif self._own:
            self._pool.shutdown(wait=wait)


@dataclass(eq=False)
class _Call:
    key: Any
    number: int
    parts: tuple[Callable[..., Any], Sequence[Any], Mapping[str, Any]]
    tries: int = 0
    alone: bool = False


def finished(
    calls: Iterable[tuple[T, tuple[Callable[..., Any], Sequence[Any], Mapping[str, Any]]]],
    executor: Executor,
    retries: int = 0,
) -> Iterator[tuple[T, Any, BaseException | None]]:
    """(key, result, error) of each call (key, (function, args, kwargs)), in the order in which they
    end.

    Calls are taken as there is room for them. One that raises, or kills its worker, is tried again
    `retries` times.
    """
    source, done = enumerate(calls), SimpleQueue[Future[Any]]()
    waiting, suspects, running = deque[_Call](), deque[_Call](), dict[Future[Any], _Call]()
    broken = False

    def following() -> _Call | None:
        """The next call for which there is room; while suspects are tried there is room for one."""
        if (
            broken
            or len(running) >= executor.window
            or any(call.alone for call in running.values())
        ):
            return None
        if suspects:
            return None if running else suspects.popleft()
        if waiting:
            return waiting.popleft()
        for number, (key, parts) in itertools.islice(source, 1):
            return _Call(key, number, parts)
        return None

    try:
        while True:
            while (call := following()) is not None:
                try:
                    future = executor.submit(_Work(*call.parts, (call.number, call.tries)))
                except BrokenExecutor:
                    waiting.append(call)
                    broken = True
                    break
                running[future] = call
                future.add_done_callback(done.put)
            if not running and not broken:
                return
            if running:
                future = done.get()
                call, error = running.pop(future), _error_of(future)
                _require_same_library(error)
                broken |= isinstance(error, BrokenExecutor)
                if error is None:
                    yield call.key, future.result(), None
                elif _killed(error) and not call.alone:  # this call, or one beside it
                    call.alone = True
                    suspects.append(call)
                # Dask has tried it again
                elif call.tries < retries and type(error).__name__ != "KilledWorker":
                    call.tries += 1
                    (suspects if call.alone else waiting).append(call)
                else:
                    yield call.key, None, error
            if broken and not running:
                executor.outlive([str(call.key) for call in suspects])
                broken = False
    finally:
        for future in running:
            future.cancel()
        executor.close(wait=not running)


def mapped(function: Callable[[Any], T], items: Sequence[Any], executor: Any) -> list[T]:
    """[function(item) for item in items] on the user's executor; the first failure is raised."""
    results: list[Any] = [None] * len(items)
    calls: Any = ((i, (function, (item,), {})) for i, item in enumerate(items))
    for i, result, error in finished(
        calls, executor if isinstance(executor, Executor) else Executor(executor)
    ):
        if isinstance(error, ValueError):
            raise error
        if error is not None:
            raise ValueError(
                f"executor must do each part of the work; one failed: {reason(error)}"
            ) from error
        results[i] = result
    return results


def reason(error: BaseException) -> str:
    """One line that says why a call failed."""
    if _killed(error):
        return f"{_KILLS} ({_said(error)})"
    if "pickle" in f"{type(error).__name__} {error}".lower() or "serialize" in str(error).lower():
        return (
            f"it cannot be sent to another process: {_said(error)}. Give functions and arguments of"
            " modules."
        )
    return _said(error)


def _killed(error: BaseException) -> bool:
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def _said(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text:.300}" if text else type(error).__name__


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _require_same_library(error: BaseException | None) -> None:
    """Stop where workers have no such library: every call would fail there."""
    if isinstance(error, OtherVersionError):
        raise error
    if isinstance(error, ModuleNotFoundError) and error.name in ("plant", "identification", "ctc"):
        raise ValueError(
            f"workers must have onepulse {__version__}; one has none. Install it there."
        )
