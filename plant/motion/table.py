"""Positions from a file or another program as a reference."""

from __future__ import annotations

import numpy as np

from plant.motion.reference import Reference, require_increasing
from plant.parts.arguments import known_options
from plant.parts.part import part, structure

__all__ = ["Table"]


@part
class Table(Reference):
    """Positions from a file or another program; straight lines between them.

    Between two samples the position is interpolated linearly, so the velocity is that of the line and the
    acceleration is zero: right for replaying a logged P loop, too rough for computed torque (use `Spline`).

    Parameters
    ----------
    times : (N,) array_like
        Strictly increasing [s].
    points : (N, n) array_like
        [rad]

    Source: paper 4.1 (reference trajectories from a file).
    """

    times: tuple = structure()
    points: tuple = structure()

    def __post_init__(self):
        times = self._keep("times", ("N",), "Give the time of each point [s].")
        self._keep("points", (len(times), "n"), "One row per time, one column per joint.")
        require_increasing("times", times)
        if len(times) < 2:
            raise ValueError(f"times must be two or more; got {len(times)}. Give the whole path.")

    @classmethod
    @known_options
    def from_csv(cls, path):
        """Read columns t [s], q_1..q_n [rad]; lines that start with # or a letter are headings."""
        rows = []
        with open(path, encoding="utf-8") as file:
            for count, line in enumerate(file, 1):
                if not line.strip() or line.lstrip()[0] == "#" or line.lstrip()[0].isalpha():
                    continue
                try:
                    rows.append([float(cell) for cell in line.split(",")])
                except ValueError:
                    text = line.strip()[:60]
                    raise ValueError(f"{path} line {count} must be numbers; got {text!r}. Correct the file.") from None
                if len(rows[-1]) != len(rows[0]) or len(rows[0]) < 2:
                    raise ValueError(f"{path} line {count} must have t and angles; got {len(rows[-1])} cells. Fill it.")
        if not rows:
            raise ValueError(f"{path} must hold rows of t, q_1..q_n; got none. Check the path.")
        table = np.array(rows)
        return cls(times=table[:, 0], points=table[:, 1:])

    @property
    def n(self):
        """Number of joints."""
        return len(self.points[0])

    @property
    def duration(self):
        """From 0 to the last sample [s]."""
        return self.times[-1]

    def motion(self, t):
        """Motion at times (N,)."""
        times, points = np.asarray(self.times), np.asarray(self.points)
        row = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        slope = np.diff(points, axis=0)[row] / np.diff(times)[row][:, None]
        inside = ((t >= times[0]) & (t < times[-1]))[:, None]
        s = np.clip(t, times[0], times[-1])
        return points[row] + slope * (s - times[row])[:, None], inside * slope, np.zeros((len(t), self.n))
