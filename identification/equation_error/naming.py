"""What messages, tables and figures call things: records by place and file, parameters by short
names, with units.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

from plant import Dynamics, Record
from plant.mechanics.lumping import STANDARD

T = TypeVar("T")

# Units of numbers of rig and law, of the side that they are stated on.
_OF_RIG = {
    "drive.motor_inertia": "kg m²",
    "drive.viscous": "N m s/rad",
    "drive.coulomb": "N m",
    "drive.motor_gain": "N m/A",
    "drive.current_limit": "A",
    "drive.current_lag": "s",
    "drive.elasticity.stiffness": "N m/rad",
    "drive.elasticity.damping": "N m s/rad",
    "drive.elasticity.backlash": "rad",
    "drive.curve.offset": "N m",
    "drive.curve.breakaway": "N m",
    "drive.curve.speed": "rad/s",
    "law.gain": "N m per pulse",
}

# Checks of columns and of what rig and law state of them: causes of whatever else looks wrong.
_MISREAD = (
    "law",
    "rows left out",
    "copied columns",
    "units of counts",
    "quantisation step",
    "swapped joints",
    "gear sign",
    "drive sign",
    "swapped torques",
    "units of torque",
)

_INERTIA = [kind.startswith(("I", "J")) for kind in STANDARD]
_FIRST = [kind in ("mx", "my", "mz") for kind in STANDARD]


def short_names(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """The same names with those of f short (`Dynamics.short_names`); `Dynamics.legend` says what
    they mean.
    """
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    return tuple(short.get(name, name) for name in names)


def units(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """Units of f and of numbers of rig and law, by name; "" of one whose unit is not known here.

    A parameter is an inertia where one is in it, else a first moment or a mass; one that enters the
    inertial torque alone is an inertia where all joints turn.
    """
    lumping = dynamics.lumping
    of_f = dict[str, str]()
    turning = not any(link.prismatic for link in dynamics.chain.links)
    for i, name in enumerate(dynamics.names):
        row = np.asarray(np.any(np.reshape(lumping.matrix[i], (-1, len(STANDARD))), axis=0))
        if row[_INERTIA].any() or (turning and not lumping.gravitational[i]):
            of_f[name] = "kg m²"
        else:
            of_f[name] = "kg m" if row[_FIRST].any() else "kg"
    return tuple(of_f.get(name, _OF_RIG.get(name.partition("[")[0], "")) for name in names)


class RecordError(ValueError):
    """A refusal of one of several records: which, what was expected, what came, and what to do.

    Sent to another process it is a `ValueError` of the same words.

    Parameters
    ----------
    said : str
        The refusal without the record.
    record : Record
        The one that it is about.
    label : str
        What messages call the record, such as ``records[1] (run_02.csv)``; "" for the only one.

    See Also
    --------
    plant.LoadError, identification.identify

    Examples
    --------
    >>> import dataclasses
    >>> from identification import RecordError, identify
    >>> from plant import puma560, simulate
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.1)
    >>> lawless = dataclasses.replace(record, law=None, name="run_02.csv")
    >>> try:
    ...     identify(puma560.dynamics(), [record, lawless, record], progress=False)
    ... except RecordError as error:
    ...     print(str(error).split(";")[0])
    ...     print(error.record.name)
    records[1] (run_02.csv): the record must name the law that made it
    run_02.csv
    """

    def __init__(self, said: str, record: Record, label: str) -> None:
        super().__init__(f"{label}: {said}" if label else said)
        self.said = said
        self.record = record

    def __reduce__(self) -> tuple[Any, ...]:
        return ValueError, (str(self),)


def record_label(records: Sequence[Record], k: int) -> str:
    """What messages call one of several records, or a single one that was read from a file; ""
    of the only one.
    """
    name = f" ({records[k].name})" if records[k].name else ""
    return f"records[{k}]{name}" if len(records) > 1 else f"the record{name}" * bool(name)


def column_of(record: Record, field: str, joint: int) -> str:
    """The column of a signal and a joint in the file of a record, as a clause; "" where no
    mapping names it.
    """
    column = record.column(field, joint)
    return "" if column == field else f", {column},"


def misread(record: Record, *, limited: bool = False) -> str:
    """The first sign, order, unit or statement of a record that its checkup calls wrong; "" where
    none is.

    Where an amplifier `limited` the torque, nothing of its unit.
    """
    among = [name for name in _MISREAD if not (limited and name == "units of torque")]
    return first_problem((dataclasses.replace(record, name=""),), among)


def first_problem(records: Sequence[Record], among: Sequence[str] = ()) -> str:
    """What the checkup of the records calls wrong first, as a sentence with the record's name;
    "" where nothing is.
    """
    for k, record in enumerate(records):
        checkup = record.check()
        for finding in checkup.problems:
            if finding.verdict == "wrong" and (not among or finding.check in among):
                joint = (
                    "" if finding.joint is None else f" of {checkup.joint_labels[finding.joint]}"
                )
                label = record_label(records, k)
                return f" {f'{label}: ' if label else ''}{finding.check}{joint}: {finding.advice}"
    return ""


def each_named(records: Sequence[Record]) -> Iterator[tuple[Record, Any]]:
    """Each record, with a context in which every refusal is about that record, and says so."""
    for k, record in enumerate(records):
        yield record, _about(record, record_label(records, k))


def of_each(make: Callable[..., T], records: Sequence[Record], *others: Iterable[Any]) -> list[T]:
    """What a function makes of each record, and of what belongs to it; a ValueError names the
    record.
    """
    found = list[T]()
    for (record, about), *more in zip(each_named(records), *others, strict=True):
        with about:
            found.append(make(record, *more))
    return found


@contextlib.contextmanager
def _about(record: Record, label: str) -> Iterator[None]:
    try:
        yield
    except RecordError:
        raise
    except ValueError as error:
        raise RecordError(str(error), record, label) from error


@contextlib.contextmanager
def held_out(kept: Sequence[Record], searched: int, among: bool) -> Iterator[None]:
    """A context in which refusals of records that were held out call them so.

    `searched`: number of the others. `among`: whether they are the last of the same list.
    """
    try:
        yield
    except RecordError as error:
        k = next(k for k, record in enumerate(kept) if record is error.record)
        place = f"records[{searched + k}]" if among else f"held_out[{k}]"
        name = f" ({error.record.name})" if error.record.name else ""
        raise RecordError(error.said, error.record, f"{place}{name}") from error
