"""What holds back the torque error of the KR300's log: one cause after another.

    python tests/benchmarks/kr300.py DATA

Fits of every fifth block of training at 1.6 Hz, with rows faster than a tenth of the usual speed,
each with one more effect; errors of the blocks kept aside, over all rows and over such rows. "as
packed" leaves the angles in the row in which the file has them, one later than their torques. The
last line is a fit of each block kept aside to itself: whatever a minute changes, heat and payload
among it, is in it.
"""

import argparse
import dataclasses
import warnings
from pathlib import Path

import numpy as np
import public_logs
from scoreboard import moving, percent

from identification import fit_torque

BAND = 1.6  # [Hz]
JOINTS = np.eye(6)


def columns(shape, name, joints=range(6)):
    """A further column per joint, of a torque shape(q, qd, qdd) (N, 6)."""
    return {f"{name} {j}": lambda q, qd, qdd, j=j: shape(q, qd, qdd) * JOINTS[j] for j in joints}


def waves(joint, orders):
    """Harmonics of the angle of a joint, as torques of that joint."""
    return {
        f"{name} {k} {joint}": lambda q, qd, qdd, wave=wave, k=k: (
            wave(k * q[:, joint : joint + 1]) * JOINTS[joint]
        )
        for k in orders
        for name, wave in (("cos", np.cos), ("sin", np.sin))
    }


def late(record):
    """The record as the file has it: angles one row later than their torques."""
    torque = np.vstack([record.torque[:1], record.torque[:-1]])
    return dataclasses.replace(record, torque=torque)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path)
    log = public_logs.kr300(parser.parse_args().data)
    warnings.simplefilter("ignore")
    usual = 10 * moving(log)

    def root(q, qd, qdd):
        return np.sign(qd) * np.sqrt(np.abs(qd))

    def cube(q, qd, qdd):
        return qd**3

    def stribeck(q, qd, qdd):
        return np.sign(qd) * np.exp(-np.abs(qd) / (0.5 * usual))

    effects = {
        "nothing": {},
        "friction with the root of speed": columns(root, "root"),
        "friction with the cube of speed": columns(cube, "cube"),
        "Stribeck at half of the usual speed": columns(stribeck, "Stribeck"),
        "harmonics 4 to 6 of joint 2": waves(1, (4, 5, 6)),
        "a spring at joint 3": waves(2, (2, 3)),
    }
    print("| effect beside friction by direction | all rows | moving |\n|---|---|---|")
    few = log.fitted[::5]

    def show(name, fitted, kept, extra):
        slowest = 0.1 * usual
        fit = fit_torque(
            log.dynamics, fitted, extra={**log.extra, **extra}, band=BAND, least_speed=slowest
        )
        every, some = fit.error_on(kept), fit.error_on(kept, least_speed=slowest)
        print(f"| {name} | {percent(every)} | {percent(some)} |", flush=True)

    show("as packed", [late(record) for record in few], [late(record) for record in log.kept], {})
    for name, extra in effects.items():
        show(name, few, log.kept, extra)
    for i, record in enumerate(log.kept):
        show(f"block {i} fitted to itself", [record], [record], {})


if __name__ == "__main__":
    main()
