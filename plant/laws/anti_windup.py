"""Integral action that does not wind up."""

from __future__ import annotations

import casadi as ca

__all__ = ["integrated"]


def integrated(integral, slope, missing, tracking, dt):
    """Integral one step later.

    What the amplifier cut off since the last step is taken back with the time constant 1 / `tracking`; of a PI law that
    is its own, gain / integral gain, so that at the limit the integral alone comes to ask for the limit.

    Parameters
    ----------
    integral : casadi SX
        Of the last step, in the unit of what the law asks for.
    slope : casadi SX
        What is integrated, times its gain [that unit / s].
    missing : casadi SX
        What was applied since the last step minus what the law had asked for.
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
