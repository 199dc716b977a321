"""What each fault of a control loop does to the paper's arm under computed torque: the table of docs/guides/faults.md.

python tests/benchmarks/faults.py [--write]
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
from faults import FAULTS, experiment

from ctc import ComputedTorque
from plant import puma560

PAGE = Path(__file__).parent.parent.parent / "docs" / "guides" / "faults.md"


def table():
    """One row per fault."""
    arm, rig = puma560.arm(), puma560.rig()
    law = ComputedTorque(arm, rig)
    yield (
        "| what was injected at call 1001 | status at the end | calls bridged | peak torque of joints 2, 3 [N m] | "
        "peak error [pulses] | peak torque, peak error without guards |"
    )
    yield "|---|---|---|---|---|---|"
    for fault in FAULTS.values():
        result = experiment(law, arm, fault)
        yield (
            f"| {fault.says} | {result.status} | {result.bridged} | {_pair(result.peak_torque, 0)} | "
            f"{_pair(result.peak_error, 1)} | {_without(law, arm, fault)} |"
        )


def _without(law, arm, fault):
    try:
        result = experiment(law, arm, fault, guards=False)
    except ValueError as refusal:
        return f"refused: {str(refusal).split(';')[0]}"
    return f"{_pair(result.peak_torque, 0)}; {_pair(result.peak_error, 1)}"


def _pair(values, digits):
    return ", ".join(f"{value:,.{digits if value < 100 else 0}f}" for value in np.asarray(values))


def main():
    """Print, and replace the table of the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put the table into docs/guides/faults.md")
    text = "\n".join(table())
    print(text)
    if parser.parse_args().write:
        before, rest = PAGE.read_text(encoding="utf-8").split("<!-- faults -->")
        after = rest.split("<!-- end of faults -->")[1]
        PAGE.write_text(f"{before}<!-- faults -->\n{text}\n<!-- end of faults -->{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
