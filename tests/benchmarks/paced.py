"""How late the steps of a paced loop begin: the exported C, and `.step` from Python with its
garbage collection frozen.

    python tests/benchmarks/paced.py [--seconds 600]

Both run at 0.7 ms over trajectory (6), each step begun at its own absolute instant
(clock_nanosleep), with nothing beside them and with a loop that never rests on every other core.
Late is a step that ends after its period. Of the others the jitter printed is half of what lies
between the earliest and the latest beginning, as a share of the period: what
``Uncertainty(jitter=...)`` takes; a late step is a lost sample (`plant.Transport`).
"""

import argparse
import contextlib
import ctypes
import gc
import multiprocessing
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from plant import puma560, simulate, write_replay

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW = ComputedTorque(ARM, RIG)
MONOTONIC, ABSOLUTE = 1, 1
PERIOD = round(1e9 * RIG.period)


class Instant(ctypes.Structure):
    """A timespec of C."""

    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout  # noqa: S603


def in_python(record, seconds):
    """The same loop by `.step`."""
    motion, counts = record.reference(record.t), record.counts.astype(float)
    steps, sleep = int(seconds / RIG.period), ctypes.CDLL(None).clock_nanosleep
    delays, taken, at = np.empty(steps), np.empty(steps), Instant()
    controller = LAW.start(RIG, counts[0])
    controller.step(counts[0], motion.q[0], motion.qd[0], motion.qdd[0])
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80))
    gc.collect()
    gc.freeze()
    gc.disable()
    start = time.monotonic_ns() + 10 * PERIOD
    for k in range(steps):
        due, row = start + k * PERIOD, k % len(counts)
        at.seconds, at.nanoseconds = divmod(due, 1_000_000_000)
        sleep(MONOTONIC, ABSOLUTE, ctypes.byref(at), None)
        woke = time.monotonic_ns()
        if not row:
            controller.reset(counts[0])
        controller.step(counts[row], motion.q[row], motion.qd[row], motion.qdd[row])
        delays[k], taken[k] = woke - due, time.monotonic_ns() - woke
    gc.enable()
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    bins = np.maximum(np.ceil(np.log2(np.maximum(delays, 1) / 1e3 * (1 + 1e-12))), 0).astype(int)
    lines = [
        f"begun less than {1 << bin} us late: {(bins == bin).sum()}" for bin in sorted(set(bins))
    ]
    lines.append(f"longest step: {taken.max() / 1e3:.1f} us")
    late = delays + taken > PERIOD
    lines.append(f"late steps: {late.sum()} of {steps}")
    lines.append(f"of the others jitter={np.ptp(delays[~late]) / 2 / PERIOD:.4f}")
    return "\n".join(lines) + "\n"


def restless():
    while True:
        pass


@contextlib.contextmanager
def busy(cores):
    others = [multiprocessing.Process(target=restless, daemon=True) for _ in range(cores)]
    for each in others:
        each.start()
    yield
    for each in others:
        each.terminate()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=600.0)
    seconds = parser.parse_args().seconds
    record = simulate(ARM, RIG, LAW, PATH)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        LAW.start(RIG, record.counts[0]).to_c(folder)
        write_replay(record, folder / "record.csv")
        run(["make", "-s"], folder)
        paced = ["./controller", "--paced", str(seconds), "record.csv"]
        for cores in (0, os.cpu_count() - 1):
            with busy(cores):
                print(f"== C, {cores} other cores busy\n{run(paced, folder)}", flush=True)
                print(
                    f"== Python, {cores} other cores busy\n{in_python(record, seconds)}", flush=True
                )
