"""How a running controller stops: a hold under the law, a ramp without it, and zero torque if
either drives the arm.

The text of this module is compiled with that of `plant.realtime.safety`.
"""

import math

from plant.realtime.memory import (
    AT_MOST,
    BAD_TIME,
    BEGUN,
    BRIDGED,
    CALLS,
    CAUSE,
    COUNTS,
    DRIVES,
    DT,
    EVENT,
    EVENT_AMOUNT,
    EVENT_CALL,
    EVENT_JOINT,
    FASTER,
    FRESH,
    FROM_Q,
    FROM_QD,
    FROM_TORQUE,
    HAD_GAPS,
    HOLDING,
    IS_DEAD,
    IS_OFF,
    IS_STUCK,
    JUMPS,
    LATCH,
    LATCHED,
    LATCH_JOINT,
    LEAST_STEP,
    LIMITED,
    LIMIT_TIME,
    NO_COUNTS,
    OFF_BEAT,
    OPPOSES,
    PLANNED,
    PUSHES,
    Q,
    QD,
    RAMPING,
    REFERENCE,
    RELEASED,
    RHYTHM,
    ROWS,
    RUNNING,
    RUNS,
    SCALARS,
    SINCE,
    SLACK,
    SPEED,
    STATES,
    STOP,
    TORQUE,
    WAS_LATE,
    WEIGHT,
    counted,
    limited,
    planned,
    standing,
)

# factor on the speed of the arm where a stop begins, or on that of its reference, that is no rise
GROWTH = 1.25

# share of the speed where a hold begins by which the arm may lag behind the reference of the hold
LAG = 0.5

# factor on `SLACK` in a ramp: a load that the model does not know sags, against the damping
SAGGING = 4.0

# factor on `SLACK` in a ramp to zero: an arm without gravity compensation falls, against the
# damping
FALLING = 8.0


def bridge(cause, joint, amount, too_often, own):
    """Note a bridged sample, or stop after too many in a row."""
    if too_often:
        stop(cause, joint, amount, own)
    elif own[CAUSE] == RUNNING:
        own[BRIDGED] += 1.0
        note(cause, joint, amount, own)


def note(cause, joint, amount, own):
    """Keep what the status says."""
    own[EVENT], own[EVENT_JOINT], own[EVENT_AMOUNT], own[EVENT_CALL] = (
        cause,
        joint,
        amount,
        own[CALLS],
    )


def stop(cause, joint, amount, own):
    """Stop, for the first cause that comes."""
    if own[CAUSE] == RUNNING:
        own[CAUSE], own[SINCE] = cause, -1.0
        note(cause, joint, amount, own)


def begin_stop(own, joints, memory):
    """Begin a stop: from the reference if the arm tracks it, otherwise from the measured motion
    with a reset law.
    """
    cause = own[CAUSE]
    elsewhere = own[CAUSE] == IS_OFF and own[CALLS] == 1.0
    for i in range(joints.shape[1]):
        # such a reference says nothing of the arm's motion
        joints[SPEED, i] *= 0.0 if elsewhere else 1.0
    begun(own, joints)
    own[SINCE] = own[JUMPS] = 0.0
    counted(memory)
    lost = cause == OFF_BEAT and own[RHYTHM] > own[FASTER]
    if cause == OPPOSES:
        latch(RUNS, int(own[EVENT_JOINT]), own)
    elif (
        own[STOP] != 0.0
        or own[RELEASED] != HOLDING
        or cause in (IS_STUCK, IS_DEAD, NO_COUNTS)
        or lost
    ):
        # a law that sees no motion would push on; one that is called too seldom, too
        release(own, joints)
    elif cause in (WAS_LATE, HAD_GAPS, BAD_TIME, OFF_BEAT):
        copy(Q, FROM_Q, joints)
        copy(QD, FROM_QD, joints)
        for i in range(joints.shape[1]):
            # the arm's, in the time that calls count
            joints[FROM_QD, i] *= own[RHYTHM] if cause == OFF_BEAT else 1.0
    else:
        if cause == IS_OFF and not elsewhere:
            running_away(own, joints, memory)
        standing(memory)
        for i in range(joints.shape[1]):
            joints[TORQUE, i] = 0.0
        take_state(0, own, joints, memory)


def begun(own, joints):
    """Keep how fast the arm is where a stop begins."""
    own[FRESH] = 1.0
    for i in range(joints.shape[1]):
        joints[BEGUN, i], joints[LIMIT_TIME, i] = abs(joints[SPEED, i]), 0.0


def release(own, joints):
    """From here on the torque ramps to its end, whatever the counts say."""
    if own[RELEASED] == HOLDING:
        if own[SINCE] < 0.0:
            begun(own, joints)
        own[RELEASED], own[SINCE] = RAMPING, 0.0
        copy(TORQUE, FROM_TORQUE, joints)


def latch(why, joint, own):
    """From here on there is no torque."""
    if own[RELEASED] != LATCHED:
        own[RELEASED], own[LATCH], own[LATCH_JOINT] = LATCHED, why, joint


def running_away(own, joints, memory):
    """Zero torque if a joint leaves its reference fast where the error stops the arm: the law
    drives it there.
    """
    planned(memory)
    for i in range(joints.shape[1]):
        leaving = joints[PLANNED, i] - joints[SPEED, i]
        if (
            leaving * (joints[REFERENCE, i] - joints[COUNTS, i]) > 0.0
            and abs(leaving) > joints[SLACK, i]
        ):
            latch(RUNS, i, own)


def opposed(own, joints, memory):
    """Zero torque if a joint goes, fast, where its torque does not push it: another joint's encoder
    or torque is its.

    A joint that only lags, because its torque is at the limit, goes the way of its reference. In a
    hold it may go on.
    """
    planned(memory)
    for i in range(joints.shape[1]):
        slack = GROWTH * abs(joints[PLANNED, i]) + joints[SLACK, i]
        error = joints[REFERENCE, i] - joints[COUNTS, i]
        if abs(joints[SPEED, i]) > slack and joints[SPEED, i] * error < 0.0:
            latch(RUNS, i, own)


def rising(own, joints, memory):
    """Zero torque once a joint is faster than a stop can make it: the stop drives it."""
    n = joints.shape[1]
    most = 0.0
    if own[RELEASED] == HOLDING:
        planned(memory)
    for i in range(n):
        most = max(most, joints[BEGUN, i] * joints[LEAST_STEP, i])
    for i in range(n):
        if own[RELEASED] == HOLDING:
            allowed = GROWTH * abs(joints[PLANNED, i]) + LAG * joints[BEGUN, i] + joints[SLACK, i]
        else:
            slack = joints[SLACK, i] * (SAGGING if own[WEIGHT] == 1.0 else FALLING)
            allowed = GROWTH * most / joints[LEAST_STEP, i] + slack
        if abs(joints[SPEED, i]) > allowed:
            latch(DRIVES, i, own)


def limit_time(own, joints, memory):
    """Zero torque once a joint's has been at its limit for too long since the stop began."""
    limited(memory)
    lasting = own[DT]
    if own[CAUSE] == OFF_BEAT:
        lasting *= math.ceil(own[RHYTHM])  # calls are lost in wholes
    for i in range(joints.shape[1]):
        joints[LIMIT_TIME, i] = abs(joints[LIMITED, i]) * lasting + joints[LIMIT_TIME, i]
        if joints[LIMIT_TIME, i] > own[AT_MOST]:
            latch(PUSHES, i, own)


def copy(source, target, joints):
    """Copy one row of numbers per joint to another."""
    for i in range(joints.shape[1]):
        joints[target, i] = joints[source, i]


def take_state(which, own, joints, memory):
    """Make the law's initial state (0) or the one that follows (2) its state (1)."""
    states = int(own[STATES])
    start = SCALARS + ROWS * joints.shape[1]
    for i in range(start, start + states):
        memory[i + states] = memory[i + which * states]
