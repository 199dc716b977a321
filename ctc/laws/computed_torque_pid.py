"""Computed torque with a PID feedback that rolls off above its bandwidth: for elastic gears."""

import casadi as ca

from ctc.laws.model_law import ModelLaw
from plant import Fields, Rig, number, part, per_joint, scalars
from plant.laws import Setpoint, Step, integrated
from plant.mechanics import inverse
from plant.parts import MODEL_ERROR, signs


def rolled_off(
    signal: ca.SX,
    before: ca.SX,
    value: ca.SX,
    rate: ca.SX,
    corner: ca.SX,
    damping: ca.SX,
    dt: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """Low-pass of second order: filtered signal (n, 1) and its rate, one step later.

    `before`, `value` and `rate` are signal, filtered signal and its rate a step ago.

    Source: Tustin's method, which is the trapezoidal rule: s = 2 / dt (z - 1) / (z + 1).
    """
    half = corner * dt / 2
    pull = corner**2 * ((signal + before) / 2 - value - dt / 2 * rate) - 2 * damping * corner * rate
    following = rate + dt * pull / (1 + 2 * damping * half + half**2)
    return value + dt / 2 * (rate + following), following


@part
class ComputedTorquePID(ModelLaw):
    """tau = D-hat (qdd_r + a(e)) + h-hat + friction, along the reference, with a PID a(s).

    a(s) = w (s + w/r) (s + i) / s / ((s/f)^2 + 2 z s/f + 1), sampled by Tustin's method, once per
    sample; e is q_r minus the middle of the encoder's cell. From its upper zero to its roll-off the
    phase of a(s) leads, so a resonance between motor and link is damped there; an observer's lag
    (`ComputedTorque`) would excite it. The first error that is read makes no kick: it counts as if
    it had been there before. What the amplifier cuts off is taken back from the integral.

    Parameters
    ----------
    arm, rig
        As of `ComputedTorque`.
    bandwidth : float
        w, where the loop's gain is about one [rad/s]: far above its zeros, and below f, a(s) is w
        s.
    ratio : float
        r, of the bandwidth over the upper zero.
    integral : float
        i, the lower zero [rad/s]; zero for no integral action.
    roll_off : float
        f, the corner of the low-pass [rad/s].
    roll_off_damping : float
        z, of the low-pass.

    Raises
    ------
    ValueError
        As `ModelLaw`; numbers that are not positive, an integral that is negative.

    See Also
    --------
    ctc.ComputedTorque, ctc.tune

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorquePID
    >>> feedback = {"ratio": 1.0, "integral": 10, "roll_off": 600, "roll_off_damping": 0.7}
    >>> law = ComputedTorquePID(puma560.arm(), puma560.rig(), bandwidth=60, **feedback)
    >>> law.bandwidth
    60.0

    Source: anti-windup with the time constant sqrt(T_i T_d): Astrom and Hagglund, Advanced PID
    Control (2006), 3.5.
    """

    bandwidth: float = number(())
    ratio: float = number(())
    integral: float = number(())
    roll_off: float = number(())
    roll_off_damping: float = number(())

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(
            self,
            positive=("bandwidth", "ratio", "roll_off", "roll_off_damping"),
            not_negative=("integral",),
        )

    # read: 1 once there was a reading; error, value, rate: the low-pass and its input.
    fields = Fields(
        read=scalars(),
        integral=per_joint(role=MODEL_ERROR),
        error=per_joint(),
        value=per_joint(),
        rate=per_joint(),
        commanded=per_joint(),
    )

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: integral -> filtered error and its rate -> acceleration -> torque."""
        n = self.arm.n
        before = self.fields.read(state, n)
        e = setpoint.q - rig.cell_centre(pulses)
        D = self.arm.dynamics.D(setpoint.q, self.arm.f)
        # The first error counts as if it had been there before, so that it makes no kick.
        error_before = ca.if_else(before.read > 0, before.error, e)
        value = ca.if_else(before.read > 0, before.value, e)

        # 1. a(s) = slow / s + (one + fast s) / ((s/f)^2 + 2 z s/f + 1), in partial fractions.
        w = self.bandwidth
        lower = self.integral
        corner = self.roll_off
        z = self.roll_off_damping
        upper = w / self.ratio
        slow = w * upper * lower
        one = w * (upper + lower) - 2 * z / corner * slow
        fast = w - slow / corner**2

        # 2. The integral, less what the amplifier cut off, with the time constant sqrt(T_i T_d).
        missing = inverse(D).solve(torque - before.commanded)
        tracking = ca.sqrt(upper * lower)
        slope = slow * (e + error_before) / 2
        integral = integrated(before.integral, slope, missing, tracking, dt)

        # 3. The low-pass, the acceleration, and the torque that it takes.
        value, rate = rolled_off(e, error_before, value, before.rate, corner, z, dt)
        acceleration = setpoint.qdd + integral + one * value + fast * rate
        h = self.h(setpoint.q, setpoint.qd)
        drive = self.rig.drive
        load = D @ setpoint.qdd + h - drive.rotor_torque(setpoint.qdd)
        commanded = D @ acceleration + h
        commanded = commanded + drive.friction(setpoint.qd, load)
        return commanded, self.fields.write(
            n, read=1, integral=integral, error=e, value=value, rate=rate, commanded=commanded
        )
