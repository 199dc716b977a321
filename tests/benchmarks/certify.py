"""Probability of leaving a pulse limit: what 10,000 closed loops cost, and whether brute force says
the same.

    python tests/benchmarks/certify.py [--samples 10000] [--brute 2000]

The time is that of trajectory (6), T = 3.65 s, under the default computed torque, drawing included.
Brute force draws by other code with another seed and runs one `simulate` after the other, on a case
that fails one time in ten: the joint starts up to half a pulse off its reference. First, the same
log with friction identified too: how many samples exceed the limit under the default, at 150 rad/s,
and there without a dead zone.
"""

import argparse
import dataclasses
import statistics
import time

import numpy as np

from ctc import ComputedTorque, Uncertainty, certify
from ctc.certification import clopper_pearson
from identification import identify
from plant import Phase, puma560, simulate


def main():
    """Print both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--brute", type=int, default=2000)
    options = parser.parse_args()
    robot, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    measured = simulate(robot, rig, puma560.p_law(), path, steps_per_sample=16)
    found = identify(puma560.dynamics(), measured, seed=1, progress=False)
    rubbed = identify(puma560.dynamics(), measured, unknown="friction", seed=1, progress=False)
    for settings in ({}, {"bandwidth": 150.0}, {"bandwidth": 150.0, "dead_zone": 0.0}):
        known = certify(
            rubbed, rubbed.rig, ComputedTorque(rubbed, **settings), path, samples=options.samples
        )
        print(
            f"friction identified, {settings}: {known.failures} of {options.samples} exceed, at"
            f" most {known.upper:.2%}"
        )
    law = ComputedTorque(found)

    everything = Uncertainty(
        load=(0, 0.5), load_position=(0, -0.55, 0), delay=(0, 1e-4), dropped=1e-3
    )
    print(
        "| drawn | sub-steps | loops | first [s] | warm, median of 3 [s] | ms and core per loop |"
    )
    print("|---|---|---|---|---|---|")
    for name, drawn in (("f, friction, phase", None), ("and load, delay, lost counts", everything)):
        for steps in (4, 16):
            seconds = []
            for _ in range(4):
                certificate = certify(
                    found, rig, law, path, drawn, samples=options.samples, steps_per_sample=steps
                )
                seconds.append(certificate.seconds)
            warm = statistics.median(seconds[1:])
            per_loop = 1e3 * warm * certificate.threads / options.samples
            print(
                f"| {name} | {steps} | {options.samples} | {seconds[0]:.1f} | {warm:.2f} |"
                f" {per_loop:.2f} |"
            )

    certificate = certify(found, rig, law, path, samples=options.samples)
    print(f"\n{certificate}\n")
    random, failures, started = np.random.default_rng(2026), 0, time.perf_counter()
    for _ in range(options.brute):
        f = random.multivariate_normal(found.fit.values, found.covariance)
        factor = 1 + 0.1 * random.normal(size=(2, 2))
        friction = {
            "viscous": rig.drive.viscous * factor[0],
            "coulomb": rig.drive.coulomb * factor[1],
        }
        phase = Phase(shift=random.uniform(-0.5, 0.5, 2))
        other = dataclasses.replace(
            rig,
            drive=dataclasses.replace(rig.drive, **friction),
            encoder=dataclasses.replace(rig.encoder, phase=phase),
        )
        record = simulate(puma560.dynamics().arm(f), other, law, path, steps_per_sample=16)
        failures += bool(np.abs(record.error_pulses).max() > 1)
    seconds = time.perf_counter() - started
    low, high = clopper_pearson(failures, options.brute)
    print(
        f"brute force: {failures} of {options.brute}, {failures / options.brute:.2%} ({low:.2%} to"
        f" {high:.2%}), {seconds:.0f} s, {1e3 * seconds / options.brute:.0f} ms each"
    )
    low, high = certificate.interval
    print(
        f"certify:     {certificate.probability:.2%} ({low:.2%} to {high:.2%}),"
        f" {certificate.seconds:.1f} s"
    )


if __name__ == "__main__":
    main()
