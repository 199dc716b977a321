"""The rig: what stands between a control program and the arm - drives, encoders, and how often they are read."""

from __future__ import annotations

import dataclasses

from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.transport import Transport
from plant.parts.arguments import instance, real
from plant.parts.part import Part, part, structure

__all__ = ["Rig", "smooth_rig"]


@part
class Rig(Part):
    """Drives, encoders and the sample period.

    Parameters
    ----------
    drive : Drive
    encoder : Encoder
    period : float
        Time between two samples of the log [s].
    transport : Transport, optional
        Torque that acts late, counts that are lost.
    """

    drive: Drive = structure(Drive)
    encoder: Encoder = structure(Encoder)
    period: float = structure(float)
    transport: Transport | None = structure(default=None)

    def __post_init__(self):
        real("period", self.period, "Give seconds; the paper logs every 0.7e-3.", positive=True)
        if self.transport is not None:
            instance("transport", self.transport, Transport, "Give Transport(delay=..., lost=...).")
        if len(self.encoder.resolution) != self.drive.n:
            raise ValueError(
                f"encoder must have {self.drive.n} joints like the drive; got {len(self.encoder.resolution)}. "
                "Give one resolution per joint."
            )

    @property
    def n(self):
        """Number of joints."""
        return self.drive.n

    def require_fit(self, chain):
        """Refuse a chain of other joints, or with another coupling of its motors.

        Raises
        ------
        ValueError
        """
        if self.n != chain.n:
            raise ValueError(f"rig must have {chain.n} joints like the arm; got {self.n}. Use a matching rig.")
        if self.drive.coupling != chain.coupling:
            raise ValueError(
                f"chain and drive must have the same coupling; got {chain.coupling.matrix or 'none'} in the chain and "
                f"{self.drive.coupling.matrix or 'none'} in the drive. Give both the same Coupling (chain.coupled)."
            )

    def pulses(self, q):
        """Encoder counts of a joint position [rad] as a controller knows them, whole numbers with the motor's sign."""
        return self.encoder.count(self.position(q))

    def read(self, q):
        """Encoder counts at a joint position [rad] as they are: those of `pulses`, but for a phase of the encoder."""
        return self.encoder.read(self.position(q))

    def position(self, q):
        """Joint position [rad] in pulses of the motor shaft, before rounding."""
        return self.encoder.position(self.drive.gear) * self.drive.coupling.shaft(q)  # pulses per radian, times angle

    def turned(self, position):
        """Joint position [rad] of a position in pulses; the way back from `position`."""
        return self.drive.joint_angle(self.encoder.turned(position))

    def counted(self, pulses):
        """Position in pulses, in the middle of the cell that these counts stand for."""
        return self.encoder.position(self.encoder.angle(pulses))

    def angle(self, pulses):
        """Joint position [rad] in the middle of the cell that these counts stand for."""
        return self.drive.joint_angle(self.encoder.angle(pulses))


def smooth_rig(rig):
    """The same rig with an encoder that does not round."""
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
