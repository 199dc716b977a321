"""Guards of a running controller's inputs: clock, reference, counts, and encoders that stand still.

`plant.realtime.safety` calls these functions; numba compiles them, and
`plant.realtime.c_running` translates them.
"""

import numpy as np

from plant.compiler import in_kernel, inlined
from plant.realtime.calls import ahead, bounds, measured, needed
from plant.realtime.memory import (
    BAD_CLOCK,
    BAD_PULSES,
    BAD_REFERENCE,
    BAD_TIME,
    DONE,
    HAD_GAPS,
    HAS_JUMPED,
    IS_DEAD,
    IS_OFF,
    IS_STUCK,
    NO_COUNTS,
    OFF_BEAT,
    OUTSIDE,
    RUNNING,
    TOO_FAST,
    WAS_LATE,
)
from plant.realtime.stopping import bridge, release, stop

# Largest angle of a reference [rad]: up to here the sines of the kernels are exact to rounding.
FAR = 1e5

# Largest count: up to here float64 holds whole numbers exactly.
EXACT = 2.0**53

# Periods between two calls above which a clock is not believed.
GLITCH = 100.0

# Weight of one sample in the mean rate of the reference.
REMEMBERED = 0.1

# Largest rate of the reference, relative to its speed, that one sample may count as: references
# may have steps.
SUDDEN = 3.0

# Time [s] for which a torque that friction cannot bear may act without a count.
DEAD_TIME = 0.02

# Time [s] without a count after which the torque of a joint at rest has settled.
SETTLED = 0.03

# Share by which the model's change of torque may be wrong.
MODEL_ERROR = 0.5


@in_kernel
def whole(count, run):
    """Whether an encoder can give this count."""
    # NaN fails the first comparison.
    return abs(count) <= EXACT and (count == np.floor(count) or run.whole_counts == 0.0)


@in_kernel
def usable(q_r, qd_r, qdd_r):
    """Whether a reference is finite, and its angles small enough for the sines of the kernels."""
    sound = True
    # NaN fails every comparison, so the limits refuse it, too.
    for i in range(len(q_r)):
        sound = sound and abs(q_r[i]) <= FAR and abs(qd_r[i]) < np.inf and abs(qdd_r[i]) < np.inf
    return sound


@inlined
def refused(pulses, q_r, qd_r, qdd_r, now, run):
    """Return code of a call that no guard can bridge: the first, or any without guards."""
    # From the second call on there is a previous sample that can bridge a bad one.
    if run.guarded == 1.0 and run.calls > 0.0:
        return DONE
    for count in pulses:
        if not whole(count, run):
            return BAD_PULSES
    # NaN stands for no clock; neither comparison holds for it.
    if run.guarded == 0.0 and (now <= run.now or abs(now) == np.inf):
        return BAD_CLOCK
    return DONE if usable(q_r, qd_r, qdd_r) else BAD_REFERENCE


@inlined
def in_time(now, run):
    """Guard of the clock; after a late call the law gets the time that really passed.

    A clock that stands, runs backwards or leaps is ignored in this call, and one period counts as
    passed.
    """
    elapsed = now - run.now
    run.dt = run.period
    # Without a clock, and in the first call, `elapsed` is NaN, for which no comparison holds.
    if run.guarded == 1.0 and (
        elapsed <= 0.0 or elapsed > GLITCH * run.period or abs(now) == np.inf
    ):
        run.bad_clocks += 1.0
        # A law without a period has no other measure of time: nothing passes.
        run.now += run.sampled * run.period
        run.passed = run.sampled * run.period
        bridge(BAD_TIME, 0, elapsed, run.bad_clocks > run.patience, run)
        return
    # Delay beyond the one that `late` allows, in periods.
    over = elapsed / run.period - 1.0 - run.late
    run.now = now
    run.bad_clocks = 0.0
    # NaN without a clock compares as not late.
    if over > 0.0:
        run.dt = elapsed
        # Each period without a call counts as a bad sample.
        run.late_calls += np.ceil(over)
        bridge(WAS_LATE, 0, elapsed - run.period, run.late_calls > run.patience, run)
    else:
        run.late_calls = 0.0
    # Only the clock knows how often a law without a period is called.
    run.passed = run.dt if run.sampled == 1.0 else elapsed


@inlined
def follow(starting, q_r, qd_r, qdd_r, memory):
    """Guard of the reference: an unusable one is extrapolated from the last usable one."""
    run = memory.run
    if usable(q_r, qd_r, qdd_r):
        run.gaps = 0.0
        # The first reference has no previous one with which it could be compared.
        if run.sampled == 1.0 and not starting:
            beat(q_r, qd_r, memory)
        for i, joint in enumerate(memory.joints):
            joint.q = q_r[i]
            joint.qd = qd_r[i]
            joint.qdd = qdd_r[i]
    else:
        run.gaps += 1.0
        ahead(memory)
        bridge(HAD_GAPS, 0, run.gaps, run.gaps > run.patience, run)


@inlined
def beat(q_r, qd_r, memory):
    """Guard of lost and doubled calls.

    A reference that is a function of time then moves faster or slower than its speed says. The
    joint that moves most decides, if it moves by more than a pulse.
    """
    run = memory.run
    # The motion must exceed one pulse: a smaller one says little about the rate.
    largest = 1.0
    rate = 0.0
    for i, joint in enumerate(memory.joints):
        # The mean of both speeds is exact for a constant acceleration.
        due = 0.5 * (joint.qd + qd_r[i]) * run.dt
        if abs(due) > largest * joint.pulse:
            largest = abs(due) / joint.pulse
            rate = (q_r[i] - joint.q) / due
    if largest > 1.0:
        # A mean over several samples, in which a step of the reference counts as `SUDDEN` at most.
        run.rhythm += REMEMBERED * (min(max(rate, -SUDDEN), SUDDEN) - run.rhythm)
        if run.rhythm < run.slowest_rhythm or run.rhythm > run.fastest_rhythm:
            stop(OFF_BEAT, 0, run.rhythm, run)


@inlined
def read(pulses, starting, memory):
    """Guard of the counts: a count with too large an innovation is replaced by its prediction.

    So is a count that is no number. If bad counts go on, the arm stops. A counter that has jumped
    for good has lost counts, since no arm can have moved so far: they are subtracted, so that a
    stop goes on where the arm is. A counter that stands still where it has jumped to may be dead:
    there is no hold with it.
    """
    run = memory.run
    dt = run.dt
    worst = -1
    largest = 0.0
    missing = False
    dumb = False

    # 1. Predict each count, and replace those that cannot be.
    for i, joint in enumerate(memory.joints):
        joint.previous_counts = joint.counts
        predicted = joint.counts + joint.speed * dt
        innovation = pulses[i] - joint.offset - predicted
        joint.expected = pulses[i] - joint.offset
        if not whole(pulses[i], run):
            joint.expected = np.floor(predicted + 0.5)
            # The first missing count is reported, before all jumps.
            if not missing:
                worst = i
                largest = 0.0
                missing = True
        elif not starting and abs(innovation) > joint.jump + abs(joint.speed) * dt:
            # The arm cannot have moved so far within a sample.
            joint.expected = np.floor(predicted + 0.5)
            # A counter that repeats its value after a jump may be dead.
            dumb = dumb or pulses[i] == joint.raw_counts
            if not missing and abs(innovation) > abs(largest):
                worst = i
                largest = innovation
        joint.raw_counts = pulses[i]

    # 2. Bridge the sample, or stop the arm.
    run.jumps = run.jumps + 1.0 if worst >= 0 else 0.0
    lost = run.jumps > run.patience
    if worst >= 0:
        if lost and run.cause != RUNNING:
            # A stop that has no feedback any more ramps.
            release(memory)
        bridge(NO_COUNTS if missing else HAS_JUMPED, worst, largest, lost, run)
        if lost and dumb:
            release(memory)

    # 3. Take the counts, and update their speed.
    for i, joint in enumerate(memory.joints):
        if lost and whole(pulses[i], run):
            # The counter has lost counts for good: its value now stands for the prediction.
            joint.offset = pulses[i] - joint.expected
        joint.counts = joint.expected
        # Without feedback the speed is unknown from here on.
        joint.speed *= 1.0 - min(run.released, 1.0) if lost else 1.0
    # A jump, or a count without a previous one, gives no speed.
    if not (lost or starting):
        measured(memory)


@in_kernel
def watch(starting, memory):
    """Guards of the tracking error, and of an encoder that stands still; in a hold only the second.

    Static friction holds a joint while the torque stays within a band of twice its level. Once the
    torque has left that band since the count changed last, the joint must have moved, if its
    reference has.
    """
    run = memory.run
    for i, joint in enumerate(memory.joints):
        error = joint.reference - joint.counts
        if run.cause == RUNNING and abs(error) > joint.error:
            stop(IS_OFF, i, error, run)
        # Path of the reference, and change of the torque, since the count changed last.
        path = joint.reference - joint.mark
        change = joint.torque - joint.mark_torque
        if starting or joint.counts != joint.previous_counts:
            joint.mark = joint.reference
            joint.mark_torque = joint.torque
            joint.still = 0.0
            joint.pushed = 0.0
            continue
        settled = joint.still >= SETTLED
        # Both have changed by more than friction explains.
        overdue = abs(path) > joint.stuck and abs(change) > joint.friction
        if overdue and stands(i, settled, memory):
            lose(IS_STUCK, i, path, memory)
        joint.still += run.dt
        if settled:
            rest(i, memory)
        elif joint.still >= SETTLED:
            # It has settled within this sample: store the torque and the motion of all joints.
            joint.rest_torque = joint.mean_torque
            for k, neighbour in enumerate(memory.joints):
                memory.motions[i, k].q = neighbour.q
                memory.motions[i, k].qd = neighbour.qd
                memory.motions[i, k].qdd = neighbour.qdd


@inlined
def stands(i, settled, memory):
    """Whether joint i must have moved.

    The torque of a settled joint may also be what holds it while the other joints move.
    """
    # Before the joint has settled, and without a model, only friction is taken into account.
    if not settled or memory.run.modelled == 0.0:
        return True
    joint = memory.joints[i]
    return unborne(i, joint.mean_torque - joint.rest_torque, memory)


@inlined
def rest(i, memory):
    """Guard of an encoder that is dead at rest, whatever its reference does.

    The mean torque must stay within the band of friction about where it settled, or the count
    change within `DEAD_TIME`, unless the motion of the other joints needs the torque.
    """
    joint = memory.joints[i]
    change = joint.mean_torque - joint.rest_torque
    if abs(change) > joint.rest and unborne(i, change, memory):
        joint.pushed += memory.run.dt
        if joint.pushed > DEAD_TIME:
            lose(IS_DEAD, i, change, memory)
    else:
        joint.pushed = 0.0


@in_kernel
def unborne(i, change, memory):
    """Whether neither friction nor the motion of the other joints explains a change of torque."""
    # Whether each reference is, to a pulse, where it was when joint i settled.
    alike = True
    for k, joint in enumerate(memory.joints):
        # `needed` reads the motion of that instant from these fields.
        joint.rest_q = memory.motions[i, k].q
        joint.rest_qd = memory.motions[i, k].qd
        joint.rest_qdd = memory.motions[i, k].qdd
        alike = alike and abs(joint.rest_q - joint.q) <= joint.pulse
    if memory.run.modelled == 0.0:
        # Without a model, any motion of a reference may explain the change.
        return alike
    needed(memory)
    joint = memory.joints[i]
    expected = joint.model_change
    # The model's change may be wrong by its share `MODEL_ERROR`.
    return abs(change - expected) > joint.rest + MODEL_ERROR * abs(expected)


@in_kernel
def lose(cause, i, amount, memory):
    """Stop for an encoder that stands still; a hold cannot go on without it."""
    run = memory.run
    # A hold that has begun goes on without feedback, as a ramp.
    if run.cause != RUNNING and run.since >= 0.0:
        release(memory)
    stop(cause, i, amount, run)


@inlined
def bounded(memory):
    """Guards of joint position and speed."""
    bounds(memory)
    for i, joint in enumerate(memory.joints):
        if joint.beyond == 1.0:
            stop(OUTSIDE, i, joint.angle, memory.run)
        elif joint.beyond == 2.0:
            stop(TOO_FAST, i, joint.speed, memory.run)
