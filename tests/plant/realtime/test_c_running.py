# ruff: noqa: S603 - the compiler, and what it made
"""The running controller in C: sample by sample that of Python, whatever happens to it; and
under the sanitizers.
"""

import ast
import ctypes
import re
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest
from guarded_loops import LIMIT, RIG, closed, elastic
from spoilt import BEGIN, BRAKED, DT, LIES, PATH, Spoilt

from ctc import ComputedTorque
from plant import PD, Guards, P, SteppedArm, puma560, simulate
from plant.compiler import CFunction
from plant.realtime import memory, names_of

CC = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(CC is None, reason="needs a C compiler")
MAKE = shutil.which("make")
needs_make = pytest.mark.skipif(MAKE is None, reason="no make here")
# relative: of compilers that contract products and sums, over a thousand samples of a closed loop
ROUNDING = 1e-9


class InC:
    """The same controller, called through its C."""

    def __init__(self, controller, folder, counts, *flags):
        controller.to_c(folder, name="arm")
        library = folder / "arm.so"
        strict = [
            "-std=c99",
            "-O1",
            "-Wall",
            "-Wextra",
            "-pedantic",
            "-Werror",
            "-ffp-contract=off",
        ]
        subprocess.run(
            [CC, *strict, *flags, "-shared", "-fPIC", "-o", library, folder / "arm.c", "-lm"],
            check=True,
        )
        self.c, self.n = ctypes.CDLL(str(library)), controller.n
        self.c.arm_step.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_double, ctypes.c_void_p]
        # C has no empty arrays: three more for a law without states
        self.state = np.zeros(len(controller.core.memory) + 3)
        self.c.arm_init(self.state.ctypes.data_as(ctypes.c_void_p), self._counts(counts))

    def _counts(self, counts):
        self.given = np.ascontiguousarray(counts, np.int32)
        return self.given.ctypes.data_as(ctypes.c_void_p)

    def step(self, counts, *motion, now=np.nan):
        torque, motion = (
            np.full(self.n, 7.0),
            [np.ascontiguousarray(each, float) for each in motion],
        )
        places = [each.ctypes.data_as(ctypes.c_void_p) for each in motion]
        state = self.state.ctypes.data_as(ctypes.c_void_p)
        code = self.c.arm_step(
            state, self._counts(counts), *places, now, torque.ctypes.data_as(ctypes.c_void_p)
        )
        return code, torque

    @property
    def stopped(self):
        return self.c.arm_stopped(self.state.ctypes.data_as(ctypes.c_void_p))

    @property
    def brake(self):
        return bool(self.c.arm_brake(self.state.ctypes.data_as(ctypes.c_void_p)))


COUNTED = [name for name in LIES if name != "nan"]  # NaN is no int32_t


@pytest.mark.parametrize(
    "when", ["motion", *(pytest.param(when, marks=pytest.mark.slow) for when in ("rest", "hold"))]
)
def test_it_does_what_python_does_whatever_happens(tmp_path, when):
    law = ComputedTorque(puma560.literature_arm(1.5), RIG, bandwidth=250.0)
    # some of the samples before the lie, and as many after it as the last of the stops needs
    first, last = BEGIN - 150, BEGIN + (320 if when == "motion" else 500)
    begin = PATH(np.array([first * DT]))
    start = np.array([0.3, -0.4]) if when == "rest" else begin.q[0]
    speed = np.zeros(2) if when == "rest" else begin.qd[0]
    counts = RIG.counts(start)
    stopped = set()
    twin = InC(law.start(RIG, counts), tmp_path / "c", counts)
    for lie in (LIES[name] for name in COUNTED):
        robot = SteppedArm(puma560.literature_arm(lie.load), RIG, start, speed)
        running, seen = law.start(RIG, robot.pulses), [robot.pulses]
        twin.c.arm_init(twin.state.ctypes.data_as(ctypes.c_void_p), twin._counts(robot.pulses))
        for k in range(first, last):
            call = Spoilt(robot.pulses.astype(float), float(k - BEGIN))
            if lie.spoil is not None and k >= BEGIN:
                lie.spoil(call, k - BEGIN, seen)
            at = np.array([(BEGIN + call.sample) * DT])
            motion = (
                (start, np.zeros(2), np.zeros(2))
                if when == "rest"
                else tuple(each[0] for each in PATH(at))
            )
            if when == "hold" and k >= BEGIN - BRAKED:
                motion = (np.full(2, np.nan),) * 3
            clock = {} if call.now is None else {"now": call.now}
            for _ in range(call.calls):
                torque = running.step(call.counts, *motion, **clock)
                code, own = twin.step(call.counts, *motion, **clock)
                assert code == 0
                np.testing.assert_allclose(
                    own, torque, rtol=0, atol=ROUNDING * LIMIT.max(), err_msg=f"{lie.says} {k}"
                )
            robot.step(np.clip(torque, -call.limit, call.limit))
        assert bool(twin.stopped) == running.stopped
        assert twin.brake == running.status.brake
        stopped.add((twin.stopped, twin.brake))
    assert len(stopped) > (1 if when == "hold" else 2)  # or nothing has happened


def test_a_call_that_nothing_can_answer_changes_nothing(tmp_path):
    law = puma560.p_law()
    twin = InC(law.start(RIG, (0, 0), guards=None), tmp_path, (0, 0))
    before = twin.state.copy()
    code, torque = twin.step((0, 0), (np.nan, 0), (0, 0), (0, 0))
    assert code == 2
    assert (torque == 7.0).all()
    np.testing.assert_array_equal(twin.state, before)
    assert twin.step((0, 0), (0.001, 0), (0, 0), (0, 0))[0] == 0


@pytest.mark.parametrize(
    "known", [{"torque": (30.0, 9.0)}, {"friction": ((0.11, 0.15), (8e-4, 14e-4))}]
)
def test_it_begins_with_what_the_controller_knew_at_its_start(tmp_path, known):
    law = ComputedTorque(puma560.literature_arm(1.5), RIG)
    running = law.start(RIG, (0, 0), **known)
    assert (running.state != law.start(RIG, (0, 0)).state).any()
    twin = InC(running, tmp_path, (0, 0))
    for _ in range(3):
        motion = (0.0, 0.001), (0.2, -0.1), (0.0, 0.0)
        code, own = twin.step((0, 0), *motion)
        assert code == 0
        torque = running.step((0, 0), *motion)
        np.testing.assert_allclose(own, torque, rtol=0, atol=ROUNDING * LIMIT.max())


@pytest.mark.parametrize(("precision", "kind"), [("double", np.float64), ("single", np.float32)])
def test_a_torque_that_rounds_below_its_limit_is_at_it(tmp_path, precision, kind):
    puma560.p_law().start(RIG, (0, 0)).to_c(tmp_path, name="arm", precision=precision)
    code = (tmp_path / "arm.c").read_text()
    limited = code[code.index("running_limited(arm_state *memory)\n{") :].split("\n}")[0]
    share = max(kind(text) for text in re.findall(r"\b0\.99\d+", limited))
    # Conversions to the shaft and back, and the last sample of a ramp, take some operations.
    assert 0.99 < share < 1 - 8 * np.finfo(kind).eps


def test_it_is_sound_under_the_sanitizers(tmp_path):
    """A program of its own, since a sanitizer has to be there before all else."""
    law = ComputedTorque(puma560.literature_arm(1.5), RIG, bandwidth=60.0)
    law.start(RIG, (0, 0), guards=Guards(position=((-2, -2), (2, 2)), torque_rate=1e5)).to_c(
        tmp_path
    )
    (tmp_path / "main.c").write_text("""
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
""")
    flags = [
        "-std=c99",
        "-g",
        "-O1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        "-Werror",
        "-Wall",
    ]
    made = subprocess.run(
        [CC, *flags, "-o", tmp_path / "run", tmp_path / "main.c", tmp_path / "controller.c", "-lm"],
        capture_output=True,
        text=True,
    )
    if "sanitize" in made.stderr or "libasan" in made.stderr:
        pytest.skip("the compiler has no sanitizers")
    assert made.returncode == 0, made.stderr
    said = subprocess.run([tmp_path / "run"], capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert int(said.stdout) > 100


@cache
def unstable():
    """A law of 250 rad/s and the counts (N, 2) that it sees on gears of 100 Hz, without guards."""
    arm = puma560.literature_arm(1.5)
    law = ComputedTorque(arm, RIG, bandwidth=250)
    return law, closed(arm, elastic(arm, 100), law, PATH, samples=500, guards=None).counts


def made(folder, law, counts, motion, **options):
    """What the program that `Law.to_c` writes, made by its Makefile, gives for these counts, and
    what it says.
    """
    law.to_c(folder, RIG, **options)
    strict = "CFLAGS=-std=c99 -O2 -Wall -Wextra -Werror -pedantic -ffp-contract=off"
    subprocess.run([MAKE, strict], cwd=folder, check=True)
    np.savetxt(
        folder / "rows.csv",
        np.hstack([counts, *motion]),
        delimiter=",",
        fmt=["%d"] * 2 + ["%.17g"] * 6,
    )
    said = subprocess.run(
        [folder / "controller", folder / "rows.csv"], capture_output=True, text=True, check=True
    )
    return np.loadtxt(said.stdout.splitlines(), delimiter=","), said.stderr


@needs_make
@pytest.mark.parametrize(
    "options", [{}, {"chatter": None}, {"stop": "zero", "duration": 0.1}], ids=str
)
def test_the_program_stops_at_the_same_sample_and_gives_the_same_torques_from_then_on(
    tmp_path, options
):
    law, counts = unstable()
    guards, motion = (
        Guards(jump=np.inf, stuck=np.inf, error=np.inf, **options),
        PATH(np.arange(len(counts)) * DT),
    )
    torque, said = made(tmp_path, law, counts, motion, guards=guards)
    controller, stop = law.start(RIG, counts[0], guards=guards), None
    for k in range(len(counts)):
        expected = controller.step(counts[k], *(x[k] for x in motion))
        np.testing.assert_allclose(
            torque[k], expected, rtol=0, atol=ROUNDING * LIMIT.max(), err_msg=str(k)
        )
        stop = k + 1 if stop is None and controller.stopped else stop
    cause = memory.IS_SATURATED if options == {"chatter": None} else memory.CHATTERS
    assert said == f"safe stop in row {stop}: cause {cause} of controller.h\n"


@needs_make
def test_a_healthy_record_is_replayed_and_counts_of_a_converter_are_the_rounded_current(tmp_path):
    """Where the scaled current is within 1e-9 of a half, rounding may go either way."""
    law, scale = ComputedTorque(puma560.arm(), RIG), np.array([2500.0, -1234.5])
    record = simulate(puma560.arm(), RIG, law, PATH, duration=0.5)
    torque, said = made(tmp_path / "torque", law, record.counts, PATH(record.t))
    np.testing.assert_allclose(
        torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max()
    )
    assert said == ""
    counts, _ = made(
        tmp_path / "dac", law, record.counts, PATH(record.t), output="dac", counts_per_ampere=scale
    )
    exact = record.current * scale
    clear = np.abs(exact - np.floor(exact) - 0.5) > 1e-9
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(counts[clear], np.rint(exact)[clear])


def test_law_and_running_controller_write_the_same_files(tmp_path):
    law, guards = unstable()[0], Guards(stop="zero")
    law.to_c(tmp_path / "law", RIG, guards=guards)
    law.start(RIG, (0, 0), guards=guards).to_c(tmp_path / "running")
    for path in (tmp_path / "law").iterdir():
        assert path.read_bytes() == (tmp_path / "running" / path.name).read_bytes()
    with pytest.raises(ValueError, match=r"chatter must have shape \(2,\)"):
        law.to_c(tmp_path / "c", RIG, guards=Guards(chatter=(0.5, 0.5, 0.5)))
    pd = PD(gain=(0.1, 0.08), derivative=(1e-3, 8e-4), filter=2000.0, period=DT)
    with pytest.raises(ValueError, match="got 'gravity' for PD"):
        pd.to_c(tmp_path / "c", RIG, guards=Guards(stop="gravity"))
    assert not (tmp_path / "c").exists()


def test_a_law_without_a_period_and_a_bad_name(tmp_path):
    twin = InC(P(gain=(0.2, 0.15)).start(RIG, (0, 0)), tmp_path / "p", (0, 0))
    running = P(gain=(0.2, 0.15)).start(RIG, (0, 0))
    for k in range(100):
        given = ((k, -k), (0.001 * k, 0), (0.1, 0), (0, 0))
        np.testing.assert_allclose(
            twin.step(*given, now=1e-4 * k)[1], running.step(*given, now=1e-4 * k), rtol=1e-12
        )
    for name in ("No", "running"):  # the guards have functions of this name
        with pytest.raises(ValueError, match=f"name must .*; got '{name}'"):
            running.to_c(tmp_path / "no", name=name)
    assert not (tmp_path / "no").exists()
    (tmp_path / "p" / "arm.c").write_text("mine")
    with pytest.raises(ValueError, match="must not exist, or be an export of arm"):
        running.to_c(tmp_path / "p", name="arm")


@pytest.mark.parametrize(
    "text",
    ["x = {}", "while x:\n    x = 0", "x = a @ b", "x = pulses[1:2:3]", "x = sorted(pulses)"],
)
def test_what_it_does_not_know_is_refused(text):
    node = ast.parse(
        "def f(pulses):\n    'Say.'\n" + "\n".join(f"    {line}" for line in text.split("\n"))
    ).body[0]
    with pytest.raises(ValueError, match="must be numbers, arrays and branches"):
        CFunction(node, names_of("arm"))
