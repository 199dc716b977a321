"""Coverage of 95 % intervals: by class of unknowns, and on robots that their rigs do not describe.

    python tests/benchmarks/intervals.py [--runs 600] [--kinds friction "gear 2 % off" ...]  # 600: hours on one core

Random arms (masses, centres, inertias 30 % off the literature's, a tool of up to 3 kg), each with encoder phases of its
own, at 16 sub-steps; one log of (6) under P control, gains in turns (0.1, 0.08) and (0.2, 0.15). Width: of the
interval, over that of noise alone. No interval: withheld, with its reason.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from identification import find_load, identify
from plant import Body, Elasticity, FrictionCurve, JointSpring, Phase, puma560, simulate

sys.path.insert(0, str(Path(__file__).parent))

from identification_study import DYNAMICS, GAINS, PATH, RIG, random_arm

FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1))
OFFSETS = tuple(f"drive.curve.offset[{i}]" for i in (0, 1))


def changed(rig, **fields):
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **fields))


def offset(values):
    return FrictionCurve(offset=values, breakaway=(0.0, 0.0), speed=(1.0, 1.0))


CURVED = changed(RIG, curve=offset((0.0, 0.0)))
CLASSES = {  # unknowns beside f, and the stated rig
    "f alone": ((), RIG),
    "friction": (FRICTION, RIG),
    "gains": (("law.gain[0]", "law.gain[1]"), RIG),
    "offsets": (OFFSETS, CURVED),
    "a gear": (("drive.gear[0]",), RIG),
    "a delay": ((), RIG),
    "a load": (None, RIG),
}
WRONG = ("gear 2 % off", "friction offset", "spring", "elastic, 100 Hz")


def robot(kind, arm, random):
    """The robot's rig, where another is stated."""
    sign = random.choice([-1.0, 1.0], 2)
    if kind == "gear 2 % off":
        return changed(RIG, gear=RIG.drive.gear * (1 + 0.02 * sign * random.permutation([0, 1])))
    if kind == "friction offset":
        return changed(RIG, curve=offset(sign * random.uniform(0.05, 0.3) * RIG.drive.coulomb))
    if kind == "spring":
        spring = JointSpring(stiffness=random.uniform(2, 10, 2), angle=random.uniform(-1, 1, 2))
        return dataclasses.replace(RIG, springs=spring)
    return changed(RIG, elasticity=Elasticity.from_resonance(arm, 100.0, 0.02, drive=RIG.drive))


def late(record, rig, samples):
    """The same experiment, its counts read so many samples after the reference, which the user
    does not know.
    """
    t = record.t - samples * rig.period
    q = np.column_stack([np.interp(t, record.t, each) for each in record.true_q.T])
    counts = np.trunc(rig.position_in_pulses(q) + rig.encoder.phase.shift)
    return dataclasses.replace(
        record, error_pulses=record.reference_pulses - counts, torque=None, current=None
    )


def one(kind, k):
    """Errors, standard deviations and those of noise alone, of all unknowns; or the reason why
    there are none.
    """
    random = np.random.default_rng([600, k])
    arm, law = random_arm(random), puma560.p_law(GAINS[k % 2])
    more, rig = CLASSES.get(kind, ((), RIG))
    real = rig if kind in CLASSES else robot(kind, arm, random)
    encoder, carried = (
        dataclasses.replace(real.encoder, phase=Phase(shift=random.uniform(-0.5, 0.5, 2))),
        arm,
    )
    if more is None:
        load = Body(mass=random.uniform(0.5, 5), com=(0.0, -random.uniform(0.2, 0.5), 0.0))
        carried = DYNAMICS.arm(arm.f + DYNAMICS.f((Body(mass=0.0, com=(0, 0, 0)), load)))
    motion = PATH
    record = simulate(
        carried, dataclasses.replace(real, encoder=encoder), law, motion, steps_per_sample=16
    )
    if kind == "a delay":
        record = late(
            record,
            dataclasses.replace(real, encoder=encoder),
            random.uniform(0.05, 0.4) * random.choice([-1, 1]),
        )
    record = dataclasses.replace(
        record, rig=rig, true_q=None, true_qd=None, link_counts=None, initial=None,
        reference=None if kind.startswith("gear") else record.reference,
    )  # fmt: skip
    try:
        if more is None:
            found = find_load(arm, record, load.com)
            return (
                np.array(each).reshape(1) for each in (found.mass - load.mass, found.std, np.nan)
            )
        found = identify(DYNAMICS, record, unknown=(*DYNAMICS.names, *more), seed=k, progress=False)
    except ValueError as error:
        return str(error)
    if found.covariance is None:
        return found.fit.fallback_reason
    known = dict(zip(rig.number_names(), rig.number_values(), strict=True))
    known |= dict(zip(law.number_names("law."), law.number_values(), strict=True))
    true = np.append(arm.f, [known[name] for name in more])
    return found.fit.values - true, found.fit.std, np.sqrt(np.diag(found.fit.noise_covariance))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=600)
    parser.add_argument(
        "--kinds", nargs="*", choices=[*CLASSES, *WRONG], default=[*CLASSES, *WRONG]
    )
    given = parser.parse_args()
    print(
        "| log | runs | no interval | hold | least of a parameter | width over noise's, median | by"
        " parameter | s |\n|---|---|---|---|---|---|---|---|"
    )
    for kind in given.kinds:
        begun, results = time.perf_counter(), [one(kind, k) for k in range(given.runs)]
        there = [tuple(result) for result in results if not isinstance(result, str)]
        off, std, noise = (np.array(each) for each in zip(*there, strict=True))
        held, wide = np.abs(off) < 1.96 * std, std / noise
        each = ", ".join(f"{ratio:.1f}" for ratio in np.median(wide, axis=0))
        print(
            f"| {kind} | {given.runs} | {1 - len(there) / given.runs:.1%} | {held.mean():.1%} | "
            f"{held.mean(axis=0).min():.1%} | {np.median(wide):.2f} | {each} | "
            f"{(time.perf_counter() - begun) / given.runs:.1f} |",
            flush=True,
        )
        for reason in sorted({result for result in results if isinstance(result, str)}):
            print(f"  no interval: {reason}")


if __name__ == "__main__":
    main()
