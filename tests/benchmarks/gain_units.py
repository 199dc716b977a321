"""Gains of a law in another unit: are they named, and is a right log ever accused?

    python tests/benchmarks/gain_units.py [--logs 30] [--first 0]

Machines, laws and logs of `random_rigs`; each gain of the law, and all together, a hundred and a
thousand times too large and too small, in degrees, and per radian of the motor in place of pulses.
"""

import argparse
import dataclasses
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))

from random_rigs import drawn

GAINS = ("gain", "derivative", "integral", "position", "speed")
FACTORS = (1e3, 1e-3, 100.0, 0.01, 180 / np.pi, np.pi / 180)


def mistakes(law):
    """Laws with gains in another unit: name of the gain, factor, law."""
    names = [name for name in GAINS if hasattr(law, name)]
    torques = [name for name in names if name != "position"]
    sets = {name: [name] for name in names} | ({"gains": torques} if len(torques) > 1 else {})
    for gain, fields in sets.items():
        for factor in FACTORS:
            changes = {name: factor * getattr(law, name) for name in fields}
            yield gain, factor, dataclasses.replace(law, **changes)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--torque", action="store_true", help="log the torque of every case")
    asked = parser.parse_args()
    counts = Counter()
    accused = []
    for seed in range(asked.first, asked.first + asked.logs):
        case = drawn(seed, torque=True) if asked.torque else drawn(seed)
        record = case.record
        logged = "torque" if record.torque is not None else "counts"
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            right = record.check()
            seconds = time.perf_counter() - begun
            if any(cause.name.startswith("unit of") for cause in right.causes):
                accused.append(seed)
            print(f"{seed}: {case.about}: right {[c.name for c in right.causes]} {seconds:.2f} s")
            for gain, factor, law in mistakes(record.law):
                begun = time.perf_counter()
                causes = dataclasses.replace(record, law=law).check().causes
                cause = causes[0] if causes else None
                name = cause.name if cause else "nothing"
                named = name in (f"unit of {gain}", "gain" if gain == "gain" else "")
                sized = named and abs(np.log(cause.size / factor)) < 0.3
                counts[logged, gain, "right" if sized else "gain" if named else name] += 1
                if not sized:
                    found = f"{name} {cause.size:.3g}" if cause else name
                    print(
                        f"    {gain} x {factor:.4g}: {found} ({time.perf_counter() - begun:.1f} s)",
                        flush=True,
                    )
    for key, count in sorted(counts.items()):
        print(*key, count)
    print("right logs accused:", accused)


if __name__ == "__main__":
    main()
