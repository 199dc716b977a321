"""Named vectors: the only place where the names of a state become places in a vector.

A law, a closed loop or a fit declares its vector once, as `Fields`. It reads the vector as a record
with those names, and writes a new one by name, so that no other file slices it by number.
"""

import collections
import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from plant.parts.fields import Floats

TORQUE_ERROR = "torque error"
"""Role of a torque [N m] by which the model of a law is estimated to be wrong."""

MODEL_TORQUE = "model torque"
"""Role of a torque [N m] that the model of a law needed in the sample before."""

MODEL_ERROR = "model error"
"""Role of an integral of the tracking error, which stands for a torque that the model lacks."""


@dataclasses.dataclass(frozen=True)
class Field:
    """One named quantity of a vector: its size, its start, its role.

    Parameters
    ----------
    size : int, optional
        Numbers, however many joints there are; by default `rows` numbers of each joint.
    rows : int
        Rows of one number per joint.
    start : float or array_like
        Value of every number at the start, in the field's unit.
    role : str, optional
        Meaning that other code asks for (`Fields.places`), such as `TORQUE_ERROR`.
    """

    size: int | None = None
    rows: int = 1
    start: Any = 0.0
    role: str | None = None

    def length(self, n: int) -> int:
        """Numbers of this field for n joints."""
        return self.rows * n if self.size is None else self.size


def per_joint(rows: int = 1, *, start: Any = 0.0, role: str | None = None) -> Field:
    """A field of one number per joint, or of several rows of them: (rows * n,)."""
    return Field(rows=rows, start=start, role=role)


def scalars(size: int = 1, *, start: Any = 0.0, role: str | None = None) -> Field:
    """A field of `size` numbers, however many joints there are."""
    return Field(size=size, start=start, role=role)


class Fields:
    """The names of a vector, in the order in which it holds them.

    Parameters
    ----------
    **fields : Field or Fields
        The quantities by name. A value that is itself `Fields` is a group, such as the state of one
        block of a law: it is read as a record inside the record, and written as a mapping.

    Raises
    ------
    ValueError
        A field that is neither; in `write`, a missing name, an unknown name or a wrong length.

    Examples
    --------
    >>> import numpy as np
    >>> from plant.parts.vector import Fields, per_joint, scalars
    >>> fields = Fields(error=per_joint(), rate=per_joint(), begun=scalars())
    >>> state = fields.read(np.array([1.0, 2.0, 3.0, 4.0, 0.0]), n=2)
    >>> state.rate
    array([3., 4.])
    >>> fields.write(2, error=state.error, rate=2 * state.rate, begun=1)
    array([1., 2., 6., 8., 1.])
    """

    def __init__(self, **fields: "Field | Fields") -> None:
        for name, field in fields.items():
            if not isinstance(field, Field | Fields):
                raise ValueError(
                    f"the field '{name}' must be a Field or a group of Fields; got a"
                    f" {type(field).__name__}. Use per_joint() or scalars()."
                )
        self.fields = fields
        self._record = collections.namedtuple("State", fields)  # type: ignore[misc]

    def __repr__(self) -> str:
        return f"Fields({', '.join(self.fields)})"

    def length(self, n: int) -> int:
        """Numbers of a whole vector for n joints."""
        return sum(field.length(n) for field in self.fields.values())

    def initial(self, n: int) -> Floats:
        """The vector (length,) at the start."""
        starts = [
            field.initial(n)
            if isinstance(field, Fields)
            else np.broadcast_to(np.asarray(field.start, float), field.length(n))
            for field in self.fields.values()
        ]
        return np.concatenate([np.empty(0), *starts])

    def read(self, vector: Any, n: int) -> Any:
        """The vector (length,) as a record: an attribute per field.

        A numpy array may hold one vector per column (length, P). A field of one number is read as
        that number, every other field as a vector.
        """
        length = vector.shape[0]
        if length != self.length(n):
            raise ValueError(
                f"a vector with the fields {', '.join(self.fields)} must have {self.length(n)}"
                f" numbers for {n} joints; got {length}. Use the vector of the same fields."
            )
        values = {}
        for name, place in self.at(n).items():
            field = self.fields[name]
            part = vector[place.start : place.stop]
            if isinstance(field, Fields):
                part = field.read(part, n)
            elif field.size == 1:
                part = vector[place.start]
            values[name] = part
        return self._record(**values)

    def write(self, n: int, **values: Any) -> Any:
        """The vector (length,) of these values: casadi's where one of them is, otherwise numpy's.

        A field of one number may be given as a number; a group as a mapping or as a record.
        """
        for name in values.keys() - self.fields.keys():
            raise ValueError(
                f"'{name}' must be a field of this vector; it has {', '.join(self.fields)}. Declare"
                " the field, or correct the name."
            )
        for name in self.fields.keys() - values.keys():
            raise ValueError(
                f"a vector must get a value for each of its fields; '{name}' has none. Write it."
            )
        parts = []
        for name, field in self.fields.items():
            value = values[name]
            if isinstance(field, Fields):
                group = value._asdict() if hasattr(value, "_asdict") else value
                value = field.write(n, **group)
            elif not isinstance(value, ca.SX | ca.MX | ca.DM):
                value = np.atleast_1d(np.asarray(value, float))
            if value.shape[0] != field.length(n) or value.shape[1:] not in ((), (1,)):
                raise ValueError(
                    f"the field '{name}' must have {field.length(n)} numbers; got shape"
                    f" {tuple(value.shape)}. Give one column of that length."
                )
            parts.append(value)
        if any(isinstance(part, ca.SX | ca.MX | ca.DM) for part in parts):
            return ca.vertcat(*parts)
        return np.concatenate([np.empty(0), *parts])

    def at(self, n: int) -> dict[str, range]:
        """Name -> places of the field in the vector."""
        places = {}
        begin = 0
        for name, field in self.fields.items():
            places[name] = range(begin, begin + field.length(n))
            begin = places[name].stop
        return places

    def places(self, n: int, role: str) -> tuple[range, ...]:
        """Places of all the fields of a role, those inside groups included, in order."""
        places: list[range] = []
        for name, place in self.at(n).items():
            field = self.fields[name]
            if isinstance(field, Fields):
                inner = field.places(n, role)
                places += [range(place.start + x.start, place.start + x.stop) for x in inner]
            elif field.role == role:
                places.append(place)
        return tuple(places)
