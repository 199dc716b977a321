"""A servo that takes goal positions: its own loop turns goal minus count into a motor torque."""

from typing import Any

import casadi as ca

from plant.laws.law import Law, Setpoint, Step
from plant.machine import Frame, InnerLoop, Rig, nearest
from plant.parts import Fields, Vector, array, number, part, per_joint, scalars, signs, structure

# Pulses per second that no servo makes: as good as at once.
_AT_ONCE = 1e12


@part
class PositionServo(InnerLoop, Law):
    """The position loop of a servo, on its own counts and with a period of its own.

    Motor torque = supply (gain e - damping rate), with e = goal - count and the rate of the counts.
    Within the dead zone, the term gain e is zero; beyond it, its size is at least `start`. The
    damping acts everywhere. The amplifier's limit is the drive's. The back-EMF of a motor that is
    fed by a voltage is the drive's viscous friction, kt^2 / R.

    As the ``law`` of a log, the reference is the goal that was sent. As the ``inner`` loop of a
    `Rig`, a law above it sends the goals: `Running.goal`. It seldom runs in a control script: its
    maker runs it. There ``Law.start(servo, rig, pulses)`` begins it, since `start` of a servo is
    its smallest torque.

    Parameters
    ----------
    gain : (n,) array_like or float
        Motor torque per pulse [N m]. Where it is not known, 1: all torques are then in pulses of
        goal. Such a log does not tell the gain; f and friction are found as shares of it, and no
        law needs more.
    damping : (n,) array_like or float, optional
        Motor torque per pulse per second [N m s], on the speed of the counts.
    dead_zone : (n,) array_like or float, optional
        Error up to which there is no torque [pulses].
    start : (n,) array_like or float, optional
        Smallest torque beyond the dead zone [N m].
    speed : (n,) array_like or float, optional
        Speed at which the servo's own goal follows the one that was sent [pulses/s]; at once by
        default.
    supply : (n,) array_like or float, optional
        Ratio of the supply voltage to the voltage at which `gain` and `damping` hold.
    register : (2,) tuple of int, optional
        Lowest and highest goal that the servo takes [counts], such as (0, 4095). A goal outside is
        replaced by the nearest of them: the servo would take it modulo a turn, and move the other
        way round.
    period : float, optional
        Period of the servo's loop [s]; the nearest value of which a whole number fits into one
        sample of the rig is used.

    Raises
    ------
    ValueError
        A gain, a speed or a supply that is not above zero; other numbers below zero; a register
        that is not a lowest and a highest goal.

    See Also
    --------
    plant.MitDrive, plant.Rig, plant.P

    Examples
    --------
    >>> import dataclasses
    >>> from plant import PositionServo, puma560
    >>> rig = dataclasses.replace(puma560.rig(), inner=PositionServo(gain=0.2, period=7e-4))
    >>> rig.inner.gain, rig.inner.stiffness_of(rig).round(0)
    (array([0.2, 0.2]), array([295922.,  91791.]))
    """

    gain: Vector = number(("n",), alike=True)
    damping: Vector = number(("n",), default=0.0, alike=True)
    dead_zone: Vector = number(("n",), default=0.0, alike=True)
    start: Vector = number(("n",), default=0.0, alike=True)  # type: ignore[assignment]  # the method is Law.start(servo, ...)
    speed: Vector = number(("n",), default=float("inf"), finite=False, alike=True)
    supply: Vector = number(("n",), default=1.0, alike=True)
    register: tuple[int, int] | None = structure(default=None)
    period: float = structure(float, default=1e-3)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(
            self,
            positive=("gain", "speed", "supply"),
            not_negative=("damping", "dead_zone", "start"),
            advice="Leave out what is not known; a gain of 1 gives torques in pulses.",
        )
        if self.register is not None:
            advice = "Give counts, such as (0, 4095)."
            lowest, highest = array("register", self.register, (2,), advice=advice).tolist()
            if not lowest < highest:
                raise ValueError(
                    f"register must be (lowest, highest); got {lowest:g}, {highest:g}. {advice}"
                )
            object.__setattr__(self, "register", (int(lowest), int(highest)))

    sends = "goal"

    # The servo's own goal, the counts of its last step, and 1 once there was one.
    fields = Fields(goal=per_joint(), pulses=per_joint(), begun=scalars())

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = gear supply (gain (goal - pulses) - damping pulses'), with dead zone and start."""
        before = self.fields.read(state, rig.n)
        # 1. The servo's own goal runs after the one that was sent; it begins there.
        change = setpoint.pulses - before.goal
        # A finite speed, since infinity times a step of length zero is not a number.
        most = ca.fmin(self.speed, _AT_ONCE) * dt
        goal = before.goal + ca.if_else(
            before.begun > 0, ca.fmin(ca.fmax(change, -most), most), change
        )
        error = goal - pulses
        motor = self.gain * error
        if not rig.encoder.smooth:
            # Start and dead zone are steps, which have no derivative.
            size = ca.fmax(ca.fabs(motor), self.start)
            motor = ca.if_else(ca.fabs(error) > self.dead_zone, ca.copysign(size, error), 0)
        # 2. Damping by the difference of two counts, as a servo takes its speed.
        rate = before.begun * (pulses - before.pulses) / dt
        motor = self.supply * (motor - self.damping * rate)
        following = self.fields.write(rig.n, goal=goal, pulses=pulses, begun=1)
        return rig.drive.joint_torque(motor), following

    def period_on(self, rig: Rig) -> float:
        """The period of which a sample of the rig has a whole number, next to the loop's."""
        return self.period_in(rig.period)

    def stiffness_of(self, rig: Rig) -> Any:
        """The gain across the gear: torque of a shaft per angle."""
        return self.supply * self.gain * self._per_radian(rig)

    def damping_of(self, rig: Rig) -> Any:
        """The damping across the gear: torque of a shaft per speed."""
        return self.supply * self.damping * self._per_radian(rig)

    def torque_rounding(self, rig: Rig) -> Any:
        """The torque of half a count."""
        return self.supply * self.gain / 2

    def frame(self, rig: Rig, q: ca.SX, qd: ca.SX, torque: ca.SX, pulses: ca.SX) -> Frame:
        """The goal, a whole count, by which the servo gives this torque on the reference."""
        drive = rig.drive
        # The servo's damping holds the joint back on the reference, too, which a goal knows
        # nothing of.
        damped = self.supply * self.damping * rig.position_in_pulses(qd)
        beside = (drive.motor_torque(torque) + damped) / (self.supply * self.gain)
        goal = rig.position_in_pulses(q) - rig.encoder.centre + beside
        # Beyond the amplifier's limit a goal further off gives no more, and is a danger once the
        # joint comes free.
        most = drive.motor_gain * drive.current_limit / (self.supply * self.gain)
        goal = ca.fmin(ca.fmax(goal, pulses - most), pulses + most)
        if self.register is not None:
            lowest, highest = self.register
            goal = ca.fmin(ca.fmax(goal, lowest), highest)
        zero = ca.SX.zeros(rig.n)
        return Frame(goal if rig.encoder.smooth else nearest(goal), zero, zero)

    def values(self, rig: Rig, frame: Frame) -> ca.SX:
        """The goals (n, 1) [counts]."""
        return frame.pulses

    def _per_radian(self, rig: Rig) -> Any:
        """Joint torque per joint angle of a gain of one N m per pulse: both cross the gear."""
        gear = rig.drive.gear
        return gear * rig.encoder.position_in_pulses(gear)
