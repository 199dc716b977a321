"""Every number promised for the paper's experiment, measured in one run: identification, spread,
verdict in pulses.

    python tests/benchmarks/verdict.py [--seeds 10] [--backend casadi]

The robot is the published f, simulated at 16 sub-steps; the model of the identification runs at 4;
verdicts at 16.
"""

import argparse
import platform
import statistics
import time

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import spread
from plant import puma560, simulate

DURATIONS = (3.65, 2.5, 2.0)


def verdicts(name, robot, rig, arms, backend, *, law=ComputedTorque):
    """One row per duration: how many arms keep all samples within one pulse, and what it costs."""
    for duration in DURATIONS:
        reports = [
            evaluate(robot, rig, law(arm, rig), puma560.reference(duration), backend=backend)
            for arm in arms
        ]
        within = np.array([report.fraction_within(1) for report in reports])
        true = max(report.max_true_error_pulses.max() for report in reports)
        peak = np.array([report.peak_torque[0] for report in reports])
        chatter = np.array([report.chatter[0] for report in reports])
        limit = np.array([report.saturation.max() for report in reports])
        print(
            f"| {name} | {duration} | {(within == 1).sum()}/{len(arms)} | {within.min():.2%} |"
            f" {true:.2f} | {np.median(peak):.0f} / {peak.max():.0f} | {np.median(chatter):.1f} |"
            f" {limit.max():.2%} |",
            flush=True,
        )


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--backend", default="casadi")
    options = parser.parse_args()
    dynamics, robot, rig, p = puma560.dynamics(), puma560.arm(), puma560.rig(), puma560.p_law()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}\n")

    measured = simulate(robot, rig, p, puma560.reference(), steps_per_sample=16)
    started = time.perf_counter()
    series = spread(
        dynamics,
        measured,
        seeds=range(options.seeds),
        published=puma560.PUBLISHED_ALTERATION,
        progress=False,
    )
    print(
        f"## {options.seeds} identifications, method paper, {time.perf_counter() - started:.1f} s"
        f" in all\n\n{series}"
    )
    ratios = [run.objective / run.initial_objective for run in series.runs]
    seconds = [run.seconds for run in series.runs[1:]]
    print(f"generation 0:  {', '.join(f'{run.initial_objective:.0f}' for run in series.runs)}")
    print(f"generation 40: {', '.join(f'{run.objective:.0f}' for run in series.runs)}")
    print(f"final / initial: median {statistics.median(ratios):.2f}, largest {max(ratios):.2f}")
    print(f"seconds per run, warm: median {statistics.median(seconds):.2f}\n")

    print(
        "| f of the controller | T [s] | all within ±1 | worst share | true error, peak [pulses] |"
        " joint 2 peak, median / max [N m] | chatter [N m] | at the limit"
        " |\n|---|---|---|---|---|---|---|---|"
    )
    verdicts("true", robot, rig, [robot], options.backend)
    random = np.random.default_rng(0)
    noisy = [
        dynamics.arm(puma560.PUBLISHED * (1 + 0.05 * random.normal(size=9))) for _ in range(10)
    ]
    verdicts("true + 5 % noise", robot, rig, noisy, options.backend)
    verdicts(
        "cold genetic algorithm", robot, rig, [run.arm for run in series.runs], options.backend
    )
    physical = puma560.literature_arm(tool_mass=1.5)
    log = simulate(physical, rig, p, puma560.reference(), steps_per_sample=16)
    other = spread(dynamics, log, seeds=range(options.seeds), progress=False)
    verdicts(
        "physical arm with 1.5 kg, from its own log",
        physical,
        rig,
        [run.arm for run in other.runs],
        options.backend,
    )

    print("\nP control on the same arm:")
    for duration in DURATIONS:
        report = evaluate(robot, rig, p, puma560.reference(duration), backend=options.backend)
        print(
            f"  T = {duration}: peaks {report.max_error_pulses} pulses,"
            f" {report.fraction_within(1):.1%} within ±1"
        )
    law, path = ComputedTorque(series.runs[0].arm, rig), puma560.reference()
    for each in (p, law):
        one, two = (
            evaluate(robot, rig, each, path, backend=backend) for backend in ("casadi", "numba")
        )
        same = np.array_equal(one.record.error_pulses, two.record.error_pulses)
        print(
            f"casadi and numba, {type(each).__name__}: pulse sequences"
            f" {'equal' if same else 'differ'}, verdicts {one.fraction_within(1):.2%} and"
            f" {two.fraction_within(1):.2%}"
        )


if __name__ == "__main__":
    main()
