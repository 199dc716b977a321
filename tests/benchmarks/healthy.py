"""Right logs of many robots, by every method: how many are accused?

    python tests/benchmarks/healthy.py [--logs 200] [--first 0] [--joints 3] [--seconds 600] [--robots PART ...]
        [--methods seeded]

The arms of the package's robot files that have masses, and of the public model files (the extra `robots`), if these are
installed; of each its first joints, as many as are asked for. Gears, friction and encoders as in `model_files.py`; each
log has a path of its own, its own friction (half to twice) and P gains, from soft to such that hunt, is simulated at 16
sub-steps, and identified from a model file whose bodies are right, by the next of the methods. All that a rig states is
right, and a second log on another path is kept aside. Every warning is an accusation; that a rough method's values are
at fault, not the log, is counted apart. The last line has the largest of what has a limit of its own: the RMS
innovation, and how much worse the log kept aside is repeated.
"""

import argparse
import collections
import contextlib
import dataclasses
import time
import warnings

import numpy as np
from model_files import ARMS, file_of, folder, path_of, rig_of

from identification import identify
from plant import Chain, Dynamics, Limits, p_gains, read_robot, simulate

METHODS = ("seeded", "prediction_error", "equation_error", "output_error")
PEAKS = (8, 15, 30, 60)
"""Largest error that the gains are made for [pulses]."""


def chains(joints, parts):
    """Name -> the chain of the first joints of each robot."""
    found = {name: read_robot(name).dynamics.chain for name in ("puma560", "ur5e")}
    try:
        folder()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of right angles that are put right
            found |= {
                name: Chain.from_urdf(file_of(name), base=ARMS[name][1], tip=ARMS[name][2])
                for name in ARMS
            }
    except SystemExit as missing:
        print(missing)
    asked = {
        name: chain
        for name, chain in found.items()
        if not parts or any(part in name for part in parts)
    }
    return {name: first(chain, joints) for name, chain in asked.items()}


def first(chain, joints):
    """The chain of its first joints; without stated limits they turn by half a turn."""
    n = min(joints, chain.n)
    lower, upper = (
        ([-np.pi] * n, [np.pi] * n)
        if chain.limits is None
        else (chain.limits.lower, chain.limits.upper)
    )
    every = {"velocity": np.full(n, np.inf), "effort": np.full(n, np.inf)}
    limits = Limits(lower=lower[:n], upper=upper[:n], **every)
    return Chain(
        links=chain.links[:n], gravity=chain.gravity, bodies=chain.bodies[:n], limits=limits
    )


def gains(truth, rig, path, first):
    """P gains for a peak error, or for a larger one where the loop hunts by as much."""
    for peak in PEAKS[first:]:
        with contextlib.suppress(ValueError):
            return p_gains(truth, rig, path, peak=peak)
    return p_gains(truth, rig, path, peak=200)


def said(chain, seed, method):
    """What is said of one right log: lines of the log, lines of the method."""
    draw, path = np.random.default_rng(seed), path_of(chain, seed)
    rig = rig_of(chain, path)
    drive = dataclasses.replace(
        rig.drive, coulomb=rig.drive.coulomb * draw.uniform(0.5, 2, chain.n),
        viscous=rig.drive.viscous * draw.uniform(0.5, 2, chain.n),
    )  # fmt: skip
    rig = dataclasses.replace(rig, drive=drive)
    dynamics = Dynamics.from_chain(chain.with_rotors(drive))
    truth = dynamics.arm(dynamics.f())
    law = gains(truth, rig, path, int(draw.integers(len(PEAKS))))
    paths = path, path_of(chain, 10_000 + seed)
    logs = [simulate(truth, rig, law, each, duration=4.0, steps_per_sample=16) for each in paths]
    try:
        found = identify(dynamics, logs, seed=seed, method=method, progress=False)
    except ValueError as refusal:
        return [f"refused: {refusal}"], [], None
    of_method = [line for line in found.warnings if "identify with that method" in line]
    return [line for line in found.warnings if line not in of_method], of_method, found


def main():
    """Log after log, robots in turn, until the number or the time is reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first log")
    parser.add_argument("--joints", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=np.inf)
    parser.add_argument("--robots", nargs="*", default=[], help="parts of names")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, help="in turn")
    given = parser.parse_args()
    arms, begun = chains(given.joints, given.robots), time.monotonic()
    counts, most = collections.Counter(), np.zeros(2)
    for seed in range(given.first, given.first + given.logs):
        if time.monotonic() - begun > given.seconds:
            break
        name, method = list(arms)[seed % len(arms)], given.methods[seed % len(given.methods)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            of_log, of_method, found = said(arms[name], seed, method)
        counts.update(
            {"logs": 1, "accused": bool(of_log), "of the method": bool(of_method and not of_log)}
        )
        if found is not None:
            told, rms = found.diagnostics, found.fit.rms_innovation or 0.0
            worse = told.held_out_difference / max(told.difference, 0.58)
            most = np.maximum(most, [0.0 if method == "output_error" else rms, worse])
            print(
                f"{name}, log {seed}, {method}: {told.difference:.2f} pulses ({worse:.2f},"
                f" {rms:.3f})",
                flush=True,
            )
        for line in of_log:
            print(f"    accused: {line}", flush=True)
    accused, logs, apart = (counts[key] for key in ("accused", "logs", "of the method"))
    print(
        f"{accused} of {logs} right logs of {len(arms)} robots accused; of {apart} more the method"
        " is at fault"
    )
    print(f"RMS innovation up to {most[0]:.3f}, kept aside up to {most[1]:.2f} times")


if __name__ == "__main__":
    main()
