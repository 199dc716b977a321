"""Repetitions of a path that are learnt from, on an arm simulated by MuJoCo: samples within ±1
pulse, largest error.

    python tests/benchmarks/learn.py [--hz 400 60 40] [--repetitions 4] [--seed 0]
    python tests/benchmarks/learn.py --stiffness 0.8 1.2 --hz 40
    python tests/benchmarks/learn.py --other

The paper's arm with 1.5 kg, MuJoCo's own friction and gears of these resonances, damping ratio
0.02. The controller's f is 3 % off (each of nine, up or down), its friction 10 % (+10 %, -10 %);
above 100 Hz it takes the gears for rigid. With --stiffness its gears are so many times as stiff as
they are. With --other the torque is learnt on trajectory (6), and f and friction mended drive the
other motions. A cell is samples within ±1 / largest error [pulses].
"""

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

from ctc import ComputedTorque, learn
from plant import Elasticity, Record, everyday_motions, puma560, simulate

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
from mujoco_elastic import RIG, MujocoArm

STEPS = 20


def geared(rig, gears):
    """A rig with these gears."""
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears))


def repetition(arm, gears, law, rig, path):
    """A log of MuJoCo's arm, which hangs in its gears where the path begins."""
    q = simulate(arm, geared(RIG, gears), puma560.p_law(), path, duration=2 * RIG.period).true_q[0]
    count = int(np.ceil(round(path.duration / RIG.period, 6)))
    t = RIG.period * np.arange(count)
    motion = path(t)
    engine = MujocoArm(arm, gears, motion.q[0], motion.qd[0], STEPS)
    state = engine.state
    state[2:4] = q
    engine.state = state
    controller = law.start(rig, engine.counts(), guards=None)
    counts, torque = np.empty((count, 2)), np.empty((count, 2))
    for k in range(count):
        counts[k] = engine.counts()
        torque[k] = controller.step(counts[k], motion.q[k], motion.qd[k], motion.qdd[k])
        engine.push(torque[k])
    asked = rig.counts(motion.q)
    return Record(
        t=t,
        reference_pulses=asked,
        error_pulses=asked - counts,
        torque=torque,
        rig=rig,
        reference=path,
    )


def cell(record):
    largest = np.abs(record.error_pulses).max(axis=1)
    return f"{(largest <= 1).mean():.1%} / {largest.max():.0f}"


def believed(arm, gears, seed):
    """f, and a rig whose friction is off, as the controller believes them."""
    f = arm.f * (1 + 0.03 * np.random.default_rng(seed).choice([-1, 1], len(arm.f)))
    off, drive = np.array([1.1, 0.9]), RIG.drive
    drive = dataclasses.replace(
        drive, coulomb=off * drive.coulomb, viscous=off * drive.viscous, elasticity=gears
    )
    return arm.dynamics.arm(f), dataclasses.replace(RIG, drive=drive)


def main(chosen):
    arm = puma560.literature_arm(1.5)
    motions = everyday_motions(arm, RIG) | {"trajectory (6)": puma560.reference()}
    names = [name for name in motions if not chosen.motions or name in chosen.motions]
    print(
        f"| gears | motion | {' | '.join(f'repetition {k}' for k in range(chosen.repetitions))} |"
        " said |"
    )
    print("|" + "---|" * (chosen.repetitions + 3))
    for hz in chosen.hz:
        true = Elasticity.from_resonance(arm, hz, 0.02, drive=RIG.drive)
        for factor in chosen.stiffness:
            known = (
                None if hz > 100 else dataclasses.replace(true, stiffness=factor * true.stiffness)
            )
            model, rig = believed(arm, known, chosen.seed)
            law = ComputedTorque(
                model, rig, **({} if chosen.bandwidth is None else {"bandwidth": chosen.bandwidth})
            )
            if chosen.other:
                other(arm, true, law, rig, motions, hz)
                continue
            for name in names:
                learnt, cells = None, []
                for _ in range(chosen.repetitions):
                    try:
                        record = repetition(
                            arm, true, learnt.law if learnt else law, rig, motions[name]
                        )
                    except ValueError as error:
                        cells.append(str(error)[:60])
                        break
                    cells.append(cell(record))
                    learnt = learn(learnt or law, rig, motions[name], record)
                said = (
                    f"{learnt!r}; innovations {[round(x, 2) for x in learnt.innovations]}"
                    if learnt
                    else ""
                )
                print(
                    f"| {hz:g} Hz, k {factor:g} | {name} | {' | '.join(cells)} | {said} |",
                    flush=True,
                )


def other(arm, true, law, rig, motions, hz):
    """Print what f and friction, mended on trajectory (6), do on other motions."""
    path, learnt = motions["trajectory (6)"], None
    for _ in range(3):
        learnt = learn(
            learnt or law,
            rig,
            path,
            repetition(arm, true, learnt.law if learnt else law, rig, path),
        )
    mended = dataclasses.replace(law, arm=learnt.arm, rig=learnt.rig)
    print(f"{hz:g} Hz; f off by at most {np.abs(learnt.arm.f / arm.f - 1).max():.1%}")
    motions = motions | {
        "(6), 20 % faster": path.slowed(1 / 1.2),
        "(6), 20 % slower": path.slowed(1.2),
    }
    for name, motion in motions.items():
        cells = [cell(repetition(arm, true, each, each.rig, motion)) for each in (law, mended)]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hz", type=float, nargs="+", default=[400, 60, 40])
    parser.add_argument("--motions", nargs="+")
    parser.add_argument("--stiffness", type=float, nargs="+", default=[1.0])
    parser.add_argument("--repetitions", type=int, default=4)
    parser.add_argument("--bandwidth", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--other", action="store_true", help="mended f and friction on other motions"
    )
    main(parser.parse_args())
