"""When computed torque is faster for a while: where a joint begins or turns back, or its counts show what is unknown.

Gears that no one stated swing under a faster controller long before they do under its own bandwidth: what counts are
off by then changes sign within milliseconds, as it does not on a rigid arm, and the joint is boosted no more.
"""

from typing import Any

import casadi as ca

_SWINGS, _QUIETER, _UNEXPECTED = 1.0, 0.75, 0.25
"""Predicted distance from the middle of the counted cell [pulses] of a swing, less the second times the dead zone (the
smaller that is, the more of the rounding is predicted); and by how much that of a load is more."""

_NEAR = 5.0
"""Error [pulses] beyond which the boost is less in proportion: it would take the torque from limit to limit."""

_WITHIN, _REMEMBERED = 0.67, 10.0
"""Time between distances of opposite signs for a swing, at most, less a sample, times the bandwidth; its memory [s]."""


def boosted(most: float, share: ca.SX, error: ca.SX, swings: ca.SX) -> ca.SX:
    """Factor (n, 1) on the bandwidth, for a share of the boost `most` and an error [pulses]; 1 after two swings."""
    near = _NEAR / ca.fmax(ca.fabs(error), _NEAR)
    return 1 + (most - 1) * share * near * (1 - ca.fmin(1, ca.fmax(0, swings - 1)))


def fresh_and_swings(
    seen: ca.SX, begins: ca.SX, fresh: ca.SX, known: list[ca.SX], dt: ca.SX, law: Any
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """What is left of the boost, the sign of the last large distance, and the swings, all (n, 1), one sample later.

    Parameters
    ----------
    seen
        Predicted distances from the middle of the counted cell [pulses].
    begins
        Where a joint begins to move, or turns back.
    fresh, known
        What was left a sample ago; that sign and the swings then.
    dt
        [s].
    law
        Computed torque, with its numbers.
    """
    (last, swings), size, sign = known, ca.fabs(seen), ca.sign(seen)
    least, soon = _SWINGS - _QUIETER * law.dead_zone, ca.exp(dt * law.bandwidth / _WITHIN - 1)
    turned = ca.logic_and(size > least, last * sign < -soon)
    unexpected = ca.logic_and(size > least + _UNEXPECTED, last * sign > soon)
    swings = ca.if_else(turned, ca.fmin(2, swings + 1), swings * ca.exp(-dt / _REMEMBERED))
    last = ca.if_else(size > least, sign, last * ca.exp(-dt * law.bandwidth / _WITHIN))
    return ca.if_else(ca.logic_or(begins, unexpected), 1, fresh * ca.exp(-dt / law.start_time)), last, swings


def switched(law: Any, n: int) -> range:
    """Places in the state of a computed torque on rigid gears that counts switch: the boost, and what ends it."""
    first = (5 + law.delay + 5 * (law.friction and law.learn_friction)) * n
    return range(first, first + 3 * n)
