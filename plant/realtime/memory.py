"""What the parts of a running controller's step share: places in its one vector `memory`, causes of
stops, codes.

`memory` holds `SCALARS` numbers, `ROWS` rows of one number per joint, the law's initial state, its
state, the state that follows, its numbers, and for each joint the motion (q, qd, qdd of all joints)
where it came to rest. The text of this module is compiled with that of `plant.realtime.safety`.
"""

GUARDED, PATIENCE, LATE, PERIOD, STOP, DURATION, STATES = range(7)
CALLS, NOW, DT, LATE_CALLS, JUMPS, GAPS, CAUSE, SINCE, RELEASED = range(7, 16)
EVENT, EVENT_JOINT, EVENT_AMOUNT, EVENT_CALL, BRIDGED, WEIGHT = range(16, 22)
SAMPLED, PASSED, AGE, FILLED, FULL, LEAST, ROUNDS, PIECES = range(22, 30)
CLOCKS, RHYTHM, SLOWER, FASTER, MODELLED, FRESH, AT_MOST, LATCH, LATCH_JOINT, RATED = range(30, 40)
BOUNDED = 40
HURRIED = 41
SCALARS = 42

COUNTS, BEFORE, EXPECTED, SPEED, ANGLE, Q, QD, QDD, REFERENCE = range(9)
WANTED, GIVEN, TORQUE, FROM_Q, FROM_QD, FROM_TORQUE, MARK, MARK_TORQUE = range(9, 17)
JUMP, STUCK, ERROR, FRICTION, SATURATION, CHATTER = range(17, 23)
RUN, AT_LIMIT, MEAN, SWING, OVER, NEWEST, OLDER = range(23, 30)
REST, PUSHED, WAS_Q, WAS_QD, WAS_QDD, NEEDED, LEAST_STEP = range(34, 41)
LOWER, UPPER, FASTEST, RATE, BEYOND, SLACK, BEGUN, PLANNED, LIMITED, LIMIT_TIME = range(41, 51)
ACTED, STILL, REST_TORQUE, OFFSET, RAW, HELD, HELD_COUNTS, HELD_SPEED, FOLLOWED, LEFT_OUT, ROWS = (
    range(51, 62)
)

# Return codes of a step; unless it is DONE, nothing has changed.
DONE, BAD_PULSES, BAD_REFERENCE, BAD_CLOCK, BAD_LAW = range(5)

RUNNING, WAS_LATE, HAD_GAPS, HAS_JUMPED, IS_STUCK, IS_OFF, NO_TORQUE, IS_SATURATED, CHATTERS = (
    range(9)
)
# Causes of a stop, and of a bridged sample.
NO_COUNTS, IS_DEAD, BAD_TIME, OFF_BEAT, OUTSIDE, TOO_FAST, TOO_STEEP, OPPOSES = range(9, 17)

# Why a stop ended in zero torque: speed that rose, time at the limit, a joint that ran away from
# its reference.
DRIVES = 1
PUSHES = 2
RUNS = 3

HOLDING, RAMPING, LATCHED = range(3)  # values of `RELEASED` in a stop

# Causes that were bridged `PATIENCE` times in a row before they stopped the arm.
PATIENT = (HAD_GAPS, HAS_JUMPED, NO_COUNTS, BAD_TIME, TOO_STEEP)

ahead = moving = measured = counted = standing = slowing = law = monitored = shifted = ramp = None
# Generated: the reference one sample on; its speed in pulses; that of the counts; counts of the
# reference and angle of the counts; the motion where a stop begins; its reference; the law;
# saturation and chatter of its torque; a new slot of time; the torque of a stop without feedback;
# what the model's torque changed by since a joint's counts did; limits of position and speed; the
# speed in pulses of the reference of a stop; which way a torque at its limit pushes counts; the
# torque that the firmware adds.
needed = bounds = planned = limited = left_out = None
