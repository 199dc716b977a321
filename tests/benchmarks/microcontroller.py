"""A guarded controller on Cortex-M7 and M4F: code, state, stack, instructions of a step, bits; and
what single costs.

    python tests/benchmarks/microcontroller.py

Computed torque of two, six and seven joints of the PUMA 560 (its wrist has one more for seven),
compiled by the exported Makefile, run in QEMU, whose counted instructions are no time. Then the
everyday motions of the paper's arm, each in a closed loop at the controller in single precision:
how far its torque is from that in double at the same counts, and the largest errors of both loops
in pulses.
"""

import ctypes
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from growth import experiment

from ctc import ComputedTorque
from plant import Harmonics, SteppedArm, everyday_motions, puma560, simulate, write_replay

ROWS = 200


def run(folder, *command):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout  # noqa: S603


def sizes(n):
    """One line per target and precision."""
    arm, record = experiment(n, 3)
    law = ComputedTorque(arm, record.rig, bandwidth=100.0)
    path = Harmonics(period=4.0, offset=(0.0,) * n, cosine=((0.3,),) * n, sine=((0.0,),) * n)
    record = simulate(arm, record.rig, law, path, duration=ROWS * record.rig.period)
    running = law.start(record.rig, record.counts[0])
    for target in ("cortex-m7", "cortex-m4f"):
        for precision in ("double", "single"):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                running.to_c(folder, target=target, precision=precision)
                write_replay(record, folder / "record.csv")
                run(folder, "make", "controller.elf")
                code = int(run(folder, "make", "-s", "size").splitlines()[1].split()[0])
                stack = re.search(r"controller_step: (\d+)", run(folder, "make", "-s", "stack"))[1]
                state = len(running.core.memory) * (8 if precision == "double" else 4)
                count = float(run(folder, "make", "-s", "instructions").split()[0])
                board = run(folder, "make", "-s", "run")
                flags = ("-std=c99", "-O2", "-ffp-contract=off")
                run(folder, "cc", *flags, "-o", "host", "main.c", "controller.c", "-lm")
                one, other = (
                    np.array(x.split()) for x in (board, run(folder, "./host", "record.csv"))
                )
                words = (
                    "all"
                    if (one == other).all()
                    else f"all but {(one != other).sum()} of {len(one)} lines"
                )
            print(
                f"| {n} | {target} | {precision} | {code:,} | {state:,} | {stack} | {count:,.0f} |"
                f" {words} |",
                flush=True,
            )


class Single:
    """A controller in single precision on this machine."""

    def __init__(self, running, folder, counts):
        running.to_c(folder, precision="single")
        flags = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
        run(folder, "cc", *flags, "-o", "single.so", "controller.c", "-lm")
        self.c, self.memory = (
            ctypes.CDLL(str(folder / "single.so")),
            np.zeros(len(running.core.memory) + 3, np.float32),
        )
        self.counts, self.torque = np.array(counts, np.int32), np.zeros(running.n, np.float32)
        self.c.controller_init(self.at(self.memory), self.at(self.counts))

    @staticmethod
    def at(array):
        return array.ctypes.data_as(ctypes.c_void_p)

    def step(self, counts, *motion):
        self.counts[:] = counts
        rows = [np.ascontiguousarray(x, np.float32) for x in motion]
        given = [self.at(x) for x in (self.memory, self.counts, *rows, self.torque)]
        if self.c.controller_step(*given):
            raise RuntimeError("every call must be answered")
        return self.torque.astype(float)

    @property
    def stopped(self):
        return self.c.controller_stopped(self.at(self.memory))


def loop(arm, rig, law, path, steps, single=None):
    """Largest error [pulses] of a loop; with a controller in single precision in it also its
    torque's [N m].
    """
    t = np.arange(steps) * rig.period
    motion = path(t)
    robot = SteppedArm(arm, rig, motion.q[0], motion.qd[0])
    running, other = law.start(rig, robot.pulses), None
    if single is not None:
        other = Single(running, single, robot.pulses)
    error, apart = np.zeros(rig.n), 0.0
    for k in range(steps):
        counts, now = robot.pulses, (motion.q[k], motion.qd[k], motion.qdd[k])
        error = np.maximum(error, np.abs(rig.counts(motion.q[k]) - counts))
        torque = running.step(counts, *now)
        if other is not None:
            torque, exact = other.step(counts, *now), torque
            apart = max(apart, np.abs(torque - exact).max())
        robot.step(torque)
    stopped = running.stopped or (other is not None and other.stopped)
    return error, apart, stopped


def errors():
    """One line per motion."""
    arm, rig = puma560.arm(), puma560.rig()
    law = ComputedTorque(arm, rig)
    for name, path in everyday_motions(arm, rig).items():
        steps = min(int(path.duration / rig.period), 6000)
        with tempfile.TemporaryDirectory() as folder:
            single, apart, stopped = loop(arm, rig, law, path, steps, Path(folder))
        double, _, _ = loop(arm, rig, law, path, steps)
        pulses = " / ".join(f"{max(x):.0f}" for x in (single, double))
        print(f"| {name} | {apart:.1e} | {pulses} |{' stopped' if stopped else ''}", flush=True)


if __name__ == "__main__":
    print(
        "| joints | target | precision | code | state | stack | instructions per step | bits of the"
        " host |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for n in (2, 6, 7):
        sizes(n)
    print(
        "\n| motion | torque of single apart [N m] | largest error, single / double [pulses]"
        " |\n|---|---|---|"
    )
    errors()
