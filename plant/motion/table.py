"""Tables of positions as references: straight lines between them, or goals that hold."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from plant.motion.reference import Timed
from plant.parts import Floats, Nested, known_options, part, read_rows, structure

# A joint's name with one number, such as q_1 [rad].
_NUMBERED = re.compile(r"(\D*)(\d+)\D*")

# Share of the shortest interval by which a time may lie before that of a goal and still have it:
# a clock takes stamps that are off by a hundredth as even.
_AT_THE_TIME = 0.02

# Units that times and angles of a table must not have.
_FOREIGN = re.compile(r"(?<![a-z])(deg|degree|degrees|°|ms|us)(?![a-z])")


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
    plant.Held, plant.Spline, plant.Reference

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
        """Read columns t [s], q_1..q_n [rad].

        Lines that start with #, and a line of names before the numbers, are headings.

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
                path, comment=lambda _, line: _require_order(line[1:].split(","), joints)
            )
            _require_order(names or [], joints)
            if table.shape[1] < 2:
                raise ValueError(f"must have t and angles; got {table.shape[1]} cells. Fill it.")
        # Messages of the reader begin with the rule; the path of the file goes before it.
        except ValueError as error:
            raise ValueError(f"{path} {error}") from None
        return cls(times=table[:, 0], points=table[:, 1:])

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        times = np.asarray(self.times)
        points = np.asarray(self.points)
        # The segment that begins at or before each time.
        row = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        # Straight lines: the speed is constant between two points, and jumps at them.
        slope = np.diff(points, axis=0)[row] / np.diff(times)[row][:, None]
        # Outside the table the arm rests at its ends.
        inside = ((t >= times[0]) & (t < times[-1]))[:, None]
        s = np.clip(t, times[0], times[-1])
        q = points[row] + slope * (s - times[row])[:, None]
        return q, inside * slope, np.zeros((len(t), self.n))


@part
class Held(Timed):
    """Goals as a servo gets them: each holds from its time until the next is sent.

    The reference of a log whose goals were not interpolated. A straight line through them would
    lead by half a period, which looks like less viscous friction.

    Parameters
    ----------
    times : (N,) array_like
        When each goal was sent, strictly increasing [s].
    points : (N, n) array_like
        [rad]

    See Also
    --------
    plant.Table, plant.PositionServo, plant.Record

    Examples
    --------
    >>> from plant import Held
    >>> goals = Held(times=(0, 1, 2), points=((0, 0), (0.5, 0.2), (1, 0)))
    >>> goals([0.5, 1.0]).q
    array([[0. , 0. ],
           [0.5, 0.2]])
    """

    times: Nested = structure()
    points: Nested = structure()
    held = True

    def __post_init__(self) -> None:
        self._keep("points", (self._keep_times(), "n"), "One row per time, one column per joint.")

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        # The last goal that was sent; before the first one, that.
        early = _AT_THE_TIME * np.diff(self.times).min()
        row = np.searchsorted(self.times, t + early, side="right") - 1
        rest = np.zeros((len(t), self.n))
        return np.asarray(self.points)[np.maximum(row, 0)], rest, rest


def _require_order(heading: Sequence[str], names: Sequence[str]) -> None:
    """Refuse a heading with the joints in another order, or with units other than s and rad."""
    cells = [cell.strip() for cell in heading]
    joints = [match.groups() for match in map(_NUMBERED.fullmatch, cells[1:]) if match]
    numbers = [int(number) for _, number in joints]
    # Numbers tell the order only if all columns have one and the same name beside it.
    numbered = len({name for name, _ in joints}) == 1 and len(numbers) == len(cells) - 1
    permuted = cells[1:] != list(names) and sorted(cells[1:]) == sorted(names)
    if permuted or (numbered and numbers != sorted(numbers)):
        raise ValueError(
            f"must have the joints in order; its columns are {', '.join(cells)}. Reorder them."
        )
    foreign = [cell for cell in cells if _FOREIGN.search(cell.lower())]
    # A comment of one cell is no heading.
    if len(cells) > 1 and foreign:
        raise ValueError(f"must be in s and rad; its heading has {foreign[0]!r}. Convert it.")
