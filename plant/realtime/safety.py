"""One sample of a running controller: checks of the inputs, guards, the law, and the safe stop.

The functions of this module, `watching` and `stopping` are compiled once for all controllers
(`plant.realtime.compiled_step`), so they are Python that numba can compile: numbers, arrays and
records, nothing allocated. `plant.realtime.c_running` translates the same text to C. The law, the
amplifier's limit and all conversions to pulses are generated from casadi, and called through
`plant.realtime.calls`.

A controller runs, and bridges what lasts a moment, until a guard sets `cause`. Then `released` says
which torque it gives: `HOLDING` that of the law on a braking reference, `RAMPING` one that ramps to
its end without the law, `LATCHED` none. It goes from one to the next and never back: to the ramp
where there is no feedback for a hold, to zero where either drives the arm.
"""

import numpy as np

from plant.compiler import inlined
from plant.realtime.calls import (
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
from plant.realtime.memory import (
    BAD_LAW,
    DONE,
    HOLDING,
    IS_SATURATED,
    LATCHED,
    NO_TORQUE,
    OPPOSES,
    RAMPING,
    RUNNING,
    TOO_STEEP,
)
from plant.realtime.stopping import begin_stop, bridge, limit_time, opposed, release, rising, stop
from plant.realtime.watching import bounded, follow, in_time, read, refused, watch

# A torque opposes the motion if, at its limit, it pushes one way for longer than this time [s] and
# this number of calls, while the joint moves the other way by more than this number of pulses.
# After twice that time the joint is judged anew.
OPPOSED = 0.004
OPPOSED_CALLS = 8.0
OPPOSED_COUNTS = 8.0

# A joint within this distance [pulses] of its reference follows it. Once it has done so over this
# path [pulses], its encoder is proved.
NEAR = 10.0
FAR_ENOUGH = 100.0


@inlined
def sample(pulses, q_r, qd_r, qdd_r, now, memory, torque):
    """One sample: torque (n,) [N m], less the torque that firmware adds; `now` [s] may be NaN."""
    run = memory.run

    # 1. Refuse a call that no guard can bridge, before anything changes.
    refusal = refused(pulses, q_r, qd_r, qdd_r, now, run)
    if refusal != DONE:
        return refusal
    starting = run.calls == 0.0
    # Without guards, a torque that is not finite undoes the call, its time included.
    earlier = run.now
    run.calls += 1.0

    # 2. Guard clock, reference and counts. From the second sample of a stop on, the reference is
    # that of the stop.
    in_time(now, run)
    if run.cause == RUNNING or run.since < 0.0:
        follow(starting, q_r, qd_r, qdd_r, memory)
    # Two counts are needed for a difference; until then the speed is that of the reference.
    if starting:
        moving(memory)
    read(pulses, starting, memory)

    # 3. Guard the arm: it must follow its reference and its torque.
    if run.cause == RUNNING:
        counted(memory)
        watch(starting or run.unmarked == 1.0, memory)
        # No torque has acted before the first sample: mark again in the second.
        run.unmarked = 1.0 if starting else 0.0
        if run.guarded == 1.0:
            opposing(memory)
        if run.bounded == 1.0:
            bounded(memory)
    # A hold needs its encoders as much as the path does.
    elif run.released == HOLDING and run.since >= 0.0:
        watch(run.unmarked == 1.0, memory)
        run.unmarked = 0.0

    # 4. Begin a stop, or go on with it.
    if run.cause != RUNNING:
        if run.since < 0.0:
            begin_stop(memory)
        else:
            run.since += run.dt
        if run.released == HOLDING:
            slowing(memory)
        # The reference is that of the stop now, and its counts must be, too.
        counted(memory)
        rising(memory)

    # 5. The torque of the law, unless the stop has released it, and the guards of this torque.
    if run.released == HOLDING:
        # After a late call, the law integrates over `longest_step` at most.
        run.dt = min(run.dt, run.longest_step * run.period)
        law(memory)
        if finite(memory):
            steep(starting, memory)
            for joint in memory.joints:
                joint.torque = joint.limited
            for i in range(len(memory.state)):
                memory.state[i] = memory.following[i]
            rate(memory)
        elif run.guarded == 0.0:
            # The caller decides: give counts and clock back, as torque and state have not changed.
            for joint in memory.joints:
                joint.counts = joint.previous_counts
            run.now = earlier
            return BAD_LAW
        else:
            stop(NO_TORQUE, 0, 0.0, run)
            release(memory)

    # 6. The torque of a stop without feedback, and its limit.
    if run.released == RAMPING:
        ramp(memory)
    if run.cause != RUNNING:
        limit_time(memory)

    # 7. Give the torque.
    left_out(memory)
    for i, joint in enumerate(memory.joints):
        # A servo holds this place once a stop lets go of the law.
        if run.released == HOLDING:
            joint.held_counts = joint.counts
        if run.released == LATCHED:
            joint.torque = 0.0
        joint.applied = joint.torque
        torque[i] = joint.torque - joint.left_out
    return DONE


@inlined
def finite(memory):
    """Whether the commanded torque, and the state that would follow, are finite."""
    # One sum tests all values: a NaN or an infinity stays in it, and neither is below infinity.
    total = 0.0
    for joint in memory.joints:
        total += abs(joint.commanded)
    for value in memory.following:
        total += abs(value)
    return total < np.inf


@inlined
def steep(starting, memory):
    """Guard of the torque's rate: a torque that changes too fast is given in part.

    All joints get the same share of their changes. If this goes on, the arm stops.
    """
    run = memory.run
    # The joint with the smallest share decides for all, so the change keeps its direction.
    share = 1.0
    worst = -1
    for i, joint in enumerate(memory.joints):
        change = abs(joint.limited - joint.applied)
        # In the first sample no torque has acted yet, from which a change could be taken.
        if not starting and joint.torque_rate * run.dt < share * change:
            share = joint.torque_rate * run.dt / change
            worst = i
    if worst < 0:
        run.steep = 0.0
        return
    run.steep += 1.0
    joint = memory.joints[worst]
    rate_of_change = (joint.limited - joint.applied) / run.dt
    bridge(TOO_STEEP, worst, rate_of_change, run.steep > run.patience, run)
    for joint in memory.joints:
        joint.limited = joint.applied + share * (joint.limited - joint.applied)


@inlined
def rate(memory):
    """Guards of the torque: a loop that saturates or oscillates holds nothing.

    So its mean torque ramps to its end.
    """
    run = memory.run
    # The means are weighted by the time that has passed; without any, nothing is averaged.
    if run.guarded == 1.0 and run.passed > 0.0:
        monitored(memory)
    if run.filled >= run.slot_length:
        shifted(memory)
    for i, joint in enumerate(memory.joints):
        # `over` holds the cause that the monitors have found, or `RUNNING`.
        if run.released == HOLDING and joint.over != RUNNING:
            at_work = run.cause == RUNNING
            amount = joint.limit_window if joint.over == IS_SATURATED else joint.swing
            stop(joint.over, i, amount, run)
            release(memory)
            # The last torque may be an extreme of the oscillation: ramp from the mean.
            for neighbour in memory.joints:
                neighbour.begin_torque = neighbour.mean_torque
            if at_work:
                opposed(memory)


@inlined
def opposing(memory):
    """Guard of a joint that moves against its torque: its encoder is reversed, or another joint's.

    A torque at its limit accelerates the joint in its direction, whatever it bears; a joint that it
    brakes becomes slower. A joint that has followed its reference counts its own motion: then the
    load is too heavy, or the amplifier too weak, and this guard is silent.
    """
    run = memory.run
    # Calls count as well as time, since a slow law has few samples within `OPPOSED`.
    shortest = max(OPPOSED, OPPOSED_CALLS * run.period)
    limited(memory)
    planned(memory)
    for i, joint in enumerate(memory.joints):
        follows = abs(joint.reference - joint.counts) <= NEAR
        # The proof is lost where the joint leaves its reference, and final once its path suffices.
        if joint.followed < FAR_ENOUGH:
            joint.followed = (
                joint.followed + abs(joint.reference_speed) * run.dt if follows else 0.0
            )
        direction = joint.direction
        duration = abs(joint.limit_push)
        if direction * joint.limit_push <= 0.0 or duration > 2.0 * shortest:
            # The torque left its limit, turned, or has been judged: begin anew.
            joint.limit_push = 0.0
            joint.limit_counts = joint.counts
            joint.limit_speed = joint.speed
        joint.limit_push += direction * run.dt
        duration = abs(joint.limit_push)
        # Motion beyond that at the speed at which the push began.
        moved = joint.counts - joint.limit_counts - joint.limit_speed * duration
        if (
            duration > shortest
            and direction * moved < -OPPOSED_COUNTS
            and joint.followed < FAR_ENOUGH
        ):
            stop(OPPOSES, i, moved, run)
