"""Tables of positions as references: straight lines between them, or goals that hold."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from plant.motion.reference import Timed
from plant.parts import Floats, Nested, known_options, part, path_of, read_rows, structure

# A joint's name with one number, such as q_1.
_NUMBERED = re.compile(r"(\D*)(\d+)\D*")

# A goal holds already this share of the shortest interval before its time, because clocks whose
# stamps are off by a hundredth count as even.
_AT_THE_TIME = 0.02

# The unit at the end of a column's name; a number in brackets is an index, as in q[0].
_UNIT = re.compile(r"\s*\[(?!\d+\])([^\[\]]*)\]$")

# Units that the first column may have, and all others.
_SECONDS = ("s", "sec", "second", "seconds")
_ANGLES = ("rad", "radian", "radians", "m", "metre", "metres", "meter", "meters")

# Words in the names of columns that tell of other units.
_FOREIGN = re.compile(r"(?<![a-z])(deg|degree|degrees|°|ms|us)(?![a-z])")

# The first cell of a comment that is a heading.
_TIME = re.compile(r"t(ime(stamp)?)?(_\w+|\s*[\[(].*)?", re.IGNORECASE)


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
    corners = True

    def __post_init__(self) -> None:
        self._keep("points", (self._keep_times(), "n"), "One row per time, one column per joint.")

    @classmethod
    @known_options
    def from_csv(cls, path: str | Path, *, joints: Sequence[str] = ()) -> Self:
        """Read columns t [s], q_1..q_n [rad].

        A line of names before the numbers is a heading, and so is a comment (#) that begins with t.

        Parameters
        ----------
        path : str or Path
        joints : sequence of str
            Names of the joints, in order; a heading may have them in place of q_1..q_n.

        Raises
        ------
        ValueError
            No table of numbers, another number of joints, or a heading that has the joints in
            another order, one twice, no t, or other units.
        """

        def comment(_: int, line: str) -> None:
            cells = line[1:].split(",")
            if _TIME.fullmatch(cells[0].strip()):
                _require_order(cells, joints)

        path_of("path", path)
        try:
            names, table = read_rows(path, comment=comment)
            columns = table.shape[1] - 1
            if columns < 1:
                raise ValueError(f"must have t and angles; got {columns + 1} cells. Fill it.")
            if len(joints) not in (0, columns):
                expected = ", ".join(f"q_{i + 1}" for i in range(len(joints)))
                raise ValueError(
                    f"must have the columns t [s], {expected} [rad]; it has {columns} columns"
                    " beside t. Give those alone."
                )
            if names:
                _require_order(names, joints)
            return cls(times=table[:, 0], points=table[:, 1:])
        # Messages of the reader begin with the rule; the path of the file goes before it.
        except ValueError as error:
            raise ValueError(f"{path} {error}") from None

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
    corners = True

    def __post_init__(self) -> None:
        self._keep("points", (self._keep_times(), "n"), "One row per time, one column per joint.")

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        # The last goal that was sent; before the first one, that.
        early = _AT_THE_TIME * np.diff(self.times).min()
        row = np.searchsorted(self.times, t + early, side="right") - 1
        rest = np.zeros((len(t), self.n))
        return np.asarray(self.points)[np.maximum(row, 0)], rest, rest


def _require_order(heading: Sequence[str], names: Sequence[str]) -> None:
    """Refuse a heading without t, with joints in another order or twice, or in other units."""
    cells = [cell.strip() for cell in heading]
    plain = [_UNIT.sub("", cell) for cell in cells]
    time, columns = plain[0], plain[1:]
    joints = [match.groups() for match in map(_NUMBERED.fullmatch, columns) if match]
    stems = {stem for stem, _ in joints}
    numbers = [int(number) for _, number in joints]
    first = _NUMBERED.fullmatch(time)
    # Speeds have the numbers of the positions, as in q_1, qd_1.
    repeated = "q" in {stem.rstrip("_ [") for stem in stems} and len(set(numbers)) < len(numbers)
    named = [name for name in columns if name]
    timeless = (time and time in names) or (first and first[1] in stems)
    if timeless or repeated or len(set(named)) < len(named):
        raise ValueError(
            f"must have each joint once, behind t; its columns are {', '.join(cells)}. Give those"
            " alone."
        )
    permuted = any(
        name in names and list(names[i : i + 1]) != [name] for i, name in enumerate(columns)
    )
    # Numbers tell the order only if all columns have one and the same name beside it.
    numbered = len(stems) == 1 and len(numbers) == len(columns)
    if permuted or (numbered and numbers != sorted(numbers)):
        raise ValueError(
            f"must have the joints in order; its columns are {', '.join(cells)}. Reorder them."
        )
    allowed = [_SECONDS] + [_ANGLES] * len(columns)
    foreign = [
        cell
        for cell, units in zip(cells, allowed, strict=True)
        if _FOREIGN.search(cell.lower())
        or ((unit := _UNIT.search(cell)) and unit[1].strip().lower() not in units)
    ]
    # A comment of one cell is no heading.
    if columns and foreign:
        raise ValueError(f"must be in s and rad; its heading has {foreign[0]!r}. Convert it.")
