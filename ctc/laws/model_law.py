"""What all laws that hold an identified arm share: which arms they refuse, which rigs they fit, how often they run."""

from __future__ import annotations

import dataclasses

from plant import Arm, Law, Rig
from plant.machine.motor_inertia import require_inertia
from plant.parts.part import structure

__all__ = ["ModelLaw"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ModelLaw(Law):
    """Base of the laws that work out torques from an arm; runs once per sample of its rig.

    Parameters
    ----------
    arm : Arm
        The identified arm, ``found.arm``.
    rig : Rig
        The identified rig, ``found.rig``.

    Raises
    ------
    ValueError
        An arm whose D(q) does not exceed the motors' own inertia everywhere (no feedback would be stable), joints that
        do not match; later, a rig with other joints than the arm's.
    """

    arm: Arm = structure(Arm, kw_only=False)  # noqa: RUF009 - declares a field
    rig: Rig = structure(Rig, kw_only=False)  # noqa: RUF009 - declares a field

    def __post_init__(self):
        super().__post_init__()
        if self.arm.n != self.rig.n:
            raise ValueError(
                f"arm and rig must have equal joints; got {self.arm.n} and {self.rig.n}. Pass found.arm and found.rig."
            )
        require_inertia(self.arm, self.rig)

    @property
    def period(self):
        """Once per sample of the rig [s]."""
        return self.rig.period

    def block(self, rig):
        rig.require_fit(self.arm.dynamics.chain)
        if abs(rig.period - self.rig.period) > 1e-9 * self.rig.period:
            raise ValueError(
                f"the rig must be sampled as the law's own, every {self.rig.period:.6g} s; got {rig.period:.6g} s. "
                "Make the law for this rig."
            )
        return super().block(rig)
