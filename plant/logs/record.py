"""The log of an experiment: all that passes from plant to identification.

A record keeps the rig, the law and the reference that made it, so that the same experiment can be
replayed with another arm. A file from a real robot enters exactly where a simulation does.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plant.checkup import Checkup, Hypothesis, examine
from plant.laws import Law
from plant.logs.record_csv import COLUMNS
from plant.logs.record_files import SOURCES, FromFiles
from plant.logs.resampling import resampled_fields
from plant.machine import InnerLoop, Rig
from plant.motion import Reference
from plant.parts import (
    Floats,
    Frozen,
    Vector,
    array,
    choice,
    frozen,
    instance,
    kept,
    known_options,
    real,
)

_LEFT_OUT: Any = None
NUMBERS = ("temperature",)  # notes that are numbers


@kept
@known_options
@frozen
class Record(FromFiles, Frozen):
    """Samples of one experiment.

    Parameters
    ----------
    t : (N,) array_like
        Times of the samples, increasing [s].
    error_pulses : (N, n) array_like
        Commanded minus counted [pulses], on the motor's shaft, with its sign.
    reference_pulses : (N, n) array_like, optional
        Commanded counts. By default 0, for logs without commands; the errors are then minus the
        counts.
    rig : Rig
    law : Law, optional
        What controlled the arm.
    reference : Reference, optional
        What the commanded counts were made from.
    torque : (N, n) array_like, optional
        Joint torque of the motors, after the amplifier's limit [N m]; what was injected is in it.
    current : (N, n) array_like, optional
        Motor current [A], of all that torque.
    injected : (N, n) array_like, optional
        Known joint torque that acted beside the law's, added to it at the amplifier [N m], such as
        an excitation; held from its sample to the next. The motors gave the sum, within the
        amplifier's limit; the law did not know of it.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0. Left out, a replay starts with the reference,
        but a joint whose first error is a pulse or more starts where its encoder says.
    valid : (N,) array_like, optional
        Weight of each sample, 0 to 1; a sample that was dropped or is wrong has 0. By default all
        have 1.
    link_counts : (N, n) array_like, optional
        What encoders on the links count, behind elastic gears, in pulses of the motors' shafts; NaN
        throughout in the column of a joint that has none.
    true_q, true_qd : (N, n) array_like, optional
        True joint motion; only a simulation knows it, and identification never reads it.
    name : str
        What messages call it: of a record that was read, its file. Records that differ only in
        this, in `columns` or in `notes` are equal.
    columns : dict, optional
        Field -> name of its column in the file, or names, one per joint, as `from_table` was given
        them; for messages.
    notes : dict, optional
        What is known of the log: text or numbers by name, such as ``robot``, ``time`` (ISO 8601, or
        Unix seconds), ``temperature`` [°C]; a `ctc.Fleet` reads these three.

    Raises
    ------
    ValueError
        Wrong shapes, NaN, time that does not increase, with the index; a law that repeats a column
        that is not there.

    See Also
    --------
    plant.simulate, plant.read_records, identification.identify

    Examples
    --------
    >>> from plant import Record, puma560, simulate
    >>> rig = puma560.rig()
    >>> record = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), duration=0.5)
    >>> record.to_csv("log.csv")
    >>> again = Record.from_csv("log.csv", rig=rig)
    >>> print((again.error_pulses == record.error_pulses).all())
    True
    """

    t: NDArray[Any]
    error_pulses: NDArray[Any]
    rig: Rig
    reference_pulses: Vector = _LEFT_OUT
    law: Law | None = None
    reference: Reference | None = None
    torque: NDArray[Any] | None = None
    current: NDArray[Any] | None = None
    injected: NDArray[Any] | None = None
    initial: NDArray[Any] | None = None
    valid: Vector = _LEFT_OUT
    link_counts: NDArray[Any] | None = None
    true_q: NDArray[Any] | None = None
    true_qd: NDArray[Any] | None = None
    name: str = dataclasses.field(default="", compare=False)
    columns: Mapping[str, Any] | None = dataclasses.field(default=None, compare=False)
    notes: Mapping[str, Any] | None = dataclasses.field(default=None, compare=False)

    def __post_init__(self) -> None:
        # 1. Parts.
        self._keep_parts()
        object.__setattr__(self, "notes", _noted(self.notes))
        # 2. Times, which must increase before anything is divided by their steps.
        t = array("t", self.t, ("N",), advice="Give the time of each sample [s].", shared=True)
        if not len(t):
            raise ValueError(
                "t must hold samples; got none. Check that the log was written to the end."
            )
        # The message names the index, by which the row is found in the file.
        stuck = np.flatnonzero(np.diff(t) <= 0)
        if len(stuck):
            i = int(stuck[0]) + 1
            raise ValueError(
                f"t must increase; got {t[i]} after {t[i - 1]} at index {i}. Sort the rows or drop"
                " one."
            )
        # 3. Signals: one row per sample, one column per joint.
        shape = (len(t), self.rig.n)
        # Checked values are set at the end, when all of them are known to be sound.
        values = {"t": t}
        for name in COLUMNS:
            value = getattr(self, name)
            if value is not None:
                # A joint without a link encoder has a column of NaN; no other signal may have gaps.
                partial = name == "link_counts"
                advice = "Give one row per sample, one column per joint."
                values[name] = array(
                    name, value, shape, advice=advice, finite=not partial, shared=True
                )
                if partial:
                    _require_sensors(self.rig, values[name])
        if self.error_pulses is None:
            raise ValueError(
                f"error_pulses must have shape {shape}; got None. Without a reference, give"
                " -counts."
            )
        if self.reference_pulses is None:
            # Without a reference the error is minus the counts.
            values["reference_pulses"] = np.zeros(shape)
        valid = np.ones(len(t)) if self.valid is None else self.valid
        values["valid"] = valid = array(
            "valid", valid, shape[:1], advice="Give one weight per sample.", shared=True
        )
        # A weight above 1 would count a sample more than once.
        wrong = np.flatnonzero((valid < 0) | (valid > 1))
        if len(wrong):
            got = f"got {valid[wrong[0]]:g} at index {wrong[0]}"
            raise ValueError(f"valid must be 0 to 1; {got}. 0 leaves a sample out.")
        if self.initial is not None:
            values["initial"] = array(
                "initial", self.initial, (2, self.rig.n), advice="Give q and qd at t = 0."
            )
        # 4. Records share their arrays, so nobody may write to them.
        for name, value in values.items():
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        # A law may need columns that this record lacks; it refuses here and not in the middle of a
        # fit.
        if self.law is not None:
            self.law.replayed(self)

    def _keep_parts(self) -> None:
        """Refuse parts of the wrong type, which would fail much later, or for other joints."""
        for name, kind in (
            ("rig", Rig),
            ("law", (Law, type(None))),
            ("reference", (Reference, type(None))),
        ):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(
                    f"{name} of a record must be a {name.capitalize()}; got"
                    f" {getattr(self, name)!r:.60}."
                )
        n = self.rig.n
        if self.reference is not None and self.reference.n != n:
            raise ValueError(
                f"reference must have {n} joints like the rig; got {self.reference.n}. Use a"
                " matching one."
            )
        if self.law is not None:
            self.law.require_joints(n, "law.")
        # An inner loop is the law of a log or lies below one, never both.
        if isinstance(self.law, InnerLoop):
            object.__setattr__(self, "law", self.law.for_joints(n))
            if self.rig.inner not in (None, self.law):
                raise ValueError(
                    "law of a record and inner loop of its rig must be one; got two that differ."
                    " Leave inner out of the rig."
                )
            if self.rig.inner is not None:
                object.__setattr__(self, "rig", dataclasses.replace(self.rig, inner=None))
        instance("name", self.name, str, "Give a word, such as the file's name.")
        if self.columns is not None:
            object.__setattr__(self, "columns", _mapped(self.columns))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.rig.n

    @property
    def counts(self) -> Floats:
        """Encoder counts, (N, n) [pulses]."""
        return self.reference_pulses - self.error_pulses

    def column(self, field: str, joint: int) -> str:
        """Name of the column of a field and a joint, for messages.

        The field is "counts", "reference", "torque" or another one. The name is the one in the
        file, if one was mapped, and the field; otherwise it is the field alone.
        """
        choice("joint", joint, range(self.n))
        mapping = self.columns or {}
        # A signal may have been computed from another column, which is the one that the user can
        # correct.
        names = [name for name in (field, *SOURCES.get(field, ())) if name in mapping]
        mapped = mapping[names[0]] if names else None
        if isinstance(mapped, str):
            return (
                f"column {mapped!r}, place {joint} ({names[0]})"
                if self.n > 1
                else f"column {mapped!r} ({names[0]})"
            )
        if mapped is not None and len(mapped) == self.n:
            return f"column {mapped[joint]!r} ({names[0]})"
        return field

    @known_options
    def check(self, *, hypotheses: Sequence[Hypothesis[Any]] = ()) -> Checkup:
        """Examine this log for errors before it is used; the `Checkup` prints as a table.

        Parameters
        ----------
        hypotheses : sequence of Hypothesis
            Mistakes of your own that are tried beside the built-in ones. One that changes nothing,
            or cannot be undone in this log, is named in ``failed`` and left out.
        """
        return examine(self, hypotheses)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        law = type(self.law).__name__ if self.law is not None else "an unknown law"
        return (
            f"Record({len(self)} samples of {self.n} joints, {self.t[-1] - self.t[0]:.3f} s, under"
            f" {law})"
        )

    def cut(self, begin: float, end: float = np.inf) -> Self:
        """The record from `begin` to before `end` [s], with its own time from 0.

        Its reference continues from there, and steps of its transport's `lost` are counted from
        there. Its jitter draws from its seed anew: a replay of the stretch has other instants.

        Raises
        ------
        ValueError
            A stretch without samples.
        """
        begin = real("begin", begin, "Give seconds of the record's t.")
        if not (isinstance(end, float) and np.isinf(end)):
            end = real("end", end, "Give seconds of the record's t.")
        rows = np.flatnonzero((self.t >= begin) & (self.t < end))
        if not len(rows):
            extent = f"The record has {self.t[0]:g} to {self.t[-1]:g} s."
            raise ValueError(
                f"begin and end must hold samples; none lies from {begin:g} to {end:g} s. {extent}"
            )
        # A slice, not the rows: times increase, so that the stretch has no holes.
        stretch = slice(rows[0], rows[-1] + 1)
        reference = self.reference
        # A cut that starts later has no known initial state, and its reference starts in its
        # middle.
        offset = float(self.t[rows[0]] - self.t[0])
        values = {name: getattr(self, name) for name in (*COLUMNS, "valid")}
        cut: dict[str, Any] = {
            name: None if value is None else value[stretch] for name, value in values.items()
        }
        if reference is not None and offset:
            reference = reference.later(offset)
        rig = self.rig
        if rig.transport is not None:
            period = (self.law and self.law.period_on(rig)) or rig.period
            lost = (k - round(offset / period) for k in rig.transport.lost)
            transport = dataclasses.replace(rig.transport, lost=tuple(k for k in lost if k > 0))
            rig = dataclasses.replace(rig, transport=transport)
        return dataclasses.replace(
            self,
            **cut,
            rig=rig,
            t=self.t[stretch] - self.t[rows[0]],
            reference=reference,
            initial=None if offset else self.initial,
        )

    @known_options
    def resampled(self, period: float) -> Self:
        """The same experiment at uniform times.

        Counts are interpolated linearly and rounded to whole pulses, unless the encoder is smooth;
        goals of a held reference hold. Link counts and the true motion are interpolated, and stay
        unrounded. Torques and currents are means over each new period. They are taken as held
        between samples, but as linear across a step longer than 1.5 median intervals. A new sample
        gets the smaller weight of its two neighbours; in a gap it gets 0. A gap is a step above 1.5
        median intervals in which the motion may leave the straight line by a thousandth of its
        range.

        Parameters
        ----------
        period : float
            Of the new samples, and of the new record's rig [s].

        Raises
        ------
        ValueError
            A period more than 20 times longer or shorter than the nominal interval: it is in
            another unit.
        """
        return type(self)(
            **resampled_fields(self, real("period", period, "Give seconds.", positive=True))
        )


def _require_sensors(rig: Rig, counts: Floats) -> None:
    """Refuse columns of link encoders that hold gaps, none at all, or others than the rig has."""
    # NaN is how a column says that there is no sensor.
    numbers = ~np.isnan(counts)
    stated = rig.encoder.side
    has_sensor = np.asarray(numbers.any(axis=0))
    # A joint has its sensor in all samples or in none.
    advice = "A joint without a second encoder is NaN throughout."
    bad = np.isinf(counts) | (numbers != has_sensor)
    if bad.any():
        index = tuple(np.argwhere(bad)[0].tolist())
        raise ValueError(
            f"link_counts must be finite; got {counts[index]} at index {index}. {advice}"
        )
    if not has_sensor.any():
        raise ValueError(
            f"link_counts must be of a joint at least; got NaN alone. Leave them out. {advice}"
        )
    wrong = np.flatnonzero(has_sensor != rig.encoder.on_links(rig.n))
    if len(wrong) and stated not in ("motor", "link"):
        # The rig says joint by joint which have two encoders.
        label = rig.joint_labels[wrong[0]]
        got = "has a column" if has_sensor[wrong[0]] else "is NaN"
        raise ValueError(
            f"link_counts must be of joints with side 'both'; {label} {got}, its rig says"
            f" {stated!r}."
        )


def _mapped(columns: Any) -> dict[str, Any]:
    """Name of a column, or a tuple of one per joint, by field; anything else is refused."""
    advice = "Give the mapping of from_table."
    mapped = {}
    for field, names in instance("columns", columns, dict, advice).items():
        listed = (names,) if isinstance(names, str) else names
        sound = isinstance(listed, (tuple, list)) and all(
            name is None or isinstance(name, str) for name in listed
        )
        if not sound:
            raise ValueError(
                f"columns must map fields to names; got {names!r:.60} for {field!r:.40}. {advice}"
            )
        mapped[field] = names if isinstance(names, str) else tuple(names)
    return mapped


def _noted(notes: Any) -> dict[str, str | float]:
    """Text, or finite numbers, by name; anything else is refused."""
    advice = 'Give such as {"robot": "cell_7", "time": "2026-05-12", "temperature": 24.5}.'
    entries = {} if notes is None else instance("notes", notes, dict, advice)
    for name, value in entries.items():
        if not isinstance(name, str) or not name or (isinstance(value, str) and not value):
            raise ValueError(
                f"notes must be text or numbers by name; got {name!r:.40}: {value!r:.40}. {advice}"
            )
        # A temperature that was written as text would be compared as text later.
        if name in NUMBERS or not isinstance(value, str):
            real(f"note {name!r:.40}", value, advice)
    return {
        name: value if isinstance(value, str) else float(value) for name, value in entries.items()
    }
