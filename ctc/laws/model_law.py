"""What all laws that hold an identified arm share: which arms they refuse, which rigs they fit, how often they run."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, dataclass_transform

from identification import Identification
from plant import Arm, Block, Law, Rig
from plant.machine.motor_inertia import require_inertia
from plant.parts.arguments import instance
from plant.parts.part import number, structure

__all__ = ["ModelLaw", "base"]

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(number, structure))
def base(cls: type[T]) -> type[T]:
    """Class decorator: fields that the parts derived from this class have in common."""
    return dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(cls)


@base
class ModelLaw(Law):
    """Base of the laws that work out torques from an arm; runs once per sample of its rig.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too: ``ComputedTorque(found)``.
    rig : Rig, optional
        The identified rig, ``found.rig``.

    Raises
    ------
    ValueError
        An arm whose D(q) does not exceed the motors' own inertia everywhere (no feedback would be stable), joints that
        do not match; later, a rig with other joints than the arm's.
    """

    arm: Arm | Any = structure(kw_only=False)  # an Identification goes in, too; its arm is kept
    rig: Rig = structure(kw_only=False, default=None)

    def __post_init__(self) -> None:
        found, name = self.arm, type(self).__name__
        if isinstance(found, Identification):
            object.__setattr__(self, "arm", found.arm)
            object.__setattr__(self, "rig", found.rig if self.rig is None else self.rig)
        instance(f"arm of {name}", self.arm, Arm, "Pass an identification, or an arm and its rig.")
        instance(f"rig of {name}", self.rig, Rig, "Pass the arm's rig, or an identification in place of the arm.")
        super().__post_init__()
        if self.arm.n != self.rig.n:
            raise ValueError(
                f"arm and rig must have equal joints; got {self.arm.n} and {self.rig.n}. Pass found.arm and found.rig."
            )
        require_inertia(self.arm, self.rig)

    @property
    def period(self) -> float | None:  # type: ignore[override]  # declared, and here the rig's
        """Once per sample of the rig [s]."""
        return self.rig.period

    def block(self, rig: Rig) -> Block:
        rig.require_fit(self.arm.dynamics.chain)
        if abs(rig.period - self.rig.period) > 1e-9 * self.rig.period:
            raise ValueError(
                f"the rig must be sampled as the law's own, every {self.rig.period:.6g} s; got {rig.period:.6g} s. "
                "Make the law for this rig."
            )
        return super().block(rig)
