"""Loads on a known arm, friction 10 % off what its rig states, logs cut at a random instant: error and coverage.

    python tests/benchmarks/find_load.py 120                   # runs per row; some 10 minutes on one core
    python tests/benchmarks/find_load.py 30 --place            # the centre of mass is unknown too
    python tests/benchmarks/find_load.py 30 --resonance 100    # on gears that the model lacks [Hz]
    python tests/benchmarks/find_load.py 30 --identified       # the arm is identified, from a log of its own

Literature arm; mass 0.2 to 5 kg, anywhere on the forearm; viscous friction and Coulomb friction of each joint, the
path's offset, the encoders' phase and the cut are drawn anew for each run. Error: of the mass [kg], rms and largest.
Coverage: of the 95 % interval; warned: share of the runs with a warning; held: covered or warned.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from identification import find_load, identify
from plant import Body, Elasticity, Phase, puma560, simulate

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))

from logged_laws import LAWS

ARM, RIG, PATH, SECONDS = puma560.literature_arm(), puma560.rig(), puma560.reference(), 2.2


FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1))


def log_of(law, seed, hertz=None, carried=True):
    """A log without torques, the mass in it, and its place."""
    rng = np.random.default_rng(seed)
    mass, place = (
        rng.uniform(0.2, 5.0),
        np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.6, -0.2), 0.0]),
    )
    added = ARM.dynamics.load_matrix() @ Body(mass=mass, com=place).standard_parameters
    loaded = ARM.dynamics.arm(ARM.f + added)
    path = dataclasses.replace(PATH, offset=np.asarray(PATH.offset) + rng.uniform(-0.05, 0.05, 2))
    drive = dataclasses.replace(
        RIG.drive,
        viscous=RIG.drive.viscous * (1 + rng.uniform(-0.1, 0.1, 2)),
        coulomb=RIG.drive.coulomb * (1 + rng.uniform(-0.1, 0.1, 2)),
        elasticity=(
            None
            if hertz is None
            else Elasticity.from_resonance(loaded, hertz, 0.02, drive=RIG.drive)
        ),
    )
    encoder = dataclasses.replace(RIG.encoder, phase=Phase(shift=rng.uniform(-0.5, 0.5, 2)))
    begin, loaded = rng.uniform(0.1, 0.6), loaded if carried else ARM
    steps = 4 if hertz is None else 16
    made = simulate(
        loaded,
        dataclasses.replace(RIG, drive=drive, encoder=encoder),
        law,
        path,
        duration=SECONDS + begin,
        steps_per_sample=steps,
    )
    bare = {"torque": None, "current": None, "true_q": None, "true_qd": None, "link_counts": None}
    return dataclasses.replace(made.cut(begin), rig=RIG, **bare), mass, place


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", type=int, nargs="?", default=120)
    parser.add_argument("--laws", nargs="*", choices=LAWS, default=["P", "PID", "computed torque"])
    parser.add_argument("--place", action="store_true")
    parser.add_argument("--resonance", type=float)
    parser.add_argument("--friction", type=float)
    parser.add_argument("--identified", action="store_true")
    given = parser.parse_args()
    print(
        "| law | rms error | largest | median deviation | covered | warned | held | seconds |"
        " refused |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in given.laws:
        rows, refused, started = [], [], time.perf_counter()
        for seed in range(given.runs):
            try:
                record, mass, place = log_of(LAWS[name], seed, given.resonance)
                arm = ARM
                if given.identified:
                    own = log_of(LAWS["P"], seed, given.resonance, carried=False)[0]
                    arm = identify(
                        ARM.dynamics, own, unknown=(*ARM.dynamics.names, *FRICTION), progress=False
                    )
                found = find_load(
                    arm, record, None if given.place else place, friction=given.friction
                )
            except ValueError as error:  # also a loop that leaves its path
                refused.append(str(error))
                continue
            low, high = found.interval
            rows.append((found.mass - mass, found.std, low <= mass <= high, bool(found.warnings)))
        seconds = (time.perf_counter() - started) / given.runs
        error, std, covered, warned = np.array(rows, float).reshape(-1, 4).T
        print(
            f"| {name} | {np.sqrt(np.mean(error**2)):.4f} | {np.abs(error).max():.4f} |"
            f" {np.median(std):.4f} | {covered.mean():.1%} | {warned.mean():.1%} |"
            f" {np.maximum(covered, warned).mean():.1%} | {seconds:.1f} |"
            f" {len(refused)}{f': {refused[0]}' if refused else ''} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
