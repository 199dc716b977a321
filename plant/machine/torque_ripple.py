"""Torque ripple of a motor (cogging): a torque that repeats with the angle of the motor, whatever the current."""

from typing import Any

import casadi as ca
import numpy as np

from plant.parts.arguments import signs
from plant.parts.fields import ArrayOrSymbols, Vector
from plant.parts.part import Part, number, part


@part
class TorqueRipple(Part):
    """Torque of the motor's magnets and slots, amplitude sin(cycles q_m + phase). Motor side.

    Parameters
    ----------
    amplitude : (n,) array_like
        Of the torque [N m], motor side; a share of the largest torque is that share of
        ``motor_gain * current_limit``.
    cycles : (n,) array_like
        Of the torque per turn of the motor, such as the number of its slots.
    phase : (n,) array_like, optional
        At motor angle 0 [rad].

    Raises
    ------
    ValueError
        Negative amplitude, cycles that are not positive.

    See Also
    --------
    plant.Drive

    Examples
    --------
    >>> from plant import TorqueRipple
    >>> ripple = TorqueRipple(amplitude=(0.01, 0.01), cycles=(6, 6))
    >>> ripple.torque((0.1, 0.0)).round(5)
    array([0.00565, 0.     ])
    """

    amplitude: Vector = number(("n",))
    cycles: Vector = number(("n",))
    phase: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("cycles",), not_negative=("amplitude",), advice="Shift the phase by pi to turn a sign.")

    def torque(self, q_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor torque [N m] at motor angles [rad]."""
        angle = self.cycles * q_m if self.phase is None else self.cycles * q_m + self.phase
        return self.amplitude * (np.sin(angle) if isinstance(angle, np.ndarray) else ca.sin(angle))
