"""One sample of a running controller: checks of the inputs, guards, the law, and the safe stop.

The text of this module is compiled once for all controllers (`plant.realtime.compiled_step`), so it is Python that
numba can compile: arrays and numbers, no objects, nothing allocated. The law, the amplifier's limit and all that
crosses to pulses are generated from casadi in place of `ahead` ... `ramp` below, and called at the address in `PIECES`;
each reads `memory` and writes its results there. `memory` is one vector: `SCALARS` numbers, `ROWS` rows of one number
per joint, then the law's initial state, its state, the state that follows, and its numbers.
"""

import numpy as np

__all__ = ["step"]

FAR = 1e5
"""Angle [rad] up to which the kernels' sines are exact to rounding."""

GUARDED, PATIENCE, LATE, PERIOD, STOP, DURATION, STATES = range(7)
CALLS, NOW, DT, LATE_CALLS, JUMPS, GAPS, CAUSE, SINCE, RELEASED = range(7, 16)
EVENT, EVENT_JOINT, EVENT_AMOUNT, EVENT_CALL, BRIDGED, WEIGHT = range(16, 22)
SAMPLED, PASSED, AGE, FILLED, FULL, LEAST, ROUNDS, PIECES, SCALARS = range(22, 31)

COUNTS, BEFORE, EXPECTED, SPEED, ANGLE, Q, QD, QDD, REFERENCE = range(9)
WANTED, GIVEN, TORQUE, FROM_Q, FROM_QD, FROM_TORQUE, MARK, MARK_TORQUE = range(9, 17)
JUMP, STUCK, ERROR, FRICTION, SATURATION, CHATTER = range(17, 23)
RUN, AT_LIMIT, MEAN, SWING, OVER, NEWEST, OLDER, ROWS = *range(23, 30), 34

DONE, BAD_PULSES, BAD_REFERENCE, BAD_CLOCK, BAD_LAW = range(5)
"""Return codes of a step; unless it is DONE, nothing has changed."""

RUNNING, WAS_LATE, HAD_GAPS, HAS_JUMPED, IS_STUCK, IS_OFF, NO_TORQUE, IS_SATURATED, CHATTERS = range(9)
"""Causes of a stop, and of a bridged sample."""

PATIENT = (HAD_GAPS, HAS_JUMPED)
"""Causes that were bridged `PATIENCE` times in a row before they stopped the arm."""

ahead = moving = measured = counted = standing = slowing = law = monitored = shifted = ramp = None
"""Generated: the reference one sample on; its speed in pulses; that of the counts; counts of the reference and angle of
the counts; the motion where a stop begins; its reference; the law; saturation and chatter of its torque; a new slot of
time; the torque of a stop without feedback."""


def step(pulses, q_r, qd_r, qdd_r, now, memory, torque):
    """One sample: torque (n,) [N m] from counts (n,) and reference (n,) each; `now` [s] is NaN without a clock."""
    n, own = torque.shape[0], memory[:SCALARS]
    joints = memory[SCALARS : SCALARS + ROWS * n].reshape(ROWS, n)
    refusal = refused(pulses, q_r, qd_r, qdd_r, now, own)
    if refusal != DONE:
        return refusal
    first, earlier = own[CALLS] == 0.0, own[NOW]
    own[CALLS] += 1.0
    in_time(now, own)
    if own[CAUSE] == RUNNING or own[SINCE] < 0.0:
        follow(q_r, qd_r, qdd_r, own, joints, memory)
    if first:
        moving(memory)
    read(pulses, first, own, joints, memory)
    if own[CAUSE] == RUNNING:
        counted(memory)
        watch(first, own, joints)
    if own[CAUSE] != RUNNING:
        if own[SINCE] < 0.0:
            begin_stop(own, joints, memory)
        else:
            own[SINCE] += own[DT]
        if own[RELEASED] == 0.0:
            slowing(memory)
        counted(memory)
    if own[RELEASED] == 0.0:
        law(memory)
        if finite(own, joints, memory):
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
    if own[RELEASED] == 1.0:
        ramp(memory)
    torque[:] = joints[TORQUE]
    return DONE


def refused(pulses, q_r, qd_r, qdd_r, now, own):
    """Return code of a call that no guard can bridge."""
    for count in pulses:
        if not (abs(count) < np.inf and (count == np.floor(count) or own[ROUNDS] == 0.0)):
            return BAD_PULSES
    if now <= own[NOW] or abs(now) == np.inf:
        return BAD_CLOCK
    mendable = own[GUARDED] == 1.0 and own[CALLS] > 0.0
    return BAD_REFERENCE if not mendable and own[CAUSE] == RUNNING and not usable(q_r, qd_r, qdd_r) else DONE


def usable(q_r, qd_r, qdd_r):
    """Whether a reference is finite, and its angles small enough for the kernels' sines."""
    sound = True
    for i in range(len(q_r)):
        sound = sound and abs(q_r[i]) <= FAR and abs(qd_r[i]) < np.inf and abs(qdd_r[i]) < np.inf
    return sound


def in_time(now, own):
    """Guard of the clock; after a late call the law is given the time that really passed."""
    elapsed = now - own[NOW]
    over = elapsed / own[PERIOD] - 1.0 - own[LATE]
    own[NOW], own[DT] = now, own[PERIOD]
    if over > 0.0:
        own[DT] = elapsed
        own[LATE_CALLS] += np.ceil(over)
        bridge(WAS_LATE, 0, elapsed - own[PERIOD], own[LATE_CALLS] > own[PATIENCE], own)
    else:
        own[LATE_CALLS] = 0.0
    own[PASSED] = own[DT] if own[SAMPLED] == 1.0 else elapsed  # how often a law without a period is called: the clock


def follow(q_r, qd_r, qdd_r, own, joints, memory):
    """Guard of the reference: one that cannot be used is extrapolated from the last that could."""
    if usable(q_r, qd_r, qdd_r):
        own[GAPS] = 0.0
        for i in range(len(q_r)):
            joints[Q, i], joints[QD, i], joints[QDD, i] = q_r[i], qd_r[i], qdd_r[i]
    else:
        own[GAPS] += 1.0
        ahead(memory)
        bridge(HAD_GAPS, 0, own[GAPS], own[GAPS] > own[PATIENCE], own)


def read(pulses, first, own, joints, memory):
    """Guard of the counts: one with too large an innovation is replaced by its prediction, unless this goes on."""
    dt, joint, largest = own[DT], -1, 0.0
    for i in range(len(pulses)):
        joints[BEFORE, i] = joints[COUNTS, i]
        predicted = joints[COUNTS, i] + joints[SPEED, i] * dt
        innovation = pulses[i] - predicted
        joints[EXPECTED, i] = pulses[i]
        if not first and abs(innovation) > joints[JUMP, i] + abs(joints[SPEED, i]) * dt:
            joints[EXPECTED, i] = np.floor(predicted + 0.5)
            if abs(innovation) > abs(largest):
                joint, largest = i, innovation
    own[JUMPS] = own[JUMPS] + 1.0 if joint >= 0 else 0.0
    lost = own[JUMPS] > own[PATIENCE]
    if joint >= 0:
        if lost and own[CAUSE] != RUNNING:
            release(own, joints)  # a stop without feedback
        bridge(HAS_JUMPED, joint, largest, lost, own)
    for i in range(len(pulses)):
        joints[COUNTS, i] = pulses[i] if lost else joints[EXPECTED, i]
        joints[SPEED, i] *= 1.0 - own[RELEASED] if lost else 1.0  # unknown from here on
    if not (lost or first):
        measured(memory)


def watch(first, own, joints):
    """Guards of the tracking error, and of an encoder that stands still.

    Static friction holds a joint while the torque stays within a band of twice its level. Once the torque has left that
    band since the counts last changed, the joint must have moved.
    """
    for i in range(joints.shape[1]):
        error = joints[REFERENCE, i] - joints[COUNTS, i]
        if abs(error) > joints[ERROR, i]:
            stop(IS_OFF, i, error, own)
        asked, pushed = joints[REFERENCE, i] - joints[MARK, i], joints[TORQUE, i] - joints[MARK_TORQUE, i]
        if first or joints[COUNTS, i] != joints[BEFORE, i]:
            joints[MARK, i], joints[MARK_TORQUE, i] = joints[REFERENCE, i], joints[TORQUE, i]
        elif abs(asked) > joints[STUCK, i] and abs(pushed) > joints[FRICTION, i]:
            stop(IS_STUCK, i, asked, own)


def rate(own, joints, memory):
    """Guards of the torque: a loop that saturates or oscillates holds nothing, so its mean torque ramps to its end."""
    if own[GUARDED] == 1.0 and own[PASSED] > 0.0:
        monitored(memory)
    if own[FILLED] >= own[FULL]:
        shifted(memory)
    for i in range(joints.shape[1]):
        if own[RELEASED] == 0.0 and joints[OVER, i] != RUNNING:
            stop(joints[OVER, i], i, joints[AT_LIMIT if joints[OVER, i] == IS_SATURATED else SWING, i], own)
            release(own, joints)
            copy(MEAN, FROM_TORQUE, joints)


def bridge(cause, joint, amount, too_often, own):
    """Note a bridged sample, or stop after too many in a row."""
    if too_often:
        stop(cause, joint, amount, own)
    elif own[CAUSE] == RUNNING:
        own[BRIDGED] += 1.0
        note(cause, joint, amount, own)


def note(cause, joint, amount, own):
    own[EVENT], own[EVENT_JOINT], own[EVENT_AMOUNT], own[EVENT_CALL] = cause, joint, amount, own[CALLS]


def stop(cause, joint, amount, own):
    """Stop, for the first cause that comes."""
    if own[CAUSE] == RUNNING:
        own[CAUSE], own[SINCE] = cause, -1.0
        note(cause, joint, amount, own)


def begin_stop(own, joints, memory):
    """Begin a stop: from the reference if the arm tracks it, otherwise from the measured motion with a reset law."""
    own[SINCE] = own[JUMPS] = 0.0
    counted(memory)
    if own[STOP] != 0.0 or own[CAUSE] == IS_STUCK:  # a law that sees no motion would push on
        release(own, joints)
    elif own[CAUSE] == WAS_LATE or own[CAUSE] == HAD_GAPS:
        copy(Q, FROM_Q, joints)
        copy(QD, FROM_QD, joints)
    else:
        standing(memory)
        joints[TORQUE, :] = 0.0
        take_state(0, own, joints, memory)


def release(own, joints):
    """From here on the torque ramps to its end, whatever the counts say."""
    if own[RELEASED] == 0.0:
        own[RELEASED], own[SINCE] = 1.0, 0.0
        copy(TORQUE, FROM_TORQUE, joints)


def finite(own, joints, memory):
    """Whether the commanded torque, and the state that would follow, are finite."""
    total, states = 0.0, int(own[STATES])
    start = SCALARS + ROWS * joints.shape[1] + 2 * states
    for i in range(joints.shape[1]):
        total += abs(joints[WANTED, i])
    for i in range(start, start + states):
        total += abs(memory[i])
    return total < np.inf


def copy(source, target, joints):
    for i in range(joints.shape[1]):
        joints[target, i] = joints[source, i]


def take_state(which, own, joints, memory):
    """Make the law's initial state (0) or the one that follows (2) its state (1)."""
    states = int(own[STATES])
    start = SCALARS + ROWS * joints.shape[1]
    for i in range(start, start + states):
        memory[i + states] = memory[i + which * states]
