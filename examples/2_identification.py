"""f1..f9 from encoder pulses alone, by the genetic algorithm of the paper, and how much they
vary over five runs.
"""

from identification import Objective, ranges, spread
from plant import puma560, simulate

# The robot: integrated four times finer than the model that is fitted to it.
measured = simulate(
    puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), steps_per_sample=16
)
dynamics = puma560.dynamics()

# Even the true f has an objective, because model and robot round differently. Differences below it
# are not significant.
floor = Objective(dynamics, measured)(puma560.PUBLISHED[None])[0]
print(f"objective (4) of the true f: {floor:.0f} pulses^2")

print("\nranges, from size and mass (3.6), and as printed:")
for name, derived, printed in zip(dynamics.names, ranges(), dynamics.ranges, strict=True):
    print(
        f"  {name}  [{derived[0]:6.2f}, {derived[1]:6.2f}]   [{printed[0]:6.2f}, {printed[1]:6.2f}]"
    )

series = spread(
    dynamics, measured, seeds=range(5), published=puma560.PUBLISHED_ALTERATION, progress=False
)
print("\nfive runs, and the alteration that the paper reports:")
print(series)
print(series.runs[0].message)
