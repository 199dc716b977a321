"""What a campaign has finished: in memory, or in a folder that outlives the process.

The folder has ``ledger.sqlite`` and ``results/``. Table ``campaign`` (key, value) holds format,
versions and processor; table ``tasks`` one row per task that was begun: ``number`` (place in the
order given), ``name``, ``work`` (SHA-256 of function and arguments), ``state`` (open, done,
failed), ``seconds`` (from its beginning to its end, waiting included), ``error``, and of results
``file`` (written by their `save`, relative to the folder) or ``value`` (JSON). The coordinator
alone writes; other tools may read at any time.
"""

import contextlib
import json
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from plant.parts.files import path_of
from plant.parts.plain import from_plain, to_plain
from plant.parts.saved import Saved, parsed, versions, written

_FORMAT = "1"
_TASKS = """create table if not exists tasks (number integer primary key, name text unique not null, work text not null,
    state text not null default 'open', began real not null, seconds real, error text, file text, value text)"""
_WHERE = "results/{:03d}"  # folders of a thousand files


class InMemory(contextlib.nullcontext[Any]):
    """Without a folder: results and errors as they are, in the order of the tasks."""

    def __init__(self) -> None:
        super().__init__(self)
        self._names: dict[str, str] = {}  # and the state of each
        self._ends: dict[str, Any] = {}

    def begins(self, number: int, name: str, work: Any) -> bool:
        """Whether a task is still to be done: all are; a name that comes twice is refused."""
        if name in self._names:
            raise _twice(name)
        self._names[name] = "open"
        return True

    def done(self, number: int, name: str, result: Any) -> Any:
        """Keep a result, and hand it back as it was kept."""
        self._names[name], self._ends[name] = "done", result
        return result

    def failed(self, number: int, name: str, error: str) -> None:
        """Keep the reason of a failure."""
        self._names[name], self._ends[name] = "failed", error

    def ended(self, state: str) -> dict[str, Any]:
        """Name -> result of those that are done, or why it failed."""
        return {name: self._ends[name] for name, its in self._names.items() if its == state}


def _twice(name: str) -> ValueError:
    return ValueError(f"names of tasks must differ; {name!r:.80} comes twice. Rename one.")


class Ledger:
    """In a folder, made if it is not there; use it in a ``with`` statement. `work` of a task is
    its SHA-256.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = path_of("folder", folder)
        self.path = self.folder / "ledger.sqlite"
        self._given = 0  # tasks of this call

    def __enter__(self) -> "Ledger":
        with self._writing():
            self.folder.mkdir(parents=True, exist_ok=True)
            # ends with the process that holds it
            self._lock = sqlite3.connect(self.folder / "lock.sqlite", timeout=0)
            try:
                self._lock.execute("begin exclusive")
            except sqlite3.OperationalError:
                self._lock.close()
                said = "must be of no other campaign that runs; one holds it. Wait for its end."
                raise ValueError(f"folder {self.folder} {said}") from None
            self._base = sqlite3.connect(self.path, isolation_level=None)
            try:
                self._open()
            except BaseException:
                self.__exit__()
                raise
        return self

    def _open(self) -> None:
        head = {
            "format": _FORMAT,
            "versions": json.dumps(versions()),
            "processor": get_host_cpu_name(),
        }
        try:
            self._base.execute("pragma journal_mode = wal")
            self._base.execute("pragma synchronous = normal")
            self._base.execute(
                "create table if not exists campaign (key text primary key, value text not null)"
            )
            self._base.execute(_TASKS)
            held = dict(self._base.execute("select key, value from campaign"))
        except sqlite3.DatabaseError as error:
            raise ValueError(
                f"{self.path} must be a ledger of campaign; {error}. Give another folder."
            ) from None
        for key, value in head.items():
            if held.setdefault(key, value) != value:
                got = f"{value:.200}; got {held[key]:.200}"
                raise ValueError(f"folder {self.folder} must be of the {key} {got}. Give another.")
        self._base.executemany("insert or ignore into campaign values (?, ?)", head.items())

    def __exit__(self, *_: object) -> None:
        self._base.close()
        self._lock.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.OperationalError) as error:
            said = error.strerror if isinstance(error, OSError) else error
            kept = "What was finished is kept: make room, or give access, and call again."
            raise ValueError(
                f"folder {self.folder} must be one that can be written; {said}. {kept}"
            ) from None

    def begins(self, number: int, name: str, work: Any) -> bool:
        """Whether a task is still to be done; another than that of before at this place is
        refused.
        """
        query = "select name, work, state, file from tasks where number = ?"
        self._given, held = (
            max(self._given, number + 1),
            self._base.execute(query, (number,)).fetchone(),
        )
        if held is None:
            with self._writing():
                try:
                    self._base.execute(
                        "insert into tasks (number, name, work, began) values (?, ?, ?, ?)",
                        (number, name, work, time.time()),
                    )
                except sqlite3.IntegrityError:
                    raise _twice(name) from None
            return True
        if held[:2] != (name, work):
            what = f"{held[0]!r:.80}" if held[0] != name else "other work of this name"
            differs = (
                f"its task {number} is {what}, got {name!r:.80}. Give the same tasks in the same"
                " order"
            )
            raise ValueError(
                f"folder {self.folder} must be of the same campaign; {differs}, or another folder."
            )
        return held[2] != "done" or not (held[3] is None or (self.folder / held[3]).is_file())

    def done(self, number: int, name: str, result: Any) -> Any:
        """Keep a result, and hand it back as it was kept; what no file can hold is a ValueError."""
        file = value = None
        if isinstance(result, Saved):
            short = re.sub(r"[^\w.+=-]+", "_", name)[:60]
            file = f"{_WHERE.format(number // 1000)}/{number:06d}_{short}.json"
            with self._writing():
                (self.folder / file).parent.mkdir(parents=True, exist_ok=True)
                result.save(self.folder / file)
        else:
            value = "".join(written(to_plain(result)))
            result = from_plain(parsed(value.encode()))
        self._end(number, "done", None, file, value)
        return result

    def failed(self, number: int, name: str, error: str) -> None:
        """Keep the reason of a failure; the next call tries it again."""
        self._end(number, "failed", error, None, None)

    def _end(self, number: int, *ends: Any) -> None:
        with self._writing():
            self._base.execute(
                "update tasks set state = ?, error = ?, file = ?, value = ?, seconds = ? - began"
                " where number = ?",
                (*ends, time.time(), number),
            )

    def ended(self, state: str) -> Mapping[str, Any]:
        """Name -> result of those that are done, or why it failed; read from the folder when it
        is asked for.
        """
        return _Rows(self.path, state, self._given)


def rows_of(path: Path, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
    """Rows of a ledger, which is only read."""
    try:
        with contextlib.closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        ) as base:
            yield from base.execute(query, values)
    except sqlite3.DatabaseError as error:
        raise ValueError(
            f"{path} must be a ledger of campaign; {error}. Give another folder."
        ) from None


class _Rows(Mapping[str, Any]):
    """Rows of one state, in the order of the tasks, of the first that many."""

    def __init__(self, path: Path, state: str, given: int) -> None:
        self._path = path
        self._those = (state, given)

    def __getitem__(self, name: str) -> Any:
        query = "select error, file, value from tasks where state = ? and number < ? and name = ?"
        for error, file, value in rows_of(self._path, query, *self._those, name):
            if error is not None:
                return error
            return (
                from_plain(parsed(value.encode()))
                if file is None
                else Saved.load(self._path.parent / file)
            )
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        query = "select name from tasks where state = ? and number < ? order by number"
        for (name,) in rows_of(self._path, query, *self._those):
            yield name

    def __len__(self) -> int:
        query = "select count(*) from tasks where state = ? and number < ?"
        return int(next(rows_of(self._path, query, *self._those))[0])

    def __repr__(self) -> str:
        return f"{len(self)} of {self._path.parent}"
