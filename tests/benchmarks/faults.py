"""What each fault of a control loop does to the paper's arm under computed torque: the tables of
docs/guides/faults.md.

    python tests/benchmarks/faults.py [--write] [--runs 20] [--mujoco]

The first table: faults of a moment and lasting ones, in motion. The second: whatever an encoder, a
clock, a script or an arm may do, at rest, in motion and during a hold, on rigid and on elastic
gears, beside the same arm without torque from the stop on; in MuJoCo the same, if asked for. Last,
so many healthy runs: random smooth paths, loads of 0 to 5 kg, rigid gears and elastic ones.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
from faults import FAULTS, experiment
from spoilt import DT, LIES, WHEN, healthy, told

from ctc import ComputedTorque
from plant import puma560

PAGE = Path(__file__).parent.parent.parent / "docs" / "guides" / "faults.md"


def table():
    """One row per fault."""
    arm, rig = puma560.arm(), puma560.rig()
    law = ComputedTorque(arm, rig)
    yield (
        "| what was injected at call 1001 | status at the end | calls bridged | peak torque of"
        " joints 2, 3 [N m] | peak error [pulses] | peak torque, peak error without guards |"
    )
    yield "|---|---|---|---|---|---|"
    for fault in FAULTS.values():
        result = experiment(law, arm, fault)
        yield (
            f"| {fault.says} | {result.status} | {result.bridged} | {_pair(result.peak_torque, 0)}"
            f" | {_pair(result.peak_error, 1)} | {_without(law, arm, fault)} |"
        )


def _without(law, arm, fault):
    try:
        result = experiment(law, arm, fault, guards=False)
    except ValueError as refusal:
        return f"refused: {str(refusal).split(';')[0]}"
    return f"{_pair(result.peak_torque, 0)}; {_pair(result.peak_error, 1)}"


def _pair(values, digits):
    return ", ".join(f"{value:,.{digits if value < 100 else 0}f}" for value in np.asarray(values))


def lies(*, mujoco=False):
    """One row per lie: in every situation the time to its detection, and what the arm does after
    it.
    """
    yield (
        "| fault | detected after [ms]: at rest, in motion, in a hold | elastic gears | largest"
        " speed after the stop [rad/s] (without torque) | largest kinetic energy [J] (without"
        " torque) | at the limit after the stop, at most [ms] |"
    )
    yield "|---|---|---|---|---|---|"
    for lie in LIES.values():
        runs = {
            gears: [told(lie, when, gears, mujoco=mujoco) for when in WHEN]
            for gears in ("rigid", "elastic")
        }
        cells = [", ".join(_detected(run) for run in those) for those in runs.values()]
        stopped = [run for those in runs.values() for run in those if run.stop is not None]
        if stopped:
            fast = max(
                stopped,
                key=lambda run: (
                    np.abs(run.speed[run.stop :]).max() / max(np.abs(run.alone).max(), 0.1)
                ),
            )
            cells += [
                f"{np.abs(fast.speed[fast.stop :]).max():.2f} ({np.abs(fast.alone).max():.2f})"
            ]
            fast = max(
                stopped,
                key=lambda run: run.energy[run.stop :].max() / max(run.energy_alone.max(), 0.1),
            )
            cells += [f"{fast.energy[fast.stop :].max():.1f} ({fast.energy_alone.max():.1f})"]
            cells += [f"{1e3 * max(run.at_limit for run in stopped):.0f}"]
        else:
            cells += ["-", "-", "-"]
        yield f"| {lie.says} | {' | '.join(cells)} |"


def _detected(run):
    if run.stop is None:
        return "-"
    return f"{1e3 * DT * (run.stop - run.begun):.0f}"


def _replaced(mark, text):
    before, rest = PAGE.read_text(encoding="utf-8").split(f"<!-- {mark} -->\n")
    after = rest.split(f"<!-- end of {mark} -->")[1]
    PAGE.write_text(
        f"{before}<!-- {mark} -->\n{text}\n<!-- end of {mark} -->{after}", encoding="utf-8"
    )


def main():
    """Print, and replace the tables of the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help="put the table into docs/guides/faults.md"
    )
    parser.add_argument("--runs", type=int, default=20, help="healthy runs")
    parser.add_argument("--mujoco", action="store_true", help="the second table in MuJoCo, too")
    given = parser.parse_args()
    tables = {"faults": table(), "lies": lies()} | (
        {"engine": lies(mujoco=True)} if given.mujoco else {}
    )
    for mark, rows in tables.items():
        text = "\n".join(rows)
        print(text, flush=True)
        if given.write:
            _replaced(mark, text)
    stopped = [status for status in map(healthy, range(given.runs)) if status != "running"]
    print(f"{len(stopped)} of {given.runs} healthy runs stopped")
    for status in stopped:
        print(status)


if __name__ == "__main__":
    main()
