"""Logs read a second time: is the convention of the counters found, does obeying `check()` do harm?

    python tests/benchmarks/second_reading.py                 all, in this order
    python tests/benchmarks/second_reading.py --logs 20       fewer of each
    python tests/benchmarks/second_reading.py rounding
    python tests/benchmarks/second_reading.py causes --logs 20 [--arms puma] [--only healthy play] [--said]
        [--law PID]

Arms, paths, gains and friction are drawn anew for each log.
"""

import argparse
import dataclasses
import warnings

import numpy as np
from spoilers import SPOILED, stated

from identification import identify
from plant import Harmonics, Phase, puma560, simulate
from plant.checkup import Signals, fix_seen

DYNAMICS, PAPER = puma560.dynamics(), puma560.rig()
_FLOOR = 0.02  # of f's scale: below it a difference is that of two logs


def drawn(seed, rounding="floor", crossing=True):
    """Record of an arm, path and P loop drawn from a seed, and its f; crossing: whether joints
    pass zero.
    """
    random = np.random.default_rng(seed)
    arm = puma560.literature_arm(random.uniform(0.0, 1.5))
    period = random.uniform(2.5, 4.0)
    cosine, sine = (random.normal(size=(2, 3)) * 0.35 / np.arange(1, 4) for _ in range(2))
    offset = (
        random.uniform(-0.2, 0.2, 2)
        if crossing
        else np.abs(cosine).sum(axis=1) + np.abs(sine).sum(axis=1) + 0.1
    )
    path = Harmonics(period=period, offset=offset, cosine=cosine, sine=sine)
    drive = dataclasses.replace(
        PAPER.drive, coulomb=PAPER.drive.coulomb * random.uniform(0.5, 1.2, 2)
    )
    encoder = dataclasses.replace(
        PAPER.encoder, rounding=rounding, phase=Phase(shift=random.uniform(-0.5, 0.5, 2))
    )
    rig = dataclasses.replace(PAPER, drive=drive, encoder=encoder)
    law = puma560.p_law(np.array((0.20, 0.15)) * random.uniform(0.3, 1.0))
    record = simulate(arm, rig, law, path, duration=2 * period, steps_per_sample=8)
    return dataclasses.replace(record, rig=stated(rig, rounding)), arm.f


def rounding(logs):
    """floor or fix, found from the log alone; and never where no joint passes zero."""
    right, wrong, silent = 0, 0, 0
    for seed in range(logs):
        true = ("floor", "fix")[seed % 2]
        seen = fix_seen(Signals(drawn(seed, true)[0]))
        clear = seen is not None and abs(seen - 0.5) > 0.45
        right, wrong = (
            right + (clear and (seen > 0.5) == (true == "fix")),
            wrong + (clear and (seen > 0.5) != (true == "fix")),
        )
        silent += not clear
    print(
        f"floor or fix, joints pass zero: {right} of {logs} found, {wrong} wrong, {silent} said to"
        " be undecidable"
    )
    none = [
        fix_seen(Signals(drawn(seed, ("floor", "fix")[seed % 2], False)[0]))
        for seed in range(max(4, logs // 10))
    ]
    print(
        f"no joint passes zero: undecidable in {sum(seen is None for seen in none)} of {len(none)}"
    )


# -- one log, spoiled ----------------------------------------------------------------------------
def error(record, f):
    """Largest error of the f that is found, in the share of the largest parameter; inf where it
    is refused.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = identify(DYNAMICS, record, method="prediction_error", progress=False)
    except ValueError:
        return np.inf
    return float(np.abs(found.f - f).max() / np.abs(f).max())


def obeyed(logs):
    """Errors of f from the clean log, the spoiled one, and the spoiled one with all advice of
    check() followed.
    """
    table = []
    for seed in range(logs):
        record, f = drawn(1000 + seed, ("floor", "fix")[seed % 2])
        random = np.random.default_rng(seed)
        kinds = random.choice(len(SPOILED), random.integers(1, 3), replace=False)
        spoiled = record
        for kind in sorted(kinds):
            spoiled = SPOILED[kind](spoiled, random)
        table.append([error(record, f), error(spoiled, f), error(spoiled.check().corrected, f)])
        names = ", ".join(SPOILED[kind].__name__ for kind in sorted(kinds))
        print(
            f"  {seed:3d} clean {table[-1][0]:.4f} as it is {table[-1][1]:.4f} obeyed"
            f" {table[-1][2]:.4f}  {names}",
            flush=True,
        )
    clean, left, followed = np.array(table).T
    with np.errstate(invalid="ignore"):
        worse = int((followed > np.maximum(1.1 * left, left + _FLOOR)).sum())
    print(
        f"advice followed: f worse in {worse} of {logs}; median error / clean:"
        f" {np.median(followed / clean):.2f}"
    )
    print(
        f"as they are: median error / clean {np.median(left / clean):.2f}, refused"
        f" {int(np.isinf(left).sum())}"
    )


def causes(logs):
    """What is said first where one thing is wrong, of arms in MuJoCo; see `causes`."""
    from causes import table

    table(logs, options.arms, options.only, options.said, options.law)


BENCHES = {"rounding": (rounding, 100), "obeyed": (obeyed, 200), "causes": (causes, 20)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("which", nargs="*", choices=[*BENCHES, []], default=list(BENCHES))
    parser.add_argument("--logs", type=int, default=0)
    parser.add_argument("--arms", nargs="*", default=["puma", "ur5e"], help="of causes")
    parser.add_argument("--only", nargs="*", default=[], help="these causes")
    parser.add_argument("--said", action="store_true", help="print what is said of each log")
    parser.add_argument("--law", default="P", help="of causes: P, PID or computed_torque")
    options = parser.parse_args()
    for name in options.which or BENCHES:
        bench, usual = BENCHES[name]
        bench(options.logs or usual)
