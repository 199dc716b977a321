"""One sample of a running controller: checks of the inputs, guards, the law, and the safe stop.

The text of this module, and of `plant.realtime.memory`, `watching` and `stopping`, is compiled once
for all controllers (`plant.realtime.compiled_step`), so it is Python that numba can compile: arrays
and numbers, no objects, nothing allocated. The law, the amplifier's limit and all that crosses to
pulses are generated from casadi in place of `ahead`
... `limited` in `memory`, and called at the address in `PIECES`; each reads the vector `memory` and writes its results
there.

A controller runs, and bridges what lasts a moment, until a guard sets `CAUSE`. Then `RELEASED` says
which torque it gives: `HOLDING` that of the law on a braking reference, `RAMPING` one that goes to
its end without the law, `LATCHED` none. It goes from one to the next and never back: to the ramp
where there is nothing to hold by, to zero where either drives the arm.
"""

import numpy as np

from plant.realtime.memory import (
    ACTED,
    AT_LIMIT,
    BAD_LAW,
    BEFORE,
    BOUNDED,
    CALLS,
    CAUSE,
    COUNTS,
    DONE,
    DT,
    FILLED,
    FOLLOWED,
    FRESH,
    FROM_TORQUE,
    FULL,
    GIVEN,
    GUARDED,
    HELD,
    HELD_COUNTS,
    HELD_SPEED,
    HOLDING,
    HURRIED,
    IS_SATURATED,
    LATCHED,
    LEFT_OUT,
    LIMITED,
    MEAN,
    NOW,
    NO_TORQUE,
    OPPOSES,
    OVER,
    PASSED,
    PATIENCE,
    PERIOD,
    PLANNED,
    RAMPING,
    RATE,
    RATED,
    REFERENCE,
    RELEASED,
    ROWS,
    RUNNING,
    SCALARS,
    SINCE,
    SPEED,
    STATES,
    SWING,
    TOO_STEEP,
    TORQUE,
    WANTED,
    counted,
    law,
    left_out,
    limited,
    monitored,
    moving,
    planned,
    ramp,
    shifted,
    slowing,
)
from plant.realtime.stopping import (
    begin_stop,
    bridge,
    copy,
    limit_time,
    opposed,
    release,
    rising,
    stop,
    take_state,
)
from plant.realtime.watching import bounded, follow, in_time, read, refused, watch

# Time [s] and calls, at least and at most twice as many, for which a torque at its limit pushes one
# way, and pulses that the joint has moved the other way meanwhile.
OPPOSED = 0.004
OPPOSED_CALLS = 8.0
OPPOSED_COUNTS = 8.0

# Pulses from its reference within which a joint follows it, and over which it then has proved its
# encoder.
NEAR = 10.0
FAR_ENOUGH = 100.0


def step(pulses, q_r, qd_r, qdd_r, now, memory, torque):
    """One sample: torque (n,) [N m], less what firmware adds; `now` [s] is NaN without a clock."""
    n = torque.shape[0]
    own = memory[:SCALARS]
    joints = memory[SCALARS : SCALARS + ROWS * n].reshape(ROWS, n)
    refusal = refused(pulses, q_r, qd_r, qdd_r, now, own)
    if refusal != DONE:
        return refusal
    first = own[CALLS] == 0.0
    earlier = own[NOW]
    own[CALLS] += 1.0
    in_time(now, own)
    if own[CAUSE] == RUNNING or own[SINCE] < 0.0:
        follow(first, q_r, qd_r, qdd_r, own, joints, memory)
    if first:
        moving(memory)
    read(pulses, first, own, joints, memory)
    if own[CAUSE] == RUNNING:
        counted(memory)
        watch(first or own[FRESH] == 1.0, own, joints, memory)
        own[FRESH] = 1.0 if first else 0.0  # of the first torque nothing is known
        if own[GUARDED] == 1.0:
            opposing(own, joints, memory)
        if own[BOUNDED] == 1.0:
            bounded(own, joints, memory)
    elif own[RELEASED] == HOLDING and own[SINCE] >= 0.0:
        watch(own[FRESH] == 1.0, own, joints, memory)
        own[FRESH] = 0.0
    if own[CAUSE] != RUNNING:
        if own[SINCE] < 0.0:
            begin_stop(own, joints, memory)
        else:
            own[SINCE] += own[DT]
        if own[RELEASED] == HOLDING:
            slowing(memory)
        counted(memory)
        rising(own, joints, memory)
    if own[RELEASED] == HOLDING:
        own[DT] = min(own[DT], own[HURRIED] * own[PERIOD])
        law(memory)
        if finite(own, joints, memory):
            steep(first, own, joints)
            copy(GIVEN, TORQUE, joints)
            take_state(2, own, joints, memory)
            rate(own, joints, memory)
        elif own[GUARDED] == 0.0:
            copy(BEFORE, COUNTS, joints)
            own[NOW] = earlier
            return BAD_LAW
        else:
            stop(NO_TORQUE, 0, 0.0, own)
            release(own, joints)
    if own[RELEASED] == RAMPING:
        ramp(memory)
    if own[CAUSE] != RUNNING:
        limit_time(own, joints, memory)
    left_out(memory)
    for i in range(n):
        if own[RELEASED] == LATCHED:
            joints[TORQUE, i] = 0.0
        joints[ACTED, i] = joints[TORQUE, i]
        torque[i] = joints[TORQUE, i] - joints[LEFT_OUT, i]
    return DONE


def finite(own, joints, memory):
    """Whether the commanded torque, and the state that would follow, are finite."""
    total = 0.0
    states = int(own[STATES])
    start = SCALARS + ROWS * joints.shape[1] + 2 * states
    for i in range(joints.shape[1]):
        total += abs(joints[WANTED, i])
    for i in range(start, start + states):
        total += abs(memory[i])
    return total < np.inf


def steep(first, own, joints):
    """Guard of the torque's rate: a torque that changes faster is given part of the way, and
    stops if this goes on.
    """
    share = 1.0
    joint = -1
    for i in range(joints.shape[1]):
        change = abs(joints[GIVEN, i] - joints[ACTED, i])
        if not first and joints[RATE, i] * own[DT] < share * change:
            share = joints[RATE, i] * own[DT] / change
            joint = i
    if joint < 0:
        own[RATED] = 0.0
        return
    own[RATED] += 1.0
    bridge(
        TOO_STEEP,
        joint,
        (joints[GIVEN, joint] - joints[ACTED, joint]) / own[DT],
        own[RATED] > own[PATIENCE],
        own,
    )
    for i in range(joints.shape[1]):
        joints[GIVEN, i] = joints[ACTED, i] + share * (joints[GIVEN, i] - joints[ACTED, i])


def rate(own, joints, memory):
    """Guards of the torque: a loop that saturates or oscillates holds nothing, so its mean
    torque ramps to its end.
    """
    if own[GUARDED] == 1.0 and own[PASSED] > 0.0:
        monitored(memory)
    if own[FILLED] >= own[FULL]:
        shifted(memory)
    for i in range(joints.shape[1]):
        if own[RELEASED] == HOLDING and joints[OVER, i] != RUNNING:
            first = own[CAUSE] == RUNNING
            stop(
                joints[OVER, i],
                i,
                joints[AT_LIMIT if joints[OVER, i] == IS_SATURATED else SWING, i],
                own,
            )
            release(own, joints)
            copy(MEAN, FROM_TORQUE, joints)
            if first:
                opposed(own, joints, memory)


def opposing(own, joints, memory):
    """Guard of a joint that moves against its torque: its encoder is reversed, or another joint's.

    A torque at its limit accelerates the joint its way, whatever it bears; a joint that it brakes
    becomes slower. One that has followed its reference counts its own motion: then the load is too
    heavy, or the amplifier too weak.
    """
    least = max(OPPOSED, OPPOSED_CALLS * own[PERIOD])
    limited(memory)
    planned(memory)
    for i in range(joints.shape[1]):
        follows = abs(joints[REFERENCE, i] - joints[COUNTS, i]) <= NEAR
        if joints[FOLLOWED, i] < FAR_ENOUGH:
            joints[FOLLOWED, i] = (
                joints[FOLLOWED, i] + abs(joints[PLANNED, i]) * own[DT] if follows else 0.0
            )
        side = joints[LIMITED, i]
        held = abs(joints[HELD, i])
        if side * joints[HELD, i] <= 0.0 or held > 2.0 * least:
            joints[HELD, i], joints[HELD_COUNTS, i], joints[HELD_SPEED, i] = (
                0.0,
                joints[COUNTS, i],
                joints[SPEED, i],
            )
        joints[HELD, i] += side * own[DT]
        held = abs(joints[HELD, i])
        moved = joints[COUNTS, i] - joints[HELD_COUNTS, i] - joints[HELD_SPEED, i] * held
        if held > least and side * moved < -OPPOSED_COUNTS and joints[FOLLOWED, i] < FAR_ENOUGH:
            stop(OPPOSES, i, moved, own)
