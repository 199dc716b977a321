"""The running controller as the model of an FMU: counts and reference in, torque out."""

import tempfile
from pathlib import Path

import numpy as np

from plant.fmu.variables import Variable, named_joints, of_joints
from plant.realtime.c_text import braced
from plant.realtime.running import Running

NAME = "controller"


def law_variables(running: Running) -> list[Variable]:
    """What is exchanged, reals first."""
    joints = named_joints(running.law.joint_labels(running.rig))
    return [
        *of_joints("q_r", joints, "input", "reference position", unit="rad"),
        *of_joints("qd_r", joints, "input", "reference velocity", unit="rad/s"),
        *of_joints("qdd_r", joints, "input", "reference acceleration", unit="rad/s2"),
        *of_joints("torque", joints, "output", "joint torque after the amplifier's limit", unit="N.m"),
        *of_joints("counts", joints, "input", "encoder count", whole=True),
        Variable("stopped", "output", "0, or why the arm is stopped: a cause in controller.h", whole=True),
        Variable("brake", "output", "1 where the mechanical brakes should hold the arm", whole=True),
    ]


def law_files(running: Running) -> dict[str, str]:
    """The C of the controller."""
    with tempfile.TemporaryDirectory() as folder:
        running.to_c(folder, name=NAME)
        return {file: (Path(folder) / file).read_text("ascii") for file in (f"{NAME}.h", f"{NAME}.c")}


def law_values(running: Running) -> dict[str, str]:
    """What the template law.c needs of it."""
    return {"period": repr(running.period), "start": braced(np.zeros(4 * running.n))}
