"""Safe stop of a running controller: a hold under the law, a ramp without it, or zero torque.

`plant.realtime.safety` calls these functions; numba compiles them, and
`plant.realtime.c_running` translates them.
"""

import math

from plant.compiler import in_kernel, inlined
from plant.realtime.calls import counted, limited, planned, standing
from plant.realtime.memory import (
    BAD_TIME,
    DRIVES,
    HAD_GAPS,
    HOLDING,
    IS_DEAD,
    IS_OFF,
    IS_STUCK,
    LATCHED,
    NO_COUNTS,
    OFF_BEAT,
    OPPOSES,
    PUSHES,
    RAMPING,
    RUNNING,
    RUNS,
    WAS_LATE,
)

# Factor on the speed of the arm where a stop begins, or on that of its reference, that is no rise.
GROWTH = 1.25

# Share of the speed where a hold begins by which the arm may lag behind the reference of the hold.
LAG = 0.5

# Factor on `slack` in a ramp: a load that the model does not know sags against the damping.
SAGGING = 4.0

# Factor on `slack` in a ramp to zero: an arm without gravity compensation falls against the
# damping.
FALLING = 8.0


@in_kernel
def note(cause, i, amount, run):
    """Store an event of joint i for the status."""
    run.event = cause
    run.event_joint = i
    run.event_amount = amount
    run.event_call = run.calls


@in_kernel
def stop(cause, i, amount, run):
    """Stop the arm for joint i; only the first cause counts."""
    if run.cause == RUNNING:
        run.cause = cause
        # The stop begins within this sample, after all guards of the inputs.
        run.since = -1.0
        note(cause, i, amount, run)


@in_kernel
def bridge(cause, i, amount, too_often, run):
    """Note a bridged sample, or stop after too many in a row."""
    if too_often:
        stop(cause, i, amount, run)
    elif run.cause == RUNNING:
        # A stop keeps its cause as the last event.
        run.bridged += 1.0
        note(cause, i, amount, run)


@in_kernel
def begun(memory):
    """Store the speed of the arm where a stop begins."""
    # No torque of the stop has acted yet: the guard of still encoders marks anew.
    memory.run.unmarked = 1.0
    for joint in memory.joints:
        joint.begin_speed = abs(joint.speed)
        joint.limit_time = 0.0


@in_kernel
def release(memory):
    """Replace the torque of the law by a ramp to the end of the stop, without feedback."""
    run = memory.run
    if run.released == HOLDING:
        # A stop that begins as a ramp has not stored the speeds of the arm.
        if run.since < 0.0:
            begun(memory)
        run.released = RAMPING
        run.since = 0.0
        # Begin at the torque that acted last, so that it does not jump.
        for joint in memory.joints:
            joint.begin_torque = joint.torque


@in_kernel
def latch(reason, i, run):
    """Command zero torque until the next start."""
    # Only the first reason counts.
    if run.released != LATCHED:
        run.released = LATCHED
        run.latch = reason
        run.latch_joint = i


@inlined
def begin_stop(memory):
    """Begin a stop: from the reference if the arm tracks it, else from the measured motion.

    From the measured motion, the law begins anew in its initial state.
    """
    run = memory.run
    cause = run.cause
    # A first reference away from the arm says nothing about the arm's motion.
    elsewhere = cause == IS_OFF and run.calls == 1.0
    for joint in memory.joints:
        joint.speed *= 0.0 if elsewhere else 1.0
    begun(memory)
    run.since = 0.0
    run.jumps = 0.0
    counted(memory)
    # The reference moves faster than its speed states where calls were lost.
    lost = cause == OFF_BEAT and run.rhythm > run.fastest_rhythm
    # Counts that run against the torque make a hold drive the arm, and the damping of a ramp, too.
    if cause == OPPOSES:
        latch(RUNS, int(run.event_joint), run)
    elif (
        run.no_hold != 0.0
        or run.released != HOLDING
        or cause in (IS_STUCK, IS_DEAD, NO_COUNTS)
        or lost
    ):
        # Without counts, or with too few calls, a law would push on: no hold.
        release(memory)
    elif cause in (WAS_LATE, HAD_GAPS, BAD_TIME, OFF_BEAT):
        # The arm tracks its reference here; the law goes on with its state.
        for joint in memory.joints:
            joint.begin_q = joint.q
            joint.begin_qd = joint.qd
            # Doubled calls: the arm moves at this share of the speed that the reference states.
            joint.begin_qd *= run.rhythm if cause == OFF_BEAT else 1.0
    else:
        # The arm does not track its reference: brake from the motion that the counts show.
        if cause == IS_OFF and not elsewhere:
            running_away(memory)
        standing(memory)
        for joint in memory.joints:
            joint.torque = 0.0
        for i in range(len(memory.state)):
            memory.state[i] = memory.initial[i]


@inlined
def running_away(memory):
    """Command zero torque if a joint leaves its reference fast where the error stops the arm.

    Then the law itself drives the joint away, and a hold under the law would go on doing so.
    """
    planned(memory)
    for i, joint in enumerate(memory.joints):
        # The error grows where its rate and the error have the same sign.
        leaving = joint.reference_speed - joint.speed
        if leaving * (joint.reference - joint.counts) > 0.0 and abs(leaving) > joint.slack:
            latch(RUNS, i, memory.run)


@inlined
def opposed(memory):
    """Command zero torque if a joint moves fast against the direction of its torque.

    Then its encoder or its torque belongs to another joint. A joint that only lags, because its
    torque is at the limit, moves in the direction of its reference and may go on in a hold.
    """
    planned(memory)
    for i, joint in enumerate(memory.joints):
        allowed = GROWTH * abs(joint.reference_speed) + joint.slack
        error = joint.reference - joint.counts
        if abs(joint.speed) > allowed and joint.speed * error < 0.0:
            latch(RUNS, i, memory.run)


@inlined
def rising(memory):
    """Command zero torque once a joint is faster than a stop can make it: the stop drives it."""
    run = memory.run
    largest = 0.0
    if run.released == HOLDING:
        planned(memory)
    # Without feedback, the motion of one joint can turn into that of another: compare angles.
    for joint in memory.joints:
        largest = max(largest, joint.begin_speed * joint.pulse)
    for i, joint in enumerate(memory.joints):
        # A hold moves as its reference does, and may lag behind it.
        if run.released == HOLDING:
            allowed = GROWTH * abs(joint.reference_speed) + LAG * joint.begin_speed + joint.slack
        else:
            slack = joint.slack * (SAGGING if run.weight == 1.0 else FALLING)
            allowed = GROWTH * largest / joint.pulse + slack
        if abs(joint.speed) > allowed:
            latch(DRIVES, i, run)


@inlined
def limit_time(memory):
    """Command zero torque once a joint has been at its torque limit for too long in a stop."""
    run = memory.run
    limited(memory)
    duration = run.dt
    if run.cause == OFF_BEAT:
        # Calls were lost, in whole numbers: each call stands for several periods.
        duration *= math.ceil(run.rhythm)
    for i, joint in enumerate(memory.joints):
        # `direction` is 0 for a torque within its limit.
        joint.limit_time = abs(joint.direction) * duration + joint.limit_time
        if joint.limit_time > run.braking:
            latch(PUSHES, i, run)
