"""Measured speed, and how an arm is brought to rest, in casadi: for the running controller and for the exported C."""

import casadi as ca

from plant.machine.rig import Rig

SMOOTHING = 0.25
"""Smoothing factor of the measured speed: quantisation is much of a change of counts."""

RAMP = 0.1
"""Share of the duration of a stop in which the torque ramps to its end: short, since it may begin at the limit."""


def smoothed(speed: ca.SX, counts: ca.SX, before: ca.SX, dt: ca.SX) -> ca.SX:
    """Speed (n, 1) [pulses/s] after a change of counts within dt."""
    return speed + SMOOTHING * ((counts - before) / dt - speed)


def slowing(since: ca.SX, duration: ca.SX, q: ca.SX, qd: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Reference of a stop [SI]: from a speed to rest, accelerations zero at both ends."""
    at, within = ca.SX.sym("since"), ca.SX.sym("duration")
    s = at / within
    travelled = within * (s - s**3 + s**4 / 2)  # from unit speed: half of the duration in the end
    speed = ca.jacobian(travelled, at)
    made = ca.Function("slowing", [at, within], [travelled, speed, ca.jacobian(speed, at)])
    travelled, speed, acceleration = made(ca.fmin(since, duration), duration)
    return q + travelled * qd, speed * qd, acceleration * qd


def ramp(rig: Rig, gravity: ca.SX, begun: ca.SX, speed: ca.SX, since: ca.SX, duration: ca.SX) -> ca.SX:
    """Torque (n, 1) [N m] that ends, limited, at gravity compensation (or zero) and damping.

    Parameters
    ----------
    rig : Rig
    gravity : casadi SX (n, 1)
        Torque of gravity less that of springs, or zeros [N m].
    begun : casadi SX (n, 1)
        Torque where the ramp began [N m].
    speed : casadi SX (n, 1)
        Measured [pulses/s]; under the damping the motors alone stop with a time constant of a quarter of the duration.
    since, duration : casadi SX
        [s]
    """
    drive, shaft = rig.drive, rig.drive.coupling.shaft(rig.to_angle(speed))
    damping = drive.coupling.joint_torque(drive.reflected_inertia() * shaft / (duration / 4))
    return begun + ca.fmin(1, since / (RAMP * duration)) * (drive.limited(gravity - damping) - begun)
