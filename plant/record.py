"""The log of an experiment: the only thing that passes from plant to identification.

A record keeps the rig, the law and the reference that made it, so that the same experiment can be replayed with
another arm. A file from a real robot enters exactly where a simulation does.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from plant.check import array, known_options
from plant.law import Law
from plant.part import restore
from plant.reference import Reference
from plant.rig import Rig

__all__ = ["Record"]

_COLUMNS = (
    ("reference_pulses", "reference", "pulses"),
    ("error_pulses", "error", "pulses"),
    ("torque", "torque", "N m"),
    ("current", "current", "A"),
    ("true_q", "true_q", "rad"),
    ("true_qd", "true_qd", "rad/s"),
)


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Samples of one experiment.

    Parameters
    ----------
    t : (N,) array_like
        Times of the samples, increasing [s].
    error_pulses : (N, n) array_like
        Commanded minus counted [pulses], on the motor's shaft, with its sign.
    reference_pulses : (N, n) array_like, optional
        Commanded counts. Left out where nothing was commanded: all 0, so that the errors are minus the counts.
    rig : Rig
    law : Law, optional
        What controlled the arm.
    reference : Reference, optional
        What the commanded counts were made from.
    torque : (N, n) array_like, optional
        Joint torque of the motors, after the amplifier's limit [N m].
    current : (N, n) array_like, optional
        Motor current [A].
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0. Left out, a replay starts with the reference, but a joint whose
        first error is a pulse or more starts where its encoder says.
    valid : (N,) array_like, optional
        Weight of each sample, 0 to 1; a sample that was dropped or is wrong has 0. By default all have 1.
    true_q, true_qd : (N, n) array_like, optional
        What no encoder sees; only a simulation knows it, and identification never reads it.

    Raises
    ------
    ValueError
        Wrong shapes, NaN, or time that does not increase; with the index where it happened.
    """

    t: np.ndarray
    error_pulses: np.ndarray
    rig: Rig
    reference_pulses: np.ndarray | None = None
    law: Law | None = None
    reference: Reference | None = None
    torque: np.ndarray | None = None
    current: np.ndarray | None = None
    initial: np.ndarray | None = None
    valid: np.ndarray | None = None
    true_q: np.ndarray | None = None
    true_qd: np.ndarray | None = None

    def __post_init__(self):
        for name, kind in (("rig", Rig), ("law", (Law, type(None))), ("reference", (Reference, type(None)))):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(f"{name} of a record must be a {name.capitalize()}; got {getattr(self, name)!r:.60}.")
        t = array("t", self.t, ("N",), advice="Give the time of each sample [s].")
        if not len(t):
            raise ValueError("t must hold samples; got none. Check that the log was written to the end.")
        stuck = np.flatnonzero(np.diff(t) <= 0)
        if len(stuck):
            i = int(stuck[0]) + 1
            raise ValueError(f"t must increase; got {t[i]} after {t[i - 1]} at index {i}. Sort the rows or drop one.")
        shape = (len(t), self.rig.n)
        values = {"t": t}
        for name, *_ in _COLUMNS:
            value = getattr(self, name)
            if value is not None:
                values[name] = array(name, value, shape, advice="Give one row per sample, one column per joint.")
        if self.error_pulses is None:
            raise ValueError(
                f"error_pulses must have shape {shape}; got None. Without a reference, give minus the counts."
            )
        if self.reference_pulses is None:
            values["reference_pulses"] = np.zeros(shape)
        valid = np.ones(len(t)) if self.valid is None else self.valid
        values["valid"] = valid = array("valid", valid, shape[:1], advice="Give one weight per sample.")
        wrong = np.flatnonzero((valid < 0) | (valid > 1))
        if len(wrong):
            raise ValueError(
                f"valid must be 0 to 1; got {valid[wrong[0]]:g} at index {wrong[0]}. 0 leaves a sample out."
            )
        if self.initial is not None:
            values["initial"] = array("initial", self.initial, (2, self.rig.n), advice="Give q and qd at t = 0.")
        for name, value in values.items():
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def n(self):
        """Number of joints."""
        return self.rig.n

    @property
    def counts(self):
        """What the encoders counted, (N, n) [pulses]."""
        return self.reference_pulses - self.error_pulses

    def __len__(self):
        return len(self.t)

    def __repr__(self):
        made = type(self.law).__name__ if self.law is not None else "an unknown law"
        return f"Record({len(self)} samples of {self.n} joints, {self.t[-1] - self.t[0]:.3f} s, under {made})"

    def to_csv(self, path):
        """Write a CSV file that `from_csv` reads back without loss.

        Line 1 is ``#`` and a JSON object with rig, law, reference and initial; line 2 names columns and units.
        """
        header = {
            "onepulse": 1,
            "rig": self.rig.describe(),
            "law": None if self.law is None else self.law.describe(),
            "reference": None if self.reference is None else self.reference.describe(),
            "initial": None if self.initial is None else self.initial.tolist(),
        }
        names, columns = ["t [s]"], [self.t[:, None]]
        for field, name, unit in _COLUMNS:
            value = getattr(self, field)
            if value is not None:
                names += [f"{name}_{i + 1} [{unit}]" for i in range(self.n)]
                columns.append(value)
        with open(path, "w", encoding="utf-8") as file:
            file.write(f"# {json.dumps(header)}\n{','.join(names)}\n")
            for row in np.hstack(columns):
                file.write(",".join(f"{x:.17g}" for x in row) + "\n")

    def to_timeresponse(self):
        """A control.TimeResponseData: inputs reference_pulses[i]; outputs error_pulses[i], and what else was logged."""
        from plant.control_systems import response

        return response(self)

    @classmethod
    @known_options
    def from_csv(cls, path, *, rig=None, law=None, reference=None, initial=None):
        """Read what `to_csv` wrote, or a plain CSV of t [s], n reference and n error columns [pulses].

        Parameters
        ----------
        path : str or Path
        rig, law, reference : optional
            Needed for a plain file (the reference may be left out: the logged counts are replayed instead); in place
            of those named in the file otherwise.
        initial : (2, n) array_like, optional
            Position [rad] and velocity [rad/s] at t = 0.

        Raises
        ------
        ValueError
            A cell that is no number, a short row, an unknown column, a header that cannot be read; with the line.
        """
        header, names, rows = {}, None, []
        with open(path, encoding="utf-8-sig") as file:
            for count, line in enumerate(file, 1):
                line = line.strip()
                if not line:
                    continue
                if line.startswith("#"):
                    header = header or _header(path, count, line)
                    continue
                cells = line.split(",")
                if names is None and not rows and any(c.strip()[:1].isalpha() for c in cells):
                    names = [cell.strip() for cell in cells]
                    continue
                try:
                    rows.append([float(cell) for cell in cells])
                except ValueError:
                    raise ValueError(f"{path} line {count} must be numbers; got {line[:60]!r}. Correct it.") from None
                if len(rows[-1]) != len(names or rows[0]):
                    expected = len(names or rows[0])
                    raise ValueError(f"{path} line {count} must have {expected} cells; got {len(cells)}. Complete it.")
        if not rows:
            raise ValueError(f"{path} must hold samples; got no row of numbers. Check that it was written to the end.")
        rig = rig or _part(path, header, "rig")
        if rig is None:
            raise ValueError(f"{path} does not name its rig; a plain file needs one. Pass rig= and law=.")
        if not isinstance(rig, Rig):
            raise ValueError(f"rig of a record must be a Rig; got {rig!r:.60}. Pass rig=.")
        table, n = np.array(rows), rig.n
        fields = {"t": table[:, 0]}
        if names is None or not any("[" in name for name in names):
            if table.shape[1] != 1 + 2 * n:
                got = f"got {table.shape[1]} columns"
                raise ValueError(f"{path} must hold t, {n} reference and {n} error columns; {got}. Leave out others.")
            fields |= {"reference_pulses": table[:, 1 : 1 + n], "error_pulses": table[:, 1 + n :]}
            broken = np.argwhere(np.abs(table[:, 1:] - np.trunc(table[:, 1:])) > 0)
            if len(broken):
                row, column = broken[0] + (0, 1)
                value = f"got {table[row, column]:g} in row {row}, column {column + 1}"
                raise ValueError(f"{path} must hold whole pulses; {value}. Turn angles into counts with rig.pulses(q).")
        else:
            known = {f"{name}_{i + 1} [{unit}]": (field, i) for field, name, unit in _COLUMNS for i in range(n)}
            for column, name in enumerate(names[1:], 1):
                if name not in known:
                    raise ValueError(f"{path} has an unknown column {name!r}; known are {', '.join(known)}. Rename it.")
                if name in names[1:column]:
                    raise ValueError(f"{path} has column {name!r} twice; each may come once. Drop one.")
                field, joint = known[name]
                fields.setdefault(field, np.full((len(table), n), np.nan))[:, joint] = table[:, column]
        return cls(
            **fields,
            rig=rig,
            law=law or _part(path, header, "law"),
            reference=reference or _part(path, header, "reference"),
            initial=header.get("initial") if initial is None else initial,
        )


def _header(path, count, line):
    try:
        header = json.loads(line[1:])
    except (ValueError, RecursionError):
        return {}  # a comment
    if isinstance(header, dict) and header.get("onepulse", 1) != 1:
        raise ValueError(f"{path} line {count} must be version 1; got {header['onepulse']!r}. Use a newer library.")
    return header if isinstance(header, dict) else {}


def _part(path, header, name):
    try:
        return restore(header.get(name))
    except RecursionError:
        raise ValueError(
            f"{path} must describe its {name} as to_csv does; it is nested too deep. Correct it."
        ) from None
