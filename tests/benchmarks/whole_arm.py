"""A whole PUMA 560, forty parameters, one log of 4 s: what identification and certificate take,
also in another tree.

    python tests/benchmarks/whole_arm.py [--rounds 3] [--old FOLDER]

Each identification runs in a process of its own: with an empty cache of kernels, with a filled one,
and once more in the same process. With --old the same runs in another checkout, in turns. The arm
with seven joints has one more in the wrist. Errors are in standard deviations of the noise alone,
rms over all parameters.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
PLANTS = 1200
"""Of the certificate whose time is measured; that of 10,000 is told."""


def experiment(n):
    """The arm, its rig, a path on which all of it shows, and a log under P control."""
    from plant import (
        Chain,
        Drive,
        Dynamics,
        Encoder,
        Harmonics,
        Link,
        Rig,
        p_gains,
        read_robot,
        simulate,
    )

    robot = read_robot("puma560")
    chain, rig = robot.dynamics.chain, robot.rig
    if n > 6:  # another wrist joint, between the fifth and the sixth
        extra = Link(name="5b", alpha=-np.pi / 2, d=0.1, frame=chain.links[4].frame)
        links = (*chain.links[:5], extra, chain.links[5])
        chain = Chain(links=links, bodies=(*chain.bodies[:5], *chain.bodies[4:]))
        pick = [0, 1, 2, 3, 4, 4, 5]
        names = ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
        drive = Drive(**{name: getattr(rig.drive, name)[pick] for name in names})
        rig = Rig(
            drive=drive, encoder=Encoder(resolution=rig.encoder.resolution[pick]), period=rig.period
        )
    dynamics = Dynamics.from_chain(chain)
    cosine, sine = np.random.default_rng(1).uniform(-0.4, 0.4, (2, n, 4)) / np.arange(1, 5)
    path = Harmonics(period=4.0, offset=(0, -0.5, 0.5, 0, 0.3, 0, 0)[:n], cosine=cosine, sine=sine)
    arm = dynamics.arm(dynamics.f())
    return arm, rig, path, simulate(arm, rig, p_gains(arm, rig, path, peak=12), path)


def one(n):
    """Seconds of a first and of a second identification, error, seconds of a certificate of
    10,000 loops.
    """
    from ctc import ComputedTorque, Uncertainty, certify
    from identification import identify

    arm, rig, path, log = experiment(n)
    seconds = []
    for _ in range(2):
        started = time.perf_counter()
        found = identify(arm.dynamics, log, seed=1, progress=False)
        seconds.append(time.perf_counter() - started)
    error = np.sqrt(np.mean(((found.f - arm.f) / found.fit.std) ** 2))
    law, doubt = ComputedTorque(arm, rig), np.diag((0.002 * np.abs(arm.f) + 1e-6) ** 2)
    given = {"uncertainty": Uncertainty(covariance=doubt), "samples": PLANTS, "progress": False}
    certify(arm, rig, law, path, **given)
    started = time.perf_counter()
    certify(arm, rig, law, path, **given)
    print(len(log), *seconds, error, (time.perf_counter() - started) * 10_000 / PLANTS)


def child(tree, n, cache):
    """The numbers of `one` in a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "ONEPULSE_CACHE": cache}
    command = [sys.executable, __file__, "--one", str(n)]
    # this file
    answer = subprocess.run(  # noqa: S603
        command, stdout=subprocess.PIPE, text=True, check=True, env=environment, cwd=tree
    )
    return [float(each) for each in answer.stdout.split()[-5:]]


def main():
    """Print a table, a row per tree and number of joints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--old", type=Path, help="another checkout")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(options.one)
        return
    trees = {"this": ROOT} | ({"old": options.old.resolve()} if options.old else {})
    print(
        "| tree | joints | samples | identify, no kernels [s] | kernels [s] | again [s] | error |"
        " certify 10,000 [s] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for n in (6, 7):
        runs = {name: {"empty": [], "filled": []} for name in trees}
        for _ in range(options.rounds):
            for name, tree in trees.items():
                with tempfile.TemporaryDirectory() as cache:
                    runs[name]["empty"].append(child(tree, n, cache))
                    runs[name]["filled"].append(child(tree, n, cache))
        for name, both in runs.items():
            empty = statistics.median(run[1] for run in both["empty"])
            filled = [statistics.median(column) for column in zip(*both["filled"], strict=True)]
            samples, first, again, error, certified = filled
            print(
                f"| {name} | {n} | {samples:.0f} | {empty:.1f} | {first:.1f} | {again:.1f} |"
                f" {error:.2f} | {certified:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
