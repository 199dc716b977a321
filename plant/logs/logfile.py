"""A log file of any format as a table of named columns; every failure is one `LoadError`."""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs.formats.columns import Block, oriented, picked
from plant.logs.isolation import LIMITS, read_isolated, read_npz
from plant.logs.text_table import read_text
from plant.parts import instance, known_options, near, path_of, require_bounded, whole

_SUFFIXES = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".dat": "csv",
    ".log": "csv",
    ".asc": "csv",
    ".npz": "npz",
    ".mat": "mat",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".mcap": "mcap",
    ".db3": "rosbag2",
    ".bag": "rosbag2",
}
# kind -> what is in such a folder
_FOLDERS = {"rosbag2": "metadata.yaml", "lerobot": "meta/info.json"}
# Common endings that are not read -> what makes a log of such a file.
_ADVICE = {
    ".xlsx": "Save the sheet as CSV.",
    ".xls": "Save the sheet as CSV.",
    ".json": "Write one row per sample as CSV, or arrays as NPZ.",
    ".npy": "Save its columns by name with numpy.savez.",
    ".pkl": "Save its columns by name with numpy.savez; pickles are never opened.",
    ".active": "Run rosbag reindex on it; its recording was interrupted.",
    ".gz": "Unpack it.",
    ".zip": "Unpack it.",
    ".zst": "Unpack it.",
}
# Their topics have rates of their own, so one of them must be the clock.
_OF_MESSAGES = ("mcap", "rosbag2")
# These hold arrays of any shape; the others hold columns.
_OF_ARRAYS = ("npz", "mat", "hdf5")
_OF_ANYTHING = (*_OF_ARRAYS, "parquet")


class LogTable(dict[str, NDArray[Any]]):
    """Columns by name, the `units` that the file states, and all names `available` in it."""

    def __init__(
        self,
        columns: Mapping[str, NDArray[Any]],
        units: Mapping[str, str],
        available: Sequence[str],
    ) -> None:
        super().__init__(columns)
        self.units = dict(units)
        self.available = tuple(available)

    def elements(self, name: str) -> list[str]:
        """Names of the columns of a block (N, k)."""
        # Labels of a block are used only if there is one for every column.
        width = self[name].shape[1]
        marks = f"{name}.", f"{name}["
        # A column of the table's own is beside the block, not in it.
        labels = [
            label for label in self.available if label.startswith(marks) and label not in self
        ]
        return labels if len(labels) == width else [f"{name}[{i}]" for i in range(width)]

    def text(self) -> tuple[str, ...]:
        """Names in the file that are neither a column of numbers nor an element of one."""
        # An element stands for its block, which is a column of numbers.
        blocks = tuple(f"{name}{mark}" for name in self if self[name].ndim == 2 for mark in ".[")
        names = (name for name in self.available if name not in self)
        return tuple(name for name in names if not name.startswith(blocks))


class LoadError(ValueError):
    """A file that cannot be read: which, what was expected, what came, and what to do.

    See Also
    --------
    plant.read_table, plant.Record

    Examples
    --------
    >>> from plant import LoadError, Record, puma560
    >>> try:
    ...     Record.from_csv("missing.csv", rig=puma560.rig())
    ... except LoadError as error:
    ...     print(str(error).split(";")[0])
    missing.csv must be a file
    """


@contextlib.contextmanager
def load_errors(path: str | Path) -> Iterator[None]:
    """Turn every failure to read a file into one `LoadError` of one line that names it."""
    # A wrong call is no fault of the file.
    path_of("path", path)
    try:
        yield
    # Raised by an inner reader, with its own path: a second path would mislead.
    except LoadError:
        raise
    except FileNotFoundError:
        raise LoadError(f"{path} must be a file; there is none. Check the path.") from None
    except ValueError as error:
        raise LoadError(f"{path} {_line(str(error))}") from None
    except Exception as error:
        message = _line(f"{type(error).__name__}: {error}"[:200])
        raise LoadError(
            f"{path} must be a sound file; reading it gave {message}. Write it again."
        ) from None


def _line(text: str) -> str:
    # Messages of third-party readers may have several lines.
    return " ".join(text.split())


@known_options
def read_table(
    path: str | Path,
    *,
    names: Sequence[str] | None = None,
    prefix: str = "",
    episode: int | None = None,
) -> dict[str, NDArray[Any]]:
    r"""Read the columns of a log, by its ending: text with a line of names, NPZ, MAT, HDF5,
    Parquet, MCAP, or a bag of ROS; or a LeRobot data set, which is a folder, as a bag may be.

    All but text and NPZ are read in a child process with limits of time and memory, and all but
    those and MAT version 5 need the extra of their name: ``hdf5``, ``parquet``, ``mcap``,
    ``rosbag2``, ``lerobot``. Columns of a group, a structure, a topic are named ``group/name``,
    ``structure.name`` and ``/topic.name``; one of an array ``name[1]``, ``name.1`` or
    ``name.elbow``. Arrays have their samples along the rows, whichever way the file has them.

    Parameters
    ----------
    path : str or Path
    names : sequence of str, optional
        Columns to read. By default all columns, each of which must hold real numbers; in files of
        messages, only the numeric ones.
    prefix : str
        Common beginning of the names in the file, such as ``run_07/``; the table's names omit it.
    episode : int, optional
        Of a LeRobot data set; by default 0.

    Returns
    -------
    dict of str to numpy.ndarray
        Columns (N,) or blocks of columns (N, n); floats, or integers as they were, but those of
        text are floats. A missing cell is NaN. A topic has as many rows as messages.

    Raises
    ------
    LoadError
        A file that is missing, corrupt, or larger than 256 MiB once expanded; a column that is not
        there, or that holds anything but real numbers. Its reader has 4.5 s; messages and CSV have
        60 s.
    ValueError
        Names that are no list of names; a path or a prefix that is none.

    See Also
    --------
    plant.Record, plant.read_records

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import read_table
    >>> _ = Path("log.csv").write_text("t,q1\n0,0.1\n0.001,0.2\n")
    >>> read_table("log.csv")
    {'t': array([0.   , 0.001]), 'q1': array([0.1, 0.2])}
    """
    # A wrong call is no fault of the file. A text would be spelt out letter by letter.
    path_of("path", path)
    instance("prefix", prefix, str, "Give what the names begin with, such as 'run_07/'.")
    if names is not None:
        listed = () if isinstance(names, str) or not isinstance(names, Iterable) else tuple(names)
        if not listed or not all(isinstance(name, str) for name in listed):
            raise ValueError(
                f"names must be a list of names; got {names!r:.60}. Give one name or more, or leave"
                " it out for all."
            )
        names = listed
    with load_errors(path):
        kind = kind_of(path)
        return read_file(kind, path, names, prefix, **options_of(kind, episode))


def kind_of(path: str | Path) -> str:
    """The kind of a file by its ending, of a folder by what is in it."""
    # A bag or data set is recognised by its index, since folders have no suffix.
    for kind, inside in _FOLDERS.items():
        if Path(path, inside).is_file():
            return kind
    # Windows programs write endings in capitals.
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        endings = f"{', '.join(_SUFFIXES)}, or be a folder with {' or '.join(_FOLDERS.values())}"
        advice = _ADVICE.get(suffix, "If it is text, let it end in .txt; otherwise convert it.")
        raise ValueError(f"must end in one of {endings}; got {suffix!r}. {advice}")
    if suffix == ".mat" and _is_hdf5(path):
        return "hdf5"
    return _SUFFIXES[suffix]


def _is_hdf5(path: str | Path) -> bool:
    """Whether a MAT file is one of version 7.3."""
    # Opening a pipe would wait for its writer.
    if not Path(path).is_file():
        return False
    with open(path, "rb") as file:
        # Both marks lie in the header of 128 bytes that every MAT file has.
        head = file.read(128)
    return head[:4] == b"\x89HDF" or head[124:128] in (b"\x00\x02IM", b"\x02\x00MI")


def options_of(kind: str, episode: int | None = None, clock: str | None = None) -> dict[str, Any]:
    """Options of the reader of a kind: the episode of a data set, or the clock of messages."""
    if kind == "lerobot":
        return {
            "episode": whole("episode", 0 if episode is None else episode, "Count from 0.", least=0)
        }
    if episode is not None:
        raise ValueError(
            f"has no episodes, as a LeRobot data set does; got episode={episode!r:.20}. Leave it"
            " out."
        )
    return {"clock": clock} if kind in _OF_MESSAGES else {}


def read_file(
    kind: str,
    path: str | Path,
    names: Iterable[str] | None,
    prefix: str,
    *,
    numbers_only: bool = False,
    **options: Any,
) -> LogTable:
    """Read columns of a file of this kind, as `read_table` does, with `options` of `options_of`.

    With `numbers_only` columns of anything else, or without samples, are left out.
    """
    with load_errors(path):
        # The size of a folder says nothing: readers open some of its files only.
        if not (kind in _FOLDERS and Path(path).is_dir()):
            require_bounded(path, LIMITS.messages if kind in _OF_MESSAGES else LIMITS.columns)
        wanted = None if names is None else [f"{prefix}{name}" for name in names]
        # The clock names a column, so it takes the prefix as well.
        of_reader = dict(options)
        if options.get("clock") is not None:
            of_reader["clock"] = f"{prefix}{options['clock']}"
        units: dict[str, str] = {}
        if kind == "csv":
            available, columns, units = read_text(path, wanted, prefix, numbers_only)
        else:
            # Third-party libraries read in a child process; numpy archives are safe to read here.
            request = os.fspath(path), wanted, prefix, LIMITS.columns
            # Readers of messages and data sets give numbers alone.
            of_reader |= {"numbers_only": True} if numbers_only and kind in _OF_ANYTHING else {}
            available, columns = (
                read_npz(*request, **of_reader)
                if kind == "npz"
                else read_isolated(kind, *request, **of_reader)
            )
            if kind in _OF_ARRAYS:
                blocks = {name: Block(array) for name, array in oriented(columns).items()}
                available += [x for name, block in blocks.items() for x in block.elements(name)]
                picks = {name: picked(name, blocks) for name in wanted or blocks}
                columns = {name: column for name, column in picks.items() if column is not None}
        if numbers_only:
            columns = {n: c for n, c in columns.items() if np.size(c) and np.ndim(c) < 3}
        require_columns(wanted or (), columns, available)
        if numbers_only and not columns:
            # The refusal of what there is says more than that there are no numbers.
            return read_file(kind, path, names, prefix, **options)
        if not columns:
            raise ValueError(
                f"must hold columns whose names begin with {prefix!r}; got {available[:5]}. Check"
                " prefix."
            )
        cut = len(prefix)
        return LogTable(
            {name[cut:]: _numbers(name, column) for name, column in columns.items()},
            {name[cut:]: unit for name, unit in units.items()},
            [name[cut:] for name in available if name.startswith(prefix)],
        )


def require_columns(
    names: Iterable[str], columns: Mapping[str, Any], available: Iterable[str] | None = None
) -> None:
    """Refuse a table that lacks one of these columns, and offer the nearest name that it has."""
    # Duplicates would fill the list of names that the message shows.
    available = list(dict.fromkeys(columns if available is None else available))
    for name in names:
        if name not in columns:
            # Six names show the style of the file; more would hide the hint.
            listed = ", ".join(repr(column) for column in available[:6])
            hint = near(name, available, "Correct the mapping.")
            listed = (
                f"{len(available)} others: {listed}{', ...' * (len(available) > 6)}"
                if available
                else "none"
            )
            raise ValueError(f"column {name!r} must be there; got {listed:.220}. {hint}")


def _numbers(name: str, column: NDArray[Any]) -> NDArray[Any]:
    """A column as float64 or int64 of this machine, one-dimensional or (N, n)."""
    # MATLAB and HDF5 store a single sample as a scalar.
    column = np.atleast_1d(column)
    if column.size == 0:
        raise ValueError(f"must hold samples; {name!r} has no samples. Leave it out.")
    if column.ndim > 2:
        raise ValueError(
            f"must hold columns (N,) or (N, n); got shape {column.shape} in {name!r}. Leave it out."
        )
    if column.dtype.kind == "f":
        return column.astype(float)
    # Counts stay integers: a float64 would round those above 2**53.
    if column.dtype.kind == "u" and (column > np.iinfo(np.int64).max).any():
        raise ValueError(
            f"must hold whole numbers below 2^63; got {column.max()} in column {name!r}."
            " Correct it."
        )
    return column.astype(np.int64)
