"""What a log says of the resonance of its gears, and of f beside it.

    python tests/benchmarks/elastic_identification.py [--robots 0 2] [--hz 25 40 inf] [--logs both] [--all]  # 30 min
    python tests/benchmarks/elastic_identification.py --backlash  # 2 min

Robots: f drawn around two arms, damping ratio 1 to 3 %, the encoders' phase and the path's offset drawn anew, 16 steps
per sample; the model has 4, and its rig says nothing of gears. One log at low gains or at high ones, or one at each.

Error: of each resonance, largest of all robots and joints. Held: stated 95 % intervals with the resonance in them.
Width: that of the stated intervals over the one needed, which is 1.96 times the RMS of the errors to either side, all
logarithms. Met: within 10 %, or held by an interval at most twice as wide as needed. Error of f: the largest of the
nine, in its printed range; median and largest of the robots. A rigid robot's resonances shall be "stiffer than"
something. With `--backlash`: a robot of 70 Hz with 1e-4 rad of it in each gear, stated in the record's rig or not.
"""

import argparse
import dataclasses
import time

import numpy as np

from identification import identify
from plant import Elasticity, P, Phase, puma560, simulate
from plant.machine import LEAST_MOTOR_INERTIA, least_inertia_margin

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
ARMS = (puma560.literature_arm(1.5), puma560.arm())
LOW, HIGH = (0.1, 0.08), (0.2, 0.15)
LOGS = {"low gains": (LOW,), "high gains": (HIGH,), "both": (LOW, HIGH)}
HERTZ, RIGID = (25, 40, 60, 100), np.inf
WIDTH = np.ptp(puma560.PRINTED_RANGES, axis=1)


def arm_near(base, rng):
    """An arm of the same structure, of which D less the rotors' inertia, the links', is positive
    definite.
    """
    heavy = dataclasses.replace(
        RIG.drive, motor_inertia=RIG.drive.motor_inertia / LEAST_MOTOR_INERTIA
    )
    rig = dataclasses.replace(RIG, drive=heavy)
    while True:
        f = base.f * (1 + 0.1 * rng.normal(size=9)) + 0.01 * rng.normal(size=9)
        if least_inertia_margin(DYNAMICS, rig, f[None])[0] > 0.02:
            return DYNAMICS.arm(f)


def robot(seed, hertz, gains):
    """An arm and its logs; one whose loop does not stay bounded is drawn again."""
    for attempt in range(100):
        rng = np.random.default_rng([seed, attempt])
        arm, ratio = arm_near(ARMS[seed % 2], rng), rng.uniform(0.01, 0.03)
        path = dataclasses.replace(
            PATH, offset=np.asarray(PATH.offset) + rng.uniform(-0.05, 0.05, 2)
        )
        drive, records = RIG.drive, []
        if np.isfinite(hertz):
            elasticity = Elasticity.from_resonance(
                arm, hertz, ratio, drive=drive, q=path([0.0]).q[0]
            )
            drive = dataclasses.replace(drive, elasticity=elasticity)
        try:
            for gain in gains:
                encoder = dataclasses.replace(RIG.encoder, phase=Phase(shift=rng.uniform(0, 1, 2)))
                rig = dataclasses.replace(RIG, drive=drive, encoder=encoder)
                record = simulate(arm, rig, P(gain=gain), path, steps_per_sample=16)
                records.append(dataclasses.replace(record, rig=RIG, true_q=None, true_qd=None))
        except ValueError:
            continue
        return arm, records
    raise RuntimeError(f"robot {seed} stays bounded in no attempt")


def study(hertz, gains, seeds, everything):
    """A row of the table."""
    resonances, f, inside, seconds, lost = [], [], [], [], 0
    for seed in seeds:
        arm, records = robot(seed, hertz, gains)
        started = time.perf_counter()
        try:
            found = identify(DYNAMICS, records, elasticity=True, held_out=(), progress=False)
        except ValueError as error:
            lost += 1
            print(f"    seed {seed}: {error}", flush=True)
            continue
        seconds.append(time.perf_counter() - started)
        resonances.append(found.fit.resonance)
        f.append(100 * (np.abs(found.f - arm.f) / WIDTH).max())
        inside.append(np.abs(found.f - arm.f) < 1.96 * found.fit.std[:9])
        if everything:
            print(
                "   ",
                seed,
                str(found.fit.resonance).splitlines()[1:],
                f"f {f[-1]:.1f} %",
                *found.warnings,
                flush=True,
            )
    hz, low, high = (
        np.array([getattr(each, name) for each in resonances]) for name in ("hz", "low", "high")
    )
    of_f = f"{np.median(f):.1f}, {max(f):.1f} | {np.sum(inside)} of {9 * len(f)}"
    last = f"{np.mean(seconds):.0f} |" + (f" {lost} not identified" if lost else "")
    if not np.isfinite(hertz):
        bounds = f"stiffer than {low.min():.0f} to {low.max():.0f}"
        held, met = (f"{np.isinf(each).sum()} of {each.size}" for each in (high, hz))
        return f"{bounds} | {held} | | {met} | {of_f} | {last}"
    error = np.log(hz / hertz)
    needed = 2 * 1.96 * np.sqrt((error[np.isfinite(error)] ** 2).mean())
    with np.errstate(divide="ignore"):
        width = np.log(high / low) / needed
    held = (low <= hertz) & (hertz <= high)
    met = (np.abs(hz / hertz - 1) <= 0.1) | (held & (width <= 2))
    worst = 100 * np.abs(hz / hertz - 1).max()
    median = f"{np.median(width):.1f}" if np.isfinite(np.median(width)) else "open"
    return (
        f"{worst:.1f} % | {held.sum()} of {held.size} | {median} | {met.sum()} of {met.size} |"
        f" {of_f} | {last}"
    )


def played(hertz=70, backlash=1e-4):
    """What a log says of gears with backlash that its rig does not state, and with it."""
    arm = ARMS[0]
    gears = Elasticity.from_resonance(
        arm, hertz, 0.02, drive=RIG.drive, q=PATH([0.0]).q[0], backlash=(backlash,) * 2
    )
    true = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    record = simulate(arm, true, P(gain=LOW), PATH, steps_per_sample=16)
    for said, rig in (("not stated", RIG), ("stated", true)):
        found = identify(
            DYNAMICS, dataclasses.replace(record, rig=rig), elasticity=True, progress=False
        )
        print(
            f"backlash {said}: found {np.round(found.fit.resonance.hz, 1)}"
            f" Hz\n{found.fit.resonance}",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--robots", type=int, nargs="*", default=[0, 2], help="seeds of the robots of each row"
    )
    parser.add_argument("--hz", type=float, nargs="*", default=[*HERTZ, RIGID])
    parser.add_argument("--logs", nargs="*", choices=LOGS, default=list(LOGS))
    parser.add_argument("--all", action="store_true", help="print every robot")
    parser.add_argument("--backlash", action="store_true", help="what backlash does, alone")
    given = parser.parse_args()
    if given.backlash:
        return played()
    print(
        "| resonance | logs | error | held | width | met | error of f [% of its range] | f held |"
        " seconds |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for hertz in given.hz:
        for name in given.logs:
            row = study(hertz, LOGS[name], given.robots, given.all)
            print(
                f"| {f'{hertz:.0f} Hz' if np.isfinite(hertz) else 'rigid'} | {name} | {row}",
                flush=True,
            )


if __name__ == "__main__":
    main()
