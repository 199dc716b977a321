"""What an FMU exchanges, by name, and how the model descriptions of both versions of FMI list it."""

import dataclasses
import re
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import quoteattr

from plant.mechanics.arm import Arm
from plant.realtime.running import Running


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number: an input, output or parameter, real or whole; outputs have no start."""

    name: str
    causality: str
    said: str
    unit: str | None = None
    start: float = 0.0
    whole: bool = False

    @property
    def settable(self) -> bool:
        return self.causality != "output"


def of_joints(
    quantity: str, joints: Sequence[str], causality: str, said: str, unit: str | None = None, whole: bool = False
) -> list[Variable]:
    """One variable per joint, ``torque.elbow``."""
    return [Variable(f"{quantity}.{joint}", causality, f"{said}, {joint}", unit, whole=whole) for joint in joints]


def named_joints(labels: Iterable[str]) -> list[str]:
    """Names of joints as FMI has them in ``torque.elbow``, from their labels."""
    names = [re.sub(r"[^A-Za-z0-9]+", "_", re.sub(r"(?<=\S) \(q\[\d+\]\)$", "", label)).strip("_") for label in labels]
    if len(set(names)) < len(names) or not all(re.match("[A-Za-z]", name) for name in names):
        rule = "differ in letters and digits, and begin with a letter"
        raise ValueError(f"joint names must {rule}; got {', '.join(names)}. Rename the joints of chain or drive.")
    return names


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


def arm_variables(arm: Arm) -> list[Variable]:
    """What is exchanged, reals first."""
    joints = named_joints(arm.dynamics.chain.joint_labels)
    f = enumerate(zip(arm.dynamics.names, arm.f, strict=True), 1)
    return [
        *of_joints("torque", joints, "input", "joint torque; the amplifier's limit is kept", unit="N.m"),
        *of_joints("q_start", joints, "parameter", "position at the start", unit="rad"),
        *of_joints("qd_start", joints, "parameter", "velocity at the start", unit="rad/s"),
        *(Variable(f"f[{i}]", "parameter", f"inertial parameter {name}", start=value) for i, (name, value) in f),
        *of_joints("q", joints, "output", "true joint position", unit="rad"),
        *of_joints("qd", joints, "output", "true joint velocity", unit="rad/s"),
        *of_joints("counts", joints, "output", "encoder count", whole=True),
    ]


def described(version: int, variables: Sequence[Variable], files: Sequence[str]) -> dict[str, str]:
    """Lists of a model description; a variable's value reference is its place, and the reals come first."""
    places = [place for place, variable in enumerate(variables) if not variable.settable]
    known = {"variables": [_declared(variable, place, version) for place, variable in enumerate(variables)]}
    if version == 2:
        known["outputs"] = [f'<Unknown index="{place + 1}"/>' for place in places]
        known["files"] = [f'<File name="{file}"/>' for file in files]
    else:
        known["outputs"] = [f'<Output valueReference="{place}"/>' for place in places]
        known["initial"] = [f'<InitialUnknown valueReference="{place}"/>' for place in places]
        known["files"] = [f'<SourceFile name="{file}"/>' for file in files]
    return {"count": str(len(variables)), **{name: "\n      ".join(lines) for name, lines in known.items()}}


def _declared(variable: Variable, place: int, version: int) -> str:
    """One variable of ModelVariables."""
    about = {"name": variable.name, "valueReference": str(place), "description": variable.said,
             "causality": variable.causality}  # fmt: skip
    if variable.causality == "parameter":
        about["variability"] = "fixed"
    elif variable.whole:
        about["variability"] = "discrete"
    value = {} if variable.unit is None else {"unit": variable.unit}
    if variable.settable:
        value["start"] = str(int(variable.start)) if variable.whole else repr(float(variable.start))
    else:
        about["initial"] = "calculated"
    said, given = (" ".join(f"{key}={quoteattr(text)}" for key, text in each.items()) for each in (about, value))
    if version == 2:
        return f"<ScalarVariable {said}><{'Integer' if variable.whole else 'Real'} {given}/></ScalarVariable>"
    return f"<{'Int32' if variable.whole else 'Float64'} {said} {given}/>"
