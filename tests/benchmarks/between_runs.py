"""Intervals of several logs of one machine whose friction drifts, and of runs of a real one: do
they hold the truth?

    CTC_DATA=... python tests/benchmarks/between_runs.py [--logs 2 4 8] [--drift 0.05 0.1]
    [--machines 24]
        [--fits fit_torque identify exact pid]

Simulated: the paper's arm, its viscous and Coulomb friction other in each log (normal, of the
drift's standard deviation, relative), other paths of 8 s. `fit_torque` has a torque with 0.3 N m of
noise; `identify` has counts alone, of 4 s, and fits their prediction error; *exact*: the same with
rigs that are taken for exact, as they are here; *pid*: the same under a PID whose torque, logged,
chatters. *Covered*: 95 % intervals of the common fit that hold the truth; *noise*: those of noise
alone. Real: the open-loop runs of a double pendulum, both designs; the intervals of each run, with
what differs between runs, against the values of each other run: *apart*, the difference within the
root of the sum of the squared half-widths, and *held*, the other's value within the interval of the
one.
"""

import argparse
import dataclasses
import itertools
import os
import sys
import warnings
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from identification import IdentificationWarning, Tolerances, fit_torque, identify
from plant import PID, Harmonics, puma560, simulate

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
KINDS = ("viscous", "coulomb")
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in KINDS for i in range(2))
UNKNOWN = (*ARM.dynamics.names, *FRICTION)
TRUTH = np.concatenate([ARM.f, RIG.drive.viscous, RIG.drive.coulomb])
RUNS = {
    "C.0": ("00", "01", "02", "03", "04", "05", "06"),
    "A.0": ("00", "01", "02", "03", "04", "05"),
}


def drifting(seed, drift, duration=8.0, law=None):
    """A log of a machine on this day, and the random numbers that it leaves."""
    random = np.random.default_rng(seed)
    friction = {
        kind: getattr(RIG.drive, kind) * (1 + drift * random.normal(size=2)) for kind in KINDS
    }
    path = Harmonics(period=4.0, offset=(0, 0), cosine=random.normal(0, 0.12, (2, 4)),
                     sine=random.normal(0, 0.12, (2, 4)))  # fmt: skip
    machine = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **friction))
    record = simulate(ARM, machine, law or puma560.p_law((0.1, 0.08)), path, duration=duration)
    return dataclasses.replace(record, rig=RIG, true_q=None, true_qd=None), random


def by_torque(seeds, drift):
    """A fit of logged torques."""
    records = []
    for record, random in (drifting(seed, drift) for seed in seeds):
        torque = record.torque + 0.3 * random.normal(size=record.torque.shape)
        records.append(dataclasses.replace(record, torque=torque, law=None, reference=None))
    return fit_torque(ARM.dynamics, records, unknown=UNKNOWN, band=5.0, every=10)


def by_counts(seeds, drift, tolerances=None):
    """A fit of counts."""
    records = [dataclasses.replace(drifting(seed, drift, 4.0)[0], torque=None) for seed in seeds]
    options = {
        "method": "prediction_error",
        "held_out": (),
        "tolerances": tolerances,
        "progress": False,
    }
    return identify(ARM.dynamics, records, unknown=UNKNOWN, **options).fit


def by_repeated(seeds, drift):
    """A fit of counts and torque under a law with memory."""
    law = PID(
        gain=(0.1, 0.08),
        integral=(0.5, 0.4),
        derivative=(4e-4, 3e-4),
        filter=2000.0,
        period=RIG.period,
    )
    records = [drifting(seed, drift, 4.0, law)[0] for seed in seeds]
    return identify(ARM.dynamics, records, unknown=UNKNOWN, held_out=(), progress=False).fit


FITS = {
    "fit_torque": by_torque,
    "identify": by_counts,
    "exact": partial(by_counts, tolerances=Tolerances.none()),
    "pid": by_repeated,
}


def simulated(logs, drift, machines, name):
    """A row of the table: how often intervals hold, how many agree, and how large the drift is
    found.
    """
    held, bare, agree, found, further = [], [], [], [], []
    for machine in range(machines):
        fit = FITS[name]([(machine, logs, i) for i in range(logs)], drift)
        off = np.abs(fit.values - TRUTH)
        held.append(off < 1.96 * fit.std)
        bare.append(off < 1.96 * np.sqrt(np.diag(fit.noise_covariance)))
        agree.append(fit.between.agree)
        found.append(fit.between.groups["drive.coulomb"])
        further.append(fit.between.further)
    held = np.array(held)
    print(f"| {name} | {logs} | {drift:.0%} | {np.mean(bare):.1%} | {held.mean():.1%} | "
          f"{held.mean(axis=0).min():.0%} | {np.mean(agree):.0%} | {np.median(found):.1%} | "
          f"{np.median(further):.0f} |", flush=True)  # fmt: skip


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
    parser.add_argument("--fits", nargs="+", choices=FITS, default=[*FITS])
    given = parser.parse_args()
    warnings.simplefilter("ignore", IdentificationWarning)  # records that contradict each other
    print(
        "| | logs | drift | noise | covered | least | agree | Coulomb drift found | logs that would"
        " halve |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, drift, logs in itertools.product(given.fits, given.drift, given.logs):
        simulated(logs, drift, given.machines, name)
    if "CTC_DATA" not in os.environ:
        print("no real runs: CTC_DATA is not set")
        return
    print(
        "\n| design | apart, within alone | held, within alone | apart | held |"
        " |\n|---|---|---|---|---|---|"
    )
    for design in RUNS:
        real(Path(os.environ["CTC_DATA"]) / "dfki_double_pendulum", design)


if __name__ == "__main__":
    main()
