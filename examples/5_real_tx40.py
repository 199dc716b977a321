"""A real log: inverse dynamics of a Staubli TX40 fitted to its motor angles and torques, against
the published fit.

Give the folder that holds ``staubli_tx40`` as CTC_DATA; the public original is the repository
thanhndv212/figaroh-plus (Apache-2.0), commit c3b5172849b744984b7181fd9d517c83fb4242e1,
examples/staubli_TX40.

Processing of the log: positions low-passed at 100 Hz (Butterworth of order 4, forwards and
backwards), differentiated by central differences; both sides low-passed at 20 Hz in the same way;
every 100th row of 5 kHz, from the first on; a joint's equation is left out below the published
speeds. Weights from the residuals of each joint.
"""

import csv
import os
import sys
from pathlib import Path

import numpy as np

from identification import fit_torque
from plant import read_robot

TX40 = read_robot("tx40")
LEAST_SPEED = (0.050, 0.050, 0.075, 0.072, 0.056, 0.122)  # [rad/s], as published


def load(folder):
    """Joint positions (N, 6) [rad] and joint torques (N, 6) [N m] from motor angles and motor
    torques.
    """
    drive = TX40.rig.drive
    motor = [
        np.loadtxt(folder / f"{name}_data.csv", delimiter=",", skiprows=1)
        for name in ("pos_read", "curr")
    ]
    return drive.joint_angle(motor[0]) + np.array(
        [0, -np.pi / 2, np.pi / 2, 0, 0, 0]
    ), drive.joint_torque(motor[1])


def fit(q, torque):
    """Base parameters, friction of every motor, and friction of joint 6 behind the coupling."""
    dynamics, rig = TX40.dynamics, TX40.rig
    friction = [
        f"drive.{kind}[{i}]" for i in range(6) for kind in ("viscous", "coulomb", "curve.offset")
    ]
    last = np.eye(6)[5]
    return fit_torque(
        dynamics,
        q,
        torque,
        rig=rig,
        cutoff=100,
        band=20,
        every=100,
        unknown=(*dynamics.names, *friction),
        least_speed=LEAST_SPEED,
        extra={
            "viscous of joint 6": lambda q, qd, qdd: qd * last,
            "coulomb of joint 6": lambda q, qd, qdd: np.sign(qd) * last,
        },
    )


def published(folder):
    """Value and standard deviation of the published weighted least squares, by name."""
    with open(folder / "TX40_bp_5.csv", newline="") as file:
        rows = [row for row in csv.reader(file) if row]
    return {
        row[0].split(" ")[0]: (float(row[3]), abs(float(row[3])) * float(row[4]) / 100)
        for row in rows
    }


def in_published_terms(found):
    """The same fit in the 60 published numbers: joint side, and the coupling's share apart
    (Iam6, fvm6, fsm6).
    """
    gear = np.abs(TX40.rig.drive.gear)
    values = {
        name.removeprefix("J1 + ").removeprefix("J2 + ").split(" ")[0]: found[name]
        for name in found.names
    }
    values |= {f"Ia{i}": values[f"J{i}"] for i in (3, 4, 5, 6)}
    viscous = gear**2 * [found[f"drive.viscous[{i}]"] for i in range(6)]
    coulomb = gear * [found[f"drive.coulomb[{i}]"] for i in range(6)]
    offset = TX40.rig.drive.gear * [found[f"drive.curve.offset[{i}]"] for i in range(6)]
    values |= {f"fv{i + 1}": viscous[i] for i in range(6)}
    values |= {f"fs{i + 1}": coulomb[i] for i in range(6)}
    values |= {f"off{i + 1}": offset[i] for i in range(6)}
    # Motor 6 turns with joints 5 and 6: its share on the diagonal is counted with theirs, except
    # for the sign's.
    values |= {"Iam6": values["Ia6"], "fvm6": viscous[5], "fsm6": coulomb[5]}
    values["Ia5"] += values["Ia6"]
    values["fv5"] += viscous[5]
    values["off5"] += offset[5]
    values["fv6"] += found["viscous of joint 6"]
    values["fs6"] = found["coulomb of joint 6"]
    return values


def compare(folder):
    """Name, ours, published, its standard deviation; and the fit itself."""
    found = fit(*load(folder))
    ours = in_published_terms(found)
    return [(name, ours[name], *given) for name, given in published(folder).items()], found


def main():
    if not os.environ.get("CTC_DATA"):
        print(
            "CTC_DATA is not set: no log to fit. Give the folder that holds staubli_tx40 (see this"
            " file's first lines)."
        )
        return 0
    folder = Path(os.environ["CTC_DATA"]) / "staubli_tx40"
    if not folder.is_dir():
        print(f"CTC_DATA must hold a folder staubli_tx40; {folder} is not there.")
        return 1
    table, found = compare(folder)
    print(f"{'':8}{'found':>12}{'published':>12}{'std':>10}{'off by':>9}")
    for name, ours, value, std in table:
        print(f"{name:8}{ours:12.4f}{value:12.4f}{std:10.4f}{(ours - value) / std:9.2f}")
    off = np.array([abs(ours - value) / std for _, ours, value, std in table])
    print(
        f"{(off <= 1).sum()} of {len(off)} within one published standard deviation, the worst at"
        f" {off.max():.2f}"
    )
    print(
        f"relative torque error {found.relative_error:.2%}, {found.rows} equations, condition"
        f" {found.condition:.0f}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
