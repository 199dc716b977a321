"""Computed torque of an arm on elastic gears, along the motion of its links."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.laws.feed_forward import WithFeedback
from plant import Rig, Setpoint
from plant.machine.gear_torque import gear_torque, require_elastic, wound
from plant.parts.part import part


@part
class FlexibleJointComputedTorque(WithFeedback):
    """tau = B theta_r'' + friction(theta_r') + tau_link(q_r, qd_r, qdd_r) + feedback(theta_r - theta).

    Inverse dynamics of the flexible-joint model along the motion q_r of the *links*, which is the setpoint:
    theta_r = q_r + tau_link / k is where the motors must be, with k the stiffness of the gears, B the inertia of the
    motors and tau_link the torque that the links need. The deflection's two derivatives are differences from one step
    to the next; nothing measured enters them, so they are free of noise, and the first two steps are without.
    `simulate` and `evaluate` compare the counts with theta_r if they follow a `plant.LinkReference` of the same arm and
    rig; the law is then given the motion of its links.

    On slow motions this is `FeedForward` along a `LinkReference`, whose rigid model takes D(theta_r) theta_r'' instead:
    wrong by (frequency of the motion over that of the resonance)^2.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, with ``drive.elasticity``: its friction is fed forward.
    feedback : Law
        A simple law, such as `plant.PD`; its period is that of the whole.

    Raises
    ------
    ValueError
        As `ModelLaw`; rigid gears, backlash, encoders on the links; a feedback for other joints.

    See Also
    --------
    plant.LinkReference, plant.Elasticity, ctc.tune

    Examples
    --------
    >>> import dataclasses
    >>> from plant import PD, Elasticity, puma560
    >>> from ctc import FlexibleJointComputedTorque
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> gears = Elasticity.from_resonance(arm, hz=60, damping_ratio=0.02, drive=rig.drive)
    >>> rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears))
    >>> feedback = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600, period=rig.period)
    >>> FlexibleJointComputedTorque(arm, rig, feedback=feedback).feedback.gain
    array([0.2, 0.1])

    Source: Spong, Modeling and control of elastic joint robots (1987); De Luca and Book, Robots with flexible elements,
    Springer Handbook of Robotics (2016), 11.1.
    """

    of_links = True

    def __post_init__(self) -> None:
        super().__post_init__()
        name = type(self).__name__
        require_elastic(name, self.rig)
        if self.feedback.period is None:
            given = type(self.feedback).__name__
            raise ValueError(f"feedback of {name} must have a period; {given} has none. Give it period=rig.period.")

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """The feedback's; no torque of the model yet; deflection and its rate, and whether they are known."""
        return np.concatenate([self.feedback.initial_state(n), np.zeros(3 * n + 2)])

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """One step: torque of the links -> deflection and its derivatives -> motors' motion -> torque."""
        n, drive = rig.n, self.rig.drive
        memory, once, twice = state[: -3 * n - 2], state[-2], state[-1]
        given, before, rate_before = ca.vertsplit(state[-3 * n - 2 : -2], n)
        carried = gear_torque(self.arm.dynamics, self.rig, setpoint.q, setpoint.qd, setpoint.qdd, self.arm.f)
        deflection = wound(drive, carried)
        rate = ca.if_else(once > 0, (deflection - before) / dt, 0)
        bend = ca.if_else(twice > 0, (rate - rate_before) / dt, 0)

        theta, speed, acceleration = setpoint.q + deflection, setpoint.qd + rate, setpoint.qdd + bend
        aimed = Setpoint(theta, speed, acceleration, rig.counts(theta))
        commanded, memory = self.feedback.equations(rig, memory, aimed, pulses, torque - given, dt)
        turning = drive.reflected_inertia() * drive.coupling.shaft(acceleration)
        given = drive.coupling.joint_torque(carried + turning) + drive.friction(speed)
        return commanded + given, ca.vertcat(memory, given, deflection, rate, 1, once)
