"""Named vectors: the only place where the names of a state become places in a vector.

A law, a closed loop or a fit declares its vector once, as `Fields`. It reads the vector as a record
with those names, and writes a new one by name, so that no other file slices it by number.
"""

import collections
import dataclasses
import functools
import keyword
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from plant.parts.arguments import instance
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
    inner : Fields, optional
        Names within this field, which is still read and written as one vector.
    initial_vector : callable, optional
        n -> the numbers at the start, from which the length follows (`vector_of`).
    """

    size: int | None = None
    rows: int = 1
    start: Any = 0.0
    role: str | None = None
    inner: "Fields | None" = None
    initial_vector: Callable[[int], Any] | None = None

    def length(self, n: int) -> int:
        """Numbers of this field for n joints."""
        if self.initial_vector is not None:
            # The state of a wrapped law knows its length by its start alone.
            return len(self.initial_vector(n))
        if self.inner is not None:
            return self.inner.length(n)
        # A size counts numbers whatever n is, rows count joints.
        return self.rows * n if self.size is None else self.size

    def initial(self, n: int) -> Floats:
        """The numbers (length,) at the start."""
        if self.initial_vector is not None:
            return np.asarray(self.initial_vector(n), float)
        if self.inner is not None:
            return self.inner.initial(n)
        return np.broadcast_to(np.asarray(self.start, float), self.length(n))

    def places(self, n: int, role: str) -> tuple[range, ...]:
        """Places of a role, counted from the start of this field."""
        if self.inner is not None:
            return self.inner.places(n, role)
        # A role belongs to a whole field, never to single numbers of it.
        return (range(self.length(n)),) if self.role == role else ()


def per_joint(rows: int = 1, *, start: Any = 0.0, role: str | None = None) -> Field:
    """A field of one number per joint, or of several rows of them: (rows * n,).

    `start` is the value at the start; `role` is a meaning that other code asks for
    (`Fields.places`).

    See Also
    --------
    plant.Fields, plant.scalars

    Examples
    --------
    >>> from plant import Fields, per_joint
    >>> Fields(error=per_joint(), gain=per_joint(start=0.5)).initial(2)
    array([0. , 0. , 0.5, 0.5])
    """
    return Field(rows=rows, start=start, role=role)


def scalars(size: int = 1, *, start: Any = 0.0, role: str | None = None) -> Field:
    """A field of `size` numbers, however many joints there are.

    See Also
    --------
    plant.Fields, plant.per_joint

    Examples
    --------
    >>> from plant import Fields, scalars
    >>> Fields(time=scalars(), load=scalars(3, start=1.0)).initial(6)
    array([0., 1., 1., 1.])
    """
    return Field(size=size, start=start, role=role)


def vector_of(fields: "Fields | None" = None, initial: Callable[[int], Any] | None = None) -> Field:
    """A field that is a whole vector, such as the state of a wrapped law; its roles are found.

    Parameters
    ----------
    fields : Fields, optional
        Names within that vector.
    initial : callable, optional
        n -> the vector at the start, where it has no names, or starts otherwise than they say.
    """
    return Field(inner=fields, initial_vector=initial)


@functools.lru_cache(maxsize=256)
def _record(names: tuple[str, ...]) -> Any:
    """Class of the record with these attributes; made once, since making it takes 0.2 ms."""
    return collections.namedtuple("State", names)


class Fields:
    """The names of a vector, in the order in which it holds them.

    Parameters
    ----------
    **fields : Field or Fields
        The quantities by name. A value that is itself `Fields` is a group, such as the state of one
        block of a law: it is read as a record inside the record, and written as a mapping. Two
        vectors are joined by ``|``.

    Raises
    ------
    ValueError
        A field that is neither, a name that clashes; in `write`, a missing name, an unknown name or
        a wrong length. A name within a group stands behind that of the group: 'gears.link'.

    See Also
    --------
    plant.per_joint, plant.scalars, plant.Law

    Examples
    --------
    >>> import numpy as np
    >>> from plant import Fields, per_joint, scalars
    >>> fields = Fields(error=per_joint(), rate=per_joint(), begun=scalars())
    >>> state = fields.read(np.array([1.0, 2.0, 3.0, 4.0, 0.0]), n=2)
    >>> state.rate
    array([3., 4.])
    >>> fields.write(2, error=state.error, rate=2 * state.rate, begun=1)
    array([1., 2., 6., 8., 1.])
    """

    def __init__(self, **fields: "Field | Fields") -> None:
        for name, field in fields.items():
            # a record's attributes: what a tuple has by itself cannot be read by that name
            if name.startswith("_") or keyword.iskeyword(name) or hasattr(tuple, name):
                raise ValueError(
                    f"the field '{name}' must have a name that a record can have; it clashes with"
                    " Python's own. Rename it."
                )
            if not isinstance(field, Field | Fields):
                raise ValueError(
                    f"the field '{name}' must be a Field or a group of Fields; got a"
                    f" {type(field).__name__}. Use per_joint() or scalars()."
                )
        self.fields = fields
        # Made here once, since vectors are read often.
        self._record = _record(tuple(fields))

    def __repr__(self) -> str:
        return f"Fields({', '.join(self.fields)})"

    def length(self, n: int) -> int:
        """Numbers of a whole vector for n joints."""
        return sum(field.length(n) for field in self.fields.values())

    def initial(self, n: int, group: str = "") -> Floats:
        """The vector (length,) at the start; errors name the `group` that it is of."""
        # So that a vector without fields is an empty array, too.
        starts = [np.empty(0)]
        for name, field in self.fields.items():
            if isinstance(field, Fields):
                starts.append(field.initial(n, f"{group}{name}."))
                continue
            try:
                starts.append(field.initial(n))
            except ValueError:
                raise ValueError(
                    f"the field '{group}{name}' must start with one number or with"
                    f" {field.length(n)}; got shape {np.shape(field.start)}. Correct its start."
                ) from None
        return np.concatenate(starts)

    def __or__(self, other: "Fields") -> "Fields":
        """These fields and then those of another vector; a name that both have is refused."""
        instance("the right side of |", other, Fields, "Join two Fields.")
        for name in other.fields:
            if name in self.fields:
                raise ValueError(
                    f"the field '{name}' must be declared once; {self} has it already. Rename one."
                )
        return Fields(**self.fields, **other.fields)

    def extended(self, **fields: "Field | Fields") -> "Fields":
        """These fields and then more; a name that is there already is refused."""
        return self | Fields(**fields)

    def read(self, vector: Any, n: int) -> Any:
        """The vector (length,) as a record: an attribute per field.

        A numpy array may hold one vector per column (length, P). A field of one number is read as
        that number, every other field as a vector.
        """
        length = vector.shape[0]
        # A vector of other fields would be read silently under wrong names.
        if length != self.length(n):
            raise ValueError(
                f"a vector with the fields {', '.join(self.fields)} must have {self.length(n)}"
                f" numbers for {n} joints; got {length}. Use the vector of the same fields."
            )
        values = {}
        for name, place in self.at(n).items():
            field = self.fields[name]
            part = _part(vector, place)
            if isinstance(field, Fields):
                part = field.read(part, n)
            # A number, not a vector of one, so that equations need no index.
            elif field.size == 1:
                part = vector[place.start]
            values[name] = part
        return self._record(**values)

    def write(self, n: int, **values: Any) -> Any:
        """The vector (length,) of these values: casadi's where one of them is, otherwise numpy's.

        A field of one number may be given as a number; a group as a mapping or as a record.
        """
        return self._written(n, values, "")

    def _written(self, n: int, values: Mapping[str, Any], group: str) -> Any:
        """As `write`; errors name the `group` of these fields, such as "gears."."""
        # Unknown names come first: a misspelt one is missing as well, and its own name helps more.
        unknown = [f"'{group}{name}'" for name in values if name not in self.fields]
        if unknown:
            raise ValueError(
                f"write must get fields of {self}; got {', '.join(unknown)}. Declare the field, or"
                " correct the name."
            )
        missing = [f"'{group}{name}'" for name in self.fields if name not in values]
        if missing:
            raise ValueError(
                f"write must get a value for each field of {self}; {', '.join(missing)} came"
                " without one. Give it."
            )
        parts = []
        for name, field in self.fields.items():
            value = values[name]
            if isinstance(field, Fields):
                # The record that `read` gave can be written back as it is.
                inner = value._asdict() if hasattr(value, "_asdict") else value
                if not isinstance(inner, Mapping):
                    raise ValueError(
                        f"the group '{group}{name}' must be a mapping of"
                        f" {', '.join(field.fields)}, or a record of `read`; got a"
                        f" {type(inner).__name__}. Write it by name."
                    )
                value = field._written(n, inner, f"{group}{name}.")
            elif not isinstance(value, ca.SX | ca.MX | ca.DM):
                value = np.atleast_1d(np.asarray(value, float))
            # A casadi column has two dimensions, a numpy vector one; both hold one column.
            if value.shape[0] != field.length(n) or value.shape[1:] not in ((), (1,)):
                raise ValueError(
                    f"the field '{group}{name}' must have {field.length(n)} numbers; got shape"
                    f" {tuple(value.shape)}. Give one column of that length."
                )
            parts.append(value)
        # One symbol makes the whole vector symbolic.
        if any(isinstance(part, ca.SX | ca.MX | ca.DM) for part in parts):
            return ca.vertcat(*parts)
        # The empty array allows a vector without fields.
        return np.concatenate([np.empty(0), *parts])

    def at(self, n: int) -> dict[str, range]:
        """Name -> places of the field in the vector."""
        places = {}
        begin = 0
        for name, field in self.fields.items():
            # The order of declaration is that of the vector, in Python and in the exported C.
            places[name] = range(begin, begin + field.length(n))
            begin = places[name].stop
        return places

    def places(self, n: int, role: str) -> tuple[range, ...]:
        """Places of all the fields of a role, those inside groups included, in order."""
        places: list[range] = []
        for name, place in self.at(n).items():
            begin = place.start
            inner = self.fields[name].places(n, role)
            # A group counts from its own start; shift its places to those of this vector.
            places += [range(begin + x.start, begin + x.stop) for x in inner]
        return tuple(places)

    def changed(self, vector: Any, n: int, role: str, change: Callable[[Any], Any]) -> Any:
        """The casadi vector with `change` applied to every field of a role, groups included."""
        for place in self.places(n, role):
            # casadi vectors cannot be assigned to, so a new one is joined of three pieces.
            head = _part(vector, range(place.start))
            tail = _part(vector, range(place.stop, vector.shape[0]))
            vector = ca.vertcat(head, change(_part(vector, place)), tail)
        return vector


def _part(vector: Any, place: range) -> Any:
    """Those numbers of a vector; of casadi's a column, also where there are none."""
    rows = slice(place.start, place.stop)
    return vector[rows, 0] if isinstance(vector, ca.SX | ca.MX | ca.DM) else vector[rows]
