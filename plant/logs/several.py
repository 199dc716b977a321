"""Several files, or all episodes of a data set, as a list of records."""

import glob
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from plant.laws.law import Law
from plant.logs.formats.lerobot import episodes_of
from plant.logs.logfile import LoadError, kind_of, load_errors
from plant.logs.record import Record
from plant.machine.rig import Rig
from plant.motion.reference import Reference
from plant.parts.arguments import known_options


@known_options
def read_records(
    paths: str | Path | Iterable[str | Path], *, rig: Rig | None = None, columns: Mapping[str, Any] | None = None,
    units: Mapping[str, Any] | None = None, wrap: ArrayLike | None = None, prefix: str = "", law: Law | None = None,
    reference: Reference | None = None, initial: ArrayLike | None = None, episodes: Iterable[int] | None = None,
) -> tuple[Record, ...]:  # fmt: skip
    """Read several logs of one machine, of any format that `read_table` knows, each as a record.

    Parameters
    ----------
    paths : str, Path, or several
        Files; a pattern such as ``"runs/*.mcap"`` stands for all that match, sorted by name. A LeRobot data set is read
        as one record per episode.
    episodes : sequence of int, optional
        Of LeRobot data sets; by default all.
    rig, columns, units, wrap, prefix, law, reference, initial
        As in `Record.from_csv`, the same for all. Without `columns` the files are those of `Record.to_csv`.

    Returns
    -------
    tuple of Record
        Each is named like its file.

    Raises
    ------
    LoadError
        A file that cannot be read, or a pattern without a match; with the path.

    See Also
    --------
    plant.Record, plant.read_table

    Examples
    --------
    >>> from plant import puma560, read_records, simulate
    >>> rig = puma560.rig()
    >>> for i in range(2):
    ...     simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), duration=0.2).to_csv(f"run_{i}.csv")
    ...
    >>> [record.name for record in read_records("run_*.csv", rig=rig)]
    ['run_0.csv', 'run_1.csv']
    """
    given = [paths] if isinstance(paths, (str, Path)) else list(paths)
    files = [file for path in given for file in _matches(path)]
    if not files:
        raise ValueError("paths must name at least one file; got none. Give files, or a pattern such as 'runs/*.csv'.")
    log: dict[str, Any] = {"rig": rig, "law": law, "reference": reference, "initial": initial}
    if columns is None:
        return tuple(Record.from_csv(file, **log, units=units, wrap=wrap, prefix=prefix) for file in files)
    log |= {"columns": columns, "units": units, "wrap": wrap, "prefix": prefix}
    records = list[Record]()
    for file in files:
        with load_errors(file):
            kind = kind_of(file)
            chosen = tuple(range(episodes_of(str(file))) if episodes is None else episodes) if kind == "lerobot" else ()
        for episode in chosen or (None,):
            records.append(Record.read(file, episode=episode, **log))
    return tuple(records)


def _matches(path: str | Path) -> list[str | Path]:
    """The files of a pattern, in order of their names; a path without wildcards stands for itself."""
    if not glob.has_magic(str(path)) or Path(path).exists():
        return [path]
    found: list[str | Path] = sorted(glob.glob(str(path)))
    if not found:
        raise LoadError(f"{path} must match a file; it matches none. Check the pattern.")
    return found
