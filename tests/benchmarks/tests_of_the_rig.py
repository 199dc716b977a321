"""Processor time of `identify`, over that of its search alone, in two trees in turns.

    python tests/benchmarks/tests_of_the_rig.py [--old FOLDER] [--joints 6] [--rounds 3]

A right log of a PUMA 560 (6 joints; 7: with one more in the wrist) under P control, 10 s, all of f
unknown. What is not the search is the preparation, the tests for what the rig may lack, and the
warnings. Each round is a process of its own with a warm cache of kernels, old and new in turns. The
bits of f and of the standard deviations are printed as hashes: they must not differ between trees.
"""

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from waiting import SECONDS, wrist

ROOT = Path(__file__).parents[2]


def hashed(array):
    """The first digits of a hash of the bits of an array."""
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:10]


def child(log, joints):
    """Print seconds of the search and of all, and the hashes of f and of its deviations."""
    from identification import identify, procedure
    from plant import Record

    spent = []
    search = procedure.search

    def timed(problem):
        started = time.process_time()
        outcome = search(problem)
        spent.append(time.process_time() - started)
        return outcome

    procedure.search = timed
    arm, rig, law, _ = wrist(joints)
    record = Record.from_csv(log, rig=rig, law=law)
    # The second call has its kernels and its path in memory.
    for _ in range(2):
        started = time.process_time()
        found = identify(arm.dynamics, record, progress=False)
        total = time.process_time() - started
    print(spent[-1], total, hashed(found.f), hashed(found.fit.std))


def main():
    """Print a row per tree: the median of its rounds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--old", type=Path, help="another checkout")
    parser.add_argument("--joints", type=int, default=6, choices=(6, 7))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(options.child, options.joints)
        return
    from plant import simulate

    trees = ({"old": options.old.resolve()} if options.old else {}) | {"new": ROOT}
    rows = {name: [] for name in trees}
    with tempfile.TemporaryDirectory() as folder:
        log = str(Path(folder, "log.csv"))
        arm, rig, law, path = wrist(options.joints)
        simulate(arm, rig, law, path, duration=SECONDS, steps_per_sample=16).to_csv(log)
        for _ in range(options.rounds):
            for name, tree in trees.items():
                environment = {**os.environ, "PYTHONPATH": str(tree)}
                command = [sys.executable, "-P", __file__, "--child", log]
                command += ["--joints", str(options.joints)]
                answer = subprocess.run(  # noqa: S603
                    command, capture_output=True, text=True, env=environment, check=True
                )
                rows[name].append(answer.stdout.split())
    print("| tree | search [s] | all [s] | all / search | f | std |\n|---|---|---|---|---|---|")
    for name, rounds in rows.items():
        search, total = np.array([row[:2] for row in rounds], float).T
        bits = [" ".join(sorted({row[i] for row in rounds})) for i in (2, 3)]
        print(
            f"| {name} | {np.median(search):.2f} | {np.median(total):.2f} |"
            f" {np.median(total / search):.2f} | {' | '.join(bits)} |"
        )


if __name__ == "__main__":
    main()
