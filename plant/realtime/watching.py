"""Guards of a running controller's inputs: clock, reference, counts, and what the counts say about
the arm.

The text of this module is compiled with that of `plant.realtime.safety`.
"""

import numpy as np

from plant.realtime.memory import (
    ANGLE,
    BAD_CLOCK,
    BAD_PULSES,
    BAD_REFERENCE,
    BAD_TIME,
    BEFORE,
    BEYOND,
    CALLS,
    CAUSE,
    CLOCKS,
    COUNTS,
    DONE,
    DT,
    ERROR,
    EXPECTED,
    FASTER,
    FRICTION,
    GAPS,
    GUARDED,
    HAD_GAPS,
    HAS_JUMPED,
    IS_DEAD,
    IS_OFF,
    IS_STUCK,
    JUMP,
    JUMPS,
    LATE,
    LATE_CALLS,
    LEAST_STEP,
    MARK,
    MARK_TORQUE,
    MEAN,
    MODELLED,
    NEEDED,
    NOW,
    NO_COUNTS,
    OFFSET,
    OFF_BEAT,
    OUTSIDE,
    PASSED,
    PATIENCE,
    PERIOD,
    PUSHED,
    Q,
    QD,
    QDD,
    RAW,
    REFERENCE,
    RELEASED,
    REST,
    REST_TORQUE,
    RHYTHM,
    ROUNDS,
    RUNNING,
    SAMPLED,
    SINCE,
    SLOWER,
    SPEED,
    STILL,
    STUCK,
    TOO_FAST,
    TORQUE,
    WAS_LATE,
    WAS_Q,
    WAS_QD,
    WAS_QDD,
    ahead,
    bounds,
    measured,
    needed,
)
from plant.realtime.stopping import bridge, release, stop

FAR = 1e5  # angle [rad] up to which the kernels' sines are exact to rounding

EXACT = 2.0**53  # counts up to which whole numbers are exact

GLITCH = 100.0  # periods between two calls above which a clock is not believed

REMEMBERED = 0.1  # weight of one sample in the mean rate of the reference

# rate of the reference, relative to its speed, that one sample may count as at most: steps happen
SUDDEN = 3.0

DEAD_TIME = 0.02  # time [s] for which a torque that friction cannot bear may act without a count

SETTLED = 0.03  # time [s] without a count after which the torque of a joint at rest has settled

MODEL_ERROR = 0.5  # share by which the model's change of torque may be wrong


def refused(pulses, q_r, qd_r, qdd_r, now, own):
    """Return code of a call that no guard can bridge: the first, or any without guards."""
    if own[GUARDED] == 1.0 and own[CALLS] > 0.0:
        return DONE
    for count in pulses:
        if not whole(count, own):
            return BAD_PULSES
    if own[GUARDED] == 0.0 and (now <= own[NOW] or abs(now) == np.inf):
        return BAD_CLOCK
    return DONE if usable(q_r, qd_r, qdd_r) else BAD_REFERENCE


def whole(count, own):
    """Whether a count is a number that an encoder can give."""
    return abs(count) <= EXACT and (count == np.floor(count) or own[ROUNDS] == 0.0)


def usable(q_r, qd_r, qdd_r):
    """Whether a reference is finite, and its angles small enough for the kernels' sines."""
    sound = True
    for i in range(len(q_r)):
        sound = sound and abs(q_r[i]) <= FAR and abs(qd_r[i]) < np.inf and abs(qdd_r[i]) < np.inf
    return sound


def in_time(now, own):
    """Guard of the clock; after a late call the law is given the time that really passed.

    A clock that stands, runs backwards or leaps counts as none in this call, and one period as
    passed.
    """
    elapsed = now - own[NOW]
    own[DT] = own[PERIOD]
    if own[GUARDED] == 1.0 and (
        elapsed <= 0.0 or elapsed > GLITCH * own[PERIOD] or abs(now) == np.inf
    ):
        own[CLOCKS] += 1.0
        own[NOW] += own[SAMPLED] * own[PERIOD]
        own[PASSED] = own[SAMPLED] * own[PERIOD]
        bridge(BAD_TIME, 0, elapsed, own[CLOCKS] > own[PATIENCE], own)
        return
    over = elapsed / own[PERIOD] - 1.0 - own[LATE]
    own[NOW], own[CLOCKS] = now, 0.0
    if over > 0.0:
        own[DT] = elapsed
        own[LATE_CALLS] += np.ceil(over)
        bridge(WAS_LATE, 0, elapsed - own[PERIOD], own[LATE_CALLS] > own[PATIENCE], own)
    else:
        own[LATE_CALLS] = 0.0
    # how often a law without a period is called: the clock
    own[PASSED] = own[DT] if own[SAMPLED] == 1.0 else elapsed


def follow(first, q_r, qd_r, qdd_r, own, joints, memory):
    """Guard of the reference: one that cannot be used is extrapolated from the last that could."""
    if usable(q_r, qd_r, qdd_r):
        own[GAPS] = 0.0
        if own[SAMPLED] == 1.0 and not first:
            beat(q_r, qd_r, own, joints)
        for i in range(len(q_r)):
            joints[Q, i], joints[QD, i], joints[QDD, i] = q_r[i], qd_r[i], qdd_r[i]
    else:
        own[GAPS] += 1.0
        ahead(memory)
        bridge(HAD_GAPS, 0, own[GAPS], own[GAPS] > own[PATIENCE], own)


def beat(q_r, qd_r, own, joints):
    """Guard of lost and doubled calls: a reference of time then moves faster or slower than its
    speed says.
    """
    most = 1.0
    rate = 0.0
    for i in range(len(q_r)):
        due = 0.5 * (joints[QD, i] + qd_r[i]) * own[DT]
        if abs(due) > most * joints[LEAST_STEP, i]:
            most = abs(due) / joints[LEAST_STEP, i]
            rate = (q_r[i] - joints[Q, i]) / due
    if most > 1.0:
        own[RHYTHM] += REMEMBERED * (min(max(rate, -SUDDEN), SUDDEN) - own[RHYTHM])
        if own[RHYTHM] < own[SLOWER] or own[RHYTHM] > own[FASTER]:
            stop(OFF_BEAT, 0, own[RHYTHM], own)


def read(pulses, first, own, joints, memory):
    """Guard of the counts: one with too large an innovation is replaced by its prediction, unless
    this goes on.

    So is one that is no number; that it goes on leaves nothing to hold by. A counter that has
    jumped for good has lost counts, which no arm can have made: they are taken off, so that a stop
    goes on where the arm is. One that stands still where it has jumped to may be dead: there is no
    hold by it.
    """
    dt = own[DT]
    joint = -1
    largest = 0.0
    missing = False
    dumb = False
    for i in range(len(pulses)):
        joints[BEFORE, i] = joints[COUNTS, i]
        predicted = joints[COUNTS, i] + joints[SPEED, i] * dt
        innovation = pulses[i] - joints[OFFSET, i] - predicted
        joints[EXPECTED, i] = pulses[i] - joints[OFFSET, i]
        if not whole(pulses[i], own):
            joints[EXPECTED, i] = np.floor(predicted + 0.5)
            joint, largest, missing = (joint, largest, missing) if missing else (i, 0.0, True)
        elif not first and abs(innovation) > joints[JUMP, i] + abs(joints[SPEED, i]) * dt:
            joints[EXPECTED, i] = np.floor(predicted + 0.5)
            dumb = dumb or pulses[i] == joints[RAW, i]
            if not missing and abs(innovation) > abs(largest):
                joint = i
                largest = innovation
        joints[RAW, i] = pulses[i]
    own[JUMPS] = own[JUMPS] + 1.0 if joint >= 0 else 0.0
    lost = own[JUMPS] > own[PATIENCE]
    if joint >= 0:
        if lost and own[CAUSE] != RUNNING:
            release(own, joints)  # a stop without feedback
        bridge(NO_COUNTS if missing else HAS_JUMPED, joint, largest, lost, own)
        if lost and dumb:
            release(own, joints)
    for i in range(len(pulses)):
        if lost and whole(pulses[i], own):
            joints[OFFSET, i] = pulses[i] - joints[EXPECTED, i]
        joints[COUNTS, i] = joints[EXPECTED, i]
        joints[SPEED, i] *= 1.0 - min(own[RELEASED], 1.0) if lost else 1.0  # unknown from here on
    if not (lost or first):
        measured(memory)


def watch(first, own, joints, memory):
    """Guards of the tracking error, and of an encoder that stands still; in a hold of the second
    alone.

    Static friction holds a joint while the torque stays within a band of twice its level. Once the
    torque has left that band since the counts last changed, the joint must have moved, if its
    reference has.
    """
    for i in range(joints.shape[1]):
        error = joints[REFERENCE, i] - joints[COUNTS, i]
        if own[CAUSE] == RUNNING and abs(error) > joints[ERROR, i]:
            stop(IS_OFF, i, error, own)
        asked = joints[REFERENCE, i] - joints[MARK, i]
        pushed = joints[TORQUE, i] - joints[MARK_TORQUE, i]
        if first or joints[COUNTS, i] != joints[BEFORE, i]:
            joints[MARK, i], joints[MARK_TORQUE, i] = joints[REFERENCE, i], joints[TORQUE, i]
            joints[STILL, i] = joints[PUSHED, i] = 0.0
            continue
        settled = joints[STILL, i] >= SETTLED
        overdue = abs(asked) > joints[STUCK, i] and abs(pushed) > joints[FRICTION, i]
        if overdue and stands(i, settled, own, joints, memory):
            lose(IS_STUCK, i, asked, own, joints)
        joints[STILL, i] += own[DT]
        if settled:
            rest(i, own, joints, memory)
        elif joints[STILL, i] >= SETTLED:
            joints[REST_TORQUE, i] = joints[MEAN, i]
            remember(i, joints, memory)


def stands(joint, settled, own, joints, memory):
    """Whether a joint that should move must have: its torque may also be what holds it while the
    others move.
    """
    if not settled or own[MODELLED] == 0.0:
        return True
    return unborne(joint, joints[MEAN, joint] - joints[REST_TORQUE, joint], own, joints, memory)


def rest(joint, own, joints, memory):
    """Guard of an encoder that is dead at rest, whatever its reference does.

    The mean torque must stay within the band of friction about where it settled, or the counts
    change within `DEAD_TIME`, unless what the other joints do needs the torque.
    """
    pushed = joints[MEAN, joint] - joints[REST_TORQUE, joint]
    if abs(pushed) > joints[REST, joint] and unborne(joint, pushed, own, joints, memory):
        joints[PUSHED, joint] += own[DT]
        if joints[PUSHED, joint] > DEAD_TIME:
            lose(IS_DEAD, joint, pushed, own, joints)
    else:
        joints[PUSHED, joint] = 0.0


def remember(joint, joints, memory):
    """Keep the reference of all joints where one came to rest."""
    n = joints.shape[1]
    start = len(memory) - 3 * n * n + 3 * n * joint
    for i in range(n):
        memory[start + i], memory[start + n + i] = joints[Q, i], joints[QD, i]
        memory[start + 2 * n + i] = joints[QDD, i]


def unborne(joint, pushed, own, joints, memory):
    """Whether neither friction nor the motion of the other joints explains a change of torque."""
    n = joints.shape[1]
    alike = True
    start = len(memory) - 3 * n * n + 3 * n * joint
    for i in range(n):
        joints[WAS_Q, i], joints[WAS_QD, i] = memory[start + i], memory[start + n + i]
        joints[WAS_QDD, i] = memory[start + 2 * n + i]
        alike = alike and abs(joints[WAS_Q, i] - joints[Q, i]) <= joints[LEAST_STEP, i]
    if own[MODELLED] == 0.0:
        return alike
    needed(memory)
    change = joints[NEEDED, joint]
    return abs(pushed - change) > joints[REST, joint] + MODEL_ERROR * abs(change)


def lose(cause, joint, amount, own, joints):
    """Stop for an encoder that stands still; a hold has nothing left to hold by."""
    if own[CAUSE] != RUNNING and own[SINCE] >= 0.0:
        release(own, joints)
    stop(cause, joint, amount, own)


def bounded(own, joints, memory):
    """Guards of joint position and speed."""
    bounds(memory)
    for i in range(joints.shape[1]):
        if joints[BEYOND, i] == 1.0:
            stop(OUTSIDE, i, joints[ANGLE, i], own)
        elif joints[BEYOND, i] == 2.0:
            stop(TOO_FAST, i, joints[SPEED, i], own)
