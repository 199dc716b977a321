"""Many independent tasks by name: results as they come, failures named, and a folder from which
it goes on.
"""

import functools
import inspect
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from types import CellType
from typing import Any, cast

from ctc.campaigns.ledger import InMemory, Ledger
from plant.parts.arguments import known_options, whole
from plant.parts.kinds import field_names
from plant.parts.messages import progress_bar
from plant.parts.saved import fingerprint
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table
from plant.simulation.executors import Executor, finished, reason

Tasks = Mapping[str, tuple[Any, ...]] | Iterable[tuple[str, tuple[Any, ...]]]

_SHOWN = 20  # failures in a printed campaign
_FORM = "Give {name: (function, args, kwargs)}, or pairs of these, such as ('a', (f, (1,), {}))."


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Shown):
    """What became of the tasks of a campaign.

    Attributes
    ----------
    results : mapping of str -> result
        In the order of the tasks; of a campaign in a folder each is read when it is asked for.
    errors : mapping of str -> str
        Why each of the others failed, in one line.
    """

    results: Mapping[str, Any]
    errors: Mapping[str, str]

    def _short(self) -> str:
        return f"{len(self.results)} tasks done, {len(self.errors)} failed"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short())
        rows = list(itertools.islice(self.errors.items(), _SHOWN))
        if rows:
            yield Table(("failed", "why"), rows, words=(1,))


@known_options
def campaign(
    tasks: Tasks,
    *,
    executor: Any = None,
    folder: str | Path | None = None,
    retries: int = 1,
    each: Callable[[str, Any], Any] | None = None,
    progress: bool = True,
) -> Campaign:
    """Run many independent tasks, on this machine or many; with a folder, what is killed goes on.

    Parameters
    ----------
    tasks : mapping, or iterable of pairs
        Name -> (function, args, kwargs). An iterable is read as workers become free, so a million
        need not be listed.
    executor : optional
        Where they run: a `concurrent.futures.Executor`, a Dask ``Client``, or a function that makes
        one, which is called again when a worker was killed. By default threads, one per core.
    folder : str or Path, optional
        Where results are kept: those that have `save` in files of their own, plain values and
        arrays as JSON in ``ledger.sqlite``. Called again with the same tasks in the same order, and
        maybe more after them, it does those that are not done. Memory then does not grow with the
        number of tasks.
    retries : int
        How often a task that fails, or kills its worker, is tried again.
    each : callable, optional
        Called with name and result as they come, those kept in the folder before not among them.
    progress : bool
        Show a progress bar, with the time left, where standard error is a terminal.

    Returns
    -------
    Campaign
        ``.results`` and ``.errors`` by name.

    Raises
    ------
    ValueError
        Bad input; a folder of other tasks, another version or processor, or in use by another
        campaign; a folder that is full; an executor that is closed, or whose workers were killed
        where no function makes another.

    Notes
    -----
    Results do not depend on the number of workers. Arguments that a file can hold are compared with
    those of a folder value by value; functions by their text, and what they hold; other objects by
    class and attributes.

    See Also
    --------
    ctc.certify, identification.identify

    Examples
    --------
    >>> from ctc import campaign
    >>> done = campaign({"a": (divmod, (7, 2), {}), "b": (divmod, (1, 0), {})}, progress=False)
    >>> done.results["a"]
    (3, 1)
    >>> print(done.errors["b"])
    ZeroDivisionError: integer division or modulo by zero
    """
    retries = whole("retries", retries, "Give 0 or more.", least=0)
    if not isinstance(tasks, Iterable) or isinstance(tasks, str):
        raise ValueError(
            f"tasks must be a mapping or pairs; got a value of type {type(tasks).__name__}. {_FORM}"
        )
    total = len(tasks) if isinstance(tasks, Sized) else None
    where = Executor(executor)
    with (
        InMemory() if folder is None else Ledger(folder) as kept,
        progress_bar(total, "campaign", "task", progress) as bar,
    ):
        for (number, name), result, error in finished(
            _open(tasks, kept, bar.update), where, retries
        ):
            if error is None:
                try:
                    result = kept.done(number, name, result)
                except (ValueError, TypeError) as refused:
                    if str(refused).startswith("folder "):
                        raise
                    error = ValueError(f"its result must be kept in a file; {refused}")
            if error is not None:
                kept.failed(number, name, reason(error))
            elif each is not None:
                each(name, result)
            bar.update()
    return Campaign(results=kept.ended("done"), errors=kept.ended("failed"))


def _open(tasks: Tasks, kept: Any, skipped: Callable[[], Any]) -> Iterator[Any]:
    """The tasks that are not done, as calls with (number, name)."""
    fingerprints = _Fingerprints()
    for number, pair in enumerate(tasks.items() if isinstance(tasks, Mapping) else tasks):
        name, parts = _checked(pair)
        if kept.begins(number, name, fingerprints.of(parts) if isinstance(kept, Ledger) else None):
            yield (number, name), parts
        else:
            skipped()


def _checked(pair: Any) -> tuple[str, Any]:
    """Name and (function, args, kwargs) of a task."""
    if (
        not isinstance(pair, tuple | list)
        or len(pair) != 2
        or not isinstance(pair[0], str)
        or not pair[0]
    ):
        raise ValueError(
            f"a task must be a name and (function, args, kwargs); got {pair!r:.80}. {_FORM}"
        )
    name, parts = pair
    sound = isinstance(parts, tuple | list) and len(parts) == 3 and callable(parts[0])
    if not sound or not isinstance(parts[1], tuple | list) or not isinstance(parts[2], Mapping):
        raise ValueError(
            f"task {name!r:.60} must be (function, args, kwargs); got {parts!r:.80}. {_FORM}"
        )
    return name, parts


class _Fingerprints:
    """SHA-256 of tasks; what does not change, and comes again with the next task, is worked out
    once.
    """

    def __init__(self) -> None:
        self._last: dict[int, tuple[Any, Any]] = {}
        # objects that are being told: one that holds itself ends there
        self._within: list[int] = []

    def of(self, parts: Any) -> str:
        function, args, kwargs = parts
        called = (
            self._told(function),
            *map(self._one, args),
            {k: self._one(v) for k, v in kwargs.items()},
        )
        return fingerprint(called)

    def _one(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value
        frozen = field_names(type(value)) is not None
        if frozen and id(value) in self._last:
            return self._last[id(value)][1]
        try:
            made = fingerprint(value)
        except ValueError:
            made = self._told(value)
        if frozen:
            self._last = dict([*self._last.items(), (id(value), (value, made))][-16:])
        return made

    def _told(self, thing: Any) -> str:
        """Of a function its text, and what a method, closure or `partial` holds; of an object
        class and attributes.
        """
        if id(thing) in self._within:
            return ""
        self._within.append(id(thing))
        try:
            if isinstance(thing, functools.partial):
                return self.of((thing.func, thing.args, thing.keywords))
            if inspect.ismethod(thing):
                return self.of((thing.__func__, (thing.__self__,), {}))
            if inspect.isfunction(thing) and (
                thing.__closure__ or thing.__defaults__ or thing.__kwdefaults__
            ):
                cells = [
                    cell.cell_contents for cell in thing.__closure__ or () if cell != CellType()
                ]
                held = _text_of(thing), *cells, *(thing.__defaults__ or ())
                return self.of((type(thing), held, thing.__kwdefaults__ or {}))
            if inspect.isroutine(thing) or inspect.isclass(thing):
                return _text_of(cast(Any, thing))
            return self.of((type(thing), (), getattr(thing, "__dict__", {})))
        finally:
            self._within.pop()


@functools.lru_cache(maxsize=256)
def _text_of(function: Any) -> str:
    """What tells functions apart: their text; of those that have none, the name."""
    try:
        return inspect.getsource(inspect.unwrap(function))
    except (OSError, TypeError):
        name = getattr(function, "__qualname__", type(function).__qualname__)
        return f"{getattr(function, '__module__', '')}.{name}"
