"""How long one step of a running controller takes, from Python and inside a loop that numba
compiles.

    python tests/benchmarks/step.py

Medians over single calls from Python (less what the clock itself takes), and over loops of a
thousand in numba; all variants take turns, so that a noisy machine disturbs them alike.
"""

import statistics
import time

import numba
import numpy as np

from ctc import ComputedTorque
from plant import puma560

SAMPLES, ROUNDS = 1000, 5


def experiment():
    """Counts (N, 2) that follow trajectory (6) with errors of up to a pulse, and its motion."""
    motion = puma560.reference()(np.arange(SAMPLES) * puma560.rig().period)
    error = np.random.default_rng(0).integers(-1, 2, (SAMPLES, 2))
    return puma560.rig().counts(motion.q) + error, motion


@numba.njit
def all_steps(step, memory, counts, q, qd, qdd, torque):
    """A thousand samples."""
    for k in range(len(counts)):
        if step(counts[k], q[k], qd[k], qdd[k], np.nan, memory, torque):
            return k
    return len(counts)


def from_python(running, rows, clocked):
    """Microseconds of each call."""
    spent, clock = [], time.perf_counter_ns
    for row in rows:
        if clocked:
            now = time.perf_counter()
            begun = clock()
            running.step(*row, now=now)
        else:
            begun = clock()
            running.step(*row)
        spent.append((clock() - begun) / 1e3)
    return spent


def main():
    """Measure and print."""
    rig, (counts, motion) = puma560.rig(), experiment()
    laws = {"P": puma560.p_law(), "ComputedTorque": ComputedTorque(puma560.arm(), rig)}
    rows = {
        "arrays": [(counts[k], *(x[k] for x in motion)) for k in range(SAMPLES)],
        "lists": [(counts[k].tolist(), *(x[k].tolist() for x in motion)) for k in range(SAMPLES)],
    }
    spent, torque = {}, np.empty(2)
    for _ in range(ROUNDS):
        empty = [-(time.perf_counter_ns() - time.perf_counter_ns()) / 1e3 for _ in range(SAMPLES)]
        clock = statistics.median(empty)
        for name, law in laws.items():
            for options in ({}, {"guards": None}):
                guards = "off" if options else "on"
                for kind, those in rows.items():
                    running = law.start(rig, counts[0], **options)
                    times = [t - clock for t in from_python(running, those, clocked=False)]
                    spent.setdefault((name, guards, f"Python, {kind}"), []).extend(times)
                    if running.status != "running":
                        raise RuntimeError(running.status)
                core = law.start(rig, counts[0], **options).core
                begun = time.perf_counter()
                done = all_steps(core.step, core.memory, counts, *motion, torque)
                spent.setdefault((name, guards, "numba"), []).append(
                    (time.perf_counter() - begun) / done * 1e6
                )
            times = from_python(law.start(rig, counts[0]), rows["arrays"], clocked=True)
            spent.setdefault((name, "on, with a clock", "Python, arrays"), []).extend(
                t - clock for t in times
            )
    print("| law | guards | called from | median [us] | 99 of 100 below [us] |")
    print("|---|---|---|---|---|")
    for (name, guards, where), times in spent.items():
        times = times[1:] if where == "numba" else times  # the first one compiles
        print(
            f"| {name} | {guards} | {where} | {statistics.median(times):.2f} |"
            f" {np.quantile(times, 0.99):.2f} |"
        )


if __name__ == "__main__":
    main()
