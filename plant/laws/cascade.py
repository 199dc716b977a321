"""The cascade of industrial drives: a position loop asks a speed loop for a speed, that one for a torque."""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.laws.anti_windup import integrated
from plant.laws.filtered_difference import filtered_difference, no_reading
from plant.laws.law import Law
from plant.parts.arguments import optional_period, signs
from plant.parts.part import number, part, structure

__all__ = ["Cascade"]


@part
class Cascade(Law):
    """P on the position, PI on the speed: motor torque = speed (w - pulses') + integral of the same.

    The wanted speed is w = position e, with e the error in pulses; pulses' is the filtered difference of the counts.
    Nothing is fed forward, so in steady motion the error is the reference's speed over `position`.

    Parameters
    ----------
    position : (n,) array_like
        Wanted speed per error, both in pulses [1/s].
    speed : (n,) array_like
        Motor torque per pulse per second [N m s], above zero.
    integral : (n,) array_like
        Motor torque per pulse [N m]: gain of the integral of the speed's error.
    filter : float
        Pole of the low-pass in front of the difference [rad/s] (`plant.laws.filtered_difference`).
    period : float, optional
        Time between two steps [s], the torque held in between. None: fast hardware, evaluated at every sub-step.
    """

    position: np.ndarray = number(("n",))
    speed: np.ndarray = number(("n",))
    integral: np.ndarray = number(("n",))
    filter: float = number(())
    period: float | None = structure(default=None)

    def __post_init__(self):
        super().__post_init__()
        signs(self, positive=("speed", "filter"), not_negative=("position", "integral"))
        optional_period(self)

    def initial_state(self, n):
        """No reading yet, nothing integrated, nothing asked for."""
        return np.concatenate([no_reading(n), np.zeros(2 * n)])

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k (K_v (K_p e - pulses') + K_i (integral of the same))."""
        n = rig.n
        memory, integral, asked = state[: n + 1], state[n + 1 : -n], state[-n:]
        missing = rig.drive.motor_torque(torque) - asked
        rate, memory = filtered_difference(pulses, memory, self.filter, dt)
        slow = self.position * (setpoint.pulses - pulses) - rate
        integral = integrated(integral, self.integral * slow, missing, self.integral / self.speed, dt)
        motor = self.speed * slow + integral
        return rig.drive.joint_torque(motor), ca.vertcat(memory, integral, motor)
