"""What an identification of a long log takes: time per sample, and memory, beside a short one.

    python tests/benchmarks/long_log.py [--samples 5215 100000 1000000] [--law P PID] [--other TREE]

The arm is the paper's on trajectory (6) again and again, under P control with its reference known,
or under a PID whose log begins in the middle of a motion and holds counts alone: no torque, no
reference. Each log is identified in a process of its own, with kernels built; `--other` does the
same with another tree of this project, in turn. Memory is the most that the process holds while it
identifies, less what it holds after the packages are imported; the log, at 100 bytes a sample, is
in it, its simulation is not. Time is that of the processor, which other work disturbs less, and of
the clock.
"""

import argparse
import ctypes
import dataclasses
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from identification import identify
from plant import PID, puma560, simulate

CUT = 0.437  # [s] before which the PID's log is thrown away


def held():
    """Memory of this process now [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def logged(law, samples):
    """The arm, and so many samples of its log under one of the two laws."""
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    if law == "P":
        return arm, simulate(
            arm,
            rig,
            puma560.p_law((0.1, 0.08)),
            path,
            duration=samples * rig.period,
            steps_per_sample=16,
        )
    pid = PID(
        gain=(0.1, 0.075),
        derivative=(4e-4, 3e-4),
        filter=3000.0,
        integral=(0.5, 0.4),
        period=rig.period,
    )
    whole = simulate(arm, rig, pid, path, duration=CUT + samples * rig.period)
    return arm, dataclasses.replace(
        whole, torque=None, true_q=None, true_qd=None, reference=None
    ).cut(CUT)


def identified(law, samples):
    """Seconds (processor, clock), peak memory [bytes], largest error in standard deviations, of
    one identification.
    """
    arm, short = logged(law, 1000)
    identify(arm.dynamics, short, progress=False)
    before = held()
    arm, log = logged(law, samples)
    ctypes.CDLL(None).malloc_trim(0)  # what the simulation has left free
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    started = time.process_time(), time.perf_counter()
    found = identify(arm.dynamics, log, seed=1, progress=False)
    took = time.process_time() - started[0], time.perf_counter() - started[1]
    peak = (
        1024 * int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) - before
    )
    return *took, peak, abs((found.f - arm.f) / found.fit.std).max()


def main():
    """Print a table, a row per law, length and tree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, nargs="+", default=[5215, 100_000, 1_000_000])
    parser.add_argument("--law", nargs="+", choices=["P", "PID"], default=["P"])
    parser.add_argument("--other", type=Path, help="another tree of this project, to compare with")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(*identified(options.one[0], int(options.one[1])))
        return
    own = Path(__file__).resolve().parents[2]
    print(
        "| law | tree | samples | processor [s] | clock [s] | memory [GB] | kB per sample | largest"
        " error / std |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for law in options.law:
        for samples in options.samples:
            for tree in filter(None, (options.other, own)):
                command = [sys.executable, __file__, "--one", law, str(samples)]
                there = {**os.environ, "PYTHONPATH": str(tree)}
                answer = subprocess.run(  # noqa: S603
                    command, capture_output=True, text=True, check=True, env=there
                )
                used, seconds, peak, error = map(float, answer.stdout.split()[-4:])
                print(
                    f"| {law} | {'this' if tree == own else 'other'} | {samples:,} | {used:.1f} |"
                    f" {seconds:.1f} | {peak / 1e9:.2f} | {peak / samples / 1e3:.1f} |"
                    f" {error:.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
