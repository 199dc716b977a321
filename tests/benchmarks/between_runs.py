"""Intervals of several logs of one machine whose friction drifts, and of runs of a real one: do they hold the truth?

    CTC_DATA=... python tests/benchmarks/between_runs.py [--logs 2 4 8] [--drift 0.05 0.1] [--machines 24]

Simulated: the paper's arm, its viscous and Coulomb friction other in each log (normal, of the drift's standard
deviation, relative), 0.3 N m of noise in the torque, other paths of 8 s. *Covered*: 95 % intervals of the common fit
that hold the truth. Real: the open-loop runs of a double pendulum, both designs; the intervals of each run, with what
differs between runs, against the values of each other run: *apart*, the difference within the root of the sum of the
squared half-widths, and *held*, the other's value within the interval of the one.
"""

import argparse
import dataclasses
import os
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from identification import fit_torque
from plant import Harmonics, puma560, simulate

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
KINDS = ("viscous", "coulomb")
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in KINDS for i in range(2))
TRUTH = np.concatenate([ARM.f, RIG.drive.viscous, RIG.drive.coulomb])
RUNS = {"C.0": ("00", "01", "02", "03", "04", "05", "06"), "A.0": ("00", "01", "02", "03", "04", "05")}


def drifting(seed, drift):
    """A log of a machine on this day."""
    random = np.random.default_rng(seed)
    friction = {kind: getattr(RIG.drive, kind) * (1 + drift * random.normal(size=2)) for kind in KINDS}
    path = Harmonics(period=4.0, offset=(0, 0), cosine=random.normal(0, 0.12, (2, 4)),
                     sine=random.normal(0, 0.12, (2, 4)))  # fmt: skip
    machine = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **friction))
    record = simulate(ARM, machine, puma560.p_law((0.1, 0.08)), path, duration=8.0)
    torque = record.torque + 0.3 * random.normal(size=record.torque.shape)
    return dataclasses.replace(record, torque=torque, rig=RIG, law=None, reference=None)


def simulated(logs, drift, machines):
    """A row of the table: how often intervals hold, how many agree, and how large the drift is found."""
    held, agree, found, further = [], [], [], []
    for machine in range(machines):
        records = [drifting((machine, logs, i), drift) for i in range(logs)]
        fit = fit_torque(ARM.dynamics, records, unknown=(*ARM.dynamics.names, *FRICTION), band=5.0, every=10)
        held.append(np.abs(fit.values - TRUTH) < 1.96 * fit.std)
        agree.append(fit.between.agree)
        found.append(fit.between.groups["drive.coulomb"])
        further.append(fit.between.further)
    held = np.array(held)
    print(f"| {logs} | {drift:.0%} | {held.mean():.1%} | {held.mean(axis=0).min():.0%} | {np.mean(agree):.0%} | "
          f"{np.median(found):.1%} | {np.median(further):.0f} |", flush=True)  # fmt: skip


def real(folder, design):
    """A row: runs against each other."""
    pendulum = import_module("8_real_double_pendulum")
    dynamics = pendulum.dynamics(pendulum.DESIGNS[design][0])
    records = [pendulum.load(folder, design, run) for run in RUNS[design]]
    between = fit_torque(dynamics, records, unknown=(*dynamics.names, *FRICTION)).between
    values, wide, bare = between.values, between.half_width, 1.96 * between.std
    pairs = [(i, j) for i in range(len(values)) for j in range(len(values)) if i != j]
    off = np.array([np.abs(values[i] - values[j]) for i, j in pairs])
    known, rows = np.isfinite(off), [design]
    for half in (bare, wide):
        both = np.array([np.hypot(half[i], half[j]) for i, j in pairs])
        one = np.array([half[i] for i, _ in pairs])
        rows += [f"{(off < both)[known].mean():.1%}", f"{(off < one)[known].mean():.1%}"]
    print(f"| {' | '.join(rows)} | {between} |".replace("\n", " "), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--drift", type=float, nargs="+", default=[0.05, 0.1])
    parser.add_argument("--machines", type=int, default=24)
    given = parser.parse_args()
    print("| logs | drift | covered | least | agree | Coulomb friction found to drift by | logs that would halve |")
    print("|---|---|---|---|---|---|---|")
    for drift in given.drift:
        for logs in given.logs:
            simulated(logs, drift, given.machines)
    if "CTC_DATA" not in os.environ:
        print("no real runs: CTC_DATA is not set")
        return
    print("\n| design | apart, within alone | held, within alone | apart | held | |\n|---|---|---|---|---|---|")
    for design in RUNS:
        real(Path(os.environ["CTC_DATA"]) / "dfki_double_pendulum", design)


if __name__ == "__main__":
    main()
