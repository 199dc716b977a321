"""Identifications of many robots over time, in one SQLite file that other tools may query.

The tables and their columns stand in ``docs/guides/campaigns.md``; format 1 is `_SCHEMA`.
"""

import contextlib
import csv
import io
import json
import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import Effect, effect_of, values_of
from ctc.campaigns.fleet_page import fleet_page, plot_fleet
from ctc.campaigns.judgement import Judgement, Logged, judged, logged
from identification.equation_error import TorqueFit, short_names, units, wrong_statements
from plant.parts import (
    fingerprint,
    instance,
    known_options,
    path_of,
    real,
    require_new,
    versions,
    write_whole,
)

# `application_id` of the file: other tools recognise it by this number, so it never changes.
_MARK = 0x6F6E6570
# `user_version` of the file: it grows with the schema, so that an older library refuses the file.
_FORMAT = 1
_SCHEMA = """
create table robots (id integer primary key, name text unique not null);
create table identifications (
    id integer primary key autoincrement, robot integer not null references robots,
    time real not null, temperature real, method text not null, versions text not null,
    covariance text not null);
create table logs (
    id integer primary key,
    identification integer not null references identifications on delete cascade,
    name text not null, samples integer not null, seconds real not null,
    sha256 text unique not null);
create table parameters (
    identification integer not null references identifications on delete cascade,
    place integer not null, name text not null, label text not null, unit text not null,
    value real not null, std real, primary key (identification, place));
create index by_robot on identifications (robot, time);
"""
# Statements that make a new file.
_CREATED = f"{_SCHEMA} pragma application_id = {_MARK}; pragma user_version = {_FORMAT};"
# Mark and version, and whether the file is new.
_HEAD = """select application_id, user_version, not exists (select * from sqlite_master)
    from pragma_application_id, pragma_user_version"""
# All values in the order of time: the identification, then the fields of `FleetRow`.
_ROWS = """select identification,
    robots.name, time, temperature, parameters.name, label, value, std, unit
    from parameters join identifications on identifications.id = identification
    join robots on robots.id = robot
    order by time, identification, place"""
# The identification of a log that is added again; its rows of other tables go with it.
_REPLACED = (
    "delete from identifications where id in (select identification from logs where sha256 = ?)"
)
# Other robots that a log was added for.
_OF = """select robots.name from logs join identifications on identifications.id = identification
    join robots on robots.id = robot where sha256 = ? and robots.name != ?"""
# The statement looks up the robot's number by its name.
_IDENTIFIED = (
    "insert into identifications select null, id, ?, ?, ?, ?, ? from robots where name = ?"
)
# Kind of a parameter of the drive -> its name in a change.
_WORDS = {
    "drive.viscous": "viscous friction",
    "drive.coulomb": "Coulomb friction",
    "drive.motor_inertia": "motor inertia",
    "drive.motor_gain": "motor gain",
    "drive.curve.offset": "torque offset",
    "drive.elasticity.stiffness": "gear stiffness",
    "drive.elasticity.damping": "gear damping",
    "drive.elasticity.backlash": "backlash of the gear",
}
# Probability of a false alarm, over all parameters of a log, below which a change is reported: one
# log in a thousand.
LEVEL = 1e-3

# In a fleet of at most so many robots, a log is judged without itself. In a larger fleet, one log
# hardly changes the scatter of weeks, and one fit of the effects serves all robots. Chosen by hand.
_FEW = 30


class FleetRow(NamedTuple):
    """One value: `time` [Unix s], `temperature` [°C] or None, `std` None where it was assumed."""

    robot: str
    time: float
    temperature: float | None
    name: str
    label: str
    value: float
    std: float | None
    unit: str


class Fleet:
    """Identified parameters of many robots, week after week, in one SQLite file.

    Parameters
    ----------
    path : str or Path
        A SQLite file; a new one is made.

    Raises
    ------
    ValueError
        A file of another kind, or of a later format; a folder that cannot be written.

    Notes
    -----
    Iteration yields the judgement of each robot's last log, the most urgent judgement first;
    ``len`` is the number of identifications. ``docs/guides/campaigns.md`` describes how a
    log is judged.

    See Also
    --------
    ctc.campaign, plant.read_records

    Examples
    --------
    >>> from ctc import Fleet
    >>> from identification import fit_torque
    >>> from plant import Record, puma560, simulate
    >>> arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    >>> fleet = Fleet("fleet.sqlite")
    >>> for week in range(3):
    ...     log = simulate(arm, rig, puma560.p_law(), path, duration=2 + week / 100)
    ...     fit = fit_torque(arm.dynamics, log, band=20.0)
    ...     fleet.add(log, fit, notes={"robot": "cell_7", "time": f"2026-05-{11 + 7 * week}"})
    ...
    >>> print(len(fleet), fleet.parameters()[0].robot, next(iter(fleet)).verdict)
    3 cell_7 same arm
    """

    def __init__(self, path: str | Path) -> None:
        self.path = path_of("path", path)
        # State of the file -> its effects: many judgements ask for them, each fit takes a while.
        self._cached: tuple[Any, tuple[Effect, ...]] = (None, ())
        # SQLite would open a new database in memory at each use.
        if str(self.path) == ":memory:":
            raise ValueError("path must be a file; got ':memory:', which is none. Name a file.")
        with self._base() as base:
            mark, version, new = base.execute(_HEAD).fetchone()
            if new:
                # One transaction makes the whole file, or none of it. Another process may make it
                # first, so that the file is read again when no other one can write.
                base.execute("begin immediate")
                mark, version, new = base.execute(_HEAD).fetchone()
            if new:
                # `executescript` would end the transaction at its start.
                for statement in _CREATED.split(";"):
                    base.execute(statement)
        # Another database must not get the tables of a fleet.
        if not new and (mark != _MARK or version != _FORMAT):
            got = f"of format {version}" if mark == _MARK else "another database"
            raise ValueError(
                f"path must be a file of a Fleet of format {_FORMAT}; {self.path} is {got}. Name"
                " another."
            )

    @contextlib.contextmanager
    def _base(self) -> Iterator[sqlite3.Connection]:
        # Each use opens and closes a connection of its own: between two uses no file is open.
        try:
            with contextlib.closing(sqlite3.connect(self.path)) as base:
                # SQLite deletes dependent rows only where a connection demands it.
                base.execute("pragma foreign_keys = on")
                # Commits at the end, and takes all back after an exception.
                with base:
                    yield base
        except (sqlite3.DatabaseError, OSError) as error:
            raise ValueError(
                f"path must be a file of a Fleet, or a new one; {self.path}: {error}. Name it."
            ) from None

    @known_options
    def add(self, *results: Any, notes: Mapping[str, Any] | None = None) -> None:
        """Store an identification; it replaces each one in the file that shares a log with it.

        A replaced identification of several logs leaves the file with all of them: give the new
        one all logs that shall stay.

        Parameters
        ----------
        *results : Identification, or Record and its Identification or TorqueFit
            Of `identification.identify` or `identification.fit_torque`; the notes of a record give
            robot and time.
        notes : dict, optional
            ``robot``, ``time`` and ``temperature`` in place of those of the record.

        Raises
        ------
        ValueError
            No covariance, robot or time; logs of several robots; a log that the file holds for
            another robot; a file that cannot be written.
        """
        log, source = logged(results, notes)
        # The content of a record marks a log, whatever its file is called.
        sums = [fingerprint(record) for record in source.records]
        temperature = log.temperature if math.isfinite(log.temperature) else None
        # JSON has no NaN.
        covariance = json.dumps(np.nan_to_num(source.covariance).tolist())
        texts = (source.method, json.dumps(versions()), covariance)
        labels = _labels(source.dynamics, source.names)
        columns = zip(labels, units(source.dynamics, source.names), log.values.items(), strict=True)
        # One transaction: a failure leaves the file as it was.
        with self._base() as base:
            # 1. Refuse a log that the file holds for another robot; delete the identifications that
            # the new one replaces.
            for digest in sums:
                for (robot,) in base.execute(_OF, (digest, log.robot)):
                    raise ValueError(
                        f"a log must be of one robot; this one is of {robot!r} already. Name it so."
                    )
            base.executemany(_REPLACED, [(digest,) for digest in sums])

            # 2. The identification, its logs, its values.
            base.execute("insert or ignore into robots (name) values (?)", (log.robot,))
            row = (log.time, temperature, *texts, log.robot)
            number = base.execute(_IDENTIFIED, row).lastrowid
            rows = [
                (None, number, record.name, len(record), float(np.ptp(record.t)), digest)
                for record, digest in zip(source.records, sums, strict=True)
            ]
            base.executemany("insert into logs values (?, ?, ?, ?, ?, ?)", rows)
            # A value that was assumed has no standard deviation.
            values = [
                (number, place, name, label, unit, value, std if 0 < std < math.inf else None)
                for place, (label, unit, (name, (value, std))) in enumerate(columns)
            ]
            base.executemany("insert into parameters values (?, ?, ?, ?, ?, ?, ?)", values)

    def __len__(self) -> int:
        with self._base() as base:
            return int(base.execute("select count(*) from identifications").fetchone()[0])

    def __repr__(self) -> str:
        return f"Fleet({str(self.path)!r}, {len(self)} identifications)"

    def parameters(self) -> list[FleetRow]:
        """All values in the order of time; see `to_csv`."""
        return [row for _, row in self._rows()]

    def _rows(self) -> list[tuple[int, FleetRow]]:
        """`parameters`, each with the number of its identification."""
        with self._base() as base:
            return [(row[0], FleetRow._make(row[1:])) for row in base.execute(_ROWS)]

    def effects(self) -> tuple[Effect, ...]:
        """Effects on each parameter: mean, scatter of robots and weeks, slope with temperature."""
        # Numbers of identifications never return: count and largest show every change of the file.
        with self._base() as base:
            state = base.execute("select count(*), max(id) from identifications").fetchone()
        if self._cached[0] != state:
            self._cached = state, tuple(map(effect_of, values_of(self.parameters())))
        return self._cached[1]

    @known_options
    def judge(
        self, *results: Any, notes: Mapping[str, Any] | None = None, level: float = LEVEL
    ) -> Judgement:
        """Judge a robot's new log against its own past: "same arm", changes, wrong statements.

        Parameters
        ----------
        *results, notes
            As of `add`; the log need not have been added.
        level : float
            Probability of a false alarm, over all parameters of a log, below which a change is
            reported.

        Returns
        -------
        Judgement
            ``.verdict``, ``.changes`` with their probabilities, and ``.looked``, all
            comparisons.
        """
        if not 0 < real("level", level, "Give a probability, such as 1e-3.") < 1:
            raise ValueError(
                f"level must be between 0 and 1; got {level:g}. Give a probability, such as 1e-3."
            )
        log, source = logged(results, notes)
        judgement = judged(log, self._before(log, self.parameters()), level)
        fit = results[-1]
        # A fit of torques has examined its own log.
        lines = [cause.line for cause in fit.causes] if isinstance(fit, TorqueFit) else []
        # A log that is read wrongly looks like another arm, or hides a change of it.
        if not lines and (judgement.changes or fit.doubts):
            for record in source.records:
                lines += wrong_statements(source.dynamics, record)
        return replace(judgement, statements=tuple(dict.fromkeys(lines)))

    def _before(self, log: Logged, rows: Sequence[FleetRow]) -> tuple[Effect, ...]:
        """Effects of all but this log and later ones of its robot; in large fleets, `effects`."""
        # In a small fleet, the robot's later logs would make its judgement depend on the date of
        # the call, and a defect in this log would widen the scatter of weeks and excuse itself.
        past = [row for row in rows if row.robot != log.robot or row.time < log.time]
        small = len({row.robot for row in rows}) <= _FEW
        if small and len(past) < len(rows):
            return tuple(map(effect_of, values_of(past)))
        return self.effects()

    def __iter__(self) -> Iterator[Judgement]:
        # The newest log of each robot; of two logs of one time, that which was added last.
        numbered = self._rows()
        rows = [row for _, row in numbered]
        last = {row.robot: number for number, row in numbered}
        newest = dict[str, Logged]()
        for number, row in numbered:
            if number == last[row.robot]:
                temperature = math.nan if row.temperature is None else row.temperature
                log = newest.setdefault(row.robot, Logged(row.robot, row.time, temperature, {}))
                log.values[row.name] = row.value, row.std or 0.0

        def urgency(judgement: Judgement) -> tuple[float, str]:
            """Probability that the surest change is a false alarm, then the robot's name."""
            chance = judgement.looked[0].false_alarm if judgement.looked else 1.0
            return chance, judgement.robot

        judgements = [judged(log, self._before(log, rows), LEVEL) for log in newest.values()]
        yield from sorted(judgements, key=urgency)

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write `parameters` as CSV."""
        # First the text, then the file as a whole: no reader ever sees a half.
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([FleetRow._fields, *self.parameters()])
        write_whole(require_new(path, overwrite), [text.getvalue()])

    def to_parquet(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write `parameters` as Parquet; needs ``onepulse[parquet]``."""
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise ValueError("to_parquet needs pyarrow: pip install 'onepulse[parquet]'.") from None
        # A column without a value, such as temperatures, has no type of its own: the schema gives
        # it.
        rows = [row._asdict() for row in self.parameters()]
        kinds = {
            name: pyarrow.string() if kind is str else pyarrow.float64()
            for name, kind in FleetRow.__annotations__.items()
        }
        stream = io.BytesIO()
        parquet.write_table(pyarrow.Table.from_pylist(rows, pyarrow.schema(kinds)), stream)
        write_whole(require_new(path, overwrite), [stream.getvalue()])

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the parameters that changed most: robots that need attention over the fleet."""
        return plot_fleet(self.effects(), list(self), ax)

    def report(
        self, path: str | Path, *, title: str = "Fleet of robot arms", overwrite: bool = False
    ) -> None:
        """Write one HTML page, whose size does not grow with the number of logs or robots."""
        # A wrong title is refused before the figures are drawn.
        instance("title", title, str, "Give a line.")
        page = fleet_page(title, self.effects(), list(self), len(self))
        write_whole(require_new(path, overwrite), [page])


def _labels(dynamics: Any, names: Sequence[str]) -> Iterator[str]:
    """Parameters in words, such as ``viscous friction of joint 2 (q[0])``."""
    for name, short in zip(names, short_names(dynamics, names), strict=True):
        kind, _, place = name.removesuffix("]").partition("[")
        # Parameters of the arm have short names of their own.
        if kind not in _WORDS or not place.isdigit():
            yield short
            continue
        # Drop the label's "(q[i])": a sentence names the joint, not its coordinate.
        joint = dynamics.chain.joint_labels[int(place)].split(" (q[")[0]
        yield f"{_WORDS[kind]} of {joint}"
