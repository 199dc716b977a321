"""The position loop inside a servo or a drive, which takes goals or frames in place of torques.

A law above it works out a torque as every law does. Here that torque means what the motor shall
give beyond the inner loop, while the joint is on its reference. It becomes a `Frame`, which the
inner loop holds until the next: a goal beside the reference, or a torque beside it. Off the
reference the inner loop adds its restoring torque, which is that of a spring and a damper.
"""

import abc
import dataclasses
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np

from plant.parts import Part, declared, real


class Frame(NamedTuple):
    """What a controller sends once per period, (n, 1) each; a goal is a frame of its counts alone.

    `pulses` on the motors' shafts, `qd` [rad/s] of the joints, `torque` [N m] joint side.
    """

    pulses: ca.SX
    qd: ca.SX
    torque: ca.SX


class InnerLoop(Part, abc.ABC):
    """Base of the loops inside servos and drives.

    A subclass is a law as well: the `law` of a log, whose reference are the goals that were sent;
    or the `inner` loop of a `Rig`, whose frames the law above it sends.
    """

    period: float = declared("Period of the loop [s].")
    fields: Any = declared("Names of its state (`plant.parts.vector.Fields`).")
    sends: str = declared("What a controller sends it: the attribute of `Running`.")

    def __post_init__(self) -> None:
        super().__post_init__()
        real("period", self.period, "Give seconds, such as 1e-3.", positive=True)

    @abc.abstractmethod
    def stiffness_of(self, rig: Any) -> Any:
        """Restoring torque per deviation (n,) [N m/rad], on the shafts."""

    @abc.abstractmethod
    def damping_of(self, rig: Any) -> Any:
        """Restoring torque per rate of the deviation (n,) [N m s/rad], on the shafts."""

    @abc.abstractmethod
    def torque_rounding(self, rig: Any) -> Any:
        """Largest change of a motor torque (n,) [N m] by the rounding of a frame."""

    @abc.abstractmethod
    def frame(self, rig: Any, q: ca.SX, qd: ca.SX, torque: ca.SX, pulses: ca.SX) -> Frame:
        """The frame by which a joint torque (n, 1) [N m] acts beside a reference q, qd (n, 1).

        It is rounded as the bus rounds it. `pulses` (n, 1) are the counts now, from which a goal is
        at most as far as the amplifier's limit allows.
        """

    @abc.abstractmethod
    def values(self, rig: Any, frame: Frame) -> ca.SX:
        """A frame as the bus takes it: the rows of `Running.goal` or `.frame` joined."""

    def added(self, rig: Any, q: ca.SX, qd: ca.SX, frame: Frame) -> ca.SX:
        """Joint torque (n, 1) [N m] of a frame on a joint that is on its reference q, qd."""
        coupling = rig.drive.coupling
        away = coupling.shaft(rig.to_angle(frame.pulses + rig.encoder.centre) - q)
        faster = coupling.shaft(frame.qd - qd)
        return frame.torque + coupling.joint_torque(
            self.stiffness_of(rig) * away + self.damping_of(rig) * faster
        )

    def counts(self, rig: Any, position: ca.SX) -> ca.SX:
        """Counts (n, 1) of the rig that the loop reads at a joint position [rad]."""
        return rig.true_counts(position)

    def for_joints(self, n: int) -> Self:
        """The same loop with one number per joint where one stood for all."""
        alike = {
            field.name: np.full(n, getattr(self, field.name))
            for field in dataclasses.fields(self)
            if field.metadata.get("alike") and np.ndim(getattr(self, field.name)) == 0
        }
        return dataclasses.replace(self, **alike) if alike else self

    def period_in(self, sample: float) -> float:
        """The period [s] of which a sample of the rig has a whole number, next to the loop's."""
        return sample / max(1, round(sample / self.period))
