"""P, PD and PID control on the tracking error in pulses; the cascade of industrial drives."""

import functools
from typing import Any

import casadi as ca

from plant.laws.law import Law, Setpoint, StatelessLaw, Step
from plant.laws.terms import SMOOTHED, difference, filtered_difference, integrated, readings
from plant.machine.rig import Rig
from plant.parts.arguments import optional_period, signs
from plant.parts.fields import Vector
from plant.parts.part import number, part, structure
from plant.parts.vector import Fields, per_joint


@part
class P(StatelessLaw):
    """P control, the experiment's: motor torque proportional to the tracking error in pulses.

    It is fast hardware (a counter and an amplifier), evaluated at every sub-step: sampled at the
    0.7 ms of the log, the same loop would be unstable.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse of error [N m]; P K_i of the paper.

    See Also
    --------
    plant.PD, plant.p_gains, plant.Law

    Examples
    --------
    >>> from plant import P
    >>> P(gain=(0.2, 0.1))
    P(gain=array([0.2, 0.1]))

    Source: paper Fig. 4.
    """

    gain: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, not_negative=("gain",))

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k P (reference pulses - pulses)."""
        # The error is reference minus count, so a joint that lags behind is pushed forward. Only
        # the drive knows gear and sign.
        return rig.drive.joint_torque(self.gain, setpoint.pulses - pulses), state


@part
class PD(Law):
    """PD control: motor torque = gain e + derivative edot, e being the tracking error in pulses.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse [N m].
    derivative : (n,) array_like
        Motor torque per pulse per second [N m s].
    filter : float
        Pole of the first-order low-pass in front of the backward difference [rad/s].
    period : float, optional
        Sampling period [s], the torque held in between. None: fast hardware, evaluated at every
        sub-step.

    See Also
    --------
    plant.P, plant.PID, ctc.PDGravity

    Examples
    --------
    >>> from plant import PD, puma560, simulate
    >>> law = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600.0)
    >>> record = simulate(puma560.arm(), puma560.rig(), law, puma560.reference(), duration=0.3)
    >>> print(abs(record.error_pulses).max() < 20)
    True
    """

    gain: Vector = number(("n",))
    derivative: Vector = number(("n",))
    filter: float = number(())
    period: float | None = structure(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("filter",), not_negative=("gain", "derivative"))
        optional_period(self)

    fields = Fields(error=SMOOTHED)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (P e + D edot)."""
        # Only the filter of the derivative remembers: a difference of raw counts would jump by a
        # pulse per sample.
        memory = self.fields.read(state, rig.n).error
        motor, memory = self.motor_torque(setpoint.pulses - pulses, memory, dt)
        return rig.drive.joint_torque(motor), self.fields.write(rig.n, error=memory)

    def motor_torque(self, error: ca.SX, memory: Any, dt: ca.SX) -> tuple[ca.SX, Any]:
        """Motor torque (n,) [N m] for an error (n,) [pulses], and the filter's memory."""
        # The derivative acts on the error, not on the counts alone: a reference that speeds up is
        # followed without delay.
        rate, memory = filtered_difference(error, memory, self.filter, dt)
        return self.gain * error + self.derivative * rate, memory


@part
class PID(PD):
    """PID control: `PD` plus the integral of the error, with anti-windup by back-calculation.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse [N m], above zero.
    integral : (n,) array_like
        Motor torque per pulse and second [N m/s].
    derivative, filter, period
        As of `PD`.

    See Also
    --------
    plant.PD, plant.Cascade, ctc.pid_gains

    Examples
    --------
    >>> from plant import PID
    >>> PID(gain=(0.2, 0.1), derivative=(0.004, 0.002), integral=(2.0, 1.0), filter=600.0).integral
    array([2., 1.])
    """

    integral: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("gain",), not_negative=("integral",))

    # `commanded`, on the motor, tells one step later how much the amplifier cut off.
    fields = PD.fields | Fields(integral=per_joint(), commanded=per_joint())

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (P e + I (integral of e) + D edot)."""
        before = self.fields.read(state, rig.n)
        error = setpoint.pulses - pulses
        # The amplifier cut this off in the last step: the torque that acted, on the motor, less the
        # command. It is zero below the limit.
        missing = rig.drive.motor_torque(torque) - before.commanded
        # Back-calculation unwinds the integral by that difference, with the time constant gain over
        # integral.
        tracking = self.integral / self.gain  # type: ignore[operator]  # mypy takes inherited fields for what goes in
        # The integral holds torque [N m], not pulse seconds, so that a change of its gain causes no
        # jump.
        integral = integrated(before.integral, self.integral * error, missing, tracking, dt)

        motor, memory = self.motor_torque(error, before.error, dt)
        commanded = motor + integral
        following = self.fields.write(rig.n, error=memory, integral=integral, commanded=commanded)
        return rig.drive.joint_torque(commanded), following


@part
class Cascade(Law):
    """Cascade control of industrial drives: P on the position, PI on the speed.

    Motor torque = speed (w - pulses') + integral of the same. The commanded speed is w = position
    e, with e the tracking error in pulses; pulses' is the filtered difference of the counts, or
    their difference over some samples. Nothing is fed forward, so in steady motion the error is the
    reference's speed over `position`.

    Parameters
    ----------
    position : (n,) array_like
        Commanded speed per tracking error, both in pulses [1/s].
    speed : (n,) array_like
        Motor torque per pulse per second [N m s], above zero.
    integral : (n,) array_like
        Motor torque per pulse [N m]: gain of the integral of the speed error.
    filter : float, optional
        Pole of the first-order low-pass in front of the backward difference [rad/s].
    difference : int, optional
        Samples over which the difference is taken, in place of the filter; such a cascade has a
        period.
    period : float, optional
        Sampling period [s], the torque held in between. None: fast hardware, evaluated at every
        sub-step.

    See Also
    --------
    plant.PID, plant.P

    Examples
    --------
    >>> from plant import Cascade
    >>> Cascade(position=(20, 20), speed=(0.01, 0.005), integral=(0.1, 0.05), filter=600.0).position
    array([20., 20.])
    """

    position: Vector = number(("n",))
    speed: Vector = number(("n",))
    integral: Vector = number(("n",))
    filter: float = number((), default=None)
    difference: int = structure(default=0)
    period: float | None = structure(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("speed",), not_negative=("position", "integral"))
        optional_period(self)
        if (
            isinstance(self.difference, bool)
            or not isinstance(self.difference, int)
            or self.difference < 0
        ):
            raise ValueError(
                f"difference must be a number of samples; got {self.difference!r}. Give 1 or more."
            )
        # An industrial drive takes its speed from a filter, or from a difference over some samples:
        # one of the two, never both.
        if (self.filter is None) == (not self.difference):
            raise ValueError(
                f"one of filter and difference must be given; got {self.filter} and"
                f" {self.difference}. Give the pole [rad/s], or the samples that the drive takes"
                " its speed from."
            )
        # A difference over samples has no meaning for hardware without samples.
        if self.difference and self.period is None:
            raise ValueError(
                "difference needs a sampled cascade; got period=None. Give the period [s], or a"
                " filter."
            )
        if self.filter is not None:
            signs(self, positive=("filter",))

    @functools.cached_property
    def fields(self) -> Fields:
        """Readings for the speed, integral and command [N m on the motor]."""
        pulses = readings(self.difference) if self.difference else SMOOTHED
        return Fields(pulses=pulses, integral=per_joint(), commanded=per_joint())

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (K_v (K_p e - pulses') + K_i (integral of the same))."""
        before = self.fields.read(state, rig.n)
        # As in `PID`: the saturation of the last step, on the motor.
        missing = rig.drive.motor_torque(torque) - before.commanded
        if self.difference:
            rate, memory = difference(pulses, before.pulses, self.difference, dt)
        else:
            rate, memory = filtered_difference(pulses, before.pulses, self.filter, dt)
        # The speed error in pulses per second: commanded speed of the position loop less the
        # measured one.
        too_slow = self.position * (setpoint.pulses - pulses) - rate
        integral = integrated(
            before.integral, self.integral * too_slow, missing, self.integral / self.speed, dt
        )
        # The amplifier's limit is the rig's; the command is stored before it, for the anti-windup
        # of the next step.
        motor = self.speed * too_slow + integral
        following = self.fields.write(rig.n, pulses=memory, integral=integral, commanded=motor)
        return rig.drive.joint_torque(motor), following
