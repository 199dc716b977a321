"""What a foreign log holds: columns, likely units, rate, gaps, and a mapping to begin with."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs.column_roles import (
    Role,
    fields_of,
    folder_of,
    groups_of,
    is_whole,
    role_of,
    written_out,
)
from plant.logs.logfile import LogTable, kind_of, load_errors, options_of, read_file
from plant.logs.unit_words import without_unit
from plant.logs.units import TIME, UNITS
from plant.parts import Floats

# A step of t beyond so many median steps is a gap, as in `Record.resampled`.
_GAP = 1.5
# Columns that are listed; a recording of a whole robot may have thousands. Chosen by hand.
_LISTED = 60


@dataclasses.dataclass(frozen=True, kw_only=True)
class LogContents:
    r"""What a log holds that has no mapping yet; printed, it is a description.

    `Record.read` and ``onepulse check`` make one where no mapping is given. Roles and units are
    guessed from names and values: check them before use.

    Parameters
    ----------
    path : str
    samples : int
        Rows of the column of time, or of the first column without one.
    roles : dict
        Column -> what it likely is.
    ranges : dict
        Column -> its least and its greatest value.
    text : tuple of str
        Columns that hold no numbers.
    columns, units : dict
        The likely mapping, for `Record.read`; empty where no positions were recognised.
    rate : str
        Period, duration and gaps of the column of time, in words.

    See Also
    --------
    plant.Record, plant.read_table

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import Record
    >>> _ = Path("run.csv").write_text("time q1 q2\n0 0.1 0.2\n0.002 0.15 0.2\n0.004 0.2 0.1\n")
    >>> contents = Record.read("run.csv")
    run.csv: 3 rows
    time: every 2 ms (500 Hz) for 0.004 s, no gaps
      time  0    0.004  time [s]
      q1    0.1  0.2    position [rad or turns]
      q2    0.1  0.2    position [rad or turns]
    Check this mapping, then read the log with it:
      columns = {"t": "time", "position": ["q1", "q2"]}
      units = {"t": "s", "position": "rad"}
      record = Record.read("run.csv", rig=rig, columns=columns, units=units)
    >>> contents.units
    {'t': 's', 'position': 'rad'}
    """

    path: str
    samples: int
    roles: Mapping[str, Role]
    ranges: Mapping[str, tuple[float, float]]
    text: tuple[str, ...]
    columns: Mapping[str, Any]
    units: Mapping[str, Any]
    rate: str

    def __str__(self) -> str:
        # JSON of names and lists is Python as well, with double quotes.
        # The words of a script: what is printed can be copied as it stands.
        columns = json.dumps(dict(self.columns), ensure_ascii=False)
        units = json.dumps(dict(self.units), ensure_ascii=False)
        path = json.dumps(self.path, ensure_ascii=False)
        mapping = [
            "Check this mapping, then read the log with it:",
            f"  columns = {columns}",
            f"  units = {units}",
            f"  record = Record.read({path}, rig=rig, columns=columns, units=units)",
        ]
        return "\n".join([*self._listed(), *(mapping if self.columns else self._without_mapping())])

    def __repr__(self) -> str:
        return f"LogContents({self.path}, {self.samples} rows of {len(self.roles)} columns)"

    def toml(self) -> str:
        """The description with the mapping as the tables of a robot file."""
        # Without positions a table [columns] would be refused when it is read.
        if not self.columns:
            return "\n".join([*self._listed(), *self._without_mapping()])
        lines = ["Check this mapping, then put it into the robot file:"]
        for title, table in (("columns", self.columns), ("units", self.units)):
            lines += ["", f"[{title}]"]
            lines += [f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in table.items()]
        return "\n".join([*self._listed(), *lines])

    def _listed(self) -> list[str]:
        """The columns as a table."""
        cells = [
            (name, *(f"{value:.6g}" for value in self.ranges[name]), str(role))
            for name, role in list(self.roles.items())[:_LISTED]
        ]
        cells += [(name, "", "", "no numbers") for name in self.text[:_LISTED]]
        # Names and numbers are aligned; the role is last and needs no width.
        widths = [max(map(len, column)) for column in list(zip(*cells, strict=True))[:3]]
        lines = [f"{self.path}: {self.samples} rows", f"time: {self.rate}"]
        for cell in cells:
            padded = [text.ljust(width) for text, width in zip(cell, [*widths, 0], strict=True)]
            lines.append("  " + "  ".join(padded))
        unlisted = len(self.roles) + len(self.text) - len(cells)
        return lines + [f"  and {unlisted} more columns"] * (unlisted > 0)

    def _without_mapping(self) -> list[str]:
        times = [name for name, role in self.roles.items() if role.quantity == "time"]
        begun = json.dumps({"t": times[0]} if times else {}, ensure_ascii=False)[:-1]
        return [
            "No column was recognised as positions or counts; map them by name:",
            f'  columns = {begun}{", " * bool(times)}"position": [...]}}',
        ]


def contents_of(
    path: str | Path, *, n: int | None = None, prefix: str = "", episode: int | None = None
) -> LogContents:
    """What a log holds, of `n` joints if their number is known.

    Raises
    ------
    LoadError
        A file that cannot be read, or that holds no numbers.
    """
    with load_errors(path):
        kind = kind_of(path)
        options = options_of(kind, episode)
        # A look at a log must not fail because of a column of words.
        table = read_file(kind, path, None, prefix, numbers_only=True, **options)
    columns = _single_columns(table)
    fields, roles = _likely(columns, table.units, n)
    times = columns[fields["t"][0]] if "t" in fields else None
    mapping: dict[str, Any] = {}
    stated: dict[str, Any] = {}
    if {"counts", "position", "motor_position"} & fields.keys():
        mapping = {f: names[0] if f == "t" else names for f, names in fields.items()}
        for field, names in fields.items():
            # A unit of the file that needs a constant is stated as it is; `Record.read` asks for
            # the constant.
            units = [next(iter(roles[name].units), UNITS[field][0]) for name in names]
            # Some joints may slide.
            if len(UNITS[field]) > 1:
                stated[field] = units[0] if len(set(units)) == 1 else units
    return LogContents(
        path=str(path),
        samples=len(next(iter(columns.values())) if times is None else times),
        roles=roles,
        ranges={name: _range(values) for name, values in columns.items()},
        text=table.text(),
        columns=mapping,
        units=stated,
        rate=_rate(times, roles[fields["t"][0]].units[0] if times is not None else "s"),
    )


def _likely(
    columns: Mapping[str, NDArray[Any]], stated: Mapping[str, str], n: int | None
) -> tuple[dict[str, list[str]], dict[str, Role]]:
    """Likely fields of a record, and the role of each column."""
    # What the file states beside a name is more certain than brackets in it.
    units = {name: stated.get(name) or without_unit(name)[1] for name in columns}
    called = written_out(columns)
    roles = {name: role_of(called[name], values, units[name]) for name, values in columns.items()}
    # A joint that hardly moves has counts if the others of its group, by names alone, have counts.
    by_name = {name: role_of(called[name], columns[name][:0], units[name]) for name in columns}
    for names in groups_of(by_name).values():
        counts = next((columns[name] for name in names if roles[name].quantity == "counts"), None)
        if counts is not None and all(is_whole(columns[name]) for name in names):
            roles |= {name: role_of(called[name], counts, units[name]) for name in names}
    # The joint that moves most decides about the unit of all.
    for names in groups_of(roles).values():
        if roles[names[0]].quantity in ("position", "torque", "current", "error"):
            together = np.concatenate([columns[name] for name in names])
            roles |= {name: role_of(called[name], together, units[name]) for name in names}
    # Only now, since a word in any name is better evidence of a time than its values.
    roles = _with_time(columns, roles)
    return _of_one_length(fields_of(roles, n), columns, roles), roles


def _single_columns(table: LogTable) -> dict[str, NDArray[Any]]:
    """Columns (N,) of a table, those of its blocks by their labels or indices."""
    columns = dict[str, NDArray[Any]]()
    for name, values in table.items():
        if values.ndim == 1 or values.shape[1] == 1:
            columns[name] = values.reshape(len(values))
            continue
        # A mapping names the columns of a block one by one: the rig may lack some of its joints.
        columns |= dict(zip(table.elements(name), values.T, strict=True))
    return columns


def _with_time(columns: Mapping[str, NDArray[Any]], roles: Mapping[str, Role]) -> dict[str, Role]:
    """Roles in which a column that no word calls a time is one, if it runs like a clock."""
    if any(role.quantity == "time" for role in roles.values()):
        return dict(roles)
    for name, role in roles.items():
        values = columns[name].astype(float)
        steps = np.diff(values)
        # The number of a row increases as well, but tells no time.
        is_clock = len(steps) > 1 and bool((steps > 0).all()) and not (steps == 1).all()
        if is_clock and role.quantity == "other" and np.ptp(steps) < np.median(steps):
            timed = role_of("time", values, None)
            return dict(roles) | {name: timed}
    return dict(roles)


def _of_one_length(
    fields: Mapping[str, list[str]],
    columns: Mapping[str, NDArray[Any]],
    roles: Mapping[str, Role],
) -> dict[str, list[str]]:
    """Fields without those of another length than the positions; messages have rates of their own.

    The time of messages is that of the topic that has the positions.
    """
    measured = next(
        (fields[f][0] for f in ("counts", "position", "motor_position") if f in fields), None
    )
    if measured is None:
        return dict(fields)
    folder = folder_of(measured)
    times = [name for name, role in roles.items() if role.quantity == "time"]
    # The length decides before the topic: a clock of other samples is none.
    same = [name for name in times if len(columns[name]) == len(columns[measured])]
    beside = [name for name in same if folder_of(name) == folder]
    fields = dict(fields) | {"t": (beside or same)[:1]}
    # The columns of other topics hold their value at the samples of the measured one.
    return {
        field: names
        for field, names in fields.items()
        if names
        and (
            all(len(columns[name]) == len(columns[measured]) for name in names)
            or measured.startswith("/")
        )
    }


def _range(values: NDArray[Any]) -> tuple[float, float]:
    # Missing cells are NaN; a column may have nothing else.
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if len(finite) else (np.nan, np.nan)


def _rate(times: Floats | None, unit: str) -> str:
    """Period, duration and gaps of times (N,), in words."""
    if times is None or len(times) < 2:
        return "no column; samples are taken as one period of the rig apart"
    if unit not in TIME:
        return f"in {unit}, which needs a constant"
    # Unix times in nanoseconds are whole numbers beyond the digits of a float.
    t = (times - times[0]) / TIME[unit]
    steps = np.diff(t)
    forward = steps[steps > 0]
    if not len(forward):
        return "it never increases"
    # The median, so that gaps and repeated times do not change the period.
    step = float(np.median(forward))
    text = f"every {_seconds(step)} ({1 / step:.6g} Hz) for {t[-1]:.6g} s"
    # Jitter below a tenth of the period is that of any clock.
    low, high = np.quantile(forward, (0.05, 0.95))
    if high - low > step / 10:
        text += f", 90 % of the steps {_seconds(low)} to {_seconds(high)}"
    gaps = forward[forward > _GAP * step]
    count = f"{len(gaps)} gap{'s' * (len(gaps) > 1)}"
    text += f", {count} of up to {_seconds(gaps.max())}" if len(gaps) else ", no gaps"
    repeated = int((steps == 0).sum())
    text += f", {repeated} rows repeat a time" if repeated else ""
    return text + (f", {int((steps < 0).sum())} steps back" if (steps < 0).any() else "")


def _seconds(step: float) -> str:
    scale, unit = next(
        ((s, u) for s, u in ((1, "s"), (1e3, "ms")) if step * s >= 0.9995), (1e6, "us")
    )
    return f"{step * scale:.4g} {unit}"
