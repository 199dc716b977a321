"""The log of an experiment: all that passes from plant to identification.

A record keeps the rig, the law and the reference that made it, so that the same experiment can be replayed with
another arm. A file from a real robot enters exactly where a simulation does.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.checkup.examine import examine
from plant.checkup.finding import Checkup
from plant.laws.law import Law
from plant.logs import record_csv
from plant.logs.logfile import load_errors
from plant.logs.mapping import record_fields
from plant.logs.record_files import Reader, read_mapped, reader
from plant.logs.resampling import resampled_fields
from plant.machine.rig import Rig
from plant.motion.reference import Reference
from plant.parts.arguments import array, known_options, real
from plant.parts.frozen import Frozen
from plant.parts.part import Vector

__all__ = ["Record"]

_COLUMNS = ("reference_pulses", "error_pulses", "torque", "current", "link_counts", "true_q", "true_qd")
_LEFT_OUT: Any = None


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Record(Frozen):
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
    link_counts : (N, n) array_like, optional
        What encoders on the links count, behind elastic gears, in pulses of the motors' shafts.
    true_q, true_qd : (N, n) array_like, optional
        True joint motion; only a simulation knows it, and identification never reads it.

    Raises
    ------
    ValueError
        Wrong shapes, NaN, time that does not increase, with the index; a law that repeats a column that is not there.
    """

    t: NDArray[Any]
    error_pulses: NDArray[Any]
    rig: Rig
    reference_pulses: Vector = _LEFT_OUT
    law: Law | None = None
    reference: Reference | None = None
    torque: NDArray[Any] | None = None
    current: NDArray[Any] | None = None
    initial: NDArray[Any] | None = None
    valid: Vector = _LEFT_OUT
    link_counts: NDArray[Any] | None = None
    true_q: NDArray[Any] | None = None
    true_qd: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        for name, kind in (("rig", Rig), ("law", (Law, type(None))), ("reference", (Reference, type(None)))):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(f"{name} of a record must be a {name.capitalize()}; got {getattr(self, name)!r:.60}.")
        if self.law is not None:
            self.law.replayed(self)
        t = array("t", self.t, ("N",), advice="Give the time of each sample [s].")
        if not len(t):
            raise ValueError("t must hold samples; got none. Check that the log was written to the end.")
        stuck = np.flatnonzero(np.diff(t) <= 0)
        if len(stuck):
            i = int(stuck[0]) + 1
            raise ValueError(f"t must increase; got {t[i]} after {t[i - 1]} at index {i}. Sort the rows or drop one.")
        shape = (len(t), self.rig.n)
        values = {"t": t}
        for name in _COLUMNS:
            value = getattr(self, name)
            if value is not None:
                values[name] = array(name, value, shape, advice="Give one row per sample, one column per joint.")
        if self.error_pulses is None:
            raise ValueError(f"error_pulses must have shape {shape}; got None. Without a reference, give -counts.")
        if self.reference_pulses is None:
            values["reference_pulses"] = np.zeros(shape)
        valid = np.ones(len(t)) if self.valid is None else self.valid
        values["valid"] = valid = array("valid", valid, shape[:1], advice="Give one weight per sample.")
        wrong = np.flatnonzero((valid < 0) | (valid > 1))
        if len(wrong):
            got = f"got {valid[wrong[0]]:g} at index {wrong[0]}"
            raise ValueError(f"valid must be 0 to 1; {got}. 0 leaves a sample out.")
        if self.initial is not None:
            values["initial"] = array("initial", self.initial, (2, self.rig.n), advice="Give q and qd at t = 0.")
        for name, value in values.items():
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.rig.n

    @property
    def counts(self) -> NDArray[np.float64]:
        """Encoder counts, (N, n) [pulses]."""
        return self.reference_pulses - self.error_pulses

    def check(self) -> Checkup:
        """Examine this log for errors before it is used; the `Checkup` prints as a table."""
        return examine(self)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        made = type(self.law).__name__ if self.law is not None else "an unknown law"
        return f"Record({len(self)} samples of {self.n} joints, {self.t[-1] - self.t[0]:.3f} s, under {made})"

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV file that `from_csv` reads back without loss, with rig, law, reference and initial in line 1."""
        record_csv.write(self, path)

    @classmethod
    @known_options
    def from_csv(
        cls, path: str | Path, *, rig: Rig | None = None, law: Law | None = None, reference: Reference | None = None,
        initial: ArrayLike | None = None, columns: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None, wrap: ArrayLike | None = None, prefix: str = "",
    ) -> Record:  # fmt: skip
        """Read what `to_csv` wrote, a plain CSV of t [s], n reference and n error columns [pulses], or a log of others.

        Parameters
        ----------
        path : str or Path
        rig, law, reference, initial : optional
            As in `Record`. A plain file needs rig and law; without a reference the logged counts are replayed. In place
            of those named in the file otherwise.
        columns : dict, optional
            With it, the file is a table of named columns, which this maps to the fields of a record; `from_table` says
            how, and what `units` and `wrap` are.
        prefix : str
            What the names of the mapped columns begin with in the file, as in ``run_07/``.

        Raises
        ------
        LoadError
            A file that cannot be read; a cell that is no number, an unknown column or header; with the line.
        """
        if columns is not None:
            log: dict[str, Any] = {"columns": columns, "units": units, "wrap": wrap, "prefix": prefix}
            return read_mapped(cls, "csv", path, rig=rig, law=law, reference=reference, initial=initial, **log)
        if units is not None or wrap is not None or prefix:
            raise ValueError("units, wrap and prefix are for mapped columns; got no mapping. Pass columns= as well.")
        with load_errors(path):
            return cls(**record_csv.read(path, rig=rig, law=law, reference=reference, initial=initial))

    from_npz: ClassVar[Reader[Record]] = reader("npz", "an NPZ archive; pickled objects are refused")
    from_mat: ClassVar[Reader[Record]] = reader("mat", "a MAT file of version 5 (saved with -v6 or -v7)")
    from_hdf5: ClassVar[Reader[Record]] = reader("hdf5", "an HDF5 file, or a MAT file of version 7.3 (extra ``hdf5``)")
    from_parquet: ClassVar[Reader[Record]] = reader("parquet", "a Parquet file (extra ``parquet``)")

    @classmethod
    @known_options
    def from_table(
        cls, table: Mapping[str, ArrayLike], *, rig: Rig, columns: Mapping[str, Any],
        units: Mapping[str, str] | None = None, wrap: ArrayLike | None = None, law: Law | None = None,
        reference: Reference | None = None, initial: ArrayLike | None = None,
    ) -> Record:  # fmt: skip
        """Make a record of named columns, such as `read_table` reads or several files give together.

        Parameters
        ----------
        table : dict of str to (N,) or (N, n) array_like
        rig : Rig
            Its gear and resolution turn angles into counts, its period is held against the times.
        columns : dict
            Field of the record -> name of its column, or names, one per joint. Exactly one of ``position`` (joint
            angles), ``motor_position``, ``counts`` and ``error_pulses``; and if there are, ``t``, ``valid``,
            ``torque``, ``current``, ``link_position`` (a second sensor's) and one of ``reference_pulses``,
            ``reference_position``, ``reference_motor_position``.
        units : dict
            Field -> unit: ``s``, ``ms`` or ``us`` of t, ``rad``, ``deg`` or ``pulses`` of positions, ``N m`` (of the
            joint) or ``motor N m`` of torque, ``A`` or ``mA`` of current.
        wrap : float or (n,) array_like, optional
            Where the measured position starts again, in its own unit: 2**16 counts, 2 pi rad. It is unwrapped by whole
            wraps, each the one nearest to the sample before.
        law, reference, initial : optional
            As in `Record`; a reference also gives the commanded counts where no column does.

        Notes
        -----
        Time starts at zero; without a column it is k period. Of rows with one time the first is kept, with a warning.
        A row with NaN in any mapped column has no weight (`valid` is 0) and holds the values of the row before; rows
        that are missing altogether are long time steps. Angles become whole pulses: where they are on a grid of one
        pulse, up to a shift per joint, these, otherwise what the rig's encoder would count, with a warning.

        Raises
        ------
        ValueError
            A column that is missing, has another length or holds anything but real numbers; a unit that is not stated,
            or does not fit the rig. Whatever `Record` refuses.
        """
        given: dict[str, Any] = {"rig": rig, "law": law, "reference": reference, "initial": initial}
        fields = record_fields(table, rig=rig, columns=columns, units=units, wrap=wrap, reference=reference)
        return cls(**fields, **given)

    @known_options
    def resampled(self, period: float) -> Record:
        """The same experiment at uniform times, its counts interpolated linearly and rounded to whole pulses.

        The true motion likewise. Torque and current are means over each new period, of a zero-order hold, or of a line
        across a gap (above 1.5 median intervals). A sample between two has their smaller weight, and none in a gap.

        Parameters
        ----------
        period : float
            Of the new samples, and of the new record's rig [s].

        Raises
        ------
        ValueError
            A period more than 20 times longer or shorter than the nominal interval: it is in another unit.
        """
        return Record(**resampled_fields(self, real("period", period, "Give seconds.", positive=True)))
