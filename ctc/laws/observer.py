"""Observer and regulator of one joint's tracking error: prediction, and gains by pole placement.

The error obeys edd = x3 - v: v is the feedback acceleration that really acted, x3 the disturbance
acceleration, all that the model does not know. Between two samples both are constant. Gains are
those of the Kalman filter and of the linear-quadratic regulator of that double integrator, whose
poles have a fixed pattern for a given ratio of the noises (docs/background/computed_torque.md), so
that one number, a bandwidth, places them.
"""

import casadi as ca
import numpy as np

# Bandwidth with which the filter follows the disturbance's random walk, over that with which it
# follows the random torque: the ratio of the two process noises.
DRIFT = 2 / 3

# The filter's poles are the stable zeros of s^6 + w^4 s^2 - (DRIFT w)^6: one real, one pair.
_SQUARE = float(max(np.roots((1, 0, 1, -(DRIFT**6))).real))
_REAL = np.sqrt(_SQUARE)
_PRODUCT = np.sqrt(DRIFT**6 / _SQUARE)
_SUM = np.sqrt(2 * _PRODUCT - _SQUARE)


def predict(
    error: ca.SX, rate: ca.SX, disturbance: ca.SX, v: ca.SX | float, dt: ca.SX | float
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Error, rate and disturbance one sample later, under a constant feedback acceleration v."""
    # The feedback reduces the error, the disturbance drives it.
    acceleration = disturbance - v
    return error + dt * rate + dt * dt / 2 * acceleration, rate + dt * acceleration, disturbance


def correct(
    error: ca.SX,
    rate: ca.SX,
    disturbance: ca.SX,
    innovation: ca.SX,
    gains: tuple[ca.SX, ca.SX, ca.SX],
    dt: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The prediction corrected by the innovation, measured minus predicted error [rad]."""
    # Gains are without unit; powers of dt give them the units of rate and acceleration.
    error = error + gains[0] * innovation
    rate = rate + gains[1] / dt * innovation
    return error, rate, disturbance + gains[2] / (dt * dt) * innovation


def triple_pole(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gains of `correct` for three poles at -omega [rad/s]."""
    z = ca.exp(-omega * dt)
    return 1 - z**3, 1.5 * (1 - z) ** 2 * (1 + z), (1 - z) ** 3


def filter_gains(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gains of the Kalman filter for a random torque of bandwidth omega [rad/s], and a drift."""
    # The real pole by Tustin's rule, like the pair below: its sign is right for any period.
    real = 2 * _REAL * omega * dt / (2 + _REAL * omega * dt)  # 1 - z
    # Characteristic polynomial of three poles, written in 1 - z so that slow poles lose no digits.
    at_one, less = _sampled(_SUM, _PRODUCT, omega * dt)
    return real + less - real * less, at_one + real * (less - at_one / 2), real * at_one


def regulator_gains(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Accelerations per error and rate: poles at omega [rad/s], damping 1/sqrt(2), torque held."""
    # The continuous regulator of a double integrator has two poles at 45 degrees: damping
    # 1/sqrt(2).
    at_one, less = _sampled(np.sqrt(2), 1.0, omega * dt)
    return at_one / (dt * dt), (less + at_one / 2) / dt


def _sampled(damping: float, stiffness: float, step: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(1 - z1) (1 - z2) and 1 - z1 z2 of s^2 + damping s + stiffness, by Tustin's rule."""
    # Values of the polynomial at z = 1 and of its last coefficient determine both poles.
    square = stiffness * step**2
    common = 4 + 2 * damping * step + square
    return 4 * square / common, 4 * damping * step / common
