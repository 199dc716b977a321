"""What each way out to the machine agrees with, its size and time: ``python
tests/benchmarks/out_to_the_machine.py``.

One table for `docs/guides/out_to_the_machine.md`: computed torque of the PUMA 560, two joints. The
plugin and the FMUs run against what their tests run against; the microcontroller under QEMU, which
counts instructions and no time.
"""

import contextlib
import ctypes
import dataclasses
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles"), str(ROOT / "tests" / "plant" / "fmu")]

from ros2_control import over  # noqa: E402
from ros_controller import Controller  # noqa: E402
from test_fmu import Fmu, loop  # noqa: E402

from ctc import ComputedTorque, evaluate  # noqa: E402
from plant import (  # noqa: E402
    PointToPoint,
    puma560,
    simulate,
    to_fmu,
    to_ros2_control,
    write_replay,
)

ARM, RIG = puma560.arm(), puma560.rig()
LAW, PATH = ComputedTorque(ARM, RIG), puma560.reference()
KILLS = 30
MOVE = PointToPoint(start=(0.0, -0.5), goal=(1.0, 0.5), duration=1.4)


def run(folder, *command):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout  # noqa: S603


def c_code(folder, record):
    """Difference of the guarded C to `.step`, bytes of code, and time of a step [s]."""
    LAW.start(RIG, record.counts[0]).to_c(folder)
    run(
        folder,
        "cc",
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        "-o",
        "c.so",
        "controller.c",
        "-lm",
    )
    c, memory, torque = ctypes.CDLL(str(folder / "c.so")), np.zeros(4000), np.zeros(2)
    python, apart, times = LAW.start(RIG, record.counts[0]), 0.0, []

    def at(values):
        return values.ctypes.data_as(ctypes.c_void_p)

    counts = np.ascontiguousarray(record.counts, np.int32)
    c.controller_init(at(memory), at(counts[0]))
    for row, *motion in zip(counts, *record.reference(record.t), strict=True):
        given = [
            at(memory),
            at(row),
            *(at(np.ascontiguousarray(x)) for x in motion),
            ctypes.c_double(np.nan),
            at(torque),
        ]
        begun = time.perf_counter()
        c.controller_step(*given)
        times.append(time.perf_counter() - begun)
        apart = max(apart, np.abs(python.step(row, *motion) - torque).max())
    code = int(run(folder, "size", "c.so").splitlines()[1].split()[0])
    return apart / np.abs(record.torque).max(), code, statistics.median(times)


def plugin(folder):
    """Difference of the torque, bytes, and time of `update` [s] of the ROS 2 plugin."""
    to_ros2_control(LAW, folder)
    share, _, allocations, times = over(Controller(folder), LAW, MOVE)
    sizes = run(folder, "size", "c.o", "plugin.o").splitlines()[1:]
    return share, sum(int(line.split()[0]) for line in sizes), statistics.median(times), allocations


def fmus(folder, record):
    """Difference of the torque to `simulate`, counts that differ, bytes of each file, time of
    both steps [s].
    """
    to_fmu(LAW, folder / "law.fmu", version=3)
    to_fmu(ARM, folder / "arm.fmu", rig=RIG, version=3)
    both = [Fmu(folder / f"{each}.fmu", folder / each) for each in ("law", "arm")]
    begun = time.perf_counter()
    counts, torque = loop(*both, record, folder)
    spent = (time.perf_counter() - begun) / len(counts)
    apart = np.abs(torque - record.torque).max() / np.abs(record.torque).max()
    return (
        apart,
        int((counts != record.counts).sum()),
        [(folder / f"{e}.fmu").stat().st_size for e in ("law", "arm")],
        spent,
    )


def microcontroller(folder, record):
    """Lines that differ from the host's, bytes of code, and instructions of a step of a
    Cortex-M7 in double.
    """
    LAW.start(RIG, record.counts[0]).to_c(folder, target="cortex-m7")
    write_replay(record, folder / "record.csv")
    run(folder, "make", "controller.elf")
    board = run(folder, "make", "-s", "run").split()
    run(
        folder,
        "cc",
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-o",
        "host",
        "main.c",
        "controller.c",
        "-lm",
    )
    host = run(folder, "./host", "record.csv").split()
    code = int(run(folder, "make", "-s", "size").splitlines()[1].split()[0])
    return (
        sum(a != b for a, b in zip(board, host, strict=True)),
        len(host),
        code,
        run(folder, "make", "-s", "instructions").split()[0],
    )


def mcap(folder, record):
    """Median time [s] that logging adds to a step, bytes of a sample, kills, and files that they
    left without index.
    """
    motion, median, path = record.reference(record.t), [], folder / "run.mcap"
    for logs in (False, True):
        controller, times = LAW.start(RIG, record.counts[0]), []
        log = controller.log_to(path) if logs else contextlib.nullcontext()
        with log:
            for k in range(len(record)):
                begun = time.perf_counter()
                controller.step(record.counts[k], motion.q[k], motion.qd[k], motion.qdd[k])
                times.append(time.perf_counter() - begun)
        median.append(statistics.median(times))
    size, broken, random = path.stat().st_size / len(record), 0, np.random.default_rng(0)
    script = ROOT / "tests" / "oracles" / "logged_run.py"
    for kill in range(KILLS):
        path = folder / f"{kill}.mcap"
        with subprocess.Popen([sys.executable, script, path], stdout=subprocess.PIPE) as process:  # noqa: S603
            process.stdout.readline()
            time.sleep(random.uniform(0.2, 1.0))
            process.kill()
        with path.open("rb") as file:
            try:
                broken += not sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
            except McapError:
                broken += 1
    return median[1] - median[0], size, KILLS, broken


def steps():
    """Largest error of the joints [pulses] on (6), for steps of no, 1 / 1000 and 1 / 100 of the
    rated torque.
    """
    rated = RIG.drive.motor_gain * RIG.drive.current_limit / 3
    for share in (None, 1e-3, 1e-2):
        drive = dataclasses.replace(RIG.drive, torque_step=None if share is None else share * rated)
        rig = dataclasses.replace(RIG, drive=drive)
        yield share, evaluate(ARM, rig, ComputedTorque(ARM, rig), PATH).max_true_error_pulses


def main():
    record = simulate(ARM, RIG, LAW, PATH)
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / part for part in ("c", "ros2", "fmu", "board", "mcap")]
        for each in folders:
            each.mkdir()
        share, code, spent = c_code(folders[0], record)
        print(
            f"guarded C: {share:.1e} of the largest torque, {code:,} bytes, {1e6 * spent:.1f} us",
            flush=True,
        )
        share, code, spent, allocations = plugin(folders[1])
        print(
            f"plugin: {share:.1e}, {code:,} bytes, {1e6 * spent:.1f} us, {allocations} allocations",
            flush=True,
        )
        share, differing, sizes, spent = fmus(folders[2], record)
        print(
            f"FMUs: {share:.1e}, {differing} counts differ, {sizes} bytes, {1e6 * spent:.0f} us for"
            " both",
            flush=True,
        )
        spent, size, kills, broken = mcap(folders[4], record)
        said = (
            f"{1e6 * spent:.0f} us more, {size:.0f} bytes a sample, {broken} of {kills} kills left"
            " no index"
        )
        print(f"MCAP: {said}", flush=True)
        if shutil.which("qemu-system-arm") and shutil.which("arm-none-eabi-gcc"):
            short = simulate(ARM, RIG, LAW, PATH, duration=200 * RIG.period)
            differing, lines, code, count = microcontroller(folders[3], short)
            print(
                f"cortex-m7: {differing} of {lines} numbers differ, {code:,} bytes, {count}"
                " instructions",
                flush=True,
            )
    for share, errors in steps():
        print(f"torque step {share}: {np.round(errors, 2)} pulses", flush=True)


if __name__ == "__main__":
    main()
