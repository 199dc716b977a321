"""What arms do all day, under the default controller: arms that exceed ±1 pulse, and torque chatter, motion by motion.

    python tests/benchmarks/everyday.py [--samples 300] [--logs 3] [--old FOLDER]

f and friction are identified from one log of the paper's arm (encoders that floor, as counters do, and the paper's), of
a two-joint arm with finer counts, and f alone with friction 10 % uncertain; arms are Monte Carlo samples of the
covariance. Whole PUMA 560 and UR5e: f 1 % and friction 5 % uncertain. A cell is the share of arms that exceed ±1 pulse
at any sample, in brackets after the first 0.3 s, and the median torque chatter of the worst joint (mean absolute change
from sample to sample) [N m]. With --old the same of another checkout, such as one of an earlier commit.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import warnings

import numpy as np

from ctc import ComputedTorque, Uncertainty, certify
from identification import IdentificationWarning, identify
from plant import (
    PID,
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    PointToPoint,
    Rig,
    puma560,
    read_robot,
    simulate,
)

BEGUN = 0.3
"""[s], until which a joint has left its rest in all these motions but the slowest."""


def motions(rig, at, far):
    """Name -> reference about a pose: joints alone, slowly, creeping, far and fast, ten pulses, there and back."""
    n, degree = rig.n, np.pi / 180
    pulse = np.abs(rig.to_angle(np.ones(n)))
    turns = np.where(np.arange(n) % 2, -1, 1)

    def move(by, duration):
        return PointToPoint(start=at, goal=at + by, duration=duration)

    alone = {f"joint {i + 1} alone": move(0.5 * np.eye(n)[i], 3.0) for i in range(n)[:2]}
    back = Harmonics(period=3.0, offset=at + 0.15, cosine=np.full((n, 1), -0.15), sine=np.zeros((n, 1)))
    return alone | {
        "slowly": move(0.3 * turns, 4.5), "creep": move(2 * degree * np.ones(n), 2.0),
        "far and fast": move(far * turns, 1.5), "ten pulses": move(10 * pulse * turns, 0.5), "there and back": back,
    }  # fmt: skip


def frictions(n):
    return [f"drive.{kind}[{joint}]" for kind in ("viscous", "coulomb") for joint in range(n)]


def paper(floor, seed, friction=True):
    """The paper's arm, identified from one log."""
    rig, dynamics = puma560.rig(), puma560.dynamics()
    rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, floor=floor))
    log = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference())
    unknown = [*dynamics.names, *(frictions(2) if friction else ())]
    return identify(dynamics, log, seed=seed, unknown=unknown, progress=False)


def geared():
    """An arm of two links with 60,000 counts per radian and more, under a PID, identified from one log."""
    drive = Drive(gear=(100, -80), motor_inertia=(1.2e-4, 8e-5), viscous=(6e-4, 5e-4), coulomb=(0.09, 0.06),
                  motor_gain=(0.15, 0.12), current_limit=(15, 12))  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4000, 4000), floor=True), period=1e-3)
    rotors = drive.reflected_inertia()
    bodies = [
        Body(mass=7, com=(0.2, 0.01, 0), inertia=(0, 0, 0, 0.10, 0, 0.10), rotor=rotors[0]),
        Body(mass=4, com=(0.175, 0.01, 0), inertia=(0, 0, 0, 0.04, 0, 0.04), rotor=rotors[1]),
    ]
    links = (Link(name="shoulder", alpha=np.pi / 2), Link(name="elbow", a=0.4))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(period=4.0, offset=(0.5, -0.6), cosine=((-0.5, -0.1), (0.4, -0.5)), sine=((0.3, 0.2), (-0.4, 0.3)))
    law = PID(gain=(0.03, 0.02), integral=(0.15, 0.1), derivative=(1e-4, 8e-5), filter=2000.0, period=1e-3)
    log = simulate(dynamics.arm(dynamics.f()), rig, law, path, steps_per_sample=16)
    return identify(dynamics, log, seed=1, unknown=[*dynamics.names, *frictions(2)], progress=False)


def cell(certificate):
    """Share that exceeds, share that does after the start, chatter."""
    runs = certificate.runs
    exceeds = np.asarray(runs.peak).max(axis=1) > 1
    late = exceeds & (np.asarray(runs.first) > BEGUN)
    return f"{exceeds.mean():.1%} ({late.mean():.1%}) {np.median(runs.chatter, axis=0).max():.2f}"


def row(name, paths, certified):
    print(f"| {name} | " + " | ".join(cell(certified(path)) for path in paths.values()) + " |", flush=True)


def table(samples, logs):
    """Print the tables."""
    paths = motions(puma560.rig(), np.array((-0.8, 0.9)), 1.2) | {"trajectory (6)": puma560.reference()}
    head = f"| arm and log | {' | '.join(paths)} |\n|{'---|' * (len(paths) + 1)}"
    print(head)
    found = {f"paper's, floor, log {seed}": paper(True, seed) for seed in range(1, logs + 1)}
    found["paper's rounding"] = paper(False, 1)
    found["f alone, friction ±10 %"] = paper(True, 1, friction=False)
    for name, each in found.items():
        law = ComputedTorque(each)
        row(name, paths, lambda path, f=each, law=law: certify(f, f.rig, law, path, samples=samples, progress=False))
    each = geared()
    law, own = ComputedTorque(each), motions(each.rig, np.array((0.1, -1.0)), 0.6)
    row("finer counts", own, lambda path: certify(each, each.rig, law, path, samples=samples, progress=False))
    print()
    for name, pose in (("puma560", (0.2, -0.8, 0.9, 0.3, 0.5, 0.2)), ("ur5e", (0.1, -1.2, 1.2, -0.9, 0.5, 0.3))):
        robot = read_robot(name)
        arm, rig = robot.arm, robot.rig
        f = arm.f * (1 + 0.01 * np.random.default_rng(0).standard_normal((64, len(arm.f))))
        law = ComputedTorque(arm, rig, bandwidth=min(140.0, 0.3 / rig.period))
        stated = Uncertainty(plants=f, friction=0.05)
        own = motions(rig, np.array(pose), 0.4)
        row(
            name, own, lambda path, a=arm, r=rig, w=law, u=stated: certify(a, r, w, path, u, samples=64, progress=False)
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--old", help="folder of another checkout, for the same table beside it")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", IdentificationWarning)
    table(chosen.samples, chosen.logs)
    if chosen.old:
        print(f"\n{chosen.old}:", flush=True)
        command = [sys.executable, __file__, "--samples", str(chosen.samples), "--logs", str(chosen.logs)]
        subprocess.run(command, env={**os.environ, "PYTHONPATH": chosen.old}, check=True)  # noqa: S603
