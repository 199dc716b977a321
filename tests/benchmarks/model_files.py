"""Public model files, each simulated by the library and identified from its log: what comes back, what is said, time.

    python tests/benchmarks/model_files.py [--robots PART ...] [--paths 1] [--friction]

Every serial arm of 4 to 7 joints of the package `example-robot-data` (an extra of its own: pip install
example-robot-data), arms of humanoids and their legs included. Gears of 100, 4,096 pulses per turn of the motor, 1 ms;
rotors of 0.3 of the mean inertia of their axis, dry friction of 5 % of the largest torque of the path. The log is of
6 s, under `p_gains`, without noise but that of its counts; all that a rig states is right. Each path is of four
harmonics in the middle of the joints' ranges.
"""

import argparse
import sys
import time
import warnings
import xml.etree.ElementTree as ET  # of an installed package
from pathlib import Path

import numpy as np

from identification import identify
from plant import Chain, Drive, Dynamics, Encoder, Harmonics, Rig, p_gains, simulate


def folder():
    """Where the package has its robots."""
    for place in map(Path, sys.path):
        found = place / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
        if found.is_dir():
            return found
    raise SystemExit("example-robot-data is not installed. pip install example-robot-data.")


def arms():
    """(name, file, tip) of every serial arm, once each."""
    for file in sorted(folder().rglob("*.urdf")):
        joints = {}
        for joint in ET.parse(file).getroot().findall("joint"):  # noqa: S314
            if joint.find("parent") is not None:
                kind = joint.get("type") if joint.find("mimic") is None else "mimic"
                joints[joint.find("child").get("link")] = joint.get("name"), kind, joint.find("parent").get("link")
        seen, parents = set(), {parent for _, _, parent in joints.values()}
        for leaf in joints:
            link, moving = leaf, []
            while link in joints:
                name, kind, above = joints[link]
                moving += [name] if kind in ("revolute", "continuous") else []
                link = above
            if leaf not in parents and 4 <= len(moving) <= 7 and tuple(moving) not in seen:
                seen.add(tuple(moving))
                yield f"{file.stem} {leaf}", file, leaf


def path_of(chain, seed):
    """Four harmonics in the middle of the ranges, at most 0.8 rad off it."""
    draw, n = np.random.default_rng(seed), chain.n
    lower, upper = (np.clip(side, -np.pi, np.pi) for side in (chain.limits.lower, chain.limits.upper))
    middle, room = (lower + upper) / 2, np.minimum((upper - lower) / 2, 0.8)
    waves = draw.uniform(-1, 1, (2, n, 4)) / np.arange(1, 5)
    scale = 0.9 * room / np.abs(waves).sum(axis=(0, 2))
    return Harmonics(period=6.0, offset=middle, cosine=waves[0] * scale[:, None], sine=waves[1] * scale[:, None])


def rig_of(chain, path):
    """A rig for this arm, and the arm with its rotors."""
    bare = Dynamics.from_chain(chain, rotors=False)
    arm = bare.arm(bare.f())
    motion = path(np.linspace(0, path.period, 200))
    inertia = 0.3 * np.mean([np.diag(arm.D(q)) for q in motion.q], axis=0)
    gear = 100.0
    torque = np.max([np.abs(arm.inverse(*state)) for state in zip(*motion, strict=True)], axis=0)
    torque = np.maximum(torque, 0.05 * torque.max()) + inertia * np.abs(motion.qdd).max(axis=0)
    every = np.ones(chain.n)
    drive = Drive(
        gear=gear * every, motor_inertia=inertia / gear**2, coulomb=0.05 * torque / gear,
        viscous=0.05 * torque / gear / (gear * np.abs(motion.qd).max(axis=0)), motor_gain=every,
        current_limit=4 * torque / gear,
    )  # fmt: skip
    return Rig(drive=drive, encoder=Encoder(resolution=4096 * every), period=1e-3)


def row(chain, seed, friction):
    """What is printed of one chain on one path."""
    path = path_of(chain, seed)
    rig = rig_of(chain, path)
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    truth = dynamics.arm(dynamics.f())
    law = p_gains(truth, rig, path, peak=30 * np.ones(chain.n))
    record = simulate(truth, rig, law, path, duration=6.0, steps_per_sample=16)
    names = [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(chain.n)] if friction else []
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(dynamics, record, unknown=[*dynamics.names, *names], progress=False)
    seconds = time.perf_counter() - begun
    off = found.f - truth.f
    spread = np.sqrt(np.mean((off / found.fit.std[: len(off)]) ** 2)) if found.covariance is not None else np.nan
    other = path_of(chain, seed + 100)(np.linspace(0, 6, 200))
    torques = [np.array([arm.inverse(*state) for state in zip(*other, strict=True)]) for arm in (found.arm, truth)]
    torque = np.sqrt(np.mean((torques[0] - torques[1]) ** 2) / np.mean(torques[1] ** 2))
    said = [line.split(";")[0] for line in found.warnings]
    return len(off), spread, torque, seconds, said


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", default=[], help="parts of names")
    parser.add_argument("--paths", type=int, default=1)
    parser.add_argument("--friction", action="store_true")
    chosen = parser.parse_args()
    print(f"{'arm':44}{'n':>3}{'path':>5}{'f':>4}{'rms off / std':>14}{'torque elsewhere':>17}{'s':>6}  warnings")
    healthy = cells = 0
    for name, file, tip in arms():
        if chosen.robots and not any(part in name for part in chosen.robots):
            continue
        for seed in range(chosen.paths):
            cells += 1
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    chain = Chain.from_urdf(file, tip=tip)
                count, spread, torque, seconds, said = row(chain, seed, chosen.friction)
            except ValueError as refusal:
                print(f"{name:44.44}{'':3}{seed:5}  refused: {refusal}", flush=True)
                continue
            healthy += not said and 0.7 <= spread <= 1.3 and torque < 0.01
            print(f"{name:44.44}{chain.n:3}{seed:5}{count:4}{spread:14.2f}{100 * torque:15.3f} %{seconds:6.1f}"
                  f"  {' | '.join(said)}", flush=True)  # fmt: skip
    print(f"{healthy} of {cells} cells healthy")


if __name__ == "__main__":
    main()
