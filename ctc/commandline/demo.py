"""The paper from end to end: measure, identify, control, and say how many pulses it was off."""

import time
from pathlib import Path

from ctc.figures.errors import plot_comparison, plot_evaluation, plot_record
from ctc.laws.computed_torque import ComputedTorque
from ctc.verdict.evaluation import Evaluation
from ctc.verdict.evaluations import evaluate
from identification import Identification, identify
from plant import puma560, simulate


def demo(seed: int, figures: Path) -> bool:
    """Run the main job, print its table, save its figures; whether computed torque stays within
    a pulse.
    """
    started = time.perf_counter()
    robot = puma560.arm()
    rig = puma560.rig()
    path = puma560.reference()
    p = puma560.p_law()

    print("1. measure: P control on trajectory (6), encoder pulses logged every 0.7 ms")
    measured = simulate(robot, rig, p, path, steps_per_sample=16)
    print(f"   {measured}")

    print(
        "2. identify: f1..f9 from those pulses alone, by the genetic algorithm of the paper and by"
        " the default"
    )
    paper, found = (
        identify(puma560.dynamics(), measured, seed=seed, method=method)
        for method in ("paper", "seeded")
    )
    for run in (paper, found):
        costs = f"{run.initial_objective:.0f} -> {run.objective:.0f} pulses^2"
        print(f"   {run.search.method}: objective (4) {costs} in {run.seconds:.1f} s")
    print("   " + "".join(f"{name:>8}" for name in found.arm.dynamics.names))
    print("   " + "".join(f"{value:8.2f}" for value in puma560.PUBLISHED) + "   of the robot")
    print("   " + "".join(f"{value:8.2f}" for value in paper.f) + "   by the paper's method")
    print("   " + "".join(f"{value:8.2f}" for value in found.f) + "   by the default method, and")
    print(
        "   " + "".join(f"{value:8.3f}" for value in found.fit.std) + "   its standard deviations"
    )

    print("3. control: the same arm under P and under computed torque from the f that were found")
    laws = {"P": p, "computed torque": ComputedTorque(found)}
    verdicts = {name: evaluate(robot, rig, law, path) for name, law in laws.items()}
    for verdict in verdicts.values():
        print("\n   " + str(verdict).replace("\n", "\n   "))

    print(f"\n4. figures, saved in the folder {figures}")
    _save_figures(figures, paper, found, verdicts)
    print(f"   done after {time.perf_counter() - started:.1f} s")
    return verdicts["computed torque"].within(1)


def _save_figures(
    folder: Path, paper: Identification, found: Identification, verdicts: dict[str, Evaluation]
) -> None:
    import matplotlib

    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    rig, path, p, (measured,) = puma560.rig(), puma560.reference(), found.law, found.records
    dynamics = found.arm.dynamics
    joints = [link.name or "" for link in found.arm.dynamics.chain.links]
    leading = paper.initial_population[paper.search.initial_costs.argsort()[:4]]
    models = [simulate(dynamics.arm(f), rig, p, path) for f in leading]
    best = simulate(found.arm, rig, p, path)
    figures = {
        "1_experiment": plot_record(measured, joints),
        "2_identification": plot_record(measured, joints, models=(models, best)),
        "2_fit": found.plot(),
        "3_p_against_computed_torque": plot_comparison(verdicts),
        "4_computed_torque": plot_evaluation(verdicts["computed torque"]),
    }
    for name, axes in figures.items():
        axes.flat[0].figure.savefig(folder / f"{name}.png", dpi=130)
