"""Public logs of real machines as records, and the arms that they are of.

Each function takes the folder of the data and gives a `Log`: what was logged, split as its
community splits it. A file that is missing raises FileNotFoundError, which names it. Lengths,
gears, rotors and bodies are those that the makers or the authors of a log published.
"""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from model_files import ARMS, file_of

from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Link,
    LoggedTorque,
    Record,
    Rig,
    read_robot,
    read_table,
)

UNITS = {"t": "s", "position": "rad", "torque": "N m"}
COLUMNS = {"t": "t", "position": "position", "torque": "torque"}


@dataclasses.dataclass(frozen=True)
class Log:
    """Logs of one machine: records to fit, records kept aside, and its equations.

    `extra`: further columns of its torque, as `fit_torque` takes them.
    """

    dynamics: Dynamics
    fitted: Sequence[Record]
    kept: Sequence[Record]
    extra: Mapping[str, Callable] = dataclasses.field(default_factory=dict)


def direct_rig(n, period, *, counts=2.0**20, **drive):
    """Drives of joints whose torque and angle are logged on the joint's side; friction is open.

    The positions of these logs are no counts: the encoder is finer than any noise.
    """
    one = np.ones(n)
    numbers = {"gear": one, "motor_inertia": 0 * one, "motor_gain": one} | drive
    return Rig(
        drive=Drive(current_limit=np.inf * one, viscous=None, coulomb=None, **numbers),
        encoder=Encoder(resolution=counts * one, rounding="round"),
        period=period,
    )


def record_of(t, position, torque, rig):
    """A record of joint angles [rad] and torques [N m], joint side."""
    table = {"t": t, "position": position, "torque": torque}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of positions between the counts of the encoder
        return Record.from_table(table, rig=rig, columns=COLUMNS, units=UNITS, law=LoggedTorque())


def halves(record):
    """First and second half of a record."""
    middle = (record.t[0] + record.t[-1]) / 2
    return record.cut(0, middle - record.t[0]), record.cut(middle - record.t[0])


def existing(path):
    """The path; an error that names it where it is missing."""
    if not Path(path).exists():
        raise FileNotFoundError(path)
    return Path(path)


# -- EMPS: one slide -----------------------------------------------------------------------------
PITCH = 2.5e-3  # travel per turn of the motor, for counts of 50 nm [m]


def emps(folder):
    """Slide of 95 kg: fit DATA_EMPS, keep DATA_EMPS_PULSES aside, both under their force."""
    from scipy.io import loadmat

    gear = 2 * np.pi / PITCH
    drive = Drive(
        gear=(gear,), motor_inertia=(0.0,), motor_gain=(1.0,), current_limit=(np.inf,),
        viscous=None, coulomb=None,
    )  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=(50_000.0,), rounding="round"), period=1e-3)
    records = []
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        table = loadmat(existing(Path(folder) / "emps" / f"{name}.mat"))
        force = table["gtau"].ravel()[0] * table["vir"]
        record = Record.from_table(
            {"t": table["t"].ravel(), "position": table["qm"], "torque": force},
            rig=rig,
            columns=COLUMNS,
            units={"t": "s", "position": "m", "torque": "N"},
            law=LoggedTorque(),
        )
        records.append(record)
    chain = Chain(links=(Link(name="slide", prismatic=True),), gravity=(0.0, 0.0, 0.0))
    return Log(Dynamics.from_chain(chain), records[:1], records[1:])


# -- UR10 and Panda: ROS 2 bags ------------------------------------------------------------------
def bag(folder, model, file):
    """A bag of joint states: the first half is fitted, the second kept aside."""
    table = read_table(existing(Path(folder) / "ur10_panda_bags" / file))
    table = {key.rpartition(".")[2]: column for key, column in table.items()}
    # Some rows of the Panda repeat the one before, and the motion goes on one row later.
    new = np.append(True, np.diff(table["position"], axis=0).any(axis=1))
    period = 1e-9 * float(np.median(np.diff(table["stamp"])))
    position, torque = table["position"][new], table["effort"][new]
    t = period * np.arange(len(position))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of right angles that are put right
        chain = Chain.from_urdf(existing(file_of(model)), tip=ARMS[model][2])
    record = record_of(t, position, torque, direct_rig(chain.n, period))
    return Log(Dynamics.from_chain(chain, rotors=False), *zip(halves(record)))


def ur10(folder):
    return bag(folder, "UR10", "ur10_exciting_trajectory.db3")


def panda(folder):
    return bag(folder, "Panda", "panda_exciting_trajectory.db3")


# -- TIAGo: the arm of seven joints --------------------------------------------------------------
# Gear and torque constant [N m/A] of each motor, by the authors of the log; efforts are currents.
TIAGO_GEAR = np.array([100, 100, 100, 100, 336, 336, 336])
TIAGO_CONSTANT = np.array([0.136, 0.136, -0.087, -0.087, -0.087, -0.0613, -0.0613])
TIAGO_ROWS = slice(921, 6791)  # the excitation, as the authors cut it


def tiago(folder):
    """The arm at 100 Hz on a torso that hardly moves: first half fitted, second kept aside."""
    columns = []
    for kind in ("position", "effort"):
        file = existing(Path(folder) / "tiago" / f"tiago_{kind}.csv")
        columns.append(np.loadtxt(file, delimiter=",", skiprows=1)[TIAGO_ROWS])
    t = columns[0][:, 0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        chain = Chain.from_urdf(
            existing(file_of("TIAGo")), base=ARMS["TIAGo"][1], tip=ARMS["TIAGo"][2]
        )
    torque = TIAGO_GEAR * TIAGO_CONSTANT * columns[1][:, 2:]
    rig = direct_rig(chain.n, float(np.median(np.diff(t))), counts=4096 * 100)
    record = record_of(t - t[0], columns[0][:, 2:], torque, rig)
    return Log(Dynamics.from_chain(chain, rotors=False), *zip(halves(record)))


# -- Staubli TX40 --------------------------------------------------------------------------------
TX40_PERIOD, TX40_REST = 1 / 5000, 1.5  # [s]; the end of the log is without motion
TX40_EVERY = 10  # one sample out of so many: 500 Hz hold all motion


def tx40(folder):
    """Motor angles and torques: the first half of the moving time is fitted, the second kept."""
    robot = read_robot("tx40")
    motor = [
        np.loadtxt(
            existing(Path(folder) / "staubli_tx40" / f"{name}_data.csv"), delimiter=",", skiprows=1
        )
        for name in ("pos_read", "curr")
    ]
    moving = slice(0, len(motor[0]) - int(TX40_REST / TX40_PERIOD), TX40_EVERY)
    shift = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    position = robot.rig.drive.joint_angle(motor[0][moving]) + shift
    torque = robot.rig.drive.joint_torque(motor[1][moving])
    drive = dataclasses.replace(robot.rig.drive, viscous=None, coulomb=None, curve=None)
    period = TX40_PERIOD * TX40_EVERY
    rig = dataclasses.replace(robot.rig, drive=drive, period=period)
    record = record_of(period * np.arange(len(position)), position, torque, rig)
    return Log(robot.dynamics, *zip(halves(record)))


# -- KUKA KR300 R2500 ----------------------------------------------------------------------------
# Standard Denavit-Hartenberg rows, gears and rotors, and the pose that is logged as zero, of
# yifang0-0/Physics-Guided-Recurrent-State-Space-Neural-Networks, data/IndustRobo.
KR300_ROWS = ((-np.pi / 2, 0.35, 0.675, -np.pi / 2), (0, 1.15, -0.189, 0),
              (-np.pi / 2, 0.041, 0.189, np.pi / 2), (np.pi / 2, 0, -1, 0),
              (-np.pi / 2, 0, 0, 0), (np.pi, 0, -0.24, 0))  # fmt: skip
KR300_GEAR = np.array([212.76, 203.52, 192.75, 156, 156, 102.17])
KR300_ROTOR = (0.00923, 0.0118, 0.0118, 0.00173, 0.00173, 0.00173)
KR300_HOME = np.radians([0, -90, 90, 0, 0, 0])
KR300_BLOCK = 605  # samples of a block, between which the robot stood [at 10 Hz]


def kr300(folder):
    """Blocks of 60.5 s at 10 Hz, motor torques: fit those of training, keep those of the test."""
    from scipy.io import loadmat

    rows = [dict(zip(("alpha", "a", "d", "theta"), row, strict=True)) for row in KR300_ROWS]
    rig = direct_rig(6, 0.1, gear=KR300_GEAR, motor_inertia=KR300_ROTOR)
    # Axis 1 turns against the first row of the table.
    sign = np.array([-1, 1, 1, 1, 1, 1])
    dynamics = Dynamics.from_chain(Chain.standard(rows))
    table = loadmat(existing(Path(folder) / "kr300" / "forward_shifted.mat"))

    # A gas spring holds joint 2; its cylinder's force is no known function of the angle. Two
    # harmonics beyond those of gravity, and a constant, describe it.
    second = np.eye(6)[1]
    extra = {
        f"{name} {k} q2": lambda q, qd, qdd, wave=wave, k=k: wave(k * q[:, 1:2]) * second
        for k in (2, 3)
        for name, wave in (("cos", np.cos), ("sin", np.sin))
    }

    def blocks(part):
        position = sign * (np.radians(table[f"y_{part}"].T) + KR300_HOME)
        torque = sign * KR300_GEAR * table[f"u_{part}"].T
        parts = len(position) // KR300_BLOCK
        pairs = zip(np.split(position, parts), np.split(torque, parts), strict=True)
        # A row of this file has the torque and the angle of one row later: a model is to predict.
        t = 0.1 * np.arange(KR300_BLOCK - 1)
        return [record_of(t, q[:-1], tau[1:], rig) for q, tau in pairs]

    return Log(dynamics, blocks("train"), blocks("test"), extra)
