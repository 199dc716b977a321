"""What arms do all day, under the default controller: arms that exceed ±1 pulse, and torque
chatter, motion by motion.

    python tests/benchmarks/everyday.py [--samples 300] [--logs 3] [--old FOLDER]
    python tests/benchmarks/everyday.py --one-log
    python tests/benchmarks/everyday.py --mujoco 10 [--hz 60]
    python tests/benchmarks/everyday.py --friction
    python tests/benchmarks/everyday.py --machines

The motions are those of `plant.everyday_motions`; of the paper's arm trajectory (6), too. The
second command prints the table of the everyday motions in docs/results.md, with one log and 300
samples.

f and friction are identified from one log of the paper's arm (encoders that floor, as counters do,
and the paper's), of a two-joint arm with finer counts, and f alone with friction 10 % uncertain;
arms are Monte Carlo samples of the covariance. Whole PUMA 560 and UR5e: f 1 % and friction 5 %
uncertain. A cell is the share of arms that exceed ±1 pulse at any sample, in brackets after the
first 0.3 s, and the median torque chatter of the worst joint (mean absolute change from sample to
sample) [N m]. With --old the same of another checkout that has `everyday_motions`.

With --mujoco the paper's arm with 1.5 kg in another engine, on gears of 400 Hz (for rigid ones) to
15 Hz, damping ratio 0.02: f and friction identified from one P log of that engine on 400 Hz, or
from one on these gears, and the gears, too; so many runs, each with other zeros of the encoders. A
cell is the runs that stay within ±1 pulse, the share of samples that do, the largest error, and the
mean torque chatter of the worst joint [N m]. With --friction the friction that the controller
believes is off: arms that exceed ±1 pulse in the first, the second and the fourth period. With
--machines the first table for other encoders and periods, one sample of delay, jitter of 10 %, and
an arm of seven joints.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from ctc import ComputedTorque, Uncertainty, certify
from identification import IdentificationWarning, identify
from plant import (
    PID,
    Body,
    Chain,
    Drive,
    Dynamics,
    Elasticity,
    Encoder,
    Harmonics,
    Link,
    Rig,
    everyday_motions,
    puma560,
    read_robot,
    simulate,
)

BEGUN = 0.3
"""[s], until which a joint has left its rest in all these motions but the slowest."""


def frictions(n):
    return [f"drive.{kind}[{joint}]" for kind in ("viscous", "coulomb") for joint in range(n)]


def paper(floor, seed, friction=True, period=None, counts=None):
    """The paper's arm, identified from one log; `counts` per turn of the motor in place of its
    own.
    """
    rig, dynamics, law = puma560.rig(), puma560.dynamics(), puma560.p_law()
    encoder = dataclasses.replace(rig.encoder, rounding="floor" if floor else "fix")
    if counts is not None:
        law = dataclasses.replace(law, gain=law.gain * encoder.resolution / counts)
        encoder = dataclasses.replace(encoder, resolution=np.full(2, counts, float))
    rig = dataclasses.replace(rig, encoder=encoder, period=period or rig.period)
    log = simulate(puma560.arm(), rig, law, puma560.reference())
    unknown = [*dynamics.names, *(frictions(2) if friction else ())]
    return identify(dynamics, log, seed=seed, unknown=unknown, progress=False)


def geared():
    """An arm of two links with 60,000 counts per radian and more, under a PID, identified from
    one log.
    """
    drive = Drive(
        gear=(100, -80),
        motor_inertia=(1.2e-4, 8e-5),
        viscous=(6e-4, 5e-4),
        coulomb=(0.09, 0.06),
        motor_gain=(0.15, 0.12),
        current_limit=(15, 12),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4000, 4000)), period=1e-3)
    rotors = drive.reflected_inertia()
    bodies = [
        Body(mass=7, com=(0.2, 0.01, 0), inertia=(0, 0, 0, 0.10, 0, 0.10), rotor=rotors[0]),
        Body(mass=4, com=(0.175, 0.01, 0), inertia=(0, 0, 0, 0.04, 0, 0.04), rotor=rotors[1]),
    ]
    links = (Link(name="shoulder", alpha=np.pi / 2), Link(name="elbow", a=0.4))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(
        period=4.0,
        offset=(0.5, -0.6),
        cosine=((-0.5, -0.1), (0.4, -0.5)),
        sine=((0.3, 0.2), (-0.4, 0.3)),
    )
    law = PID(
        gain=(0.03, 0.02), integral=(0.15, 0.1), derivative=(1e-4, 8e-5), filter=2000.0, period=1e-3
    )
    log = simulate(dynamics.arm(dynamics.f()), rig, law, path, steps_per_sample=16)
    return identify(dynamics, log, seed=1, unknown=[*dynamics.names, *frictions(2)], progress=False)


def cell(certificate):
    """Share that exceeds, share that does after the start, chatter."""
    runs = certificate.runs
    exceeds = np.asarray(runs.peak).max(axis=1) > 1
    late = exceeds & (np.asarray(runs.first) > BEGUN)
    return f"{exceeds.mean():.1%} ({late.mean():.1%}) {np.median(runs.chatter, axis=0).max():.2f}"


def row(name, certificates):
    print(f"| {name} | " + " | ".join(map(cell, certificates.values())) + " |", flush=True)


def certified(found, rig, law, motions, stated=None, samples=64):
    return certify(found, rig, law, motions, stated, samples=samples, progress=False)


def one_log(samples):
    """Print the table of the paper's arm in docs/results.md."""
    found = paper(True, 1)
    motions = everyday_motions(found.arm, found.rig) | {"trajectory (6)": puma560.reference()}
    certificates = certified(found, found.rig, ComputedTorque(found), motions, samples=samples)
    print(
        f"| motion | of {samples} samples exceed ±1 | largest error [pulses] | torque chatter [N"
        " m] |"
    )
    print("|---|---|---|---|")
    for name, each in certificates.items():
        chatter = np.median(each.runs.chatter, axis=0).max()
        print(f"| {name} | {each.failures} | {each.runs.peak.max():.0f} | {chatter:.2f} |")


def table(samples, logs):
    """Print the tables."""
    mine = {"trajectory (6)": puma560.reference()}
    found = {f"paper's, floor, log {seed}": paper(True, seed) for seed in range(1, logs + 1)}
    found["paper's rounding"] = paper(False, 1)
    found["f alone, friction ±10 %"] = paper(True, 1, friction=False)
    motions = everyday_motions(puma560.arm(), puma560.rig()) | mine
    print(f"| arm and log | {' | '.join(motions)} |\n|{'---|' * (len(motions) + 1)}")
    for name, each in found.items():
        row(name, certified(each, each.rig, ComputedTorque(each), motions, samples=samples))
    each = geared()
    row(
        "finer counts",
        certified(
            each,
            each.rig,
            ComputedTorque(each),
            everyday_motions(each.arm, each.rig),
            samples=samples,
        ),
    )
    print()
    for name in ("puma560", "ur5e"):
        robot = read_robot(name)
        arm, rig = robot.arm, robot.rig
        f = arm.f * (1 + 0.01 * np.random.default_rng(0).standard_normal((64, len(arm.f))))
        law = ComputedTorque(arm, rig, bandwidth=min(145.0, 0.3 / rig.period), dead_zone=0.2)
        row(
            name,
            certified(
                arm, rig, law, everyday_motions(arm, rig), Uncertainty(plants=f, friction=0.05)
            ),
        )


def engine(runs, only, pool):
    """Print the table of another engine's arm, of all gears or one [Hz]; the pool's processes
    share the runs.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
    from mujoco_elastic import RIG, p_loop, run

    arm, random = puma560.literature_arm(1.5), np.random.default_rng(0)
    gears = {
        hz: Elasticity.from_resonance(arm, hz, 0.02, drive=RIG.drive)
        for hz in (400, 200, 100, 60, 40, 25, 15)
    }
    law, path = puma560.p_law(), puma560.reference()

    def hanging(hz, path):
        rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears[hz]))
        return simulate(arm, rig, law, path, duration=2 * RIG.period).true_q[0]

    def identified(hz, **options):
        log = p_loop(arm, gears[hz], np.array(law.gain), hanging(hz, path), path.duration, 20)
        unknown = [*arm.dynamics.names, *frictions(2)]
        return identify(arm.dynamics, log, seed=1, unknown=unknown, progress=False, **options)

    rigid = identified(400)
    motions = everyday_motions(rigid.arm, rigid.rig) | {"trajectory (6)": path}
    print(
        f"| gears, as the controller knows them | {' | '.join(motions)}"
        f" |\n|{'---|' * (len(motions) + 1)}"
    )
    for hz, known in [
        (400, False),
        (200, False),
        (100, False),
        (60, False),
        (60, True),
        (40, True),
        (25, True),
        (15, True),
    ]:
        if only not in (None, hz):
            continue
        controller, cells = ComputedTorque(identified(hz, elasticity=True) if known else rigid), []
        for motion in motions.values():
            begin = hanging(hz, motion)
            shifts = random.uniform(-0.5, 0.5, (runs, 2))
            loop = arm, gears[hz], controller, begin, motion, motion.duration, 20
            tried = [
                each.result() for each in [pool.submit(run, *loop, shift=shift) for shift in shifts]
            ]
            largest = np.abs([errors for errors, _, _ in tried]).max(axis=2)
            chatter = np.mean(
                [np.abs(np.diff(torque, axis=0)).mean(axis=0) for _, _, torque in tried], axis=0
            ).max()
            within = (largest.max(axis=1) <= 1).sum()
            cells.append(
                f"{within}/{runs} {(largest <= 1).mean():.2%} {largest.max():.0f} {chatter:.2f}"
            )
        print(
            f"| {hz} Hz, {'identified' if known else 'rigid'} | {' | '.join(cells)} |", flush=True
        )


def friction(samples):
    """Print how soon friction that is off is learnt."""
    found = paper(True, 1)
    back = everyday_motions(found.arm, found.rig)["there and back"]
    print(
        "| friction believed | path | learns | first period | second | fourth"
        " |\n|---|---|---|---|---|---|"
    )
    for factor in (0.7, 0.9, 1.1, 1.3):
        drive = found.rig.drive
        off = dataclasses.replace(
            drive, coulomb=factor * drive.coulomb, viscous=factor * drive.viscous
        )
        for name, path in (("there and back", back), ("trajectory (6)", puma560.reference())):
            for learns in (True, False):
                law = ComputedTorque(
                    found, dataclasses.replace(found.rig, drive=off), learn_friction=learns
                )
                shares = []
                for period in (0, 1, 3):
                    begun, options = period * path.duration, {"samples": samples, "progress": False}
                    after = {"after": begun, "duration": begun + path.duration}
                    certificate = certify(found, found.rig, law, path, **options, **after)
                    shares.append(
                        f"{certificate.probability:.1%}, largest {certificate.runs.peak.max():.0f}"
                    )
                print(
                    f"| {factor} of what it is | {name} | {learns} | {' | '.join(shares)} |",
                    flush=True,
                )


def machines(samples):
    """Print the table of other machines."""
    machine = paper(True, 1)
    late, shaken = machine.rig.period, 0.1
    rows = {
        f"{counts:,} counts a turn": (paper(True, 1, counts=counts), None)
        for counts in (400, 1000, 4000)
    }
    rows |= {
        f"period {1e3 * period:g} ms": (paper(True, 1, period=period), None)
        for period in (3.5e-4, 7e-4, 2e-3)
    }
    rows["one sample of delay"] = machine, Uncertainty(delay=(late, late))
    rows["jitter of 10 %"] = machine, Uncertainty(jitter=(shaken, shaken))
    motions = everyday_motions(puma560.arm(), puma560.rig()) | {
        "trajectory (6)": puma560.reference()
    }
    print(f"| machine | {' | '.join(motions)} |\n|{'---|' * (len(motions) + 1)}", flush=True)
    for name, (found, stated) in rows.items():
        row(name, certified(found, found.rig, ComputedTorque(found), motions, stated, samples))
    robot, random, pick = read_robot("puma560"), np.random.default_rng(0), (0, 1, 2, 3, 4, 4, 5)
    links, drive = robot.dynamics.chain.links, robot.rig.drive
    links = (*links[:5], Link(name="5b", alpha=-np.pi / 2, d=0.1, frame=links[4].frame), links[5])
    bodies = [robot.dynamics.chain.bodies[i] for i in pick]
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    numbers = ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
    drive = Drive(**{name: np.array(getattr(drive, name))[list(pick)] for name in numbers})
    rig = Rig(
        drive=drive,
        encoder=Encoder(resolution=robot.rig.encoder.resolution[list(pick)]),
        period=robot.rig.period,
    )
    arm = dynamics.arm(dynamics.f())
    f = arm.f * (1 + 0.01 * random.standard_normal((64, len(arm.f))))
    law = ComputedTorque(arm, rig, bandwidth=min(145.0, 0.3 / rig.period), dead_zone=0.2)
    row(
        "seven joints",
        certify(
            arm,
            rig,
            law,
            everyday_motions(arm, rig),
            Uncertainty(plants=f, friction=0.05),
            samples=64,
            progress=False,
        ),
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--one-log", action="store_true", help="the paper's arm from one log alone")
    parser.add_argument("--mujoco", type=int, help="runs of another engine's arm")
    parser.add_argument("--hz", type=int, help="of these, gears of this resonance alone")
    parser.add_argument(
        "--friction", action="store_true", help="friction that is off, with and without learning"
    )
    parser.add_argument("--old", help="folder of another checkout, for the same table beside it")
    parser.add_argument(
        "--machines",
        action="store_true",
        help="other encoders, periods, delay, jitter, seven joints",
    )
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", IdentificationWarning)
    if chosen.one_log:
        sys.exit(one_log(chosen.samples))
    if chosen.machines:
        sys.exit(machines(chosen.samples))
    if chosen.friction:
        sys.exit(friction(chosen.samples))
    if chosen.mujoco:
        with ProcessPoolExecutor() as pool:
            sys.exit(engine(chosen.mujoco, chosen.hz, pool))
    table(chosen.samples, chosen.logs)
    if chosen.old:
        print(f"\n{chosen.old}:", flush=True)
        command = [
            sys.executable,
            __file__,
            "--samples",
            str(chosen.samples),
            "--logs",
            str(chosen.logs),
        ]
        subprocess.run(command, env={**os.environ, "PYTHONPATH": chosen.old}, check=True)  # noqa: S603
