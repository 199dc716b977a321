"""What computed torque does where a joint begins or turns back: it learns friction, and is faster
for a while.

The disturbance torque holds all that the model lacks: gravity, which stays where a joint turns
back, and friction, which turns. Just after a turn its change is therefore projected on that of
Coulomb and viscous friction, and goes from the one to the other, so that the torque does not jump
(docs/background/computed_torque.md).

Gears that no one stated swing under a faster controller long before they do under its own
bandwidth: what counts are off by then changes sign within milliseconds, as it does not on a rigid
arm, and the joint is boosted no more.
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import Drive, Rig
from plant.parts.arguments import array

# Rate [1/s] at which friction is learnt where a joint turns back, and time constant of what was
# before [s].
_LEARNS = 40.0
_RECENT = 0.4

_HOLDS = "Give the joint torque that holds the arm now [N m]."

_TINY = 1e-9  # beside the square of friction torques [N m], where there is no friction


def learn(
    known: tuple[ca.SX, ca.SX],
    recent: list[ca.SX],
    stated: tuple[ca.SX, ca.SX],
    delta: ca.SX,
    heading: ca.SX,
    most: ca.SX | float,
    dt: ca.SX,
) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:
    """Learnt shares, disturbance torque without what they took over, and what was recent, one
    sample later.

    On the shafts, (n, 1) each: shares `known` by which Coulomb and viscous friction differ, at
    `most`, from the `stated`, which are Coulomb level and viscous friction at the reference's speed
    [N m]; disturbance torque `delta`; `heading` of the reference, -1 to 1; `recent` heading,
    viscous friction and disturbance torque.
    """
    turned = heading - recent[0]
    changes = stated[0] * turned, stated[1] - recent[1]
    # a start from rest turns nothing
    rate = _LEARNS * ca.fabs(heading) * ca.fmax(ca.fabs(turned) - 1, 0)
    step = (
        rate
        * dt
        / (1 + rate * dt)
        * (delta - recent[2])
        / (changes[0] ** 2 + changes[1] ** 2 + _TINY)
    )
    following = [
        ca.fmin(ca.fmax(was + step * change, -most), most)
        for was, change in zip(known, changes, strict=True)
    ]
    coulomb = following[0] - known[0]
    drag = following[1] - known[1]
    delta = delta - stated[0] * heading * coulomb - stated[1] * drag
    before = recent[0], recent[1], recent[2] - stated[0] * recent[0] * coulomb - recent[1] * drag
    follow = ca.fabs(heading) * (1 - ca.exp(-dt / _RECENT))
    now = heading, stated[1], delta
    return (
        following,
        delta,
        [was + follow * (new - was) for was, new in zip(before, now, strict=True)],
    )


def shares(friction: ArrayLike, drive: Drive, most: float | None) -> NDArray[np.float64]:
    """Shares (2, n) by which Coulomb and viscous friction, motor side, differ from a drive's;
    others are refused.
    """
    given = array(
        "friction", friction, (2, drive.n), advice="Give that of a running controller, motor side."
    )
    stated = np.array([drive.coulomb, drive.viscous])
    differs = (
        np.divide(given, stated, out=np.where(given == stated, 1.0, np.inf), where=stated > 0) - 1
    )
    if most is None or not (np.abs(differs) <= most * (1 + 1e-9)).all():
        allowed = (
            "left out where none is learnt" if most is None else f"within {most:.0%} of the rig's"
        )
        raise ValueError(
            f"friction must be {allowed}; got {given.tolist()}, the rig's are {stated.tolist()}."
        )
    return differs


def unexplained(
    torque: ArrayLike, law: Any, rig: Rig, q: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Torque (n,) by which one that holds an arm differs from its weight beyond what known
    static friction explains.
    """
    held = array("torque", torque, (rig.n,), advice=_HOLDS)
    coupling = rig.drive.coupling
    limit = rig.drive.torque_limit()
    if (np.abs(coupling.shaft_torque(held)) > limit).any():
        raise ValueError(f"torque must be within the amplifier's {limit} N m; got {held}. {_HOLDS}")
    weight = law.arm.h(q, np.zeros(rig.n)) - np.ravel(law.rig.spring_torque(q))
    lacking = coupling.shaft_torque(held - weight)
    level = law.rig.drive.joint_coulomb() if law.friction else 0.0
    return coupling.joint_torque(lacking - np.clip(lacking, -level, level))


# Predicted distance from the middle of the counted cell [pulses] of a swing, less the second times
# the dead zone (the smaller that is, the more of the rounding is predicted); and by how much that
# of a load is more.
_SWINGS = 1.0
_QUIETER = 0.75
_UNEXPECTED = 0.25

# error [pulses] beyond which the boost is less in proportion: it would take the torque from limit
# to limit
_NEAR = 5.0

# Time between distances of opposite signs for a swing, at most, less a sample, times the bandwidth;
# its memory [s].
_WITHIN = 0.67
_REMEMBERED = 10.0


def boosted(most: float, share: ca.SX, error: ca.SX, swings: ca.SX) -> ca.SX:
    """Factor (n, 1) on the bandwidth, for a share of the boost `most` and an error [pulses]; 1
    after two swings.
    """
    near = _NEAR / ca.fmax(ca.fabs(error), _NEAR)
    return 1 + (most - 1) * share * near * (1 - ca.fmin(1, ca.fmax(0, swings - 1)))


def fresh_and_swings(
    seen: ca.SX, begins: ca.SX, fresh: ca.SX, known: list[ca.SX], dt: ca.SX, law: Any
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """What is left of the boost, the sign of the last large distance, and the swings, all (n, 1),
    one sample later.

    `seen`: predicted distances from the middle of the counted cell [pulses]. `begins`: where a
    joint begins to move, or turns back. `fresh`, `known`: what was left a sample ago; that sign and
    the swings then. `dt`: [s]. `law`: computed torque, with its numbers.
    """
    (last, swings), size, sign = known, ca.fabs(seen), ca.sign(seen)
    least = _SWINGS - _QUIETER * law.dead_zone
    soon = ca.exp(dt * law.bandwidth / _WITHIN - 1)
    turned = ca.logic_and(size > least, last * sign < -soon)
    unexpected = ca.logic_and(size > least + _UNEXPECTED, last * sign > soon)
    swings = ca.if_else(turned, ca.fmin(2, swings + 1), swings * ca.exp(-dt / _REMEMBERED))
    last = ca.if_else(size > least, sign, last * ca.exp(-dt * law.bandwidth / _WITHIN))
    return (
        ca.if_else(ca.logic_or(begins, unexpected), 1, fresh * ca.exp(-dt / law.start_time)),
        last,
        swings,
    )
