"""Second-order low-pass of a sampled signal and its rate, by Tustin's method: the roll-off of a PID law.

The filter is 1 / ((s / f)^2 + 2 z s / f + 1). Its states are the filtered signal and the rate of that, so a step of
another length, after a late call, changes nothing but the step.
"""

import casadi as ca


def rolled_off(
    signal: ca.SX, before: ca.SX, value: ca.SX, rate: ca.SX, corner: ca.SX, damping: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Filtered signal and its rate, one step later.

    Parameters
    ----------
    signal, before : casadi SX (n, 1)
        Read now, and in the step before.
    value, rate : casadi SX (n, 1)
        Filtered signal, and its rate, in the step before.
    corner : casadi SX
        f [rad/s]
    damping : casadi SX
        z
    dt : casadi SX
        Time since the step before [s].

    Returns
    -------
    value, rate : casadi SX (n, 1)

    Source: Tustin's method, which is the trapezoidal rule: s = 2 / dt (z - 1) / (z + 1).
    """
    half = corner * dt / 2
    pull = corner**2 * ((signal + before) / 2 - value - dt / 2 * rate) - 2 * damping * corner * rate
    following = rate + dt * pull / (1 + 2 * damping * half + half**2)
    return value + dt / 2 * (rate + following), following
