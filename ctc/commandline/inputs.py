"""What commands read: robot files, logs, results; and the places that they may write."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identification import Identification
from plant import Record, Reference, Robot, Spline, Table, read_records, read_robot

__all__ = ["new_place", "path_of", "records_of", "result_of", "robot_of"]

_KNOTS = 0.02
"""Time between the points of a logged path that a spline goes through [s]."""

_AT_REST = 0.02
"""Speed of a joint [rad/s] below which a path begins at rest."""


def robot_of(path: str) -> Robot:
    """A robot from its file, or one of the package."""
    return read_robot(path)


def records_of(paths: list[str], robot: Robot | None, cut: tuple[float, float] | None = None) -> tuple[Record, ...]:
    """Logs as records: with the columns of a robot's file, or such as the library wrote."""
    if robot is None:
        records = read_records(paths)
    else:
        records = read_records(paths, rig=robot.rig, law=robot.law, columns=robot.columns, units=robot.units)
    return records if cut is None else tuple(record.cut(*cut) for record in records)


def result_of(path: str) -> Identification:
    """An identification from the file that ``identify -o`` wrote."""
    return Identification.load(path)


def path_of(record: Record, given: str | None = None) -> Reference:
    """The path that a controller is to follow: the file given, or that of a log.

    A table of positions becomes a spline through one point every 20 ms; it begins and ends at rest.

    Raises
    ------
    ValueError
        No path in the log but its counts, or one that begins in motion.
    """
    path = Table.from_csv(given) if given is not None else record.reference
    if path is None:
        got = "it has its counts alone"
        raise ValueError(f"the log must hold the path without rounding; {got}. Give --path FILE with t, q_1, ...")
    if not isinstance(path, Table):
        return path
    times, points = np.array(path.times), np.array(path.points)
    times -= times[0]
    step = max(1, round(_KNOTS / float(np.median(np.diff(times)))))
    kept = np.unique([*range(0, len(times), step), len(times) - 1])
    ends = np.abs([(points[1] - points[0]) / times[1], (points[-1] - points[-2]) / (times[-1] - times[-2])])
    if ends.max() > _AT_REST:
        raise ValueError(
            f"the path must begin and end at rest; a joint moves at {ends.max():.2g} rad/s there. "
            "Give --path FILE with one that does."
        )
    return Spline(times=times[kept], points=points[kept])


def new_place(path: str, force: bool) -> Path:
    """Where a file is to be written, before the work begins.

    Raises
    ------
    ValueError
        A file that is there, without force; a folder that is not there.
    """
    place = Path(path)
    if place.exists() and not force:
        raise ValueError(f"{path} is there. Name another file, or pass --force.")
    if place.is_dir() or not place.parent.is_dir():
        raise ValueError(f"{path} must be a file in a folder that is there. Make the folder first, or name another.")
    return place
