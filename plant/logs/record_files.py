"""How a `Record` is read and written: its own CSV, columns of other formats, MCAP for viewers."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from plant.laws import Law
from plant.logs import record_csv
from plant.logs.contents import LogContents, contents_of
from plant.logs.logfile import kind_of, load_errors, options_of, read_file
from plant.logs.mapping import MEASURED, mapped_names, record_fields
from plant.machine import Rig
from plant.motion import Held, Reference
from plant.parts import McapFile, instance, joint_topics, known_options

# Signal of a record -> fields of a mapping, under other names, from which the signal can be made.
SOURCES = {
    "counts": ("position", "motor_position", "error_pulses"),
    "error": ("error_pulses", "position", "motor_position", "counts"),
    "reference": ("reference_pulses", "reference_position", "reference_motor_position"),
    "torque": ("current",),
    "link_counts": ("link_position",),
}


class FromFiles:
    """The readers and the writer of a `Record`."""

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV file that `from_csv` reads back without loss.

        Line 1 holds what is no column, such as the rig.
        """
        record_csv.write(self, path)

    def to_mcap(self, path: str | Path) -> None:
        """Write an MCAP file for Foxglove, PlotJuggler and Rerun, with times that start at 0.

        ``/joint_states`` has the measured joints in rad and N m, ``/reference`` has the commanded
        joints in rad, and ``/sample`` has all columns of this record. To export an evaluation, call
        this method of its ``record``.
        """
        record: Any = self
        # MCAP has times in whole nanoseconds.
        times = np.rint(1e9 * (record.t - record.t[0])).astype(int).tolist()
        columns = {
            name: getattr(record, name)
            for name in record_csv.COLUMNS
            if getattr(record, name) is not None
        }
        columns |= {"valid": record.valid[:, None]}
        # Viewers need the number of columns of each signal before the first message.
        topics = joint_topics(record.n, {name: values.shape[1] for name, values in columns.items()})
        # The centre of the quantisation cell is the best estimate of a position from its count.
        q = record.rig.cell_centre(record.counts)
        q_r = record.rig.to_angle(record.reference_pulses)
        # A message of joint states may leave efforts out, as it does speeds.
        torque = columns.get("torque", np.zeros((len(times), 0)))
        with McapFile(path, record.rig.drive.joints, record.n, topics) as file:
            # Sample by sample, so that the messages of all topics are in order of time.
            for k, time in enumerate(times):
                file.append("/joint_states", time, (q[k], (), torque[k]))
                file.append("/reference", time, (q_r[k], (), ()))
                file.append("/sample", time, [values[k] for values in columns.values()])

    @classmethod
    @known_options
    def from_csv(
        cls,
        path: str | Path,
        *,
        rig: Rig | None = None,
        law: Law | None = None,
        reference: Reference | None = None,
        initial: ArrayLike | None = None,
        columns: Mapping[str, Any] | None = None,
        units: Mapping[str, Any] | None = None,
        wrap: ArrayLike | None = None,
        prefix: str = "",
        held: bool = False,
        torque_delay: int = 0,
    ) -> Self:
        """Read a file of `to_csv`, a plain CSV, or, with `columns`, a CSV log of another program.

        A plain CSV has one column t [s], n columns of the reference and n of the error [pulses].

        Parameters
        ----------
        path : str or Path
        rig, law, reference, initial : optional
            As in `Record`. A plain file needs rig and law; without a reference the logged counts
            are replayed. With a file of `to_csv`, these arguments replace what the file says.
        columns : dict, optional
            Map of the fields of a record to named columns of the file. `from_table` describes this
            map, `units` and `wrap`.
        prefix : str
            What the names of the mapped columns begin with in the file, as in ``run_07/``.
        held : bool
            The commanded counts are goals that a servo held until the next row, not points of a
            path: the reference becomes `Held`.
        torque_delay : int
            Rows by which mapped columns of torque and current are late, as drives export them: 1
            where the torque of a sample stands in the next row.

        Raises
        ------
        LoadError
            A file that cannot be read; a cell that is no number, a short row, an unknown column, a
            header that cannot be read; with the line.
        ValueError
            `units`, `wrap`, `prefix` or `torque_delay` without `columns`; a mapping that no file
            can have.
        """
        if columns is not None:
            return cls._read(
                "csv",
                path,
                None,
                rig=rig,
                columns=columns,
                units=units,
                wrap=wrap,
                prefix=prefix,
                law=law,
                reference=reference,
                initial=initial,
                held=held,
                torque_delay=torque_delay,
            )
        # The formats of the library have fixed units and names.
        _require_none_of(
            units=units, wrap=wrap, prefix=prefix or None, torque_delay=torque_delay or None
        )
        # The record is made inside `load_errors`, since its refusals concern the file as well.
        with load_errors(path):
            # In place of what the file states: a user who passes a rig means this one.
            fields = record_csv.read(path, rig=rig, law=law, reference=reference, initial=initial)
            record = cls(**fields | {"name": str(path)})
            return _with_goals_held(record) if held else record

    @overload
    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        rig: Rig,
        columns: Mapping[str, Any],
        units: Mapping[str, Any] | None = None,
        wrap: ArrayLike | None = None,
        prefix: str = "",
        episode: int | None = None,
        law: Law | None = None,
        reference: Reference | None = None,
        initial: ArrayLike | None = None,
        held: bool = False,
        torque_delay: int = 0,
    ) -> Self: ...

    @overload
    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        rig: Rig | None = None,
        columns: None = None,
        units: None = None,
        wrap: None = None,
        prefix: str = "",
        episode: int | None = None,
        law: Law | None = None,
        reference: Reference | None = None,
        initial: ArrayLike | None = None,
        held: bool = False,
        torque_delay: int = 0,
    ) -> "Self | LogContents": ...

    @classmethod
    @known_options
    def read(
        cls,
        path: str | Path,
        *,
        rig: Rig | None = None,
        columns: Mapping[str, Any] | None = None,
        units: Mapping[str, Any] | None = None,
        wrap: ArrayLike | None = None,
        prefix: str = "",
        episode: int | None = None,
        law: Law | None = None,
        reference: Reference | None = None,
        initial: ArrayLike | None = None,
        held: bool = False,
        torque_delay: int = 0,
    ) -> "Self | LogContents":
        """Read mapped columns of a log in any format of `read_table`, which knows a file by its
        ending and a folder by its contents.

        Without `columns`, it returns the record of a file of `to_csv`. For any other file it prints
        the contents, with a mapping to begin with, and returns them as a `LogContents`. In a log of
        messages, columns of topics other than the measured one hold their last value.

        Parameters
        ----------
        path, prefix, episode
            As in `read_table`.
        rig, columns, units, wrap, law, reference, initial, held, torque_delay
            As in `from_table`. Of a LeRobot data set map ``action`` to ``reference_position`` and
            ``observation.state`` to ``position``, with ``held=True``.

        Raises
        ------
        ValueError
            A mapping that no file can have, such as one without a measured position; `units`,
            `wrap` or `torque_delay` without `columns`, or `held` for contents.
        LoadError
            A file that cannot be read, or that does not hold what is mapped.
        """
        if columns is None:
            # The header of a file of `to_csv` states rig and law, so no mapping is needed.
            if record_csv.is_own(path):
                # `from_csv` refuses what is for mapped columns, and has no episode to refuse.
                with load_errors(path):
                    options_of("csv", episode)
                return cls.from_csv(
                    path,
                    rig=rig,
                    law=law,
                    reference=reference,
                    initial=initial,
                    units=units,
                    wrap=wrap,
                    prefix=prefix,
                    held=held,
                    torque_delay=torque_delay,
                )
            _require_none_of(
                units=units, wrap=wrap, held=held or None, torque_delay=torque_delay or None
            )
            n = None if rig is None else instance("rig", rig, Rig, "Pass rig=.").n
            contents = contents_of(path, n=n, prefix=prefix, episode=episode)
            print(contents)
            return contents
        with load_errors(path):
            # The suffix chooses the reader; a folder is known by its contents.
            kind = kind_of(path)
        return cls._read(
            kind,
            path,
            episode,
            rig=rig,
            columns=columns,
            units=units,
            wrap=wrap,
            prefix=prefix,
            law=law,
            reference=reference,
            initial=initial,
            held=held,
            torque_delay=torque_delay,
        )

    @classmethod
    def _read(
        cls, kind: str, path: str | Path, episode: int | None, *, prefix: str, **log: Any
    ) -> Self:
        names = mapped_names(log["columns"], log["units"])
        instance("rig", log["rig"], Rig, "Pass rig=.")
        # The measured column is the clock of messages: its topic gives the instants of all samples.
        measured = next(log["columns"][field] for field in MEASURED if field in log["columns"])
        clock = measured if isinstance(measured, str) else measured[0]
        # Episodes of one data set have one path; an error must say which one it means.
        name = str(path) if episode is None else f"{path}, episode {episode}"
        with load_errors(name):
            options = options_of(kind, episode, clock)
            return cls.from_table(read_file(kind, path, names, prefix, **options), name=name, **log)

    @classmethod
    @known_options
    def from_table(
        cls,
        table: Mapping[str, ArrayLike],
        *,
        rig: Rig,
        columns: Mapping[str, Any],
        units: Mapping[str, Any] | None = None,
        wrap: ArrayLike | None = None,
        law: Law | None = None,
        reference: Reference | None = None,
        initial: ArrayLike | None = None,
        name: str = "",
        held: bool = False,
        torque_delay: int = 0,
    ) -> Self:
        """Make a record of named columns, such as `read_table` reads or several files give
        together.

        Parameters
        ----------
        table : dict of str to (N,) or (N, n) array_like
        rig : Rig
            Its gear and resolution turn angles into counts. Its period is compared with the times.
        columns : dict
            Field of the record -> name of its column, or names, one per joint. Exactly one of
            ``position`` (joint angles), ``motor_position``, ``counts`` and ``error_pulses``, and
            any of ``t``, ``valid``, ``torque``, ``current``, ``injected``, ``link_position`` (a
            second sensor's; None of a joint without one) and one of ``reference_pulses``,
            ``reference_position``, ``reference_motor_position``. Positions that are smooth and not
            rounded become the record's reference. The mean of ``temperature`` [°C], and the first
            of ``time`` (Unix seconds), become notes.
        units : dict
            Field -> unit: ``s``, ``ms``, ``us`` or ``ns`` of t, ``rad``, ``deg`` or ``pulses`` of
            positions, of joints that slide ``m`` or ``mm``, ``N m`` (of the joint), ``N`` (of one
            that slides) or ``motor N m`` of torques, ``A`` or ``mA`` of current. Where some joints
            turn and others slide, one per joint: ``("rad", "m")``. By default ``degC`` of
            temperature (else ``K``) and ``s`` of time.
        wrap : float or (n,) array_like, optional
            Where the measured position starts again, in its own unit: 2**16 counts, 2 pi rad. It is
            unwrapped by whole wraps, each the one nearest to the sample before. Where it
            then differs from a reference in the same unit by whole wraps alone, these are taken
            off, with a warning.
        law, reference, initial : optional
            As in `Record`; a reference also gives the commanded counts where no column does.
        name : str
            What messages call the record.
        held : bool
            As in `from_csv`: commanded positions are goals, and none become a path.
        torque_delay : int
            As in `from_csv`.

        Notes
        -----
        Time starts at zero; without a column, sample k is at k periods. Of rows with one time the
        first is kept, with a warning. A row with NaN in any mapped column has no weight (`valid` is
        0) and holds the values of the row before; rows that are missing altogether are long time
        steps.
        Angles become whole pulses: their own where they are on a grid of one pulse, up to a shift
        per joint; otherwise what the rig's encoder would count, with a warning.

        Raises
        ------
        ValueError
            A column that is missing, has another length or holds anything but real numbers; a unit
            that is not stated, or does not fit the rig. Whatever `Record` refuses.
        """
        arguments: dict[str, Any] = {
            "rig": rig,
            "law": law,
            "reference": reference,
            "initial": initial,
            "name": name,
            "columns": columns,
        }
        # Fields of the table take precedence: a path in it becomes the reference.
        fields = record_fields(
            table,
            rig=rig,
            columns=columns,
            units=units,
            wrap=wrap,
            reference=reference,
            held=held,
            torque_delay=torque_delay,
        )
        record = cls(
            **arguments | {key: value for key, value in fields.items() if value is not None}
        )
        return _with_goals_held(record) if held else record


def _require_none_of(**options: Any) -> None:
    """Refuse options of mapped columns where nothing is mapped; None passes."""
    # They would be ignored without a word.
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise ValueError(
            f"{', '.join(given)} must come with mapped columns; got no mapping. Pass columns= as"
            " well."
        )


def _with_goals_held(record: Any) -> Any:
    """The same record with a `Held` reference, made of its commanded counts (N, n)."""
    # A path beside held goals would contradict them between two rows.
    if record.reference is not None and not record.reference.held:
        kind = type(record.reference).__name__
        raise ValueError(
            f"held goals must be the record's own commanded counts; got a reference, {kind}. Leave"
            " out reference=, or held=."
        )
    goals = record.reference_pulses
    # Constant goals are the mark of a column that is not the commanded one.
    if not np.ptp(goals, axis=0).any():
        raise ValueError(
            "held goals must move; the commanded counts are constant. Map the column of the goals"
            " that were sent, such as LeRobot's action."
        )
    # The middle of a cell: its count is the goal again, whatever is rounded on the way.
    held = Held(times=record.t - record.t[0], points=record.rig.cell_centre(goals))
    return dataclasses.replace(record, reference=held)
