"""Simple laws that a record may have been made with."""

from __future__ import annotations

import numpy as np

from plant.law import Law
from plant.part import number, part

__all__ = ["P"]


@part
class P(Law):
    """Position controller of the experiment: motor torque proportional to the error in pulses.

    It is fast hardware (a counter and an amplifier), evaluated at every sub-step: held over the 0.7 ms of the log the
    same loop would be unstable.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse of error [N m]; P K_i of the paper.

    Source: paper Fig. 4.
    """

    gain: np.ndarray = number(("n",))

    def __post_init__(self):
        super().__post_init__()
        if (self.gain < 0).any():
            raise ValueError(f"gain must not be negative; got {self.gain}. The sign of the gear is in the drive.")

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k P (reference pulses - pulses)."""
        return rig.drive.joint_torque(self.gain, setpoint.pulses - pulses), state
