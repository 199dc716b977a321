"""Status of a running controller, errors of its calls, and its log."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike

from plant.machine import Rig
from plant.parts import (
    STATUS,
    TURNS,
    Floats,
    JointUnits,
    McapFile,
    array,
    joint_topics,
    require_new,
)
from plant.realtime import memory as layout
from plant.realtime.pieces import RAMP
from plant.realtime.watching import FAR

# Arguments of a step, in the order of the core; the errors of `Running.step` name them.
ARGUMENTS = ("pulses", "q_r", "qd_r", "qdd_r")

# Number of calls in which a joint is far from its reference because of the units, or the start, of
# the reference.
FIRST_CALLS = 2


def numbers(name: str, value: ArrayLike, n: int, advice: str) -> Floats:
    """Numbers of one argument, finite or not; all but plain arrays of numbers are refused."""
    try:
        # The usual call is an array already: nothing is copied within a sample.
        plain = np.asarray(value)
    except ValueError:
        return array(name, value, (n,), advice=advice, finite=False)
    # Masked arrays convert without their mask, strings and booleans to numbers: refuse them.
    masked = isinstance(value, np.ma.MaskedArray)
    if masked or plain.dtype.kind not in "iuf":
        kind = "a masked array" if masked else f"{plain.dtype} {value!r:.60}"
        raise ValueError(f"{name} must be plain numbers of shape ({n},); got {kind}. {advice}")
    return plain if plain.shape == (n,) else array(name, value, (n,), advice=advice, finite=False)


def whole_counts(pulses: ArrayLike, rig: Rig) -> Floats:
    """Encoder counts (n,), checked."""
    counts = array("pulses", pulses, (rig.n,), advice="Give the encoder count of each joint.")
    if not rig.encoder.smooth and (counts != np.trunc(counts)).any():
        raise ValueError(
            f"pulses must be whole encoder counts; got {counts}. Give counts, not angles."
        )
    return counts


def refuse(
    refusal: int, arguments: Sequence[Floats], rig: Rig, previous: float, now: float
) -> NoReturn:
    """Raise the error of a refused call at `now` [s], after a call at `previous` [s]."""
    # In the order of `ARGUMENTS`: counts, then the reference's motion.
    counts = arguments[0]
    motion = arguments[1:]
    # The core gives only the kind of the error; the checks of the arguments word it.
    if refusal == layout.BAD_PULSES:
        whole_counts(counts, rig)
    if refusal == layout.BAD_REFERENCE:
        for name, value in zip(ARGUMENTS[1:], motion, strict=True):
            array(name, value, (rig.n,), advice="Give one value per joint [SI].")
        raise ValueError(f"q_r must be below {FAR:g} rad; got {motion[0]}. Take whole turns off.")
    if refusal == layout.BAD_CLOCK:
        raise ValueError(
            f"now must be finite and advance; got {now} after {previous}. Give seconds of a steady"
            " clock."
        )
    raise ValueError(
        f"the law must give finite torques; it does not at pulses {counts}. Check its numbers."
    )


def clock(now: Any) -> float:
    """Time of a call [s]; one that is no number is infinite, since NaN stands for none."""
    if type(now) is not float and (
        isinstance(now, (bool, np.bool_)) or not isinstance(now, (int, float, np.number))
    ):
        raise ValueError(f"now must be a number; got {now!r:.60}. Give seconds of a steady clock.")
    time = float(now)
    # A comparison with itself fails for NaN alone.
    return time if time == time else np.inf


class Status(str):
    """State of a running controller in words.

    `brake` asks for the mechanical brakes. It is True once nothing else holds the arm: after the
    ramp of a stop has ended, or at once where a stop was latched because its torque drove the arm.
    """

    brake: bool

    __slots__ = ("brake",)

    @classmethod
    def of(
        cls, run: Any, labels: Sequence[str], units: Sequence[JointUnits], gravity: bool
    ) -> Self:
        """Status by the memory's record `run`, and the labels and units of the joints.

        `gravity` says that ramps end with gravity compensation.
        """
        status = cls(_sentence(run, labels, units, gravity))
        # Under a hold the law carries the arm, and until a ramp has ended some of its torque
        # remains.
        ramped = run.since >= RAMP * run.duration
        status.brake = bool(
            run.released == layout.LATCHED or (run.released != layout.HOLDING and ramped)
        )
        return status


def _sentence(run: Any, labels: Sequence[str], units: Sequence[JointUnits], gravity: bool) -> str:
    event = run.event
    if event == layout.RUNNING:
        return "running"
    joint = int(run.event_joint)
    reason = wording(event, labels[joint], run.event_amount, units[joint])
    call = run.event_call
    if run.cause == layout.RUNNING:
        return f"running; bridged {reason} at call {call:.0f}"
    patience = run.patience
    again = f", {patience + 1:.0f} times in a row" if event in layout.PATIENT and patience else ""
    end = "holding"
    if run.released == layout.RAMPING:
        end = "ramp to gravity compensation" if gravity else "ramp to zero"
    elif run.released == layout.LATCHED:
        motion = {
            layout.DRIVES: "grew faster in the stop",
            layout.PUSHES: "stayed at its torque limit",
            layout.RUNS: "ran away",
        }[int(run.latch)]
        end = f"no torque since {labels[int(run.latch_joint)]} {motion}"
    hint = ""
    # So early the units or the start of the reference are the likely reason.
    if event == layout.IS_OFF and call <= FIRST_CALLS:
        hint = f"; a reference is in {units[joint].position}, and begins where the arm is"
    return f"safe stop, {end}: {reason}{again}, at call {call:.0f}{hint}"


def wording(cause: float, joint: str, amount: float, units: JointUnits = TURNS) -> str:
    """A cause in words, with the joint's label and units, and the amount that the core noted."""
    return {
        layout.RUNNING: "",
        layout.WAS_LATE: f"a call that came {1e3 * amount:.3g} ms late",
        layout.HAD_GAPS: "a reference that is no finite position",
        layout.HAS_JUMPED: f"a jump of {abs(amount):.0f} pulses of {joint}",
        layout.IS_STUCK: (
            f"the encoder of {joint} stands still while its reference moved by {abs(amount):.0f}"
            " pulses"
        ),
        layout.IS_OFF: f"{joint} is {abs(amount):.0f} pulses from its reference",
        layout.NO_COUNTS: f"counts of {joint} that are no whole numbers",
        layout.IS_DEAD: (
            f"the encoder of {joint} stands still while its torque changed by {abs(amount):.0f}"
            f" {units.effort}"
        ),
        layout.BAD_TIME: f"a clock that moved by {amount:.3g} s",
        layout.OFF_BEAT: (
            f"calls lost or doubled: the reference moves at {amount:.2f} times its speed"
        ),
        layout.OUTSIDE: f"{joint} is outside its limits, at {amount:.4g} {units.position}",
        layout.TOO_FAST: f"{joint} is faster than its limit, at {amount:.0f} pulses/s",
        layout.TOO_STEEP: f"a torque of {joint} that changes by {amount:.3g} {units.effort}/s",
        layout.OPPOSES: (
            f"{joint} moved by {abs(amount):.0f} pulses against its torque, which is at its limit"
        ),
        layout.NO_TORQUE: "the law gives no finite torque",
        layout.IS_SATURATED: (
            f"the torque of {joint} was at its limit for {1e3 * amount:.0f} of 100 ms"
        ),
        layout.CHATTERS: (
            f"the torque of {joint} swings by {amount:.0f} {units.effort} about its mean"
        ),
    }[int(cause)]


# Largest difference [ns] between the clock of the calls and the time of the day: three years. A
# clock that differs more is not believed.
CLOCK_ERROR = 1e17


class RunLog(McapFile):
    """Log of a running controller; once closed, it ignores further samples.

    ``/joint_states`` and ``/reference`` are messages of `sensor_msgs/msg/JointState`, ``/sample``
    has counts and torque under a record's names, ``/status`` a `std_msgs/msg/String` whenever that
    changes.
    """

    def __init__(self, path: str | Path, controller: Any) -> None:
        n = controller.n
        self._controller = controller
        columns = dict.fromkeys(("reference_pulses", "error_pulses", "torque"), n)
        topics = {**joint_topics(n, columns), **STATUS}
        super().__init__(require_new(path, False), controller.rig.drive.joints, n, topics)
        # Views of the controller's memory, which hold the values of the last call.
        memory = layout.view(controller.core.memory, n, 0)
        self._run = memory.run
        self._joints = memory.joints
        # Unknown until the first call with a clock.
        self._offset: float | None = None
        self._state: tuple[float, ...] = ()

    def sample(self) -> None:
        """Append the sample of the last call at the time of the day.

        That time follows the clock of the calls, if they have one.
        """
        if self._file.closed:
            return
        clock = time.time_ns()
        run = self._run
        # A steady clock begins anywhere, so its offset from the time of the day is taken once.
        now = 1e9 * float(run.now)
        if now == now:
            if self._offset is None:
                self._offset = clock - now
            if abs(self._offset + now - clock) < CLOCK_ERROR:
                clock = int(self._offset + now)
        # Times of a log must not decrease.
        clock = max(clock, self._last)
        joints = self._joints
        torque = joints["torque"]
        reference = joints["reference"]
        self.append("/joint_states", clock, (joints["angle"], (), torque))
        self.append("/reference", clock, (joints["q"], (), ()))
        self.append("/sample", clock, (reference, reference - joints["counts"], torque))
        state = (run.cause, run.released, run.bridged)
        if state != self._state:
            self._state = state
            self.append("/status", clock, self._controller.status)
