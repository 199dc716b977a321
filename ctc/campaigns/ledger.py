"""Finished tasks of a campaign: in memory, or in a folder that outlives the process.

The folder has ``ledger.sqlite`` and ``results/``. Table ``campaign`` (key, value) holds format,
versions and processor; table ``tasks`` one row per task that was begun: ``number`` (place in the
order), ``name``, ``work`` (SHA-256 of function and arguments), ``state`` (open, done,
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

from plant.parts import Saved, from_plain, parsed, path_of, to_plain, versions, written

# Version of the tables: a folder of another one is refused.
_FORMAT = "1"
_TASKS = """create table if not exists tasks (
    number integer primary key, name text unique not null, work text not null,
    state text not null default 'open', began real not null, seconds real, error text,
    file text, value text)"""


class InMemory(contextlib.nullcontext[Any]):
    """Without a folder: results and errors as they are, in the order of the tasks."""

    def __init__(self) -> None:
        super().__init__(self)
        # Name -> state, in the order of the tasks; name -> result or reason, in that of their end.
        self._states: dict[str, str] = {}
        self._ends: dict[str, Any] = {}

    def begins(self, number: int, name: str, work: Any) -> bool:
        """Whether a task is still to be done: all are; a name that comes twice is refused."""
        if name in self._states:
            raise _twice(name)
        self._states[name] = "open"
        return True

    def done(self, number: int, name: str, result: Any) -> Any:
        """Store a result, and return it."""
        self._states[name] = "done"
        self._ends[name] = result
        return result

    def failed(self, number: int, name: str, error: str) -> None:
        """Store the reason of a failure."""
        self._states[name] = "failed"
        self._ends[name] = error

    def ended(self, state: str) -> dict[str, Any]:
        """Name -> result of finished tasks, or reason of the failed ones."""
        return {name: self._ends[name] for name, its in self._states.items() if its == state}


def _twice(name: str) -> ValueError:
    return ValueError(f"names of tasks must differ; {name!r:.80} comes twice. Rename one.")


class Ledger:
    """Tasks of a campaign in a folder, a new one if need be; use it in a ``with`` statement.

    `work` of a task is its SHA-256.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = path_of("folder", folder)
        self.path = self.folder / "ledger.sqlite"
        # Tasks of this call: an earlier one may have had more, which its results leave out.
        self._count = 0

    def __enter__(self) -> "Ledger":
        # 1. The lock of the folder.
        with self._writing():
            self.folder.mkdir(parents=True, exist_ok=True)
            # A lock of SQLite ends with the process that holds it, also where that was killed. The
            # ledger itself stays readable for other tools.
            self._lock = sqlite3.connect(self.folder / "lock.sqlite", timeout=0)
            try:
                self._lock.execute("begin exclusive")
            except sqlite3.OperationalError:
                self._lock.close()
                raise ValueError(
                    f"folder {self.folder} must be of no other campaign that runs; one holds it."
                    " Wait for its end."
                ) from None
            # 2. The ledger; without `__exit__` to come, an error here releases the lock.
            with contextlib.ExitStack() as opened:
                opened.callback(self._lock.close)
                # Autocommit, so that each task is on disk when its call returns.
                self._base = sqlite3.connect(self.path, isolation_level=None)
                opened.callback(self._base.close)
                self._open()
                opened.pop_all()
        return self

    def _open(self) -> None:
        # Results have the same bits only on one version and one kind of processor.
        head = {
            "format": _FORMAT,
            "versions": json.dumps(versions()),
            "processor": get_host_cpu_name(),
        }
        try:
            # Readers do not block the writer; a killed process loses no finished task.
            self._base.execute("pragma journal_mode = wal")
            self._base.execute("pragma synchronous = normal")
            self._base.execute(
                "create table if not exists campaign (key text primary key, value text not null)"
            )
            self._base.execute(_TASKS)
            stored = dict(self._base.execute("select key, value from campaign"))
        except sqlite3.DatabaseError as error:
            raise ValueError(
                f"{self.path} must be a ledger of campaign; {error}. Give another folder."
            ) from None
        # A new folder takes this head; any other must have it.
        for key, value in head.items():
            if stored.setdefault(key, value) != value:
                got = f"{value:.200}; got {stored[key]:.200}"
                raise ValueError(f"folder {self.folder} must be of the {key} {got}. Give another.")
        self._base.executemany("insert or ignore into campaign values (?, ?)", head.items())

    def __exit__(self, *_: object) -> None:
        self._base.close()
        self._lock.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        # Every write may meet a full disk or a lost mount: one message for all.
        try:
            yield
        except (OSError, sqlite3.OperationalError) as error:
            # `campaign` ends by a message that begins with "folder".
            why = error.strerror if isinstance(error, OSError) else error
            raise ValueError(
                f"folder {self.folder} must be one that can be written; {why}. What was finished is"
                " kept: make room, or give access, and call again."
            ) from None

    def begins(self, number: int, name: str, work: Any) -> bool:
        """Whether a task is still to be done; it must be that of earlier calls at its number."""
        self._count = max(self._count, number + 1)
        query = "select name, work, state, file from tasks where number = ?"
        stored = self._base.execute(query, (number,)).fetchone()
        if stored is None:
            with self._writing():
                try:
                    self._base.execute(
                        # The time counts from here, waiting for a worker included.
                        "insert into tasks (number, name, work, began) values (?, ?, ?, ?)",
                        (number, name, work, time.time()),
                    )
                except sqlite3.IntegrityError:
                    # Names are unique in the table.
                    raise _twice(name) from None
            return True
        stored_name, stored_work, state, file = stored
        if (stored_name, stored_work) != (name, work):
            got = f"{stored_name!r:.80}" if stored_name != name else "other work of this name"
            raise ValueError(
                f"folder {self.folder} must be of the same campaign; its task {number} is {got},"
                f" got {name!r:.80}. Give the same tasks in the same order, or another folder."
            )
        # A result whose file was deleted is computed anew.
        if state == "done" and (file is None or (self.folder / file).is_file()):
            return False
        with self._writing():
            # A new attempt has a time of its own: the days since the last one are not its work.
            self._base.execute("update tasks set began = ? where number = ?", (time.time(), number))
        return True

    def done(self, number: int, name: str, result: Any) -> Any:
        """Store a result, and return it as the folder holds it; ValueError if no file can."""
        file = value = None
        if isinstance(result, Saved):
            # The name is for people, the number makes it unique; a thousand files to a folder.
            short = re.sub(r"[^\w.+=-]+", "_", name)[:60]
            file = f"results/{number // 1000:03d}/{number:06d}_{short}.json"
            with self._writing():
                (self.folder / file).parent.mkdir(parents=True, exist_ok=True)
                result.save(self.folder / file)
        else:
            # Read back, so that this call and a later one return the same.
            value = "".join(written(to_plain(result)))
            result = from_plain(parsed(value.encode()))
        self._end(number, "done", None, file, value)
        return result

    def failed(self, number: int, name: str, error: str) -> None:
        """Store the reason of a failure; the next call tries the task again."""
        self._end(number, "failed", error, None, None)

    def _end(self, number: int, *ends: Any) -> None:
        with self._writing():
            self._base.execute(
                "update tasks set state = ?, error = ?, file = ?, value = ?, seconds = ? - began"
                " where number = ?",
                (*ends, time.time(), number),
            )

    def ended(self, state: str) -> Mapping[str, Any]:
        """Name -> result of finished tasks, or reason of the failed ones; read on access."""
        return _Rows(self.path, state, self._count)


def rows_of(path: Path, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
    """Rows of a ledger, opened for reading alone."""
    try:
        # Read only: a wrong path must not become an empty database.
        address = f"{path.absolute().as_uri()}?mode=ro"
        with contextlib.closing(sqlite3.connect(address, uri=True)) as base:
            yield from base.execute(query, values)
    except sqlite3.DatabaseError as error:
        raise ValueError(
            f"{path} must be a ledger of campaign; {error}. Give another folder."
        ) from None


class _Rows(Mapping[str, Any]):
    """Results or reasons of one state, in the order of the tasks, of the first `count` tasks."""

    def __init__(self, path: Path, state: str, count: int) -> None:
        self._path = path
        self._choice = (state, count)

    def __getitem__(self, name: str) -> Any:
        query = "select error, file, value from tasks where state = ? and number < ? and name = ?"
        for error, file, value in rows_of(self._path, query, *self._choice, name):
            if error is not None:
                return error
            if file is not None:
                return Saved.load(self._path.parent / file)
            return from_plain(parsed(value.encode()))
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        query = "select name from tasks where state = ? and number < ? order by number"
        for (name,) in rows_of(self._path, query, *self._choice):
            yield name

    def __len__(self) -> int:
        # Counted by the database: the names of a million tasks are not read for it.
        query = "select count(*) from tasks where state = ? and number < ?"
        return int(next(rows_of(self._path, query, *self._choice))[0])

    def __repr__(self) -> str:
        return f"{len(self)} of {self._path.parent}"
