"""Inputs of the commands (logs, paths) and the output files that they may write."""

import dataclasses
import math
import os
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from identification import Identification
from plant import (
    LoadError,
    LogContents,
    Record,
    Reference,
    Robot,
    Spline,
    Table,
    everyday_motions,
    read_records,
)
from plant.logs import contents_of, files_of, is_own
from plant.parts import frozen_settings, warn
from plant.simulation import Clock, Logged


@dataclasses.dataclass(frozen=True)
class Answer:
    """An answer of a command: printed as text, or as JSON; exit code 0 if `good`, else 1."""

    text: str
    data: dict[str, Any]
    good: bool = True


def plain_number(value: Any) -> float | None:
    """A number for JSON, which has no infinity and no NaN: then none."""
    return float(value) if value is not None and math.isfinite(value) else None


@frozen_settings
class PathSettings:
    """How a table of positions becomes a path; chosen by hand.

    Parameters
    ----------
    knots : float
        Time between the points that the spline goes through [s]: closer points would follow the
        rounding of the counts.
    longer, wider : float
        Duration and angles, as multiples of the log's, from which on the units look wrong
        (milliseconds, degrees).
    at_rest : float
        Speed of a joint [rad/s] below which the path begins and ends at rest.
    """

    knots: float = 0.02
    longer: float = 100.0
    wider: float = 10.0
    at_rest: float = 0.02


PATHS = PathSettings()


def records_of(
    paths: list[str], robot: Robot | None, cut: tuple[float, float] | None = None
) -> tuple[Record, ...]:
    """Logs as records: with the columns of a robot's file, or such as the library wrote."""
    # Without a robot file each log must hold its own rig.
    options: dict[str, Any] = {}
    if robot is not None:
        # What a robot file says about logs; the rest of it is about the arm.
        names = ("law", "columns", "units", "torque_delay")
        options = {"rig": robot.named_rig} | {name: getattr(robot, name) for name in names}
    records = read_records(paths, **options)
    return records if cut is None else tuple(record.cut(*cut) for record in records)


def described(paths: Sequence[str], robot: Robot | None) -> tuple[list[str], list[LogContents]]:
    """Logs that can be read as they are, and descriptions of those that need a mapping.

    A log needs one if neither a robot file maps its columns nor `Record.to_csv` wrote it.
    """
    # With a mapping every log is read by it, so nothing needs a description.
    if robot is not None and robot.columns is not None:
        return list(paths), []
    readable = list[str]()
    contents = list[LogContents]()
    for path in (str(file) for pattern in paths for file in files_of(pattern)):
        if is_own(path) or (robot is not None and _is_plain(path, robot)):
            readable.append(path)
        else:
            contents.append(contents_of(path, n=None if robot is None else robot.rig.n))
    return readable, contents


def _is_plain(path: str, robot: Robot) -> bool:
    """Whether a file has the plain columns t, references and errors of a robot."""
    try:
        # By reading it: the heading of a plain file alone would not show a broken one.
        Record.from_csv(path, rig=robot.rig, law=robot.law)
    except LoadError:
        return False
    return True


def path_of(identification: Identification, file: str | None = None) -> Reference:
    """The path that a controller is to follow: the file given, or that of the first log.

    A table of positions becomes a spline through one point every 20 ms. So do the commanded counts
    of a log that has no more, as the smoothest motion that their rounding allows. A log without a
    path is refused.
    """
    if file is not None and not Path(file).is_file():
        raise ValueError(
            f"the path to follow must be a CSV file that is there; {file} is not. Its columns: t,"
            " q_1, ..."
        )
    # 1. The path: of the file, of the log, or of its commanded counts.
    record = identification.records[0]
    path = _table(file, identification) if file is not None else record.reference
    # Without a reference the commanded counts are the path, smoothed within their rounding.
    if path is None:
        # Counts that never change command no motion.
        if not np.ptp(record.reference_pulses):
            raise ValueError(
                "the log must hold the path that was followed; it does not. Give --path FILE: t,"
                " q_1, ..."
            )
        times = record.t - record.t[0]
        points = Logged(record.reference_pulses, record.rig, Clock.of(record)).smoothed(times).q
    elif isinstance(path, Table):
        times = np.array(path.times) - path.times[0]
        points = np.array(path.points)
    else:
        # Other references are smooth by themselves.
        return path
    # 2. Thin it out. The last point always stays, else the path would end early.
    step = max(1, round(PATHS.knots / float(np.median(np.diff(times)))))
    knots = np.unique([*range(0, len(times), step), len(times) - 1])
    # The spline begins and ends at rest only where the table does.
    ends = np.abs(
        [(points[1] - points[0]) / times[1], (points[-1] - points[-2]) / (times[-1] - times[-2])]
    )
    return Spline(
        times=times[knots], points=points[knots], at_rest=bool(ends.max() < PATHS.at_rest)
    )


def motions_asked(
    identification: Identification, path: str | None, everyday: bool
) -> Reference | Mapping[str, Reference]:
    """The path of `path_of`, or everyday motions, with the path of a file as one more."""
    if not everyday:
        return path_of(identification, path)
    motions = everyday_motions(identification.arm, identification.rig)
    if path is None:
        return motions
    # By the name of its file, as the rows of a certificate are named.
    return motions | {Path(path).stem: path_of(identification, path)}


def _table(file: str, identification: Identification) -> Table:
    """A path from a file; warns where its units look wrong or its rows are far apart."""
    record = identification.records[0]
    # Columns may have the joints' names, and there must be as many.
    path = Table.from_csv(
        file, joints=[link.name or "" for link in identification.arm.dynamics.chain.links]
    )
    times = np.asarray(path.times)
    points = np.asarray(path.points)
    spacing = float(np.median(np.diff(times)))
    # What only looks wrong is a warning: a slow path may be meant.
    if np.ptp(times) > PATHS.longer * np.ptp(record.t):
        warn(
            f"{file} lasts {np.ptp(times):.4g} s, the log {np.ptp(record.t):.3g} s: is its t in ms?"
        )
    elif spacing > 2 * PATHS.knots:
        warn(
            f"{file} has rows {spacing:.3g} s apart; a spline goes through them. Give one every"
            f" {PATHS.knots:g} s or less."
        )
    # Degrees are 57 times as large as radians; a slow log may move by a tenth of its path.
    largest = max(float(np.abs(points).max()), 1e-9)
    if largest > PATHS.wider * max(float(np.abs(record.rig.cell_centre(record.counts)).max()), 1.0):
        warn(
            f"{file} has angles of up to {largest:.3g} rad, many times those of the log: are they"
            " in degrees?"
        )
    return path


def new_place(path: str, force: bool, inputs: Sequence[str] = ()) -> Path:
    """Check an output path before the work begins.

    It refuses a file that exists (without force) or that the command reads, and a folder that does
    not exist or cannot be written.
    """
    place = Path(path)
    # `samefile` also sees links, and another spelling of one path.
    if any(Path(file).exists() and place.exists() and place.samefile(file) for file in inputs):
        raise ValueError(f"{path} is what is read. Name another file to write.")
    if place.exists() and not force:
        raise ValueError(f"{path} is there. Name another file, or pass --force.")
    if place.is_dir() or not place.parent.is_dir():
        raise ValueError(
            f"{path} must be a file in a folder that is there. Make the folder first, or name"
            " another."
        )
    if not os.access(place.parent, os.W_OK):
        raise ValueError(
            f"{path} must be in a folder that can be written in; {place.parent} cannot. Name"
            " another."
        )
    return place


def output_place(options: Namespace) -> Any:
    """Path of the output file, never a file that the command reads; None to print alone."""
    if options.output is None:
        return None
    # Any file that this command reads, whatever its option is called.
    inputs: list[str] = []
    for name in ("logs", "held_out", "robot", "found", "certificate", "path"):
        value = vars(options).get(name)
        if value is not None:
            inputs += value if isinstance(value, list) else [value]
    return new_place(options.output, options.force, inputs)
