"""Several files, or all episodes of a data set, as a list of records."""

import dataclasses
import glob
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from plant.laws import Law
from plant.logs.formats.lerobot import episodes_of
from plant.logs.logfile import LoadError, kind_of, load_errors
from plant.logs.record import NUMBERS, Record
from plant.machine import Rig
from plant.motion import Reference
from plant.parts import decimal, known_options, path_of


@known_options
def read_records(
    paths: str | Path | Iterable[str | Path],
    *,
    rig: Rig | None = None,
    columns: Mapping[str, Any] | None = None,
    units: Mapping[str, Any] | None = None,
    wrap: ArrayLike | None = None,
    prefix: str = "",
    law: Law | None = None,
    reference: Reference | None = None,
    initial: ArrayLike | None = None,
    episodes: Iterable[int] | None = None,
    notes: str | Mapping[str, Any] | None = None,
    torque_delay: int = 0,
) -> tuple[Record, ...]:
    """Read several logs of one machine, of any format that `read_table` knows, each as a record.

    Parameters
    ----------
    paths : str, Path, or several
        Files; a pattern such as ``"runs/*.mcap"`` stands for all that match, sorted by name. A
        LeRobot data set is read as one record per episode.
    episodes : sequence of int, optional
        Of LeRobot data sets; by default all.
    notes : str or dict, optional
        What is noted of each record, beside what its file says: a pattern of file names such as
        ``"{robot}/{time}_{temperature}C"``, or names and values for all.
    rig, columns, units, wrap, prefix, law, reference, initial, torque_delay
        As in `Record.from_csv`, the same for all. Without `columns` the files are those of
        `Record.to_csv`.

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
    >>> record = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), duration=0.2)
    >>> for i in range(2):
    ...     record.to_csv(f"run_{i}.csv")
    >>> [record.name for record in read_records("run_*.csv", rig=rig)]
    ['run_0.csv', 'run_1.csv']
    """
    one = isinstance(paths, str) or not isinstance(paths, Iterable)
    listed: Any = [paths] if one else paths
    files = [file for path in listed for file in files_of(path)]
    if not files:
        raise ValueError(
            "paths must name at least one file; got none. Give files, or a pattern such as"
            " 'runs/*.csv'."
        )
    log: dict[str, Any] = {"rig": rig, "law": law, "reference": reference, "initial": initial}
    log["torque_delay"] = torque_delay
    # Without a mapping the files are those of `to_csv`.
    if columns is None:
        read = (
            Record.from_csv(file, **log, units=units, wrap=wrap, prefix=prefix) for file in files
        )
        return tuple(
            _with_notes(record, notes, file) for record, file in zip(read, files, strict=True)
        )
    log |= {"columns": columns, "units": units, "wrap": wrap, "prefix": prefix}
    records = list[Record]()
    for file in files:
        with load_errors(file):
            # A data set counts as its episodes; any other file is one record.
            kind = kind_of(file)
            chosen = (
                tuple(range(episodes_of(str(file))) if episodes is None else episodes)
                if kind == "lerobot"
                else ()
            )
        # None is the only episode of a file that is no data set.
        for episode in chosen or (None,):
            records.append(_with_notes(Record.read(file, episode=episode, **log), notes, file))
    return tuple(records)


def notes_of(notes: str | Mapping[str, Any], path: str | Path) -> dict[str, Any]:
    """Notes from a dictionary, or from a file name by ``"{robot}/{time}_{temperature}C"``.

    The pattern must match the end of the path without its suffix, from the start of a folder or
    file name on; earlier groups are the greediest.
    """
    if not isinstance(notes, str):
        return dict(notes)
    # Every second part is the name in braces, the others are literal text.
    parts = re.split(r"\{(\w+)\}", notes)
    names = parts[1::2]
    # The names become groups of a regular expression, which must be unique identifiers.
    if not names or len(set(names)) < len(names) or not all(name.isidentifier() for name in names):
        raise ValueError(
            f'notes must name what they find in braces, as "{{robot}}_{{time}}"; got {notes!r:.60}.'
            " Do so."
        )
    # A value does not cross a folder, so that "{robot}/{time}" takes one folder each.
    spelt = "".join(
        f"(?P<{part}>[^/]+)" if i % 2 else re.escape(part) for i, part in enumerate(parts)
    )
    # The suffix starts with a letter, so the decimals of a temperature are no suffix.
    match = re.fullmatch(f"(?:.*/)?{spelt}", re.sub(r"\.[A-Za-z]\w*$", "", Path(path).as_posix()))
    if match is None:
        raise ValueError(
            f"notes must fit the name {Path(path).name!r:.80}; {notes!r:.60} does not. Correct the"
            " pattern."
        )
    return {
        name: decimal(text) if name in NUMBERS else text for name, text in match.groupdict().items()
    }


def _with_notes(record: Record, notes: Any, file: str | Path) -> Record:
    """A record with what is noted of it beside what its file says."""
    if notes is None:
        return record
    return dataclasses.replace(record, notes={**(record.notes or {}), **notes_of(notes, file)})


def files_of(path: str | Path) -> list[str | Path]:
    """Files that match a pattern, sorted by name; a path without wildcards stands for itself."""
    # A file whose own name has brackets is no pattern.
    if not glob.has_magic(str(path_of("paths", path))) or Path(path).exists():
        return [path]
    # `glob` returns files in the order of the disk.
    files: list[str | Path] = sorted(glob.glob(str(path)))
    if not files:
        raise LoadError(f"{path} must match a file; it matches none. Check the pattern.")
    return files
