"""What was identified of many robots over time, in one SQLite file that other tools may query.

The tables and their columns stand in ``docs/guides/campaigns.md``; format 1 is `_SCHEMA`.
"""

import contextlib
import csv
import io
import json
import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import Effect, effect_of, values_of
from ctc.campaigns.fleet_page import fleet_page, plot_fleet
from ctc.campaigns.judgement import Judgement, Logged, judged, logged
from identification.equation_error.naming import short_names, units
from plant.parts.arguments import instance, known_options, real
from plant.parts.files import path_of, require_new, write_whole
from plant.parts.saved import fingerprint, versions

_MARK = 0x6F6E6570  # application_id of the file
_FORMAT = 1  # user_version
_SCHEMA = """
create table robots (id integer primary key, name text unique not null);
create table identifications (id integer primary key autoincrement, robot integer not null references robots,
    time real not null, temperature real, method text not null, versions text not null, covariance text not null);
create table logs (id integer primary key, identification integer not null references identifications on delete cascade,
    name text not null, samples integer not null, seconds real not null, sha256 text unique not null);
create table parameters (identification integer not null references identifications on delete cascade,
    place integer not null, name text not null, label text not null, unit text not null, value real not null, std real,
    primary key (identification, place));
create index by_robot on identifications (robot, time);
"""
_HEAD = """select application_id, user_version, not exists (select * from sqlite_master)
    from pragma_application_id, pragma_user_version"""
_ROWS = """select robots.name, time, temperature, parameters.name, label, value, std, unit from parameters
    join identifications on identifications.id = identification join robots on robots.id = robot
    order by time, identification, place"""
_REPLACED = (
    "delete from identifications where id in (select identification from logs where sha256 = ?)"
)
_OF = """select robots.name from logs join identifications on identifications.id = identification
    join robots on robots.id = robot where sha256 = ? and robots.name != ?"""
_IDENTIFIED = (
    "insert into identifications select null, id, ?, ?, ?, ?, ? from robots where name = ?"
)
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
# probability of a false alarm, over all parameters of a log, below which a change is called one
LEVEL = 1e-3


_FEW = 30  # robots; of more, a log that is judged weighs little in what weeks differ by


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
    """Robots and what was identified of them, week after week, in one file.

    Parameters
    ----------
    path : str or Path
        A SQLite file; made if it is not there.

    Raises
    ------
    ValueError
        A file of another kind, or of a later format; a folder that cannot be written.

    Notes
    -----
    Iterating gives the judgement of each robot's last log, the one that needs attention first in
    front; ``len`` is the number of identifications. What is judged, and how, stands in
    ``docs/guides/campaigns.md``.

    See Also
    --------
    ctc.campaign, plant.read_records

    Examples
    --------
    >>> from ctc import Fleet
    >>> from identification import fit_torque
    >>> from plant import Record, puma560, simulate
    >>> arm, rig, path, fleet = puma560.arm(), puma560.rig(), puma560.reference(), Fleet("fleet.sqlite")
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
        self._known: tuple[Any, tuple[Effect, ...]] = (None, ())
        try:
            with self._base() as base:
                mark, made, fresh = base.execute(_HEAD).fetchone()
                if fresh:
                    base.executescript(
                        f"{_SCHEMA} pragma application_id = {_MARK}; pragma user_version ="
                        f" {_FORMAT};"
                    )
        except (sqlite3.DatabaseError, OSError) as error:
            raise ValueError(
                f"path must be a file of a Fleet, or a new one; {self.path}: {error}. Name it."
            ) from None
        if not fresh and (mark != _MARK or made != _FORMAT):
            got = f"of format {made}" if mark == _MARK else "another database"
            raise ValueError(
                f"path must be a file of a Fleet of format {_FORMAT}; {self.path} is {got}. Name"
                " another."
            )

    @contextlib.contextmanager
    def _base(self) -> Iterator[sqlite3.Connection]:
        with contextlib.closing(sqlite3.connect(self.path)) as base:
            base.execute("pragma foreign_keys = on")
            with base:
                yield base

    @known_options
    def add(self, *found: Any, notes: Mapping[str, Any] | None = None) -> None:
        """Keep an identification, in place of one of the same log.

        Parameters
        ----------
        *found : Identification, or Record and what was identified of it
            Of `identification.identify` or `identification.fit_torque`; a record beside it says
            robot and time.
        notes : dict, optional
            ``robot``, ``time`` and ``temperature`` in place of those of the record.

        Raises
        ------
        ValueError
            Without covariance, robot or time; logs of several robots.
        """
        log, source = logged(found, notes)
        sums = [fingerprint(record) for record in source.records]
        warm = log.temperature if math.isfinite(log.temperature) else None
        texts = (
            source.method,
            json.dumps(versions()),
            json.dumps(np.nan_to_num(source.covariance).tolist()),
        )
        labels = _labels(source.dynamics, source.names), units(source.dynamics, source.names)
        with self._base() as base:
            for known in sums:
                for (other,) in base.execute(_OF, (known, log.robot)):
                    raise ValueError(
                        f"a log must be of one robot; this one is of {other!r} already. Name it so."
                    )
            base.executemany(_REPLACED, [(each,) for each in sums])
            base.execute("insert or ignore into robots (name) values (?)", (log.robot,))
            number = base.execute(_IDENTIFIED, (log.time, warm, *texts, log.robot)).lastrowid
            rows = [
                (None, number, record.name, len(record), float(np.ptp(record.t)), each)
                for record, each in zip(source.records, sums, strict=True)
            ]
            base.executemany("insert into logs values (?, ?, ?, ?, ?, ?)", rows)
            each = enumerate(zip(*labels, log.values.items(), strict=True))
            values = [
                (number, i, name, label, unit, value, std if 0 < std < math.inf else None)
                for i, (label, unit, (name, (value, std))) in each
            ]
            base.executemany("insert into parameters values (?, ?, ?, ?, ?, ?, ?)", values)

    def __len__(self) -> int:
        with self._base() as base:
            return int(base.execute("select count(*) from identifications").fetchone()[0])

    def __repr__(self) -> str:
        return f"Fleet({str(self.path)!r}, {len(self)} identifications)"

    def parameters(self) -> list[FleetRow]:
        """Every value in the order of time; see `to_csv`."""
        with self._base() as base:
            return [FleetRow(*row) for row in base.execute(_ROWS)]

    def effects(self) -> tuple[Effect, ...]:
        """Of each parameter: mean of the fleet, what robots and weeks differ by, slope with
        temperature.
        """
        with self._base() as base:
            state = base.execute("select count(*), max(id) from identifications").fetchone()
        if self._known[0] != state:
            self._known = state, tuple(effect_of(each) for each in values_of(self.parameters()))
        return self._known[1]

    @known_options
    def judge(
        self, *found: Any, notes: Mapping[str, Any] | None = None, level: float = LEVEL
    ) -> Judgement:
        """A robot's new log against its own past: "same arm", or what changed.

        Parameters
        ----------
        *found, notes
            As of `add`; it need not have been added.
        level : float
            Probability of a false alarm below which a change is called one, over all parameters of
            a log.

        Returns
        -------
        Judgement
            ``.verdict``, ``.changes`` with their probabilities, and ``.looked``, all that was
            compared.
        """
        if not 0 < real("level", level, "Give a probability, such as 1e-3.") < 1:
            raise ValueError(
                f"level must be between 0 and 1; got {level:g}. Give a probability, such as 1e-3."
            )
        log = logged(found, notes)[0]
        return judged(log, self._before(log, self.parameters()), level)

    def _before(self, log: Logged, rows: Sequence[FleetRow]) -> tuple[Effect, ...]:
        """As `effects`, of all but this log and what its robot did after it; in large fleets it
        hardly counts.
        """
        past = [row for row in rows if row.robot != log.robot or row.time < log.time]
        alone = len(past) < len(rows) and len({row.robot for row in rows}) <= _FEW
        return tuple(effect_of(each) for each in values_of(past)) if alone else self.effects()

    def __iter__(self) -> Iterator[Judgement]:
        last = dict[str, Logged]()
        rows = self.parameters()
        for row in rows:
            if row.robot not in last or row.time > last[row.robot].time:
                warm = math.nan if row.temperature is None else row.temperature
                last[row.robot] = Logged(row.robot, row.time, warm, {})
            last[row.robot].values[row.name] = row.value, row.std or 0.0
        found = [judged(log, self._before(log, rows), LEVEL) for log in last.values()]
        yield from sorted(
            found, key=lambda each: (each.looked[0].false_alarm if each.looked else 1.0, each.robot)
        )

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write `parameters` as CSV."""
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
        rows = [row._asdict() for row in self.parameters()]
        kinds = {
            name: pyarrow.string() if kind is str else pyarrow.float64()
            for name, kind in FleetRow.__annotations__.items()
        }
        stream = io.BytesIO()
        parquet.write_table(pyarrow.Table.from_pylist(rows, pyarrow.schema(kinds)), stream)
        write_whole(require_new(path, overwrite), [stream.getvalue()])

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the parameters that changed most, of the robots that need attention, over the
        fleet.
        """
        return plot_fleet(self.effects(), list(self), ax)

    def report(
        self, path: str | Path, *, title: str = "Fleet of robot arms", overwrite: bool = False
    ) -> None:
        """Write one HTML page, whose size does not grow with the number of logs or robots."""
        page = fleet_page(
            instance("title", title, str, "Give a line."), self.effects(), list(self), len(self)
        )
        write_whole(require_new(path, overwrite), [page])


def _labels(dynamics: Any, names: Sequence[str]) -> Iterator[str]:
    """What each parameter is called: ``viscous friction of joint 2 (q[0])``."""
    for name, short in zip(names, short_names(dynamics, names), strict=True):
        kind, _, place = name.removesuffix("]").partition("[")
        known = kind in _WORDS and place.isdigit()
        joint = dynamics.chain.joint_labels[int(place)].split(" (q[")[0] if known else ""
        yield f"{_WORDS[kind]} of {joint}" if known else short
