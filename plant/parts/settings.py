"""Settings: named numbers with usual values, of which a part or a call may have others."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, TypeVar, dataclass_transform

import numpy as np

from plant.parts.arguments import real, whole
from plant.parts.part import Part

T = TypeVar("T")


@dataclass_transform(
    frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field,)
)
def frozen_settings(cls: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass of the numbers that shape a computation."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


class Settings(Part):
    """Base of settings that a user gives and a file holds, with ``@part`` above them.

    Numbers are positive. Those that `may_be_zero` names may also be zero, and those that `at_most`
    names have a largest value. A refusal names the default as usual.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ()
    at_most: ClassVar[Mapping[str, float]] = {}

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            name = f"{field.name} of {type(self).__name__}"
            usual = f"{field.default} is usual."
            if field.type is int:
                whole(name, value, usual, least=int(field.name not in self.may_be_zero))
            elif field.type is float:
                object.__setattr__(self, field.name, real(name, value, usual))
            elif field.type == tuple[float, ...]:
                if not isinstance(value, (tuple, list)) or not value:
                    raise ValueError(f"{name} must be some numbers; got {value!r:.60}. {usual}")
                value = tuple(real(name, each, usual) for each in value)
                object.__setattr__(self, field.name, value)
            limit = self.at_most.get(field.name, np.inf)
            if field.name in self.may_be_zero:
                sign, sound = "not be negative", np.greater_equal(value, 0)
            else:
                sign, sound = "be positive", np.greater(value, 0)
            if not np.all(sound):
                raise ValueError(f"{name} must {sign}; got {value}. {usual}")
            if np.any(np.greater(value, limit)):
                raise ValueError(f"{name} must be at most {limit}; got {value}. {usual}")
