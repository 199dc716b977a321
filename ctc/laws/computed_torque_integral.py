"""The computed torque of the textbooks with integral action: measured position, differentiated speed."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.laws.model_law import ModelLaw
from plant import Rig, Setpoint
from plant.laws.terms import filtered_difference, integrated, no_reading
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import signs
from plant.parts.part import number, part


@part
class ComputedTorqueIntegral(ModelLaw):
    """tau = D-hat(q) (qdd_r + 3 w edot + 3 w^2 e + w^3 (integral of e)) + h-hat(q, qd) + friction(qd_r).

    Once per sample: q is the middle of the encoder's cell, e = q_r - q, edot its filtered difference and
    qd = qd_r - edot. What the amplifier cuts off is taken back from the integral.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float
        w, the triple pole of the error [rad/s].
    filter : float
        Pole of the first-order low-pass in front of the backward difference [rad/s].

    Raises
    ------
    ValueError
        As `ModelLaw`; poles that are not positive.

    See Also
    --------
    ctc.ComputedTorque, ctc.ComputedTorquePID

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorqueIntegral, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> law = ComputedTorqueIntegral(arm, rig, bandwidth=60, filter=600)
    >>> evaluate(arm, rig, law, puma560.reference(), duration=0.3, backend="numba").joint_labels
    ['joint 2 (q[0])', 'joint 3 (q[1])']

    Source: Lewis, Dawson and Abdallah, Robot Manipulator Control (2004), 4.4, PID computed torque.
    """

    bandwidth: float = number(())
    filter: float = number(())

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("bandwidth", "filter"))

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """No reading yet, nothing integrated, no torque commanded."""
        return np.concatenate([no_reading(n), np.zeros(2 * n)])

    def model_errors(self, n: int) -> tuple[range, ...]:
        """The integral."""
        return (range(n + 1, 2 * n + 1),)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """One sample: what was cut off -> error and its rate -> acceleration -> torque."""
        n, model, f, w = self.arm.n, self.arm.dynamics, self.arm.f, self.bandwidth
        memory, integral, commanded = state[: n + 1], state[n + 1 : -n], state[-n:]
        q = rig.cell_centre(pulses)
        e = setpoint.q - q
        rate, memory = filtered_difference(e, memory, self.filter, dt)
        qd, D = setpoint.qd - rate, model.D(q, f)
        missing = inverse(D).solve(torque - commanded)
        integral = integrated(integral, w**3 * e, missing, w / 3, dt)
        wanted = D @ (setpoint.qdd + 3 * w * rate + 3 * w**2 * e + integral) + self.h(q, qd)
        wanted = wanted + self.rig.drive.friction(setpoint.qd)
        return wanted, ca.vertcat(memory, integral, wanted)
