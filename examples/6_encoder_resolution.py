"""How coarse may an encoder be? The same arm with 100 to 10,000 pulses per motor turn.

The P gain per pulse is scaled for equal stiffness of the loop. For each encoder: worst and median
error of f1..f9, in per cent of the printed ranges, by the paper's genetic algorithm on pulses, by
least squares on differentiated positions (the equation error), and by the default; and the tracking
error of computed torque with the latter, in pulses. A coarse encoder needs a slower controller: at
360 rad/s, the default of an arm alone, the torque chatter with 100 pulses per turn is 136 N m.
"""

import dataclasses

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import Encoder, puma560, simulate

WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()
METHODS = ("paper", "equation_error", "seeded")


def study(pulses):
    """Worst and median error of each method, and the evaluation with f of the default."""
    rig = dataclasses.replace(puma560.rig(), encoder=Encoder(resolution=(pulses, pulses)))
    gain = np.array((0.20, 0.15)) * puma560.rig().encoder.resolution / pulses
    measured = simulate(
        puma560.arm(), rig, puma560.p_law(tuple(gain)), puma560.reference(), steps_per_sample=16
    )
    errors = {}
    for method in METHODS:
        found = identify(puma560.dynamics(), measured, method=method, seed=1, progress=False)
        off = 100 * np.abs(found.f - puma560.PUBLISHED) / WIDTH
        errors[method] = off.max(), np.median(off)
    law = ComputedTorque(found)
    report = evaluate(puma560.arm(), rig, law, puma560.reference(), backend="numba")
    return errors, report


def main():
    print(
        "pulses per | worst and median error of f [% of range]          | computed torque,"
        " default f"
    )
    print(
        "motor turn |   paper's GA     | least squares    |  default      | within ±1 | peak"
        " [pulses]"
    )
    for pulses in (100, 200, 500, 1_000, 2_000, 5_000, 10_000):
        errors, report = study(pulses)
        row = " | ".join(f"{worst:6.1f} {median:8.1f} " for worst, median in errors.values())
        print(
            f"{pulses:10,d} | {row}| {report.share_within(1):>10} |"
            f" {report.max_error_pulses.max():.0f}"
        )


if __name__ == "__main__":
    main()
