"""What is proved beside what is sampled: ``python tests/benchmarks/proved.py [--boost 1] [motion
...]``.

The paper's arm, f and friction identified from one log, under its default controller on trajectory
(6), on that at half speed, and in everyday motions: bounds of the error before rounding, the
largest of 1,000 samples, and the time.
"""

import argparse
import time
import warnings

from everyday import paper

from ctc import ComputedTorque, certify
from identification import IdentificationWarning
from plant import everyday_motions, puma560

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("motions", nargs="*", default=["(6)", "(6), half speed"])
parser.add_argument("--boost", type=float, help="start_boost of the controller; by default its own")
given = parser.parse_args()
warnings.simplefilter("ignore", IdentificationWarning)
found = paper(True, 1)
law = ComputedTorque(found, start_boost=given.boost)
motions = {"(6)": puma560.reference(), "(6), half speed": puma560.reference().slowed(2.0)}
motions |= everyday_motions(found.arm, found.rig)
for name in given.motions:
    certificate = certify(found, found.rig, law, motions[name], samples=1000, progress=False)
    began, processor = time.perf_counter(), time.process_time()
    proved, sampled = certificate.proved, certificate.runs.unrounded.max(axis=0)
    lasted = (
        f"{time.perf_counter() - began:.0f} s, processor {time.process_time() - processor:.0f} s"
    )
    print(
        f"{name}: rounding alone {proved.rounding.round(2)} (sampled"
        f" {certificate.by_counts.round(2)})"
    )
    print(
        f"  {proved.share:g} of the ranges {proved.error.round(2)} (sampled, all"
        f" {sampled.round(2)}); {lasted}"
    )
    print(f"  {proved}", flush=True)
