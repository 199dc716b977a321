"""The paper from end to end: measure, identify, control, judge in encoder pulses."""

import time
from pathlib import Path

from ctc.figures import plot_comparison, plot_evaluation, plot_record
from ctc.laws import ComputedTorque
from ctc.verdict import Evaluation, evaluate
from identification import Identification, identify
from identification.equation_error import units as units_of
from plant import puma560, simulate
from plant.parts import Table


def demo(seed: int, figures: Path) -> bool:
    """Run the demo, print its tables, save its figures; True if the error stays within a pulse."""
    started = time.perf_counter()
    robot = puma560.arm()
    rig = puma560.rig()
    path = puma560.reference()
    p = puma560.p_law()

    # A robot that no simulation step of the identification shares: 16 sub-steps, there 4.
    # Each step says what it does before it does it: the second one takes a while.
    print("1. measure: P control on trajectory (6), encoder pulses logged every 0.7 ms")
    measured = simulate(robot, rig, p, path, steps_per_sample=16)
    print(f"   {measured}")

    print(
        "2. identify: f1..f9 from those pulses alone, by the genetic algorithm of the paper and by"
        " the default"
    )
    paper, default = (
        identify(puma560.dynamics(), measured, seed=seed, method=method)
        for method in ("paper", "seeded")
    )
    # Both methods for the same objective, so that the table compares search methods alone.
    for run in (paper, default):
        costs = f"{run.initial_objective:.0f} -> {run.objective:.0f} pulses^2"
        print(f"   {run.search.method}: objective (4) {costs} in {run.seconds:.1f} s")
    dynamics = default.arm.dynamics
    names = dynamics.names
    columns = (puma560.PUBLISHED, paper.f, default.f)
    rows = [
        (name, unit, *(f"{value:.2f}" for value in values), f"{std:.3f}")
        for name, unit, values, std in zip(
            names,
            units_of(dynamics, names),
            zip(*columns, strict=True),
            default.fit.std,
            strict=True,
        )
    ]
    head = ("", "unit", "of the robot", "paper's method", "default method", "its std")
    print("\n".join(f"   {line}" for line in Table(head, rows, words=(1,)).lines()))

    # The verdict is on the robot itself, not on the arm as identified.
    print("3. control: the same arm under P and under computed torque from the f that were found")
    laws = {"P": p, "computed torque": ComputedTorque(default)}
    verdicts = {name: evaluate(robot, rig, law, path) for name, law in laws.items()}
    for verdict in verdicts.values():
        print("\n   " + str(verdict).replace("\n", "\n   "))

    print(f"\n4. figures, saved in the folder {figures}")
    _save_figures(figures, paper, default, verdicts)
    print(f"   done after {time.perf_counter() - started:.1f} s")
    # The promise of the paper, as the exit code of the command.
    return verdicts["computed torque"].within(1)


def _save_figures(
    folder: Path, paper: Identification, default: Identification, verdicts: dict[str, Evaluation]
) -> None:
    import matplotlib

    # The demo draws into files, also where there is no screen.
    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    rig = puma560.rig()
    path = puma560.reference()
    measured = default.records[0]
    dynamics = default.arm.dynamics
    joints = [link.name or "" for link in dynamics.chain.links]
    # The four best of the first generation beside the best of the last one: Figs. 6 to 9.
    leading = paper.initial_population[paper.search.initial_costs.argsort()[:4]]
    models = [simulate(dynamics.arm(f), rig, default.law, path) for f in leading]
    best = simulate(default.arm, rig, default.law, path)
    figures = {
        "1_experiment": plot_record(measured, joints),
        "2_identification": plot_record(measured, joints, models=(models, best)),
        "2_fit": default.plot(),
        "3_p_against_computed_torque": plot_comparison(verdicts),
        "4_computed_torque": plot_evaluation(verdicts["computed torque"]),
    }
    for name, axes in figures.items():
        axes.flat[0].figure.savefig(folder / f"{name}.png", dpi=130)
