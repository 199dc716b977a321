"""Does a known spring, or a known injected torque, cost anything? And what says that one was left
out?

Logs of the literature arm under P, by MuJoCo (its own joint stiffness, friction and bodies) or by
the library's own simulator: plain, with joint springs, with a torque injected at the amplifier. Of
each kind several logs, which begin at other places of the paths of the paper. f is identified with
what is known stated, and with it left out.

    python tests/benchmarks/known_torques.py [--logs 8] [--method seeded] [--engine mujoco]

Printed, over all logs: rms error of f, in the widths of the printed ranges, of all parameters and
of the worst in each log; its ratio to the plain logs'; rms of simulated minus measured errors; logs
in which a warning says that they do not agree; share of the 95 % intervals that hold the truth.
"""

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

from identification import identify
from plant import Harmonics, JointSpring, puma560, simulate

sys.path[:0] = [str(Path(__file__).parents[1] / "oracles")]
from mujoco_springs import p_loop  # noqa: E402 - in tests/oracles

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
DYNAMICS, WIDTH = ARM.dynamics, np.ptp(np.array(puma560.dynamics().ranges), axis=1)
SPRINGS = JointSpring(stiffness=(60.0, 25.0), angle=(0.2, -0.4))
STIFFNESS = "springs.stiffness[0]", "springs.stiffness[1]"


def path(k):
    """Trajectory (6), its amplitudes and phases changed a little from log to log."""
    random = np.random.default_rng(k)
    amplitude, phase = np.pi / 4 * random.uniform(0.85, 1.15, 2), random.uniform(0, 0.4, 2)
    cosine = ((amplitude[0] * np.cos(phase[0]), 0.0), (0.0, -amplitude[1] * np.cos(phase[1])))
    sine = ((amplitude[0] * np.sin(phase[0]), 0.0), (0.0, -amplitude[1] * np.sin(phase[1])))
    return Harmonics(period=3.65, offset=(-amplitude[0], amplitude[1]), cosine=cosine, sine=sine)


def pushed(k, samples=5215):
    """Three tones per joint [N m]."""
    random, t = np.random.default_rng((k, 1)), RIG.period * np.arange(samples)
    tones = [np.sin(2 * np.pi * random.uniform(1, 8) * t + random.uniform(0, 6)) for _ in range(6)]
    return np.column_stack([12.0 * np.sum(tones[:3], axis=0), 5.0 * np.sum(tones[3:], axis=0)])


def logs(count, engine):
    """Kind -> records, with all stated that is known."""
    law, sprung = puma560.p_law(), dataclasses.replace(RIG, springs=SPRINGS)
    made = {"plain": [], "springs": [], "injected": []}
    for k in range(count):
        reference, torque = path(k), pushed(k)
        if engine == "mujoco":
            records = (
                p_loop(ARM, law, path=reference),
                dataclasses.replace(p_loop(ARM, law, SPRINGS, path=reference), rig=sprung),
                p_loop(ARM, law, path=reference, injected=torque),
            )
        else:
            records = (
                simulate(ARM, RIG, law, reference),
                simulate(ARM, sprung, law, reference),
                simulate(ARM, RIG, law, reference, injected=torque),
            )
        for kind, record in zip(made, records, strict=True):
            made[kind].append(record)
    return made


def found_in(record, method, unknown=None):
    """Errors of f in widths, rms difference [pulses], whether a warning was given, and which
    intervals hold f.
    """
    found = identify(DYNAMICS, record, method=method, unknown=unknown, progress=False)
    error = (found.f - ARM.f) / WIDTH
    held = np.full(len(error), np.nan)
    if found.covariance is not None:
        held = np.abs(found.f - ARM.f) <= 1.96 * np.sqrt(np.diag(found.covariance)[: len(error)])
    warned = any(
        "differ by" in warning or "cannot be compared" in warning for warning in found.warnings
    )
    own = [] if found.rig.springs is None else found.rig.springs.stiffness - SPRINGS.stiffness
    return error, np.sqrt(found.objective / record.error_pulses.size), warned, held, own


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=8)
    parser.add_argument("--method", default="seeded")
    parser.add_argument("--engine", choices=("mujoco", "own"), default="mujoco")
    given = parser.parse_args()
    made = logs(given.logs, given.engine)
    bare = [dataclasses.replace(record, rig=RIG) for record in made["springs"]]
    guessed = dataclasses.replace(RIG, springs=dataclasses.replace(SPRINGS, stiffness=(40.0, 40.0)))
    cases = {
        "plain": (made["plain"], None),
        "springs known": (made["springs"], None),
        "stiffness unknown": (
            [dataclasses.replace(record, rig=guessed) for record in bare],
            (*DYNAMICS.names, *STIFFNESS),
        ),
        "springs left out": (bare, None),
        "injected, known": (made["injected"], None),
        "injected, left out": (
            [dataclasses.replace(record, injected=None) for record in made["injected"]],
            None,
        ),
    }
    print(
        f"{given.logs} logs of each kind, engine {given.engine}, method {given.method}; errors of f"
        " in % of its range"
    )
    print(
        f"{'':<19} {'rms':>7} {'worst':>7} {'ratio':>6} {'differ by':>10} {'warned':>7} {'held':>6}"
    )
    plain, stiffness = None, []
    for name, (records, unknown) in cases.items():
        results = [found_in(record, given.method, unknown) for record in records]
        error, differ, warned, held, own = zip(*results, strict=True)
        error = np.abs(np.array(error))
        rms, worst = (
            100 * np.sqrt(np.mean(error**2)),
            100 * np.sqrt(np.mean(error.max(axis=1) ** 2)),
        )
        plain = rms if plain is None else plain
        covered = "-" if np.isnan(held).all() else f"{np.nanmean(held):.0%}"
        row = f"{rms:7.2f} {worst:7.2f} {rms / plain:6.2f} {np.median(differ):10.2f}"
        print(f"{name:<19} {row} {sum(warned):>4}/{len(warned)} {covered:>6}", flush=True)
        stiffness = np.array(own) if name == "stiffness unknown" else stiffness
    rms = np.sqrt(np.mean(np.square(stiffness), axis=0))
    print(f"stiffness, of {SPRINGS.stiffness} N m/rad: off by {np.round(rms, 2)} (rms)")


if __name__ == "__main__":
    main()
