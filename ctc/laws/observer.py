"""Observer and regulator of one joint's tracking error: prediction, and gains that put their poles where they belong.

The error obeys edd = x3 - v: v is the feedback acceleration that really acted, x3 the disturbance acceleration, all
that the model does not know. Between two samples both are constant. Gains are those of the Kalman filter and of the
linear-quadratic regulator of that double integrator, whose poles have a fixed pattern for a given ratio of the noises
(docs/background/computed_torque.md), so that one number, a bandwidth, places them.
"""

import casadi as ca
import numpy as np

DRIFT = 2 / 3
"""Bandwidth with which the disturbance's random walk is followed, over that of the random torque."""

# The filter's poles are the stable zeros of s^6 + w^4 s^2 - (DRIFT w)^6: one real, one pair.
_SQUARE = float(max(np.roots((1, 0, 1, -(DRIFT**6))).real))
_REAL, _PRODUCT = np.sqrt(_SQUARE), np.sqrt(DRIFT**6 / _SQUARE)
_SUM = np.sqrt(2 * _PRODUCT - _SQUARE)


def predict(
    error: ca.SX, rate: ca.SX, disturbance: ca.SX, v: ca.SX | float, dt: ca.SX | float
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Error, rate and disturbance one sample later, under a constant feedback acceleration v."""
    acceleration = disturbance - v
    return error + dt * rate + dt * dt / 2 * acceleration, rate + dt * acceleration, disturbance


def correct(
    error: ca.SX, rate: ca.SX, disturbance: ca.SX, innovation: ca.SX, gains: tuple[ca.SX, ca.SX, ca.SX], dt: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The prediction corrected by the innovation, measured minus predicted error [rad]."""
    return (
        error + gains[0] * innovation,
        rate + gains[1] / dt * innovation,
        disturbance + gains[2] / (dt * dt) * innovation,
    )


def observer_gains(first: ca.SX, second: ca.SX, third: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gains of `correct` for the characteristic polynomial z^3 - first z^2 + second z - third."""
    return 1 - third, (3 - first - second + 3 * third) / 2, 1 - first + second - third


def triple_pole(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gains of an observer with three poles at -omega [rad/s]."""
    z = ca.exp(-omega * dt)
    return observer_gains(3 * z, 3 * z**2, z**3)


def filter_gains(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gains of the Kalman filter whose process noise is a random torque of bandwidth omega [rad/s], and a drift."""
    real, pair = ca.exp(-_REAL * omega * dt), ca.exp(-_SUM / 2 * omega * dt)
    both = 2 * pair * ca.cos(np.sqrt(_PRODUCT - _SUM**2 / 4) * omega * dt)
    return observer_gains(real + both, pair**2 + real * both, real * pair**2)


def regulator_gains(omega: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Feedback accelerations per error and per rate: poles at omega [rad/s], damping 1/sqrt(2), torque held."""
    pair = ca.exp(-omega * dt / np.sqrt(2))
    both = 2 * pair * ca.cos(omega * dt / np.sqrt(2))
    return (1 - both + pair**2) / (dt * dt), (3 - both - pair**2) / (2 * dt)
