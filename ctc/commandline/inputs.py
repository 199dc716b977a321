"""What commands read: robot files, logs, results; and the places that they may write."""

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from identification import Identification
from plant import Record, Reference, Robot, Spline, Table, everyday_motions, read_records
from plant.parts.messages import warn
from plant.simulation.clock import Clock
from plant.simulation.followed_path import Logged


@dataclasses.dataclass(frozen=True)
class Answer:
    """An answer of a command: printed as text, or as JSON; exit code 0 if `good`, else 1."""

    text: str
    data: dict[str, Any]
    good: bool = True


def plain_number(value: Any) -> float | None:
    """A number for JSON, which has no infinity and no NaN: then none."""
    return float(value) if value is not None and math.isfinite(value) else None


_KNOTS = 0.02  # time between the points of a logged path that a spline goes through [s]
# times the log's duration, and its angles, from which on a path looks like other units
_LONGER = 100.0
_WIDER = 10.0
_AT_REST = 0.02  # speed of a joint [rad/s] below which a path begins at rest


def records_of(
    paths: list[str], robot: Robot | None, cut: tuple[float, float] | None = None
) -> tuple[Record, ...]:
    """Logs as records: with the columns of a robot's file, or such as the library wrote."""
    of_robot: Any = (
        {}
        if robot is None
        else {name: getattr(robot, name) for name in ("rig", "law", "columns", "units")}
    )
    records = read_records(paths, **of_robot)
    return records if cut is None else tuple(record.cut(*cut) for record in records)


def path_of(found: Identification, given: str | None = None) -> Reference:
    """The path that a controller is to follow: the file given, or that of the first log.

    A table of positions becomes a spline through one point every 20 ms. So do the commanded counts
    of a log that has no more, as the smoothest motion that their rounding allows. A log without a
    path is refused.
    """
    if given is not None and not Path(given).is_file():
        there = "a CSV file that is there"
        raise ValueError(
            f"the path to follow must be {there}; {given} is not. Its columns: t, q_1, ..."
        )
    record = found.records[0]
    path = _table(given, found) if given is not None else record.reference
    if path is None:
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
        return path
    step = max(1, round(_KNOTS / float(np.median(np.diff(times)))))
    kept = np.unique([*range(0, len(times), step), len(times) - 1])
    ends = np.abs(
        [(points[1] - points[0]) / times[1], (points[-1] - points[-2]) / (times[-1] - times[-2])]
    )
    return Spline(times=times[kept], points=points[kept], at_rest=bool(ends.max() < _AT_REST))


def motions_asked(
    found: Identification, path: str | None, everyday: bool
) -> Reference | Mapping[str, Reference]:
    """The path of `path_of`, or everyday motions, with the path of a file as one more."""
    if not everyday:
        return path_of(found, path)
    return everyday_motions(found.arm, found.rig) | (
        {} if path is None else {Path(path).stem: path_of(found, path)}
    )


def _table(given: str, found: Identification) -> Table:
    """A path from a file, with a warning where its numbers look like other units, or leave much
    to the spline.
    """
    record = found.records[0]
    path = Table.from_csv(
        given, joints=[link.name or "" for link in found.arm.dynamics.chain.links]
    )
    n = found.arm.n
    if path.n != n:
        columns = ", ".join(f"q_{i + 1}" for i in range(n))
        has = (
            f"it has {path.n} columns beside t. Give those alone; the log's own path is followed"
            " without --path"
        )
        raise ValueError(f"{given} must have the columns t [s], {columns} [rad]; {has}.")
    times = np.asarray(path.times)
    points = np.asarray(path.points)
    apart = float(np.median(np.diff(times)))
    if np.ptp(times) > _LONGER * np.ptp(record.t):
        warn(
            f"{given} lasts {np.ptp(times):.4g} s, the log {np.ptp(record.t):.3g} s: is its t"
            " in ms?"
        )
    elif apart > 2 * _KNOTS:
        warn(
            f"{given} has rows {apart:.3g} s apart; a spline goes through them. Give one every"
            f" {_KNOTS:g} s or less."
        )
    largest = max(float(np.abs(points).max()), 1e-9)
    if largest > _WIDER * max(float(np.abs(record.rig.cell_centre(record.counts)).max()), 1.0):
        warn(
            f"{given} has angles of up to {largest:.3g} rad, many times those of the log: are they"
            " in degrees?"
        )
    return path


def new_place(path: str, force: bool, inputs: Sequence[str] = ()) -> Path:
    """Where a file is to be written, before the work begins.

    Refused are a file that is there, without force, or that is read; a folder that is not there, or
    not to be written.
    """
    place = Path(path)
    if any(Path(each).exists() and place.exists() and place.samefile(each) for each in inputs):
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
