"""When computed torque is faster for a while: where a joint begins or turns back, or its counts show what is unknown.

Gears that no one stated swing under a faster controller long before they do under its own bandwidth: their innovations
then change sign within milliseconds, as those of a rigid arm do not, and the joint is boosted no more.
"""

import casadi as ca
import numpy as np

_UNEXPECTED, _SWINGS = 0.75, 0.5
"""Innovations [pulses] beyond the dead zone: those of a load, or of friction that is far off; those of a swing."""

_NEAR = 5.0
"""Error [pulses] beyond which the boost is less in proportion: it would take the torque from limit to limit."""

_WITHIN, _REMEMBERED = 6e-3, 10.0
"""Times [s]: between innovations of opposite signs, at most, for a swing; for how long one is remembered."""


def boosted(most: float, share: ca.SX, error: ca.SX, swings: ca.SX) -> ca.SX:
    """Factor (n, 1) on the bandwidth, for a share of the boost `most` and an error [pulses]; 1 after two swings."""
    near = _NEAR / ca.fmax(ca.fabs(error), _NEAR)
    return 1 + (most - 1) * share * near * (1 - ca.fmin(1, ca.fmax(0, swings - 1)))


def fresh_and_swings(
    seen: ca.SX, begins: ca.SX, fresh: ca.SX, known: list[ca.SX], dt: ca.SX, lasts: float
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """What is left of the boost, the sign of the last large innovation, and the swings, all (n, 1), one sample later.

    Parameters
    ----------
    seen
        Innovations beyond the dead zone [pulses].
    begins
        Where a joint begins to move, or turns back.
    fresh, known
        What was left a sample ago; that sign and the swings then.
    dt
        [s].
    lasts
        Time constant of the boost [s].
    """
    (last, swings), size, sign = known, ca.fabs(seen), ca.sign(seen)
    turned = ca.logic_and(size > _SWINGS, last * sign < -np.exp(-1))
    swings = ca.if_else(turned, ca.fmin(2, swings + 1), swings * ca.exp(-dt / _REMEMBERED))
    last = ca.if_else(size > _SWINGS, sign, last * ca.exp(-dt / _WITHIN))
    return ca.if_else(ca.logic_or(begins, size > _UNEXPECTED), 1, fresh * ca.exp(-dt / lasts)), last, swings
