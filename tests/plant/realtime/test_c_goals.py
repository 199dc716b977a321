"""C of a law above servos and MIT drives: goals and frames of the running controller."""

import ctypes
import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from servos import GAIN, arm, rig

from ctc import ComputedTorque
from plant import (
    Guards,
    Harmonics,
    MitDrive,
    PositionServo,
    SteppedArm,
    simulate,
    write_replay,
)

ARM = arm()
CC = shutil.which("cc") or shutil.which("gcc")
PATH = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
needs_c = pytest.mark.skipif(
    shutil.which("cc") is None or shutil.which("make") is None, reason="no C compiler or no make"
)


def run(*command, folder):
    return subprocess.run(  # noqa: S603
        [str(word) for word in command], cwd=folder, capture_output=True, text=True, check=True
    )


@needs_c
def test_goals_of_the_c_are_those_of_the_running_controller(tmp_path):
    loop = rig()
    law = ComputedTorque(ARM, loop)
    record = simulate(ARM, loop, law, PATH, duration=2.0)
    law.to_c(tmp_path, loop, guards=None, output="goal")
    run("make", folder=tmp_path)
    write_replay(record, tmp_path / "record.csv")
    lines = run(tmp_path / "controller", "record.csv", folder=tmp_path).stdout.splitlines()
    goals = np.loadtxt(lines, delimiter=",").astype(int)

    running = law.start(loop, record.counts[0], guards=None)
    motion = PATH(record.t)
    expected = []
    for counts, *state in zip(record.counts, *motion, strict=True):
        running.step(counts, *state)
        expected.append(running.goal)
    np.testing.assert_array_equal(goals, expected)
    assert np.ptp(goals, axis=0).min() > 400


def test_goals_are_refused_where_nothing_takes_them(tmp_path):
    law = ComputedTorque(ARM, rig(inner=None), bandwidth=30)
    with pytest.raises(ValueError, match="this one has none"):
        law.to_c(tmp_path, guards=None, output="goal")
    running = law.start(rig(inner=None), np.zeros(2), guards=None)
    with pytest.raises(ValueError, match=r"has none: take running\.torque\.$"):
        _ = running.goal
    frames = rig(0.002, None)
    frames = dataclasses.replace(frames, inner=MitDrive.for_arm(ARM, frames, stiffness=40))
    with pytest.raises(ValueError, match="has MitDrive"):
        ComputedTorque(ARM, frames).to_c(tmp_path, guards=None, output="goal")
    with pytest.raises(ValueError, match="has PositionServo"):
        ComputedTorque(ARM, rig()).to_c(tmp_path, output="frame")
    # A servo takes no torque.
    for guards in (None, Guards()):
        with pytest.raises(ValueError, match="has an inner loop"):
            ComputedTorque(ARM, rig()).to_c(tmp_path, guards=guards)
    assert not list(tmp_path.iterdir())


# -- with every guard ------------------------------------------------------------------------------
class InC:
    """The guarded controller, called through its C."""

    def __init__(self, running, folder, counts, output, rows):
        running.to_c(folder, name="arm", output=output)
        library = folder / "arm.so"
        flags = "-std=c99 -O1 -Wall -Wextra -pedantic -Werror -ffp-contract=off -shared -fPIC"
        run(CC, *flags.split(), "-o", library, folder / "arm.c", "-lm", folder=folder)
        self.c = ctypes.CDLL(str(library))
        self.c.arm_step.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_double, ctypes.c_void_p]
        self.memory = np.zeros(len(running.core.memory) + 3)
        self.sent = np.zeros((rows, 2) if rows > 1 else 2, np.int32 if output == "goal" else float)
        self.counts = np.array(counts, np.int32)
        self.c.arm_init(self.memory.ctypes.data_as(ctypes.c_void_p), self._place(self.counts))

    @staticmethod
    def _place(values):
        return values.ctypes.data_as(ctypes.c_void_p)

    def step(self, counts, motion, now):
        self.counts = np.array(counts, np.int32)
        places = [np.ascontiguousarray(values, float) for values in motion]
        arguments = [self._place(values) for values in (self.memory, self.counts, *places)]
        assert self.c.arm_step(*arguments, now, self._place(self.sent)) == 0
        return self.sent

    @property
    def stopped(self):
        return bool(self.c.arm_stopped(self._place(self.memory)))


def repeats(k, counts, seen):
    """From here on the bus repeats its last answer."""
    return seen[119] if k >= 120 else counts


def wraps(k, counts, seen):
    """The counter of one servo passes its end."""
    return counts - np.array([4096, 0]) * (k >= 120)


def sound(k, counts, seen):
    return counts


def servo_loop():
    return rig(inner=PositionServo(gain=GAIN, register=(0, 4095)))


def frame_loop():
    loop = rig(0.002, None)
    return dataclasses.replace(loop, inner=MitDrive.for_arm(ARM, loop, stiffness=40))


@needs_c
@pytest.mark.parametrize(
    "stop", ["hold", *(pytest.param(stop, marks=pytest.mark.slow) for stop in ("gravity", "zero"))]
)
@pytest.mark.parametrize(
    ("loop", "rows"), [(servo_loop(), 1), (frame_loop(), 5)], ids=["goal", "frame"]
)
def test_what_the_guarded_c_sends_has_the_bits_of_python(tmp_path, loop, rows, stop):
    """Sound, with reads that repeat, counters that wrap, and calls that come late."""
    output = loop.inner.sends
    guards = Guards(stop=stop, stuck=40)
    law = ComputedTorque(ARM, loop)
    times = loop.period * np.arange(240)
    # The second joint comes near the end of its register, at 0.
    path = Harmonics(period=2.0, offset=(0.6, 0.42), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
    motion = path(times)
    begin = loop.counts(motion.q[0])
    twin = InC(law.start(loop, begin, guards=guards), tmp_path, begin, output, rows)
    outcomes = []
    for spoil, pause in ((sound, 0.0), (repeats, 0.0), (wraps, 0.0), (sound, 0.5)):
        running = law.start(loop, begin, guards=guards)
        twin.c.arm_init(twin._place(twin.memory), twin._place(np.array(begin, np.int32)))
        arm_in_c, robot = [], bench(loop, motion)
        for k, state in enumerate(zip(*motion, strict=True)):
            arm_in_c.append(robot.pulses)
            counts = spoil(k, robot.pulses, arm_in_c)
            now = times[k] + pause * (k >= 120)
            running.step(counts, *state, now=now)
            sent = getattr(running, output)
            np.testing.assert_array_equal(twin.step(counts, state, now), sent)
            follow(robot, loop, sent)
            if output == "goal":
                # Never further from the count than the amplifier's limit gives torque.
                assert (sent >= 0).all()
                low = counts < 0
                assert np.abs(sent - counts)[~low].max(initial=0) <= np.ceil(3.35 / GAIN)
        assert twin.stopped == running.stopped
        outcomes.append(running.stopped)
    assert outcomes == [False, True, True, True]


@needs_c
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("loop", [servo_loop(), frame_loop()], ids=["goal", "frame"])
def test_goals_and_frames_of_a_microcontroller_compile_without_a_warning(tmp_path, loop, precision):
    running = ComputedTorque(ARM, loop).start(loop, loop.counts((0.6, 0.4)))
    running.to_c(tmp_path, output=loop.inner.sends, target="cortex-m7", precision=precision)
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-c"]
    # A number of double precision would be slow on a processor without it.
    flags += ["-Wdouble-promotion"] if precision == "single" else []
    run(CC, *flags, "controller.c", folder=tmp_path)
    header = (tmp_path / "controller.h").read_text()
    numbers = "int32_t goal[2]"
    if loop.inner.sends == "frame":
        numbers = ("float" if precision == "single" else "double") + " frame[10]"
    assert numbers in header


@needs_c
@pytest.mark.parametrize("guards", [None, Guards()], ids=["law", "guarded"])
@pytest.mark.parametrize("loop", [servo_loop(), frame_loop()], ids=["goal", "frame"])
def test_what_is_sent_leaves_out_what_the_firmware_adds(tmp_path, loop, guards):
    law = ComputedTorque(ARM, loop)
    output = loop.inner.sends
    begin = loop.counts((0.6, 0.42))
    motion = (0.6, 0.42), (0.0, 0.0), (0.0, 0.0)
    whole = law.start(loop, begin, guards=guards)
    left = law.start(loop, begin, guards=guards, without=("gravity",))
    firmware = whole.step(begin, *motion) - left.step(begin, *motion)
    assert np.abs(firmware).min() > 2 * GAIN
    sent = getattr(left, output)
    change = getattr(whole, output) - sent
    added = change * GAIN if output == "goal" else change[4]
    # A goal is a whole count, and the torque of a frame has a step.
    np.testing.assert_allclose(added, firmware, rtol=0, atol=GAIN)

    law.to_c(tmp_path, loop, guards=guards, output=output, without=("gravity",))
    np.savetxt(tmp_path / "record.csv", [[*begin, *np.ravel(motion)]], "%.17g", ",")
    run(CC, "-O0", "controller.c", "main.c", "-lm", "-o", "controller", folder=tmp_path)
    line = run(tmp_path / "controller", "record.csv", folder=tmp_path).stdout
    np.testing.assert_array_equal(np.fromstring(line, sep=","), sent.ravel())


def bench(loop, motion):
    below = dataclasses.replace(loop, inner=None, period=1e-3)
    return SteppedArm(ARM, below, motion.q[0], motion.qd[0])


def follow(robot, loop, sent):
    """One period of the inner loops at 1 kHz."""
    for _ in range(round(loop.period / 1e-3)):
        if loop.inner.sends == "goal":
            robot.step(np.clip(GAIN * (sent - robot.pulses), -3.35, 3.35))
            continue
        q, qd, kp, kd, tau = sent
        robot.step(np.clip(kp * (q - robot.q) + kd * (qd - robot.qd) + tau, -3.35, 3.35))
