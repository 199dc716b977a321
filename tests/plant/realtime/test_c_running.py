# ruff: noqa: S603 - the compiler, and what it made
"""The running controller in C: sample by sample that of Python, whatever happens to it; and under the sanitizers."""

import ast
import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from guarded_loops import LIMIT, RIG
from spoilt import BEGIN, BRAKED, DT, LIES, PATH, Spoilt

from ctc import ComputedTorque
from plant import Guards, P, SteppedArm, puma560
from plant.compiler.python_to_c import CFunction
from plant.realtime.c_running import NAMES

CC = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(CC is None, reason="needs a C compiler")
ROUNDING = 1e-9  # relative: of compilers that contract products and sums, over a thousand samples of a closed loop


class InC:
    """The same controller, called through its C."""

    def __init__(self, controller, folder, counts, *flags):
        controller.to_c(folder, name="arm")
        library = folder / "arm.so"
        strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off"]
        subprocess.run([CC, *strict, *flags, "-shared", "-fPIC", "-o", library, folder / "arm.c", "-lm"], check=True)
        self.c, self.n = ctypes.CDLL(str(library)), controller.n
        self.c.arm_step.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_double, ctypes.c_void_p]
        self.state = np.zeros(len(controller.core.memory))
        self.c.arm_init(self.state.ctypes.data_as(ctypes.c_void_p), self._counts(counts))

    def _counts(self, counts):
        self.given = np.ascontiguousarray(counts, np.int32)
        return self.given.ctypes.data_as(ctypes.c_void_p)

    def step(self, counts, *motion, now=np.nan):
        torque, motion = np.full(self.n, 7.0), [np.ascontiguousarray(each, float) for each in motion]
        places = [each.ctypes.data_as(ctypes.c_void_p) for each in motion]
        state = self.state.ctypes.data_as(ctypes.c_void_p)
        code = self.c.arm_step(state, self._counts(counts), *places, now, torque.ctypes.data_as(ctypes.c_void_p))
        return code, torque

    @property
    def stopped(self):
        return self.c.arm_stopped(self.state.ctypes.data_as(ctypes.c_void_p))

    @property
    def brake(self):
        return bool(self.c.arm_brake(self.state.ctypes.data_as(ctypes.c_void_p)))


COUNTED = [name for name in LIES if name != "nan"]  # NaN is no int32_t


@pytest.mark.parametrize("when", ["rest", "motion", "hold"])
def test_it_does_what_python_does_whatever_happens(tmp_path, when):
    law = ComputedTorque(puma560.literature_arm(1.5), RIG, bandwidth=250.0)
    start = np.array([0.3, -0.4]) if when == "rest" else PATH(np.zeros(1)).q[0]
    speed = np.zeros(2) if when == "rest" else PATH(np.zeros(1)).qd[0]
    first = RIG.counts(start)
    stopped = set()
    twin = InC(law.start(RIG, first), tmp_path / "c", first)
    for lie in (LIES[name] for name in COUNTED):
        robot = SteppedArm(puma560.literature_arm(lie.load), RIG, start, speed)
        running, seen = law.start(RIG, robot.pulses), [robot.pulses]
        twin.c.arm_init(twin.state.ctypes.data_as(ctypes.c_void_p), twin._counts(robot.pulses))
        for k in range(BEGIN + 500):
            call = Spoilt(robot.pulses.astype(float), float(k - BEGIN))
            if lie.spoil is not None and k >= BEGIN:
                lie.spoil(call, k - BEGIN, seen)
            at = np.array([(BEGIN + call.sample) * DT])
            motion = (start, np.zeros(2), np.zeros(2)) if when == "rest" else tuple(each[0] for each in PATH(at))
            if when == "hold" and k >= BEGIN - BRAKED:
                motion = (np.full(2, np.nan),) * 3
            clock = {} if call.now is None else {"now": call.now}
            for _ in range(call.calls):
                torque = running.step(call.counts, *motion, **clock)
                code, own = twin.step(call.counts, *motion, **clock)
                assert code == 0
                np.testing.assert_allclose(own, torque, rtol=0, atol=ROUNDING * LIMIT.max(), err_msg=f"{lie.says} {k}")
            robot.step(np.clip(torque, -call.limit, call.limit))
        assert bool(twin.stopped) == running.stopped
        assert twin.brake == running.status.brake
        stopped.add((twin.stopped, twin.brake))
    assert len(stopped) > (1 if when == "hold" else 3)  # or nothing has happened


def test_a_call_that_nothing_can_answer_changes_nothing(tmp_path):
    law = puma560.p_law()
    twin = InC(law.start(RIG, (0, 0), guards=None), tmp_path, (0, 0))
    before = twin.state.copy()
    code, torque = twin.step((0, 0), (np.nan, 0), (0, 0), (0, 0))
    assert code == 2
    assert (torque == 7.0).all()
    np.testing.assert_array_equal(twin.state, before)
    assert twin.step((0, 0), (0.001, 0), (0, 0), (0, 0))[0] == 0


def test_it_is_sound_under_the_sanitizers(tmp_path):
    """A program of its own, since a sanitizer has to be there before all else."""
    law = ComputedTorque(puma560.literature_arm(1.5), RIG, bandwidth=60.0)
    law.start(RIG, (0, 0), guards=Guards(position=((-2, -2), (2, 2)), torque_rate=1e5)).to_c(tmp_path)
    (tmp_path / "main.c").write_text(
        """
#include "controller.h"
#include <math.h>
#include <stdio.h>
int main(void)
{
    controller_state self;
    const double odd[] = {0.0, 0.01, -3.0, 1e6, 1e300, NAN, INFINITY};
    int stops = 0;
    for (int run = 0; run < 200; run++) {
        int32_t counts[2] = {0, 0};
        double torque[2], q[2] = {0, 0}, qd[2] = {0, 0}, qdd[2] = {0, 0};
        controller_init(&self, counts);
        for (int k = 0; k < 400; k++) {
            const int strange = k > 50 && (k * 7 + run) % 40 == 0;
            q[0] = strange ? odd[(k + run) % 7] : 0.001 * k;
            counts[0] = strange && run % 3 == 0 ? 2147483647 : (int32_t)(13.0 * k * (run % 5 != 1));
            controller_step(&self, counts, q, qd, qdd, run % 2 ? NAN : (strange ? -1.0 : 0.0007 * k), torque);
            if (!isfinite(torque[0]) || !isfinite(torque[1]))
                return 1;
        }
        stops += controller_stopped(&self) != 0;
    }
    printf("%d\\n", stops);
    return 0;
}
"""
    )
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Werror", "-Wall"]
    made = subprocess.run([CC, *flags, "-o", tmp_path / "run", tmp_path / "main.c", tmp_path / "controller.c", "-lm"],
                          capture_output=True, text=True)  # fmt: skip
    if "sanitize" in made.stderr or "libasan" in made.stderr:
        pytest.skip("the compiler has no sanitizers")
    assert made.returncode == 0, made.stderr
    said = subprocess.run([tmp_path / "run"], capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert int(said.stdout) > 100


def test_a_law_without_a_period_and_a_bad_name(tmp_path):
    twin = InC(P(gain=(0.2, 0.15)).start(RIG, (0, 0)), tmp_path / "p", (0, 0))
    running = P(gain=(0.2, 0.15)).start(RIG, (0, 0))
    for k in range(100):
        given = ((k, -k), (0.001 * k, 0), (0.1, 0), (0, 0))
        np.testing.assert_allclose(twin.step(*given, now=1e-4 * k)[1], running.step(*given, now=1e-4 * k), rtol=1e-12)
    with pytest.raises(ValueError, match="name must be a small letter"):
        running.to_c(tmp_path, name="No")
    (tmp_path / "p" / "arm.c").write_text("mine")
    with pytest.raises(ValueError, match="must not exist, or be an export of arm"):
        running.to_c(tmp_path / "p", name="arm")


@pytest.mark.parametrize("text", ["x = {}", "while x:\n    x = 0", "x = a @ b", "x = own[1:2:3]", "x = sorted(own)"])
def test_what_it_does_not_know_is_refused(text):
    node = ast.parse("def f(own):\n    'Say.'\n" + "\n".join(f"    {line}" for line in text.split("\n"))).body[0]
    with pytest.raises(ValueError, match="must be numbers, arrays and branches"):
        CFunction(node, NAMES)
