"""What one step of an exported controller takes, and that its torque is the simulation's.

    python tests/benchmarks/c_export.py

Every law is exported, compiled by its Makefile, fed the pulses of a simulated trajectory (6), and
compared with the torque that the simulation logged; then the same program times itself, over whole
records, seven times. Last, one with all guards of the running controller.
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from plant import Guards, puma560, simulate, write_replay

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAWS = {
    "P": puma560.p_law(),
    "ComputedTorque": ComputedTorque(ARM, RIG),
    "ComputedTorque, delay=1": ComputedTorque(ARM, RIG, delay=1),
    "ComputedTorque, measured=True, delay=1": ComputedTorque(ARM, RIG, measured=True, delay=1),
}


def measured(law, folder, guards=None):
    """Largest difference of the torque relative to the largest torque, and seven times per step
    [ns].
    """
    record = simulate(ARM, RIG, law, PATH)
    law.to_c(folder, RIG, guards=guards)
    write_replay(record, folder / "record.csv")
    run(["make"], folder)
    torque = np.loadtxt(run(["./controller", "record.csv"], folder).splitlines(), delimiter=",")
    times = [
        float(run(["./controller", "--time", "record.csv"], folder).split()[0]) for _ in range(7)
    ]
    return np.abs(torque - record.torque).max() / np.abs(record.torque).max(), times


def run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout  # noqa: S603


if __name__ == "__main__":
    print(
        "| law | ns per step, median (least to most of 7) | largest difference of the torque,"
        " relative |"
    )
    print("|---|---|---|")
    rows = [(name, law, None) for name, law in LAWS.items()]
    for name, law, guards in [
        *rows,
        ("ComputedTorque, with all guards", LAWS["ComputedTorque"], Guards()),
    ]:
        with tempfile.TemporaryDirectory() as folder:
            difference, times = measured(law, Path(folder), guards)
        print(
            f"| {name} | {np.median(times):.0f} ({min(times):.0f} to {max(times):.0f}) |"
            f" {difference:.1e} |",
            flush=True,
        )
