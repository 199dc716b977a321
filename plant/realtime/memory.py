"""Memory of a running controller: one declaration of named fields for Python, numba and C.

The memory is one contiguous vector of float64, so that a user can copy and restore a controller as
a whole. `view` gives its parts names: records for the controller, each joint and each motion at
rest, and arrays for the states of the law. `plant.realtime.c_running` prints the C struct from the
same fields, and `Layout.components` tells the generated functions where a quantity is stored.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Slots of the sliding window of saturation, with the one that is being filled.
SLOTS = 6

# Fields of the controller as a whole, with their meanings.
RUN_FIELDS = {
    # Settings: they stay as `initial_memory` writes them.
    "guarded": "1 with guards, 0 without",
    "patience": "number of consecutive bad samples that are bridged",
    "late": "share of a period by which a call may be late",
    "period": "period of the law [s]",
    "no_hold": "1 where every stop ramps at once",
    "duration": "duration of the braking [s]",
    "states": "number of states of the law",
    "weight": "1 where a ramp ends with gravity compensation",
    "sampled": "1 for a law with a period",
    "slot_length": "age at which the newest slot is full [s]",
    "shortest_limit": "uninterrupted time at the limit that counts [s]",
    "whole_counts": "1 for an encoder that gives whole counts",
    "slowest_rhythm": "lowest rate of the reference, relative to its speed",
    "fastest_rhythm": "highest rate of the reference, relative to its speed",
    "modelled": "1 for a law with the model of an arm",
    "braking": "time at the torque limit that a stop may take [s]",
    "bounded": "1 where positions or speeds have limits",
    "longest_step": "longest step of the law, in periods",
    # The clock and the reference
    "calls": "number of calls",
    "now": "time of the last call [s], NaN without a clock",
    "dt": "time since the last call, as the law gets it [s]",
    "passed": "time since the last call, as the monitors get it [s]",
    "late_calls": "consecutive periods without a call in time",
    "bad_clocks": "consecutive calls with a bad clock",
    "gaps": "consecutive references that are not finite",
    "jumps": "consecutive samples with a bad count",
    "steep": "consecutive samples with too steep a torque",
    "rhythm": "mean rate of the reference, relative to its speed",
    "unmarked": "1 before the first torque of the law or of a stop has acted",
    # The monitors of the torque
    "age": "time over which the mean torque was taken [s]",
    "filled": "age of the newest slot [s]",
    # The stop
    "cause": "why the arm is stopped, or RUNNING",
    "since": "time since the stop began [s], -1 before its first sample",
    "released": "which torque the stop gives: HOLDING, RAMPING or LATCHED",
    "latch": "why a stop ended in zero torque: DRIVES, PUSHES or RUNS",
    "latch_joint": "joint for which the stop ended in zero torque",
    # The status
    "event": "last cause that was bridged or that stopped the arm",
    "event_joint": "joint of the event",
    "event_amount": "size of the event",
    "event_call": "call of the event",
    "bridged": "number of bridged samples",
}

# Fields of each joint, with their meanings.
JOINT_FIELDS = {
    # Settings
    "jump": "largest innovation of a count [pulses]",
    "stuck": "motion of the reference without a count [pulses]",
    "error": "largest tracking error [pulses]",
    "friction": "band of static friction in motion [N m]",
    "rest": "change of torque that leaves the joint at rest [N m]",
    "saturation": "largest time at the torque limit within the window [s]",
    "chatter": "largest swing of the torque [N m]",
    "lower": "lowest position [rad]",
    "upper": "highest position [rad]",
    "speed_limit": "largest speed [rad/s]",
    "torque_rate": "largest rate of the torque [N m/s]",
    "slack": "speed that is no rise in a stop [pulses/s]",
    "pulse": "angle of one pulse of every motor [rad]",
    # Counts
    "counts": "count that the law gets",
    "previous_counts": "count of the call before",
    "held_counts": "count of the last call in which the law gave the torque",
    "expected": "count of this call after the guard of the counts",
    "raw_counts": "count as it was read",
    "offset": "counts that a counter has lost",
    "speed": "smoothed speed of the counts [pulses/s]",
    "angle": "position of the counts [rad]",
    # Reference
    "q": "reference position [rad]",
    "qd": "reference velocity [rad/s]",
    "qdd": "reference acceleration [rad/s^2]",
    "reference": "count of the reference",
    "reference_speed": "speed of the reference [pulses/s]",
    # Torque
    "commanded": "torque of the law [N m]",
    "limited": "torque of the law after the amplifier's limit [N m]",
    "torque": "torque that acts until the next call [N m]",
    "applied": "torque that acted until this call [N m]",
    "left_out": "part of the torque that the firmware adds [N m]",
    "direction": "direction in which a torque at its limit pushes the counts, or 0",
    # Monitors of the torque
    "limit_run": "uninterrupted time at the limit [s]",
    "limit_window": "time at the limit within the window [s]",
    "mean_torque": "running mean of the torque [N m]",
    "swing": "mean distance of the torque from its mean [N m]",
    "over": "cause for which the torque stops the arm, or 0",
    "newest": "time at the limit within the newest slot [s]",
    "older": "times at the limit within the older slots, newest first [s]",
    "beyond": "1 beyond a limit of position, 2 of speed, or 0",
    # Encoder that stands still
    "mark": "reference when the count changed last [pulses]",
    "mark_torque": "torque when the count changed last [N m]",
    "still": "time since the count changed last [s]",
    "rest_torque": "torque at which the joint settled [N m]",
    "pushed": "time for which friction cannot bear the torque [s]",
    "rest_q": "position at which this or another joint settled [rad]",
    "rest_qd": "velocity at which it settled [rad/s]",
    "rest_qdd": "acceleration at which it settled [rad/s^2]",
    "model_change": "change of the model's torque since the joint settled [N m]",
    # Torque against the motion
    "followed": "path over which the joint followed its reference [pulses]",
    "limit_push": "time for which the limited torque pushes one way, signed [s]",
    "limit_counts": "count at the beginning of that time",
    "limit_speed": "speed at the beginning of that time [pulses/s]",
    # The stop
    "begin_q": "position at which the stop began [rad]",
    "begin_qd": "velocity at which the stop began [rad/s]",
    "begin_torque": "torque at which the ramp began [N m]",
    "begin_speed": "absolute speed at which the stop began [pulses/s]",
    "limit_time": "time at the limit since the stop began [s]",
}

# Fields of which a joint has several values.
SIZES = {"older": SLOTS - 1}


def _record(fields: Any) -> np.dtype[Any]:
    """Record of float64 fields that Python and numba read by name."""
    # Fields of float64 alone need no padding, so a record is a slice of the vector.
    kinds = [(name, float, (SIZES[name],)) if name in SIZES else (name, float) for name in fields]
    return np.dtype((np.record, kinds))


RUN = _record(RUN_FIELDS)
JOINT = _record(JOINT_FIELDS)
MOTION = _record(("q", "qd", "qdd"))

# Sizes in numbers of the vector.
NUMBER = np.dtype(float).itemsize
RUN_SIZE = RUN.itemsize // NUMBER
JOINT_SIZE = JOINT.itemsize // NUMBER
MOTION_SIZE = MOTION.itemsize // NUMBER

# The law's states in the order of the memory.
LAW_STATES = ("initial", "state", "following")


class Memory(NamedTuple):
    """Parts of a memory by name; all are views of `vector`.

    Parameters
    ----------
    run : record
        Fields of `RUN_FIELDS`.
    joints : (n,) array of records
        Fields of `JOINT_FIELDS`.
    initial, state, following : (s,) numpy.ndarray
        State of the law at its start, now, and after this sample.
    motions : (n, n) array of records
        Motion (q, qd, qdd) of joint j where joint i came to rest, as ``motions[i, j]``.
    vector : (m,) numpy.ndarray
        The whole memory, from which the functions of law and rig read.
    pieces : int
        Address of the functions of law and rig (`plant.compiler.intrinsics.switch`).
    """

    run: Any
    joints: Any
    initial: Any
    state: Any
    following: Any
    motions: Any
    vector: Any
    pieces: Any


def view(vector, n, pieces):
    """Memory of a controller of n joints by its parts; numba compiles this function, too."""
    run = vector[:RUN_SIZE].view(RUN)[0]
    law = RUN_SIZE + n * JOINT_SIZE
    joints = vector[RUN_SIZE:law].view(JOINT)
    # The state of the law at its start, now, and after this sample, as `LAW_STATES` orders them.
    states = int(run.states)
    state = law + states
    following = state + states
    numbers = following + states
    # The numbers of law and rig follow; only the functions of law and rig read them. The motions
    # come last, so their begin needs no count of these numbers.
    rest = len(vector) - MOTION_SIZE * n * n
    motions = vector[rest:].view(MOTION).reshape(n, n)
    return Memory(
        run,
        joints,
        vector[law:state],
        vector[state:following],
        vector[following:numbers],
        motions,
        vector,
        pieces,
    )


class Layout(NamedTuple):
    """Positions of all quantities in the memory of n joints, a law of s states, and m numbers."""

    n: int
    states: int
    numbers: int

    @classmethod
    def of(cls, block: Any, n: int) -> "Layout":
        return cls(n, len(block.initial), len(block.values))

    def vector(self, block: Any) -> NDArray[np.float64]:
        """A memory with the states and the numbers of law and rig, and zeros elsewhere."""
        # All three of `LAW_STATES` begin with the initial state.
        fields = np.zeros(RUN_SIZE + self.n * JOINT_SIZE)
        motions = np.zeros(MOTION_SIZE * self.n**2)
        return np.concatenate([fields, *[block.initial] * 3, block.values, motions])

    def components(self, name: str) -> list[tuple[int, str]]:
        """Position in the vector, and C expression, of each component of a quantity.

        Components of a field with several values come value by value, each of all joints.
        """
        if name in RUN_FIELDS:
            return [(_offset(RUN, name), f"memory->run.{name}")]
        if name in JOINT_FIELDS:
            offset = RUN_SIZE + _offset(JOINT, name)
            return [
                (
                    offset + joint * JOINT_SIZE + i,
                    f"memory->joints[{joint}].{name}" + (f"[{i}]" if name in SIZES else ""),
                )
                for i in range(SIZES.get(name, 1))
                for joint in range(self.n)
            ]
        # The states of the law follow the joints, and its numbers follow the states.
        start = RUN_SIZE + self.n * JOINT_SIZE
        size = self.states
        if name == "numbers":
            start += len(LAW_STATES) * self.states
            size = self.numbers
        else:
            start += LAW_STATES.index(name) * self.states
        return [(start + i, f"memory->{name}[{i}]") for i in range(size)]


def _offset(record: Any, name: str) -> int:
    offset: int = record.fields[name][1]
    return offset // NUMBER


# Return codes of a step; unless it is DONE, counts, torque and state are those of the call before.
DONE, BAD_PULSES, BAD_REFERENCE, BAD_CLOCK, BAD_LAW = range(5)

# Causes of a stop, and of a bridged sample; C has them in its header.
CAUSES = (
    "RUNNING",
    "WAS_LATE",
    "HAD_GAPS",
    "HAS_JUMPED",
    "IS_STUCK",
    "IS_OFF",
    "NO_TORQUE",
    "IS_SATURATED",
    "CHATTERS",
    "NO_COUNTS",
    "IS_DEAD",
    "BAD_TIME",
    "OFF_BEAT",
    "OUTSIDE",
    "TOO_FAST",
    "TOO_STEEP",
    "OPPOSES",
)
RUNNING, WAS_LATE, HAD_GAPS, HAS_JUMPED, IS_STUCK, IS_OFF, NO_TORQUE, IS_SATURATED = range(8)
CHATTERS, NO_COUNTS, IS_DEAD, BAD_TIME, OFF_BEAT, OUTSIDE, TOO_FAST, TOO_STEEP = range(8, 16)
OPPOSES = 16

# Causes that were bridged `patience` times in a row before they stopped the arm.
PATIENT = (HAD_GAPS, HAS_JUMPED, NO_COUNTS, BAD_TIME, TOO_STEEP)

# Why a stop ended in zero torque: a speed that rose, too long a time at the limit, or a joint that
# ran away from its reference.
DRIVES, PUSHES, RUNS = range(1, 4)

# Values of `released`: the torque of the law on a braking reference, a ramp without the law, none.
HOLDING, RAMPING, LATCHED = range(3)
