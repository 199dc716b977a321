"""What one step of an exported controller takes, and that its torque is the simulation's.

    python tests/benchmarks/c_export.py

Every law is exported, compiled by cc -std=c99 -O2, fed the pulses of a simulated trajectory (6), and compared with the
torque that the simulation logged; then the same program times itself, over whole records, seven times. Last, the
controller with all of its guards (`Running.to_c`).
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from plant import puma560, simulate
from plant.simulation.controller_log import write_replay

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAWS = {
    "P": puma560.p_law(),
    "ComputedTorque": ComputedTorque(ARM, RIG),
    "ComputedTorque, delay=1": ComputedTorque(ARM, RIG, delay=1),
    "ComputedTorque, measured=True, delay=1": ComputedTorque(ARM, RIG, measured=True, delay=1),
}


def measured(law, folder):
    """Largest difference of the torque relative to the largest torque, and seven times per step [ns]."""
    record = simulate(ARM, RIG, law, PATH)
    law.to_c(folder, RIG)
    write_replay(record, folder / "record.csv")
    run(["make"], folder)
    torque = np.loadtxt(run(["./controller", "record.csv"], folder).splitlines(), delimiter=",")
    times = [float(run(["./controller", "--time", "record.csv"], folder).split()[0]) for _ in range(7)]
    return np.abs(torque - record.torque).max() / np.abs(record.torque).max(), times


TIMED = """
#include "controller.h"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#define SAMPLES %d
static int32_t counts[SAMPLES][2];
static double motion[3][SAMPLES][2], torque[SAMPLES][2];
int main(int argc, char **argv)
{
    controller_state self;
    FILE *file = fopen("record.csv", "r");
    (void)fscanf(file, "%%*[^\\n]");
    for (int k = 0; k < SAMPLES; k++)
        if (fscanf(file, "%%d,%%d,%%lf,%%lf,%%lf,%%lf,%%lf,%%lf", &counts[k][0], &counts[k][1], &motion[0][k][0],
                &motion[0][k][1], &motion[1][k][0], &motion[1][k][1], &motion[2][k][0], &motion[2][k][1]) != 8)
            return 1;
    const clock_t start = clock();
    long steps = 0;
    do {
        controller_init(&self, counts[0]);
        for (int k = 0; k < SAMPLES; k++, steps++)
            controller_step(&self, counts[k], motion[0][k], motion[1][k], motion[2][k], NAN, torque[k]);
    } while (clock() - start < CLOCKS_PER_SEC / 2);
    if (argc > 1 && !strcmp(argv[1], "--time"))
        printf("%%.1f\\n", 1e9 * (double)(clock() - start) / CLOCKS_PER_SEC / (double)steps);
    else
        for (int k = 0; k < SAMPLES; k++)
            printf("%%.17g,%%.17g\\n", torque[k][0], torque[k][1]);
    return controller_stopped(&self);
}
"""


def guarded(law, folder):
    """The same of the running controller."""
    record = simulate(ARM, RIG, law, PATH)
    law.start(RIG, record.counts[0]).to_c(folder)
    write_replay(record, folder / "record.csv")
    (folder / "main.c").write_text(TIMED % len(record), encoding="ascii")
    run(["cc", "-std=c99", "-O2", "-o", "controller", "main.c", "controller.c", "-lm"], folder)
    torque = np.loadtxt(run(["./controller"], folder).splitlines(), delimiter=",")
    times = [float(run(["./controller", "--time"], folder)) for _ in range(7)]
    return np.abs(torque - record.torque).max() / np.abs(record.torque).max(), times


def run(command, folder):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout  # noqa: S603


if __name__ == "__main__":
    print("| law | ns per step, median (least to most of 7) | largest difference of the torque, relative |")
    print("|---|---|---|")
    rows = [(name, measured, law) for name, law in LAWS.items()]
    for name, work, law in [*rows, ("ComputedTorque, with all guards", guarded, LAWS["ComputedTorque"])]:
        with tempfile.TemporaryDirectory() as folder:
            difference, times = work(law, Path(folder))
        print(
            f"| {name} | {np.median(times):.0f} ({min(times):.0f} to {max(times):.0f}) | {difference:.1e} |", flush=True
        )
