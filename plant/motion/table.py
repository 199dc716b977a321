"""Table of positions, from a file or another program, as a reference."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from plant.motion.reference import Timed
from plant.parts.arguments import known_options
from plant.parts.csv_rows import read_rows
from plant.parts.fields import Floats, Nested
from plant.parts.part import part, structure

_NUMBERED = re.compile(r"(\D*)(\d+)\D*")  # a name and its number

# Units that times and angles of a table do not have.
_OTHER = re.compile(r"(?<![a-z])(deg|degree|degrees|°|ms|us)(?![a-z])")


@part
class Table(Timed):
    """Table of positions, from a file or another program, linearly interpolated.

    Velocity is piecewise constant and acceleration zero: right for replaying a logged P loop, too
    rough for computed torque (use `Spline`).

    Parameters
    ----------
    times : (N,) array_like
        Strictly increasing [s].
    points : (N, n) array_like
        [rad]

    See Also
    --------
    plant.Spline, plant.Reference

    Examples
    --------
    >>> from plant import Table
    >>> path = Table(times=(0, 1, 2), points=((0, 0), (0.5, 0.2), (1, 0)))
    >>> path([0.5]).q
    array([[0.25, 0.1 ]])

    Source: paper 4.1 (reference trajectories from a file).
    """

    times: Nested = structure()
    points: Nested = structure()

    def __post_init__(self) -> None:
        self._keep("points", (self._keep_times(), "n"), "One row per time, one column per joint.")

    @classmethod
    @known_options
    def from_csv(cls, path: str | Path, *, joints: Sequence[str] = ()) -> Self:
        """Read columns t [s], q_1..q_n [rad]; lines that start with #, and a first one of names,
        are headings.

        Parameters
        ----------
        path : str or Path
        joints : sequence of str
            Names of the joints, in order; a heading may have them in place of q_1..q_n.

        Raises
        ------
        ValueError
            No table of numbers, or a heading that has the joints in another order or other units.
        """
        try:
            names, table = read_rows(
                path, comment=lambda _, line: _require_ours(line[1:].split(","), joints)
            )
            _require_ours(names or [], joints)
            if table.shape[1] < 2:
                raise ValueError(f"must have t and angles; got {table.shape[1]} cells. Fill it.")
        except ValueError as error:
            raise ValueError(f"{path} {error}") from None
        return cls(times=table[:, 0], points=table[:, 1:])

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        times = np.asarray(self.times)
        points = np.asarray(self.points)
        row = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        slope = np.diff(points, axis=0)[row] / np.diff(times)[row][:, None]
        inside = ((t >= times[0]) & (t < times[-1]))[:, None]
        s = np.clip(t, times[0], times[-1])
        return (
            points[row] + slope * (s - times[row])[:, None],
            inside * slope,
            np.zeros((len(t), self.n)),
        )


def _require_ours(heading: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a heading whose joints are numbered or named in another order, or whose units are
    not s and rad.
    """
    cells = [cell.strip() for cell in heading]
    joints = [match.groups() for match in map(_NUMBERED.fullmatch, cells[1:]) if match]
    order = [int(number) for _, number in joints]
    alike = len({name for name, _ in joints}) == 1
    numbered = alike and len(order) == len(cells) - 1 and order != sorted(order)
    if numbered or (cells[1:] != list(known) and sorted(cells[1:]) == sorted(known)):
        raise ValueError(
            f"must have the joints in order; its columns are {', '.join(cells)}. Reorder them."
        )
    other = [cell for cell in cells if _OTHER.search(cell.lower())]
    if len(cells) > 1 and other:
        raise ValueError(f"must be in s and rad; its heading has {other[0]!r}. Convert it.")
