"""What an identification of a long log takes: time per sample, and memory, beside a short one.

    python tests/benchmarks/long_log.py [--samples 5215 100000 1000000]

The arm is the paper's under P control, on trajectory (6) again and again; each log is identified in a process of its
own, with kernels built. Memory is the most that the process has held, less what it holds after the packages are
imported; the log itself, at 100 bytes a sample, and what its simulation needs are in it.
"""

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

from identification import identify
from plant import puma560, simulate


def held():
    """Memory of this process now [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def identified(samples):
    """Seconds, peak memory [bytes] and the largest error, in standard deviations, of one identification."""
    arm, rig, law, path = puma560.literature_arm(1.5), puma560.rig(), puma560.p_law((0.1, 0.08)), puma560.reference()
    identify(arm.dynamics, simulate(arm, rig, law, path, duration=0.5), progress=False)
    before = held()
    log = simulate(arm, rig, law, path, duration=samples * rig.period, steps_per_sample=16)
    started = time.perf_counter()
    found = identify(arm.dynamics, log, seed=1, progress=False)
    seconds = time.perf_counter() - started
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return seconds, peak, abs((found.f - arm.f) / found.fit.std).max()


def main():
    """Print a table, a row per length."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, nargs="+", default=[5215, 100_000, 1_000_000])
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(*identified(options.one))
        return
    print("| samples | time [s] | per sample, first row as 1 | memory [GB] | kB per sample | largest error / std |")
    print("|---|---|---|---|---|---|")
    first = None
    for samples in options.samples:
        command = [sys.executable, __file__, "--one", str(samples)]
        answer = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - this file
        seconds, peak, error = map(float, answer.stdout.split()[-3:])
        first = first or seconds / samples
        print(
            f"| {samples:,} | {seconds:.1f} | {seconds / samples / first:.2f} | {peak / 1e9:.2f} | "
            f"{peak / samples / 1e3:.1f} | {error:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
