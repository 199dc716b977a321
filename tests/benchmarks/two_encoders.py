"""A heavy six-joint arm with two encoders on three joints: errors of stiffness and damping, and
coverage.

    python tests/benchmarks/two_encoders.py [--draws 50] [--runs 3] [--spread 0.05]

Truth by pinocchio (`oracles/heavy_arm.py`). Stiffness and damping of each gear within 30 %, paths
of 8 s, phases and zeros of the encoders are drawn anew. f is known, or stated with a spread from
which the true bodies are drawn, or unknown and found from torques with 1 % of noise. *drift*: the
stiffness of each run deviates by 3 %, the machine's is meant. *Worst*: largest error of a stiffness
of all runs together. *Width*: median half-width of its 95 % intervals. *Held*: intervals that hold
the truth: of all gears, and of the least gear.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
from heavy_arm import DAMPING, SEEN, STIFFNESS, arm_of, bodies, other, run

from identification import find_gears

ROWS = {
    "known": (False, 0.0),
    "spread": (True, 0.0),
    "unknown": (None, 0.0),
    "known, drift": (False, 0.03),
}


def drawn(seed, runs, spread, drift):
    """Records, stiffness and damping of a machine, whose bodies deviate by a spread."""
    random = np.random.default_rng(seed)
    share = random.uniform(0.7, 1.3, (2, 6))
    stiffness, damping, some = STIFFNESS * share[0], DAMPING * share[1], bodies()
    some = other(some, spread, random) if spread else some
    each = stiffness * (1 + drift * random.normal(size=(runs, 6)))
    return [run(some, k, damping, random, noise=0.01) for k in each], stiffness, damping


def row(name, draws, runs, spread):
    """A row of the table."""
    doubtful, drift = ROWS[name]
    stated, worst, held, alone, damped, width, started = (
        arm_of(bodies()),
        [],
        [],
        [],
        [],
        [],
        time.perf_counter(),
    )
    for seed in range(draws):
        records, k, d = drawn(seed, runs, spread if doubtful else 0.0, drift)
        given = stated if doubtful is False else stated.dynamics
        found = find_gears(given, records, prior=spread if doubtful else None)
        worst.append(np.abs(found.stiffness / k - 1)[SEEN])
        held.append(((found.low <= k) & (k <= found.high))[SEEN])
        alone += [((each.low <= k) & (k <= each.high))[SEEN] for each in found.runs]
        damped.append(((found.damping_low <= d) & (d <= found.damping_high))[SEEN])
        width.append((found.high / found.low - 1)[SEEN] / 2)
    shares = [
        f"{np.mean(each):.0%}, {np.mean(each, axis=0).min():.0%}" for each in (held, alone, damped)
    ]
    seconds = (time.perf_counter() - started) / draws
    print(
        f"| {name} | {np.max(worst):.2%} | {np.median(width):.2%} | {' | '.join(shares)} |"
        f" {seconds:.1f} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--spread", type=float, default=0.05)
    parser.add_argument("--only", nargs="*", choices=ROWS, default=list(ROWS))
    given = parser.parse_args()
    print(
        "| f | worst | width | stiffness held | by single runs | damping held | seconds per draw |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in given.only:
        row(name, given.draws, given.runs, given.spread)


if __name__ == "__main__":
    main()
