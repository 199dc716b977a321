"""The rig: what stands between a control program and the arm - drives, encoders, and how often they are read."""

from __future__ import annotations

import numpy as np

from plant.drive import Drive
from plant.encoder import Encoder
from plant.part import Part, part, structure

__all__ = ["Rig"]


@part
class Rig(Part):
    """Drives, encoders and the sample period.

    Parameters
    ----------
    drive : Drive
    encoder : Encoder
    period : float
        Time between two samples of the log [s].
    """

    drive: Drive = structure()
    encoder: Encoder = structure()
    period: float = structure()

    def __post_init__(self):
        if not isinstance(self.period, (int, float)) or not np.isfinite(self.period) or self.period <= 0:
            raise ValueError(f"period must be a positive time [s]; got {self.period!r}. The paper logs every 0.7e-3 s.")
        if len(self.encoder.resolution) != self.drive.n:
            raise ValueError(
                f"encoder must have {self.drive.n} joints like the drive; got {len(self.encoder.resolution)}. "
                "Give one resolution per joint."
            )

    @property
    def n(self):
        """Number of joints."""
        return self.drive.n

    def pulses(self, q):
        """Encoder counts at a joint position [rad], whole numbers with the motor's sign."""
        return self.encoder.pulses(self.drive.motor_angle(q))

    def position(self, q):
        """Joint position [rad] in pulses of the motor shaft, before rounding."""
        return self.encoder.position(self.drive.motor_angle(q))

    def angle(self, pulses):
        """Joint position [rad] in the middle of the cell that these counts stand for."""
        return self.drive.joint_angle(self.encoder.angle(pulses))
