"""Frozen dataclasses of arrays that can be compared, copied and sent to another process."""

import dataclasses
from typing import Any, ClassVar, TypeVar, dataclass_transform

import numpy as np

T = TypeVar("T")


class Frozen:
    """Base of a frozen dataclass with ``eq=False``: equal when all fields are, arrays bit for bit.

    A copy equals its original. Fields with ``compare=False`` do not count.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            # Pickle does not store that an array cannot be written to.
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = [field.name for field in dataclasses.fields(self) if field.compare]
        return self is other or all(
            _same(getattr(self, name), getattr(other, name)) for name in names
        )

    def __hash__(self) -> int:
        # Arrays are left out: equal objects still have equal hashes, and hashing stays cheap.
        plain = (getattr(self, field.name) for field in dataclasses.fields(self) if field.compare)
        return hash(
            (type(self), *(value for value in plain if isinstance(value, (bool, int, float, str))))
        )


@dataclass_transform(
    eq_default=False,
    kw_only_default=True,
    frozen_default=True,
    field_specifiers=(dataclasses.field,),
)
def frozen(cls: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass, which `Frozen` compares and `Shown` prints."""
    # A comparison or a text of the dataclass would take the place of those of its bases.
    plain = cls.__repr__ is object.__repr__
    return dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=plain)(cls)


def _same(a: Any, b: Any) -> bool:
    # One object needs no comparison; parts of a changed copy are those of the original.
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    # Bytes, not ==: NaN must equal NaN, and 0.0 must differ from -0.0.
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    # Containers compare their items in the same way, since these may be arrays.
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    # Numbers and texts; each type was compared above, so 1 differs from True.
    return bool(a == b) or (a != a and b != b)  # NaN is the same NaN
