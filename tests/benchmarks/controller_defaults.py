"""How the defaults of ComputedTorque were chosen: tracking against torque for several settings, in
one run.

    python tests/benchmarks/controller_defaults.py

Twenty cold identifications (seeds 0-19) and ten vectors with 5 % noise drive the published arm
along trajectory (6) at T = 3.65, 2.5 and 2.0 s; 4 sub-steps per sample, compiled kernel.
"""

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import spread
from plant import puma560, simulate

SETTINGS = (
    # bandwidth, observer_ratio, start_boost, dead_zone
    (100, 1.3, 4.0, 0.2),
    (145, 1.3, 4.0, 0.2),
    (200, 1.3, 4.0, 0.0),
    (250, 1.3, 4.0, 0.0),
    (300, 1.3, 4.0, 0.0),
    (360, 1.0, 4.0, 0.0),
    (360, 1.3, 1.0, 0.0),
    (360, 1.3, 2.0, 0.0),
    (360, 1.3, 4.0, 0.0),
    (360, 1.3, 4.0, 0.2),
    (360, 1.7, 4.0, 0.0),
)


def main():
    """Print the table."""
    dynamics, robot, rig = puma560.dynamics(), puma560.arm(), puma560.rig()
    measured = simulate(robot, rig, puma560.p_law(), puma560.reference(), steps_per_sample=16)
    cold = [run.arm for run in spread(dynamics, measured, seeds=range(20), progress=False).runs]
    random = np.random.default_rng(0)
    noisy = [
        dynamics.arm(puma560.PUBLISHED * (1 + 0.05 * random.normal(size=9))) for _ in range(10)
    ]
    print(
        "| bandwidth | ratio | boost | dead zone | true f: chatter [N m] | peak [N m] | cold: worst"
        " share at T = 3.65, 2.5, 2.0 | all within ±1, of 20 | noisy: worst share | all within ±1,"
        " of 10 |\n|" + "---|" * 10
    )
    for bandwidth, ratio, boost, zone in SETTINGS:
        named = {
            "bandwidth": bandwidth,
            "observer_ratio": ratio,
            "start_boost": boost,
            "dead_zone": zone,
        }

        def run(arm, duration, named=named):
            law = ComputedTorque(arm, rig, **named)
            return evaluate(
                robot, rig, law, puma560.reference(duration), backend="numba", steps_per_sample=4
            )

        true = run(robot, 3.65)
        cells = []
        for arms in (cold, noisy):
            shares = np.array(
                [
                    [run(arm, duration).fraction_within(1) for arm in arms]
                    for duration in (3.65, 2.5, 2.0)
                ]
            )
            cells += [
                ", ".join(f"{s:.2%}" for s in shares.min(axis=1)),
                ", ".join(map(str, (shares == 1).sum(axis=1))),
            ]
        print(
            f"| {bandwidth} | {ratio} | {boost} | {zone} | {true.chatter[0]:.1f} |"
            f" {true.peak_torque[0]:.0f} | " + " | ".join(cells) + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()
