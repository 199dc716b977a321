"""Names in messages, tables and figures: records by place and file, parameters with units."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

from plant import Dynamics, Record
from plant.mechanics import STANDARD

T = TypeVar("T")

# Units of the numbers of the rig and the law, by kind. `_OF_JOINT` lists the kinds whose unit
# depends on whether the joint turns or slides.
_OF_RIG = {
    "drive.motor_inertia": "kg m²",
    "drive.viscous": "N m s/rad",
    "drive.coulomb": "N m",
    "drive.motor_gain": "N m/A",
    "drive.current_limit": "A",
    "drive.current_lag": "s",
    "drive.curve.offset": "N m",
    "drive.curve.breakaway": "N m",
    "drive.curve.speed": "rad/s",
    "law.gain": "N m per pulse",
    "law.derivative": "N m s per pulse",
    "law.position": "1/s",
    "law.speed": "N m s per pulse",
}

# Numbers that are stated on the joint side, where a slide has other units than a joint that turns.
# Each value is the field of `JointUnits` that holds the unit.
_OF_JOINT = {
    "drive.elasticity.stiffness": "stiffness",
    "drive.elasticity.damping": "damping",
    "drive.elasticity.backlash": "position",
}

# Each constant marks the standard parameters of one quantity. The unit of a parameter of f follows
# from the standard parameters that it lumps together.
_INERTIA = np.array([kind.startswith("I") for kind in STANDARD])
_ROTOR = np.array([kind.startswith("J") for kind in STANDARD])
_FIRST = [kind in ("mx", "my", "mz") for kind in STANDARD]


def short_names(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """Return the names, and replace those of the parameters f by `Dynamics.short_names`.

    `Dynamics.legend` explains the short names.
    """
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    return tuple(short.get(name, name) for name in names)


def units(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """Units of the named parameters f and numbers of rig and law; "" for a name not known here.

    A parameter of f has the unit of an inertia if it contains an inertia, else that of a first
    moment if it contains one, else that of a mass. If all joints turn, a parameter that does not
    enter the gravitational torque has the unit of an inertia, too. The rotor of a slide is a mass.
    """
    lumping = dynamics.lumping
    of_f = {}
    # Along a prismatic joint a mass enters the inertial torque, too.
    slides = np.array([link.prismatic for link in dynamics.chain.links])
    # By link and kind: rotors of joints that turn are inertias, too.
    inertias = _INERTIA | (_ROTOR & ~slides[:, None])
    for i, name in enumerate(dynamics.names):
        # The kinds of standard parameters, of all bodies, that this one lumps together.
        row = np.reshape(lumping.matrix[i], (-1, len(STANDARD))) != 0
        if row[inertias].any() or (not slides.any() and not lumping.gravitational[i]):
            of_f[name] = "kg m²"
        else:
            of_f[name] = "kg m" if row[:, _FIRST].any() else "kg"

    # The unit of a gear is that of its joint.
    of_joint = {
        f"{kind}[{i}]": str(getattr(unit, field))
        for i, unit in enumerate(dynamics.chain.joint_units)
        for kind, field in _OF_JOINT.items()
    }

    def unit(name: str) -> str:
        return (of_f | of_joint).get(name, _OF_RIG.get(name.partition("[")[0], ""))

    return tuple(map(unit, names))


class RecordError(ValueError):
    """A record is refused; the message names the record by its label.

    Pickling turns this error into a `ValueError` with the same message, which another process gets.

    Parameters
    ----------
    said : str
        The message without the label.
    record : Record
        The refused record.
    label : str
        Name of the record in messages, such as ``records[1] (run_02.csv)``; "" leaves it out.

    See Also
    --------
    plant.LoadError, identification.identify

    Examples
    --------
    >>> import dataclasses
    >>> from identification import RecordError, identify
    >>> from plant import puma560, simulate
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.1)
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
        # A record may be a gigabyte, and its law need not pickle: the words alone travel.
        return ValueError, (str(self),)


def record_label(records: Sequence[Record], k: int) -> str:
    """Label of a record in messages: its place among several, and its name if it has one.

    The label of an only record is "" if the record has no name.
    """
    name = f" ({records[k].name})" if records[k].name else ""
    return f"records[{k}]{name}" if len(records) > 1 else f"the record{name}" * bool(name)


def column_of(record: Record, field: str, joint: int) -> str:
    """The column of a signal and a joint in the file of a record, as a clause.

    "" where no mapping names it.
    """
    column = record.column(field, joint)
    return "" if column == field else f", {column},"


def each_named(records: Sequence[Record]) -> Iterator[tuple[Record, Any]]:
    """Each record, with a context in which every refusal names that record."""
    for k, record in enumerate(records):
        # Each context belongs to one record: the caller enters the context only for the work on
        # that record.
        yield record, _about(record, record_label(records, k))


def of_each(
    make: Callable[..., T], records: Sequence[Record], *arguments_of_each: Iterable[Any]
) -> list[T]:
    """Call a function with each record and that record's further arguments; return the results.

    If the function raises a ValueError, the error that reaches the caller names the record.
    """
    results = []
    for (record, about), *arguments in zip(each_named(records), *arguments_of_each, strict=True):
        with about:
            results.append(make(record, *arguments))
    return results


@contextlib.contextmanager
def _about(record: Record, label: str) -> Iterator[None]:
    try:
        yield
    except RecordError:
        # It names its record already.
        raise
    except ValueError as error:
        raise RecordError(str(error), record, label) from error


@contextlib.contextmanager
def held_out(records: Sequence[Record], searched: int, among: bool) -> Iterator[None]:
    """A context in which a refusal names a held-out record by its place in the user's list.

    `searched`: number of records that were not held out. `among`: whether the user passed one list,
    in which the held-out records come last, instead of a list of their own.
    """
    try:
        yield
    except RecordError as error:
        # By identity: two equal records are two places.
        places = [k for k, record in enumerate(records) if record is error.record]
        if not places:
            # The refused record is a changed copy; its error has a label already.
            raise
        k = places[0]
        # By the list in which the user passed it.
        place = f"records[{searched + k}]" if among else f"held_out[{k}]"
        name = f" ({error.record.name})" if error.record.name else ""
        raise RecordError(error.said, error.record, f"{place}{name}") from error
