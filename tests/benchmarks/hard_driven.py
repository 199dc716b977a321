"""Right logs of loops that are soft, lag far behind, or are at their limits: is one accused?

    python tests/benchmarks/hard_driven.py [--logs 48] [--first 0]

The PUMA 560 under P, PD, PID and cascades, and machines of `random_rigs`. The gains of the laws are
multiplied, and the limits of the amplifiers reduced; each log is judged with its torque and without.
"""

import argparse
import dataclasses
import sys
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))

from random_rigs import drawn, driven, hard_driven

from plant import PD, PID, Cascade, puma560

LOOPS = ((1, 1), (4, 1), (15, 1), (60, 1), (1, 0.35), (1, 0.2), (15, 0.3), (0.2, 1))
"""Factors of the gains, and of the limits."""


def laws_of_the_puma():
    """Laws of the PUMA 560, sampled and fast, by name."""
    gain, period = puma560.p_law().gain, puma560.rig().period
    yield "P", puma560.p_law()
    rate = {"derivative": 4e-3 * gain, "filter": 2000.0}
    for name, clock in (("sampled", {"period": period}), ("fast", {})):
        yield f"{name} PD", PD(gain=gain, **rate, **clock)
        yield f"{name} PID", PID(gain=gain, integral=5 * gain, **rate, **clock)
        cascade = {"position": (60.0, 60.0), "speed": 4e-3 * gain, "integral": 0.05 * gain}
        yield f"{name} cascade", Cascade(**cascade, filter=2000.0, **clock)


def logs(first, count):
    """Names and right logs."""
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    for name, law in laws_of_the_puma():
        for factor, limit in LOOPS:
            record = driven(rig, law, arm, path, factor, limit, duration=1.5)
            yield "PUMA", f"{name}, gains {factor:g}, limits {limit:g}", record
    for seed in range(first, first + count):
        if drawn(seed, torque=True).record.reference is None:
            continue
        for factor, limit in LOOPS:
            name = f"machine {seed}, gains {factor:g}, limits {limit:g}"
            yield "drawn", name, hard_driven(seed, factor, limit)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=48)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    judged, accused = Counter(), Counter()
    warnings.simplefilter("ignore")
    for kind, name, record in logs(asked.first, asked.logs):
        alone = dataclasses.replace(record, torque=None, current=None)
        for logged, log in (("with a torque", record), ("without a torque", alone)):
            judged[kind, logged] += 1
            causes = log.check().causes
            if causes:
                accused[kind, logged] += 1
                print(f"{name}, {logged}: {[str(cause).splitlines()[0] for cause in causes]}")
    for group, count in judged.items():
        print(f"{', '.join(group)}: {accused[group]} of {count} right logs accused")


if __name__ == "__main__":
    main()
