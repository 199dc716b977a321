"""P, PD and PID control on the tracking error in pulses; the cascade of industrial drives."""

import functools
from types import SimpleNamespace
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.laws.law import Law, Setpoint, StatelessLaw, Step
from plant.laws.terms import (
    ANTI_WINDUP,
    INTEGRATION,
    SMOOTHED,
    Integral,
    difference,
    filtered_difference,
    readings,
)
from plant.machine import Rig
from plant.parts import (
    Fields,
    Floats,
    Vector,
    array,
    choice,
    number,
    optional_period,
    part,
    per_joint,
    signs,
    structure,
    whole,
)

# Factors that convert gains of drives to SI units: gains of the position loop to 1/s, gains of the
# speed loop to torque or current per rad/s.
_PER_SECOND = {"1/s": 1.0, "mm/min/um": 1000 / 60}
_PER_RADIAN = {
    "N m s/rad": 1.0,
    "A s/rad": 1.0,
    "N m/rpm": 30 / np.pi,
    "A/rpm": 30 / np.pi,
}


@part
class P(StatelessLaw):
    """P control of the experiment: motor torque proportional to the tracking error in pulses.

    The law models fast hardware (a counter and an amplifier), so it is evaluated at every sub-step.
    The same loop would be unstable if it were sampled every 0.7 ms, the period of the log.

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

    At sample k, T after the one before, in this order:

    1. e_k = r_k - c_k, of the reference and the counts.
    2. s_k = s_(k-1) + (1 - exp(-filter T)) (e_k - s_(k-1)), with s_0 = e_0; edot_k = (s_k -
       s_(k-1)) / T.
    3. u_k = gain e_k + derivative edot_k, limited by the amplifier and held until sample k + 1.

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
    derivative_of : {"error", "counts"}
        What step 2 differentiates: e, or -c, which no step of the reference disturbs.

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
    derivative_of: str = structure(choices=("error", "counts"), default="error")

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("filter",), not_negative=("gain", "derivative"))
        optional_period(self)

    fields = Fields(error=SMOOTHED)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (P e + D edot)."""
        # The state holds only the memory of the derivative's filter. The law filters because a
        # difference of raw counts jumps by whole pulses from sample to sample.
        memory = self.fields.read(state, rig.n).error
        motor, memory = self.motor_torque(setpoint.pulses - pulses, memory, dt, pulses)
        return rig.drive.joint_torque(motor), self.fields.write(rig.n, error=memory)

    def motor_torque(
        self, error: ca.SX, memory: Any, dt: ca.SX, pulses: ca.SX
    ) -> tuple[ca.SX, Any]:
        """Return motor torque (n,) [N m] for error and counts (n,) [pulses], and the new memory."""
        # The rate of the error includes the speed of the reference, so the torque responds to that
        # speed directly. The rate of the counts does not include it.
        signal = error if self.derivative_of == "error" else -pulses
        rate, memory = filtered_difference(signal, memory, self.filter, dt)
        return self.gain * error + self.derivative * rate, memory


@part
class PID(PD):
    """PID control: `PD` plus the integral of the error, with anti-windup.

    Between steps 2 and 3 of `PD`:

    - i_k = i_(k-1) + T integral e_k + min(T integral / gain, 1) (a_k - u_(k-1)), with i_(-1) = 0;
      a_k is the torque that the amplifier gave since sample k - 1, which is u_(k-1) below its
      limit.

    Then u_k = gain e_k + derivative edot_k + i_k.

    Parameters
    ----------
    gain : (n,) array_like
        Motor torque per pulse [N m], above zero.
    integral : (n,) array_like
        Motor torque per pulse and second [N m/s].
    derivative, filter, period, derivative_of
        As of `PD`.
    integration : {"backward", "forward", "tustin"}
        Rule of the integral. "backward" (Euler) is the rule above. With "forward" (Euler), u_k
        takes i_(k-1) in place of i_k. With "tustin" (trapezoids), i_k takes (e_k + e_(k-1)) / 2 in
        place of e_k, with e_(-1) = 0.
    anti_windup : {"back-calculation", "clamping", "limit", "none"}
        "back-calculation" is the last term of i_k; the other choices omit that term. "clamping"
        stops the integration at the torque limit, unless the step leads away from that limit.
        "limit" clips i_k at the amplifier's limit. "none" lets the integral wind up.

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
    integration: str = structure(choices=INTEGRATION, default="backward")
    anti_windup: str = structure(choices=ANTI_WINDUP, default="back-calculation")

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("gain",), not_negative=("integral",))

    @functools.cached_property
    def fields(self) -> Fields:  # type: ignore[override]  # that of `PD` has nothing to choose
        """Filter, integral and command [N m on the motor].

        `commanded` tells one step later how much the amplifier cut off.
        """
        memory = PD.fields | Fields(integral=per_joint(), commanded=per_joint())
        return memory | Integral(self.integration, self.anti_windup).fields

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (P e + I (integral of e) + D edot)."""
        before = self.fields.read(state, rig.n)
        error = setpoint.pulses - pulses
        # Back-calculation unwinds with the time constant gain over integral.
        tracking = self.integral / self.gain  # type: ignore[operator]  # mypy takes inherited fields for what goes in
        # The integral holds torque [N m], not pulse seconds, so that a change of its gain causes no
        # jump.
        rule = Integral(self.integration, self.anti_windup)
        acting, stored = rule.step(before, self.integral * error, tracking, rig, torque, dt)

        motor, memory = self.motor_torque(error, before.error, dt, pulses)
        commanded = motor + acting
        following = self.fields.write(rig.n, error=memory, commanded=commanded, **stored)
        return rig.drive.joint_torque(commanded), following


@part
class Cascade(Law):
    """Cascade control of industrial drives: P on the position, PI on the speed.

    At sample k, T after the one before, in this order:

    1. e_k = r_k - c_k, of the reference and the counts.
    2. The speed v_k. With a filter: s_k = s_(k-1) + (1 - exp(-filter T)) (c_k - s_(k-1)), s_0 =
       c_0, v_k = (s_k - s_(k-1)) / T. With a difference of m samples: v_k = (c_k - c_(k-m)) / (m
       T), where the counts stood still before the first sample.
    3. The speed error w_k = position e_k - v_k.
    4. i_k = i_(k-1) + T integral w_k + min(T integral / speed, 1) (a_k - u_(k-1)), with i_(-1) = 0;
       a_k is the torque that the amplifier gave since sample k - 1, which is u_(k-1) below its
       limit.
    5. u_k = speed w_k + i_k on the motor, limited by the amplifier and held until sample k + 1.

    The law feeds nothing forward. So in steady motion, below the amplifier's limit and with
    `integral` above zero, the tracking error is the reference's speed divided by `position`.
    `from_drive` takes gains in the units of drives.

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
        Number m of samples over which the difference is taken, in place of the filter. It requires
        a `period`.
    period : float, optional
        Sampling period [s], the torque held in between. None: fast hardware, evaluated at every
        sub-step.
    integration : {"backward", "forward", "tustin"}
        Rule of the integral. "backward" (Euler) is step 4 as above. With "forward" (Euler), u_k
        takes i_(k-1) in place of i_k. With "tustin" (trapezoids), i_k takes (w_k + w_(k-1)) / 2 in
        place of w_k, with w_(-1) = 0.
    anti_windup : {"back-calculation", "clamping", "limit", "none"}
        "back-calculation" is the last term of step 4; the other choices omit that term. "clamping"
        stops the integration at the torque limit, unless the step leads away from that limit.
        "limit" clips i_k at the amplifier's limit. "none" lets the integral wind up.

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
    integration: str = structure(choices=INTEGRATION, default="backward")
    anti_windup: str = structure(choices=ANTI_WINDUP, default="back-calculation")

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("speed",), not_negative=("position", "integral"))
        optional_period(self)
        samples = whole("difference", self.difference, "Give 1 sample or more.", least=0)
        object.__setattr__(self, "difference", samples)
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

    @classmethod
    def from_drive(
        cls,
        rig: Rig,
        *,
        Kp: ArrayLike,
        Kv: ArrayLike,
        Tn: ArrayLike,
        position_unit: str = "1/s",
        speed_unit: str = "N m s/rad",
        **fields: Any,
    ) -> Self:
        """A cascade with gains in the units of drives.

        Parameters
        ----------
        rig : Rig
        Kp : (n,) array_like
            Gain of the position loop, in `position_unit`.
        Kv : (n,) array_like
            Gain of the speed loop, motor torque or current per motor speed, in `speed_unit`.
        Tn : (n,) array_like
            Reset time of the speed loop [s]; infinity without an integral.
        position_unit : {"1/s", "mm/min/um"}
            1 mm/min/um is 1000/60 1/s.
        speed_unit : {"N m s/rad", "A s/rad", "A/rpm", "N m/rpm"}
            Unit of `Kv`. The rig's motor gain converts a current [A] to a motor torque [N m].
        **fields
            Further fields of a cascade: filter or difference, period, integration, anti_windup.

        Examples
        --------
        >>> from plant import Cascade, puma560
        >>> law = Cascade.from_drive(puma560.rig(), Kp=20, Kv=0.05, Tn=0.02, filter=600.0)
        >>> law.position, (law.integral / law.speed).round(6)
        (array([20., 20.]), array([50., 50.]))
        """
        choice("position_unit", position_unit, tuple(_PER_SECOND))
        choice("speed_unit", speed_unit, tuple(_PER_RADIAN))
        per_current = speed_unit.startswith("A")
        gains = SimpleNamespace(
            Kp=_of_joints("Kp", Kp, rig.n),
            Kv=_of_joints("Kv", Kv, rig.n),
            Tn=_of_joints("Tn", Tn, rig.n, finite=False),
        )
        # Under the drive's names, which the caller gave.
        advice = "Give the gains of the drive's data sheet, and Tn in s."
        signs(gains, positive=("Kv", "Tn"), not_negative=("Kp",), advice=advice)
        # Motor torque per motor speed [N m s/rad], then per pulses per second.
        torque = gains.Kv * _PER_RADIAN[speed_unit]
        torque = torque * (rig.drive.motor_gain if per_current else 1.0)
        speed = torque * 2 * np.pi / rig.encoder.resolution
        position = gains.Kp * _PER_SECOND[position_unit]
        return cls(position=position, speed=speed, integral=speed / gains.Tn, **fields)

    @functools.cached_property
    def fields(self) -> Fields:
        """Readings for the speed, integral and command [N m on the motor]."""
        pulses = readings(self.difference) if self.difference else SMOOTHED
        memory = Fields(pulses=pulses, integral=per_joint(), commanded=per_joint())
        return memory | Integral(self.integration, self.anti_windup).fields

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k (speed w + integral (time integral of w)), w = position e - pulses'."""
        before = self.fields.read(state, rig.n)
        if self.difference:
            samples, period = self.difference, self.period
            rate, memory = difference(pulses, before.pulses, samples, dt, period)
        else:
            rate, memory = filtered_difference(pulses, before.pulses, self.filter, dt)
        # The speed error in pulses per second: commanded speed of the position loop less the
        # measured one.
        too_slow = self.position * (setpoint.pulses - pulses) - rate
        rule = Integral(self.integration, self.anti_windup)
        slope = self.integral * too_slow
        acting, stored = rule.step(before, slope, self.integral / self.speed, rig, torque, dt)
        # The rig applies the amplifier's limit, not this law. The state stores the command without
        # that limit, for the anti-windup of the next step.
        motor = self.speed * too_slow + acting
        following = self.fields.write(rig.n, pulses=memory, commanded=motor, **stored)
        return rig.drive.joint_torque(motor), following


def _of_joints(name: str, value: ArrayLike, n: int, *, finite: bool = True) -> Floats:
    """Numbers (n,) of all joints, given once or per joint."""
    advice = "Give one number, or one per joint."
    listed: Any = value if np.iterable(value) else [value]
    numbers = array(name, listed, ("n",), advice=advice, finite=finite)
    if len(numbers) not in (1, n):
        raise ValueError(f"{name} must be one number, or {n}; got {len(numbers)}. {advice}")
    return np.broadcast_to(numbers, n)
