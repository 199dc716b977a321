"""Many independent tasks by name: results as they come, named failures, a folder to resume from."""

import functools
import inspect
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from types import CellType
from typing import Any, cast

from ctc.campaigns.ledger import InMemory, Ledger
from plant.parts import Piece, Shown, Table, Verdict, known_options, progress_bar, whole
from plant.parts.kinds import field_names
from plant.parts.saved import fingerprint
from plant.simulation.executors import Executor, finished, reason

Tasks = Mapping[str, tuple[Any, ...]] | Iterable[tuple[str, tuple[Any, ...]]]

# Advice of every message about a task that has another form.
_FORM = "Give {name: (function, args, kwargs)}, or pairs of these, such as ('a', (f, (1,), {}))."


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Shown):
    """Results and failures of the tasks of a campaign.

    Attributes
    ----------
    results : mapping of str -> result
        In the order of the tasks; a campaign in a folder reads each on access.
    errors : mapping of str -> str
        Reason of each failure, in one line.
    """

    results: Mapping[str, Any]
    errors: Mapping[str, str]

    def _short(self) -> str:
        return f"{len(self.results)} tasks done, {len(self.errors)} failed"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short())
        # A screen of failures: a campaign of a million may have as many.
        rows = list(itertools.islice(self.errors.items(), 20))
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
    """Run many independent tasks, on one machine or many; a folder lets a killed campaign resume.

    Parameters
    ----------
    tasks : mapping, or iterable of pairs
        Name -> (function, args, kwargs). An iterable is read as workers become free, so a million
        need not be listed.
    executor : optional
        A `concurrent.futures.Executor`, a Dask ``Client``, or a function that makes one, which is
        called again when a worker was killed. By default threads, one per core.
    folder : str or Path, optional
        Folder of the results: those that have `save` in files of their own, plain values and arrays
        as JSON in ``ledger.sqlite``. A later call with the same tasks in the same order, and maybe
        more after them, does the unfinished ones. Memory then does not grow with the number of
        tasks.
    retries : int
        Number of further attempts of a task that fails, or kills its worker.
    each : callable, optional
        Called with name and result of each task that ends, not of those that the folder held.
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
    those of a folder value by value; functions by their text and the values they hold; other
    objects by class and attributes.

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
    # A text is iterable, too: its letters would be refused one by one.
    if not isinstance(tasks, Iterable) or isinstance(tasks, str):
        raise ValueError(
            f"tasks must be a mapping or pairs; got a value of type {type(tasks).__name__}. {_FORM}"
        )
    # An iterator has no length; its progress bar counts without an end.
    total = len(tasks) if isinstance(tasks, Sized) else None
    pool = Executor(executor)
    with (
        InMemory() if folder is None else Ledger(folder) as ledger,
        progress_bar(total, "campaign", "task", progress) as bar,
    ):
        # `finished` takes one task at a time, so that the ledger need not hold them all.
        calls = _open(tasks, ledger, bar.update)
        for (number, name), result, error in finished(calls, pool, retries):
            if error is None:
                try:
                    result = ledger.done(number, name, result)
                except (ValueError, TypeError) as refused:
                    # A full disk ends the campaign; a result that no file can hold fails alone.
                    if str(refused).startswith("folder "):
                        raise
                    error = ValueError(f"its result must be kept in a file; {refused}")
            if error is not None:
                ledger.failed(number, name, reason(error))
            elif each is not None:
                # A failed task also counts as ended.
                each(name, result)
            bar.update()
    return Campaign(results=ledger.ended("done"), errors=ledger.ended("failed"))


def _open(tasks: Tasks, ledger: Any, skipped: Callable[[], Any]) -> Iterator[Any]:
    """Unfinished tasks, as calls with (number, name)."""
    fingerprints = _Fingerprints()
    # The pairs may be endless or read from a file: one at a time.
    for number, pair in enumerate(tasks.items() if isinstance(tasks, Mapping) else tasks):
        name, call = _checked(pair)
        # In memory no earlier call can have had other tasks of these names.
        work = fingerprints.of(call) if isinstance(ledger, Ledger) else None
        if ledger.begins(number, name, work):
            yield (number, name), call
        else:
            skipped()


def _checked(pair: Any) -> tuple[str, Any]:
    """Name and (function, args, kwargs) of a task."""
    # A mistake in the form of a task is met here, not on a worker.
    if (
        not isinstance(pair, tuple | list)
        or len(pair) != 2
        or not isinstance(pair[0], str)
        or not pair[0]
    ):
        raise ValueError(
            f"a task must be a name and (function, args, kwargs); got {pair!r:.80}. {_FORM}"
        )
    name, call = pair
    sound = isinstance(call, tuple | list) and len(call) == 3 and callable(call[0])
    if not sound or not isinstance(call[1], tuple | list) or not isinstance(call[2], Mapping):
        raise ValueError(
            f"task {name!r:.60} must be (function, args, kwargs); got {call!r:.80}. {_FORM}"
        )
    return name, call


class _Fingerprints:
    """SHA-256 of tasks; that of a frozen value which comes again with the next task is reused."""

    def __init__(self) -> None:
        # Id -> (value, fingerprint) of the frozen values used last. The value itself is held, so
        # that no other object gets its id.
        self._recent: dict[int, tuple[Any, Any]] = {}
        # Ids of the objects being described: one that holds itself ends there.
        self._within: list[int] = []

    def of(self, call: Any) -> str:
        function, args, kwargs = call
        text = self._described(function)
        values = [self._value(value) for value in args]
        named = {name: self._value(value) for name, value in kwargs.items()}
        return fingerprint((text, *values, named))

    def _value(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value
        # Only what cannot change may be reused.
        frozen = field_names(type(value)) is not None
        if frozen and id(value) in self._recent:
            return self._recent[id(value)][1]
        try:
            digest = fingerprint(value)
        except ValueError:
            # No file can hold it.
            digest = self._described(value)
        if frozen:
            # Tasks share a handful of records and arms; sixteen bound the memory. Chosen by hand.
            recent = [*self._recent.items(), (id(value), (value, digest))]
            self._recent = dict(recent[-16:])
        return digest

    def _described(self, thing: Any) -> str:
        """Fingerprint of a function by its text and the values it holds, else of an object.

        A method holds its object, a closure its variables, a `partial` its arguments; an object is
        its class and attributes.
        """
        if id(thing) in self._within:
            return ""
        # A `partial` and a method are called as their function with more arguments.
        self._within.append(id(thing))
        try:
            if isinstance(thing, functools.partial):
                return self.of((thing.func, thing.args, thing.keywords))
            # Two closures of one text differ by the values that they hold.
            if inspect.ismethod(thing):
                return self.of((thing.__func__, (thing.__self__,), {}))
            if inspect.isfunction(thing) and (
                thing.__closure__ or thing.__defaults__ or thing.__kwdefaults__
            ):
                # An empty cell belongs to a variable that is not assigned yet.
                cells = [
                    cell.cell_contents for cell in thing.__closure__ or () if cell != CellType()
                ]
                values = (_text_of(thing), *cells, *(thing.__defaults__ or ()))
                return self.of((type(thing), values, thing.__kwdefaults__ or {}))
            if inspect.isroutine(thing) or inspect.isclass(thing):
                return _text_of(cast(Any, thing))
            return self.of((type(thing), (), getattr(thing, "__dict__", {})))
        finally:
            self._within.pop()


@functools.lru_cache(maxsize=256)
def _text_of(function: Any) -> str:
    """Source text of a function or class; its name where it has none, as compiled ones."""
    try:
        return inspect.getsource(inspect.unwrap(function))
    except (OSError, TypeError):
        name = getattr(function, "__qualname__", type(function).__qualname__)
        return f"{getattr(function, '__module__', '')}.{name}"
