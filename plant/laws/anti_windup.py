"""Integral action with anti-windup by back-calculation."""

import casadi as ca


def integrated(integral: ca.SX, slope: ca.SX, missing: ca.SX, tracking: ca.SX, dt: ca.SX) -> ca.SX:
    """Integral one step later, with back-calculation against windup.

    What the amplifier cut off since the last step is fed back with the time constant 1 / `tracking`. For a PI law that
    is gain / integral gain: in saturation the integral then settles at the limit.

    Parameters
    ----------
    integral : casadi SX
        Of the last step, in the unit of the command.
    slope : casadi SX
        What is integrated, times its gain [that unit / s].
    missing : casadi SX
        What was applied since the last step minus what was commanded.
    tracking : casadi SX
        [1/s]
    dt : casadi SX
        [s]

    Returns
    -------
    casadi SX

    Source: back-calculation; Astrom and Hagglund, Advanced PID Control (2006), 3.5.
    """
    return integral + dt * slope + ca.fmin(tracking * dt, 1) * missing
