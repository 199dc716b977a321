"""Base of settings that a user can give and a file can hold: design numbers with usual values."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from plant.parts.part import Part


class Settings(Part):
    """Design numbers, all with a default, which the refusal of another value names as usual.

    Numbers are positive. Those that `may_be_zero` names may also be zero, and those that `at_most`
    names have a largest value.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ()
    at_most: ClassVar[Mapping[str, float]] = {}

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            name = f"{field.name} of {type(self).__name__}"
            usual = f"{field.default} is usual."
            limit = self.at_most.get(field.name, np.inf)
            if field.name in self.may_be_zero:
                sign, sound = "not be negative", np.greater_equal(value, 0)
            else:
                sign, sound = "be positive", np.greater(value, 0)
            if not np.all(sound):
                raise ValueError(f"{name} must {sign}; got {value}. {usual}")
            if np.any(np.greater(value, limit)):
                raise ValueError(f"{name} must be at most {limit}; got {value}. {usual}")
