"""Terms of sampled controllers: the rate of a signal, and an integral with anti-windup.

The encoder is the only source of speed that a law has. The rate is taken behind a low-pass, which
is sampled exactly, or over several samples. If the sampling period is long against the filter's
time constant, the rate is the plain backward difference; if it is short, it is the usual filtered
derivative, pole s / (s + pole).
"""

from typing import Any, NamedTuple

import casadi as ca

from plant.machine import Rig
from plant.parts import Fields, per_joint, scalars

SMOOTHED = Fields(signal=per_joint(), begun=scalars())
"""Memory of `filtered_difference`: the low-pass, and 1 once there was a reading."""


def readings(samples: int) -> Fields:
    """Memory of `difference`: the last readings, latest first, and 1 once there was one."""
    return Fields(signals=per_joint(rows=samples), begun=scalars())


def filtered_difference(signal: ca.SX, memory: Any, pole: ca.SX, dt: ca.SX) -> tuple[ca.SX, Any]:
    """Filtered rate (n,) [signal / s] of a signal (n,), and the memory for the next call.

    `memory` is a record of `SMOOTHED`; at its start the rate is zero, whatever the signal is.
    `pole` is that of the low-pass [rad/s], `dt` the time since the last reading [s].
    """
    # The first reading starts the low-pass at the signal itself, so that it gives no rate.
    smoothed = ca.if_else(memory.begun > 0, memory.signal, signal)
    # Exact response of the low-pass over dt, which is stable for any pole.
    change = (1 - ca.exp(-pole * dt)) * (signal - smoothed)
    return change / dt, memory._replace(signal=smoothed + change, begun=1)


def difference(
    signal: ca.SX, memory: Any, samples: int, dt: ca.SX, period: Any
) -> tuple[ca.SX, Any]:
    """Rate (n,) of a signal (n,) over some samples, and the memory, a record of `readings`.

    The samples are a `period` apart, and the last one `dt` after the one before it [s].
    """
    # Before the first reading the signal is taken to have stood still.
    signals = ca.if_else(memory.begun > 0, memory.signals, ca.repmat(signal, samples, 1))
    rows = ca.vertsplit(signals, signal.shape[0])
    # A late call lengthens only its own sample.
    span = samples * dt - (samples - 1) * (dt - period)
    rate = (signal - rows[-1]) / span
    return rate, memory._replace(signals=ca.vertcat(signal, *rows[:-1]), begun=1)


INTEGRATION = ("backward", "forward", "tustin")
"""How an integral is summed: with this sample, from those before, or by trapezoids."""

ANTI_WINDUP = ("back-calculation", "clamping", "limit", "none")
"""What an integral does while the amplifier limits the torque."""

# Difference of the applied from the commanded torque, relative, that is no rounding.
_LIMITED = 1e-9


class Integral(NamedTuple):
    """How a law integrates: `rule` of `INTEGRATION`, and `anti_windup` of `ANTI_WINDUP`."""

    rule: str
    anti_windup: str

    @property
    def fields(self) -> Fields:
        """Memory beside the integral: the last integrand, of trapezoids."""
        return Fields(slope=per_joint()) if self.rule == "tustin" else Fields()

    def step(
        self, before: Any, slope: ca.SX, tracking: ca.SX, rig: Rig, torque: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """The integral (n,) that acts in this sample, and the memory for the next.

        `before`: the record of the law's memory, with `integral` and `commanded`, on the motor.
        `slope`: integrand times its gain. `tracking`: integral gain over gain [1/s]. `torque`: that
        acted since the last sample, on the joint.
        """
        # The amplifier cut this off in the last step: zero below the limit.
        missing = rig.drive.motor_torque(torque) - before.commanded
        memory = {}
        if self.rule == "tustin":
            memory["slope"] = slope
            slope = (slope + before.slope) / 2
        if self.anti_windup == "clamping":
            # Integrate at the limit only what leads away from it. A rounding is less.
            rounded = _LIMITED * ca.fabs(before.commanded) + rig.torque_rounding
            at_limit = ca.fabs(missing) > rounded
            slope = ca.if_else(ca.logic_and(at_limit, slope * missing <= 0), 0, slope)
        if self.anti_windup == "back-calculation":
            following = integrated(before.integral, slope, missing, tracking, dt)
        else:
            following = before.integral + dt * slope
        if self.anti_windup == "limit":
            limit = rig.drive.motor_gain * rig.drive.current_limit
            following = ca.fmin(ca.fmax(following, -limit), limit)
        memory["integral"] = following
        return before.integral if self.rule == "forward" else following, memory


def integrated(integral: ca.SX, slope: ca.SX, missing: ca.SX, tracking: ca.SX, dt: ca.SX) -> ca.SX:
    """Integral one step later, with back-calculation against windup.

    The torque that the amplifier cut off since the last step (`missing`: applied minus commanded)
    is fed back with the time constant 1 / `tracking` [s]. For a PI law `tracking` is integral gain
    over gain, so that in saturation the integral settles at the limit. `slope` is the integrand
    times its gain.

    Source: back-calculation; Astrom and Hagglund, Advanced PID Control (2006), 3.5.
    """
    # At most all of it in one step: a longer step would overshoot.
    return integral + dt * slope + ca.fmin(tracking * dt, 1) * missing
