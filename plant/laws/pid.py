"""Simple laws that a record may have been made with: P, PD and PID on the error in pulses."""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.laws.anti_windup import integrated
from plant.laws.filtered_difference import filtered_difference, no_reading
from plant.laws.law import Law, StatelessLaw
from plant.parts.arguments import optional_period, signs
from plant.parts.part import number, part, structure

__all__ = ["PD", "PID", "P"]


@part
class P(StatelessLaw):
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
        signs(self, not_negative=("gain",))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k P (reference pulses - pulses)."""
        return rig.drive.joint_torque(self.gain, setpoint.pulses - pulses), state


@part
class PD(Law):
    """Motor torque = gain e + derivative edot, with e the error in pulses and edot its filtered difference.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse [N m].
    derivative : (n,) array_like
        Motor torque per pulse per second [N m s].
    filter : float
        Pole of the low-pass in front of the difference [rad/s] (`plant.laws.filtered_difference`).
    period : float, optional
        Time between two steps [s], the torque held in between. None: fast hardware, evaluated at every sub-step.
    """

    gain: np.ndarray = number(("n",))
    derivative: np.ndarray = number(("n",))
    filter: float = number(())
    period: float | None = structure(default=None)

    def __post_init__(self):
        super().__post_init__()
        signs(self, positive=("filter",), not_negative=("gain", "derivative"))
        optional_period(self)

    def initial_state(self, n):
        """No reading yet."""
        return no_reading(n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k (P e + D edot)."""
        motor, state = self.motor_torque(setpoint.pulses - pulses, state, dt)
        return rig.drive.joint_torque(motor), state

    def motor_torque(self, error, memory, dt):
        """Motor torque (n,) [N m] for an error (n,) [pulses], and the memory of its difference."""
        rate, memory = filtered_difference(error, memory, self.filter, dt)
        return self.gain * error + self.derivative * rate, memory


@part
class PID(PD):
    """PD plus the integral of the error; what the amplifier cuts off does not wind it up (`plant.laws.anti_windup`).

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse [N m], above zero.
    integral : (n,) array_like
        Motor torque per pulse and second [N m/s].
    derivative : (n,) array_like
        Motor torque per pulse per second [N m s].
    filter : float
        Pole of the low-pass in front of the difference [rad/s] (`plant.laws.filtered_difference`).
    period : float, optional
        Time between two steps [s], the torque held in between. None: fast hardware, evaluated at every sub-step.
    """

    integral: np.ndarray = number(("n",))

    def __post_init__(self):
        super().__post_init__()
        signs(self, positive=("gain",), not_negative=("integral",))

    def initial_state(self, n):
        """No reading yet, nothing integrated, nothing asked for."""
        return np.concatenate([no_reading(n), np.zeros(2 * n)])

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k (P e + I (integral of e) + D edot)."""
        n, error = rig.n, setpoint.pulses - pulses
        memory, integral, asked = state[: n + 1], state[n + 1 : -n], state[-n:]
        missing = rig.drive.motor_torque(torque) - asked
        integral = integrated(integral, self.integral * error, missing, self.integral / self.gain, dt)
        motor, memory = self.motor_torque(error, memory, dt)
        return rig.drive.joint_torque(motor + integral), ca.vertcat(memory, integral, motor + integral)
