"""The same arm under P control and under computed torque with the f identified from its pulses."""

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import puma560, simulate

robot, rig, path, p = puma560.arm(), puma560.rig(), puma560.reference(), puma560.p_law()
measured = simulate(robot, rig, p, path, steps_per_sample=16)
found = identify(puma560.dynamics(), measured, seed=1, progress=False)
law = ComputedTorque(found)

for duration in (3.65, 2.5, 2.0):
    print(f"\ntrajectory (6) in {duration} s")
    for each in (p, law):
        print(evaluate(robot, rig, each, puma560.reference(duration)))

# The same controller, sample by sample, as a control script runs it; here with the pulses of the
# simulation.
report = evaluate(robot, rig, law, path)
record = report.record
counts = record.counts
motion = path(record.t)
controller = law.start(rig, counts[0])
torque = np.array([controller.step(*row) for row in zip(counts, *motion, strict=True)])
print(
    "\nstep by step, the torque differs from the simulation's by",
    np.abs(torque - record.torque).max(),
    "N m at most",
)
assert report.within(1)
