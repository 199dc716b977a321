"""Sliding mode with a boundary layer: model errors below a bound are rejected, not identified."""

import casadi as ca

from ctc.laws.model_law import ModelLaw
from plant import Fields, Rig, number, part
from plant.laws import SMOOTHED, Setpoint, Step, filtered_difference
from plant.parts import signs


@part
class SlidingMode(ModelLaw):
    """tau = D-hat (qdd_r + w edot + reach sat(s / layer)) + h-hat + friction, with s = edot + w e.

    Once per sample: q is the middle of the encoder's cell, e = q_r - q, edot its filtered
    difference and qd = qd_r - edot. Outside the layer s goes to it at `reach`, whatever the model
    has wrong by less than that; inside it is held by a proportional feedback of reach / layer
    [1/s].

    Parameters
    ----------
    arm, rig
        As of `ComputedTorque`.
    bandwidth : float
        w: how fast e goes to zero on the surface s = 0 [rad/s].
    reach : float
        Acceleration towards the surface [rad/s^2]; above what the model has wrong.
    layer : float
        Half the width of the boundary layer, in s [rad/s].
    filter : float
        Pole of the first-order low-pass in front of the backward difference [rad/s].

    Raises
    ------
    ValueError
        As `ModelLaw`; numbers that are not positive.

    See Also
    --------
    ctc.ComputedTorque, ctc.Adaptive

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import SlidingMode
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> SlidingMode(arm, rig, bandwidth=40, reach=20, layer=0.05, filter=600).layer
    0.05

    Source: Slotine and Li, Applied Nonlinear Control (1991), ch. 7.
    """

    bandwidth: float = number(())
    reach: float = number(())
    layer: float = number(())
    filter: float = number(())

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("bandwidth", "reach", "layer", "filter"))

    fields = Fields(error=SMOOTHED)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: error and its rate -> s -> torque."""
        n = self.arm.n
        q = rig.cell_centre(pulses)
        e = setpoint.q - q
        rate, memory = filtered_difference(e, self.fields.read(state, n).error, self.filter, dt)
        s = rate + self.bandwidth * e
        # Proportional within the layer, so that the torque does not chatter at the surface.
        towards = self.reach * ca.fmax(ca.fmin(s / self.layer, 1), -1)
        # On the surface s = 0 the error decays with the bandwidth.
        acceleration = setpoint.qdd + self.bandwidth * rate + towards
        inertia = self.arm.dynamics.D(q, self.arm.f) @ acceleration
        # Friction along the reference: the measured speed changes its sign with each count.
        friction = self.rig.drive.friction(setpoint.qd)
        torque = inertia + self.h(q, setpoint.qd - rate) + friction
        return torque, self.fields.write(n, error=memory)
