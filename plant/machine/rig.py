"""The rig: what stands between a control program and the arm - drives, encoders, and how often they are read."""

from __future__ import annotations

import dataclasses

from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.transport import Transport
from plant.parts.arguments import instance, real
from plant.parts.labels import joint_labels
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

        if self.encoder.side == "link" and self.drive.elasticity is None:
            raise ValueError("an encoder on the link's side needs a drive that gives; got a rigid one. Add elasticity.")

    @property
    def n(self):
        """Number of joints."""
        return self.drive.n

    @property
    def joint_labels(self) -> list[str]:
        """What to call each joint (`joint_label`), by the drive's names."""
        return joint_labels(self.drive.joints, self.n)

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

    def counts(self, q):
        """Encoder counts of a joint position [rad] as a controller knows them, whole numbers with the motor's sign."""
        return self.encoder.quantised(self.position_in_pulses(q))

    def true_counts(self, q):
        """Encoder counts at a joint position [rad] as they are: those of `counts`, but for a phase of the encoder."""
        return self.encoder.true_counts(self.position_in_pulses(q))

    def position_in_pulses(self, q):
        """Joint position [rad] in pulses of the motor shaft, before rounding."""
        per_radian = self.encoder.position_in_pulses(self.drive.gear)
        return per_radian * self.drive.coupling.shaft(q)

    def to_angle(self, position):
        """Joint position [rad] of a position in pulses; the way back from `position_in_pulses`."""
        return self.drive.joint_angle(self.encoder.to_angle(position))

    def cell_centre(self, counts):
        """Joint position [rad] in the middle of the quantisation cell of these counts."""
        return self.drive.joint_angle(self.encoder.cell_centre(counts))


def smooth_rig(rig):
    """The same rig with an encoder that does not round."""
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
