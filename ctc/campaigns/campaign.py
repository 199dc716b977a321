"""Many independent tasks by name: results as they come, named failures, a folder to resume from."""

import copyreg
import functools
import inspect
import itertools
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from types import CellType, MappingProxyType
from typing import Any, cast

import numpy as np

from ctc.campaigns.ledger import InMemory, Ledger
from plant.parts import (
    Piece,
    Shown,
    Table,
    Verdict,
    field_names,
    fingerprint,
    known_options,
    progress_bar,
    whole,
)
from plant.simulation import Executor, finished, reason

Tasks = Mapping[str, tuple[Any, ...]] | Iterable[tuple[str, tuple[Any, ...]]]

# The advice that ends every message about a task of a wrong form.
_FORM = "Give {name: (function, args, kwargs)}, or pairs of these, such as ('a', (f, (1,), {}))."

# What a function does, without the places of its lines in a file.
_CODE = (
    "code",
    "consts",
    "names",
    "varnames",
    "flags",
    "argcount",
    "posonlyargcount",
    "kwonlyargcount",
    "exceptiontable",
)


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
        # The first twenty fit on a screen: a campaign may have a million failures.
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
        Folder of the results. A result that has `save` goes into a file of its own; plain values
        and arrays go as JSON into ``ledger.sqlite``. A later call with the same tasks in the same
        order, and maybe more after them, does the unfinished ones. With a folder, memory does not
        grow with the number of tasks.
    retries : int
        Number of further attempts of a task that fails, or kills its worker.
    each : callable, optional
        Called with the name and result of each task that succeeds in this call; not for a task that
        fails, nor for one whose result the folder held.
    progress : bool
        Show a progress bar, with the time left, where standard error is a terminal.

    Returns
    -------
    Campaign
        ``.results`` and ``.errors`` by name.

    Raises
    ------
    ValueError
        Bad input; a folder that holds other tasks, was made by another version or processor, is in
        use by another campaign, or is full; an executor that is closed, or whose workers were
        killed, unless `executor` is a function that makes another.

    Notes
    -----
    Results do not depend on the number of workers. A folder compares its tasks with those of a
    later call: arguments that a file can hold by value, functions by their text and the values that
    they hold, other objects by what a pickle holds. What cannot be compared, such as an open file,
    is refused.

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
    # Otherwise it is met after the first task, which may take hours.
    if each is not None and not callable(each):
        raise ValueError(
            f"each must be a function; got {each!r:.60}. Give one that takes a name and a result."
        )
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
                each(name, result)
            # The bar counts failed tasks, too.
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
    """SHA-256 of tasks; a frozen value that came recently is not fingerprinted again."""

    def __init__(self) -> None:
        # Id -> (value, fingerprint) of the frozen values fingerprinted last. The value itself is
        # held, so that no other object gets its id.
        self._recent: dict[int, tuple[Any, Any]] = {}
        # Fingerprints of the functions and classes of modules.
        self._fixed: dict[Any, str] = {}
        # Ids of the objects being described: one that holds itself is not described again.
        self._within: list[int] = []

    def of(self, call: Any) -> str:
        function, args, kwargs = call
        return self._described((function, tuple(args), dict(kwargs)))

    def _value(self, value: Any) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        # Only what cannot change may be reused.
        if _of_module(value):
            if value not in self._fixed:
                self._fixed[value] = self._described(value)
            return self._fixed[value]
        frozen = field_names(type(value)) is not None
        if frozen and id(value) in self._recent:
            return self._recent[id(value)][1]
        # Of other classes a file does not hold all, such as the default of a defaultdict.
        in_file = frozen or type(value) is np.ndarray or isinstance(value, np.generic)
        try:
            digest = fingerprint(value) if in_file else self._described(value)
        except ValueError:
            if not in_file:
                raise
            # No file can hold it.
            digest = self._described(value)
        if frozen:
            # Tasks share a handful of records and arms; sixteen bound the memory. Chosen by hand.
            recent = [*self._recent.items(), (id(value), (value, digest))]
            self._recent = dict(recent[-16:])
        return digest

    def _described(self, thing: Any) -> str:
        """Description of a thing by the values that it consists of."""
        if id(thing) in self._within:
            # How far out it is, since it may hold others that hold it.
            return f"{len(self._within) - self._within.index(id(thing))} further out"
        self._within.append(id(thing))
        try:
            values = [self._value(part) for part in _parts(thing)]
        finally:
            self._within.pop()
        if type(thing) in (set, frozenset):
            # Each process has another order of the texts in a set.
            values.sort(key=repr)
        return fingerprint((type(thing).__name__, *values))


def _of_module(thing: Any) -> bool:
    """Whether this is the function or class of its name in its module, as fixed as its text."""
    if not inspect.isfunction(thing) and not inspect.isclass(thing):
        return False
    return getattr(sys.modules.get(thing.__module__), thing.__qualname__, None) is thing


def _parts(thing: Any) -> Iterable[Any]:
    """Values that describe a thing.

    A function is described by its text, its code and the values that it holds; a class by its
    text, or its name where it is compiled; another object by what a copy is made of.
    """
    if type(thing) in (tuple, list, set, frozenset):
        return cast(Iterable[Any], thing)
    if type(thing) in (dict, MappingProxyType):
        return cast(Iterable[Any], thing.items())
    if type(thing) is bytes:
        return (thing.hex(),)
    if inspect.ismodule(thing):
        return (thing.__name__,)
    if inspect.iscode(thing):
        # Functions of one line, and those without a text, differ in their code alone.
        return (_text_of(thing), *(getattr(thing, f"co_{name}") for name in _CODE))
    if inspect.isfunction(thing):
        # An empty cell belongs to a variable that is not assigned yet.
        cells = [cell.cell_contents for cell in thing.__closure__ or () if cell != CellType()]
        return thing.__code__, cells, thing.__defaults__, thing.__kwdefaults__, vars(thing)
    if inspect.ismethod(thing):
        return thing.__func__, thing.__self__
    if inspect.isclass(thing):
        text = _text_of(cast(Any, thing))
        name = f"{thing.__module__}.{thing.__qualname__}"
        if _of_module(thing) and (text or thing.__module__ != "__main__"):
            return (text or name,)
        # A class that was typed in has nothing but its methods; those of a class that a function
        # makes hold variables of that function.
        return (text or name, *filter(inspect.isfunction, vars(thing).values()))
    if hasattr(thing, "py_func"):
        # Each process gives another number to a function that numba compiles.
        return thing.py_func, thing.targetoptions
    if isinstance(thing, functools._lru_cache_wrapper):
        return (thing.__wrapped__,)
    return _copied(thing)


def _copied(thing: Any) -> Iterable[Any]:
    """What a copy of an object is made of, as in a pickle."""
    reduce = copyreg.dispatch_table.get(type(thing))
    try:
        made = reduce(thing) if reduce else thing.__reduce_ex__(2)
        # The name of a compiled function, which must not mean another object.
        if isinstance(made, str):
            if operator.attrgetter(made)(sys.modules[thing.__module__]) is not thing:
                raise ValueError(made)
            return thing.__module__, made
    # The classes of others may raise anything here.
    except Exception:
        raise ValueError(
            "tasks of a folder must hold what a later call can compare; got a value of type"
            f" {type(thing).__name__}. Leave it out of them, or give no folder."
        ) from None
    # Items of lists and dictionaries of other classes come as iterators.
    return [list(part) if isinstance(part, Iterator) else part for part in made]


@functools.lru_cache(maxsize=256)
def _text_of(thing: Any) -> str:
    """Source text of a code object or class; "" where it is compiled or has no source."""
    try:
        return inspect.getsource(thing)
    except (OSError, TypeError):
        return ""
