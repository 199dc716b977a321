"""The observer's memory on a real machine, chosen without the runs that are kept aside: nested
leave-one-run-out.

    CTC_DATA=... python tests/benchmarks/real_memory.py

Double pendulum, both designs: of the runs to learn from, each is left out once, for each memory;
the memory with which these are simulated best is the one to use. Then all of them give f, and the
runs kept aside, which nothing was chosen by, are simulated freely.
"""

import os
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from identification.replay import prediction

pendulum = import_module("8_real_double_pendulum")

MEMORIES = (4, 8, 16, 32)
FORMER = {"A.0": (0.036, 0.091), "C.0": (0.031, 0.056)}  # [rad] rms of the runs kept aside, before


def main():
    folder, own = Path(os.environ["CTC_DATA"]) / "dfki_double_pendulum", prediction._REPLAYED
    for design, (lengths, learn, aside) in pendulum.DESIGNS.items():
        dynamics = pendulum.dynamics(lengths)
        records, kept = (
            [pendulum.load(folder, design, run) for run in runs] for runs in (learn, aside)
        )
        missed = {}
        for memory in MEMORIES:
            prediction._REPLAYED = memory
            off = []
            for k, record in enumerate(records):
                found = pendulum.fit(dynamics, records[:k] + records[k + 1 :])
                off.append(pendulum.misses(found, [record]))
            missed[memory] = float(np.sqrt(np.mean(np.square(off))))
            print(
                f"{design}: memory of {memory} samples, runs left out missed by"
                f" {missed[memory]:.4f} rad",
                flush=True,
            )
        best = min(missed, key=missed.get)
        for memory in dict.fromkeys((best, own)):
            prediction._REPLAYED = memory
            off = pendulum.misses(pendulum.fit(dynamics, records, kept), kept)
            which = "chosen so" if memory == best else "the library's"
            said = (
                f"{off[0]:.4f} and {off[1]:.4f} rad; before {FORMER[design][0]} and"
                f" {FORMER[design][1]}"
            )
            print(
                f"{design}: memory of {memory} ({which}): runs kept aside missed by {said}",
                flush=True,
            )
        prediction._REPLAYED = own


if __name__ == "__main__":
    main()
