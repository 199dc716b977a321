"""Extended-state observer of one joint's tracking error: the error, its rate, and a disturbance acceleration.

The model is edd = x3 - v, with v the feedback acceleration that really acted (after the amplifier's limit) and x3 the
disturbance acceleration, all that the model does not know. It is sampled exactly for a constant v and x3, and corrected
by the innovation with gains that put all three poles at z = exp(-omega dt).
"""

import casadi as ca


def predict(
    error: ca.SX, rate: ca.SX, disturbance: ca.SX, v: ca.SX | float, dt: ca.SX | float
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Error, rate and disturbance one sample later, under a constant feedback acceleration v."""
    acceleration = disturbance - v
    return error + dt * rate + dt * dt / 2 * acceleration, rate + dt * acceleration, disturbance


def correct(
    error: ca.SX, rate: ca.SX, disturbance: ca.SX, measured: ca.SX, omega: ca.SX, dt: ca.SX | float
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Correct the prediction by the innovation, measured minus predicted error.

    Parameters
    ----------
    error, rate, disturbance : casadi SX
        As predicted [rad, rad/s, rad/s^2].
    measured : casadi SX
        Measured error [rad].
    omega : casadi SX
        Triple pole of the observer [rad/s].
    dt : casadi SX
        Sample period [s].

    Returns
    -------
    error, rate, disturbance : casadi SX
    """
    z = ca.exp(-omega * dt)
    innovation = measured - error
    return (
        error + (1 - z**3) * innovation,
        rate + 1.5 * (1 - z) ** 2 * (1 + z) / dt * innovation,
        disturbance + (1 - z) ** 3 / (dt * dt) * innovation,
    )
