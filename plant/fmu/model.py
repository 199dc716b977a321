"""Variables of an FMU in the model descriptions of FMI 2 and 3; the step of `simulate` as C.

The functions of an arm are those of `plant.simulation.closed_loop`; here they are put into text.
"""

import dataclasses
import re
import textwrap
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import quoteattr

import casadi as ca
import numpy as np

from plant.compiler import STATE, TIME, UNIFORM, braced, comment, helpers, statements
from plant.mechanics import Arm
from plant.realtime import Running
from plant.simulation import ClosedLoop, bounded


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number: an input, output or parameter, real or whole; outputs have no start."""

    # The token of an FMU depends on these names by `repr`; see `plant.fmu.export`.
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
    quantity: str,
    joints: Sequence[str],
    causality: str,
    description: str,
    unit: str | None = None,
    whole: bool = False,
) -> list[Variable]:
    """One variable per joint, ``torque.elbow``."""
    return [
        Variable(f"{quantity}.{joint}", causality, f"{description}, {joint}", unit, whole=whole)
        for joint in joints
    ]


def named_joints(labels: Iterable[str]) -> list[str]:
    """Names of joints as FMI has them in ``torque.elbow``, from their labels."""
    # Remove the index of the label, ``(q[0])``, then all that FMI's structured names cannot hold.
    names = [
        re.sub(r"[^A-Za-z0-9]+", "_", re.sub(r"(?<=\S) \(q\[\d+\]\)$", "", label)).strip("_")
        for label in labels
    ]
    # Two labels may become the same name once other characters are replaced.
    if len(set(names)) < len(names) or not all(re.match("[A-Za-z]", name) for name in names):
        rule = "differ in letters and digits, and begin with a letter"
        raise ValueError(
            f"joint names must {rule}; got {', '.join(names)}. Rename the joints of chain or drive."
        )
    return names


def law_variables(running: Running) -> list[Variable]:
    """What is exchanged, reals first."""
    joints = named_joints(running.law.joint_labels(running.rig))
    torque = "joint torque after the amplifier's limit"
    if running.without:
        torque += f", without {', '.join(running.without)}"
    return [
        *of_joints("q_r", joints, "input", "reference position", unit="rad"),
        *of_joints("qd_r", joints, "input", "reference velocity", unit="rad/s"),
        *of_joints("qdd_r", joints, "input", "reference acceleration", unit="rad/s2"),
        *of_joints("torque", joints, "output", torque, unit="N.m"),
        *of_joints("counts", joints, "input", "encoder count", whole=True),
        Variable(
            "stopped", "output", "0, or why the arm is stopped: a cause in controller.h", whole=True
        ),
        Variable(
            "brake", "output", "1 where the mechanical brakes should hold the arm", whole=True
        ),
    ]


def arm_variables(arm: Arm) -> list[Variable]:
    """What is exchanged, reals first."""
    joints = named_joints(arm.dynamics.chain.joint_labels)
    f = enumerate(zip(arm.dynamics.names, arm.f, strict=True), 1)
    return [
        *of_joints(
            "torque", joints, "input", "joint torque; the amplifier's limit is kept", unit="N.m"
        ),
        *of_joints("q_start", joints, "parameter", "position at the start", unit="rad"),
        *of_joints("qd_start", joints, "parameter", "velocity at the start", unit="rad/s"),
        *(
            Variable(f"f[{i}]", "parameter", f"inertial parameter {name}", start=value)
            for i, (name, value) in f
        ),
        *of_joints("q", joints, "output", "true joint position", unit="rad"),
        *of_joints("qd", joints, "output", "true joint velocity", unit="rad/s"),
        *of_joints("counts", joints, "output", "encoder count", whole=True),
    ]


def described(version: int, variables: Sequence[Variable], files: Sequence[str]) -> dict[str, str]:
    """Lists of a model description; the value reference of a variable is its index, reals first."""
    # The structure of a model lists what it computes, and no inputs.
    places = [place for place, variable in enumerate(variables) if not variable.settable]
    lists = {
        "variables": [
            _declared(variable, place, version) for place, variable in enumerate(variables)
        ]
    }
    # FMI 2 refers to variables by index from 1, FMI 3 by value reference.
    if version == 2:
        lists["outputs"] = [f'<Unknown index="{place + 1}"/>' for place in places]
        lists["files"] = [f'<File name="{file}"/>' for file in files]
    else:
        lists["outputs"] = [f'<Output valueReference="{place}"/>' for place in places]
        lists["initial"] = [f'<InitialUnknown valueReference="{place}"/>' for place in places]
        lists["files"] = [f'<SourceFile name="{file}"/>' for file in files]
    return {
        "count": str(len(variables)),
        **{name: "\n      ".join(lines) for name, lines in lists.items()},
    }


def _declared(variable: Variable, place: int, version: int) -> str:
    """One variable of ModelVariables."""
    about = {
        "name": variable.name,
        "valueReference": str(place),
        "description": variable.said,
        "causality": variable.causality,
    }
    # Reals are continuous by default; parameters and integers need their variability.
    if variable.causality == "parameter":
        about["variability"] = "fixed"
    elif variable.whole:
        about["variability"] = "discrete"
    # FMI requires a start of inputs and parameters, and none of calculated outputs.
    value = {} if variable.unit is None else {"unit": variable.unit}
    if variable.settable:
        value["start"] = str(int(variable.start)) if variable.whole else repr(float(variable.start))
    else:
        about["initial"] = "calculated"
    head = _attributes(about)
    body = _attributes(value)
    if version == 2:
        return (
            f"<ScalarVariable {head}><{'Integer' if variable.whole else 'Real'}"
            f" {body}/></ScalarVariable>"
        )
    return f"<{'Int32' if variable.whole else 'Float64'} {head} {body}/>"


def _attributes(texts: dict[str, str]) -> str:
    return " ".join(f"{key}={quoteattr(text)}" for key, text in texts.items())


def arm_values(arm: Arm, loop: ClosedLoop) -> dict[str, str]:
    """What the templates arm.c and arm.h need of an arm and its loop."""
    p = arm.dynamics.p
    # Torques, start positions and velocities, f, and outputs, in the order of `arm_variables`.
    start = np.concatenate([np.zeros(3 * arm.n), arm.f, np.zeros(2 * arm.n)])
    # f belongs to the instance, since it is a parameter; the other numbers are constants.
    numbers = loop.number_values(arm.f)[p:]
    bodies = {"settled": _settled(loop), "moved": _moved(loop), "observed": _observed(loop)}
    return {
        "h": repr(loop.h),
        "steps": str(loop.steps_per_sample),
        "states": str(len(loop.state_names)),
        "listed": comment(", ".join(loop.number_names[p:]))[3:-3],
        "numbers": braced(numbers),
        "helpers": helpers("\n".join(bodies.values())),
        "start": braced(start),
        **bodies,
    }


def _settled(loop: ClosedLoop) -> str:
    """The state at the start."""
    q = ca.SX.sym("q", loop.n)
    qd = ca.SX.sym("qd", loop.n)
    numbers = ca.SX.sym("f", _count(loop))
    start = {"q": q, "qd": qd}
    # With elastic gears the links start where the springs carry their weight.
    if loop.elastic:
        start |= {"link": loop.hanging.expand()(q, numbers), "link_speed": qd}
    # Velocities of the links equal those of the motors: no deflection changes.
    function = ca.Function("settled", [q, qd, numbers], [loop.state_with(**start)])
    rows = [[(f"{name}[{i}]", STATE) for i in range(loop.n)] for name in ("q", "qd")]
    return _body(function, [*rows, _numbers(loop)], {"state": range(len(loop.state_names))})


def _moved(loop: ClosedLoop) -> str:
    """One sub-step."""
    places = loop.time_fields.at(loop.n)
    times = [("0.0", UNIFORM)] * len(loop.time_names)
    for i, place in enumerate(places["logged"]):
        times[place] = (f"torque[{i}]", TIME)
    # The torque is held along the sub-step, whose length is fixed at export.
    times[places["h"].start] = (repr(loop.h), UNIFORM)
    state = ca.SX.sym("x", loop.substep.size1_in(0))
    time = ca.SX.sym("t", loop.substep.size1_in(1))
    numbers = ca.SX.sym("numbers", loop.substep.size1_in(2))
    function = ca.Function("moved", [state, time, numbers], loop.substep(state, time, numbers)[:1])
    return _body(
        function, [_state(loop), times, _numbers(loop)], {"state": range(len(loop.state_names))}
    )


def _observed(loop: ClosedLoop) -> str:
    """Position, velocity and counts of a state, and whether they are bounded."""
    n = loop.n
    symbols = ca.SX.sym("state", len(loop.state_names))
    state = loop.read_state(symbols)
    q, qd = loop.joint_motion(state)
    counts = loop.rig.true_counts(loop.encoded(state))
    sound = ca.logic_and(state.ok > 0, bounded(ca.vertsplit(ca.vertcat(state.q, state.qd))))
    # A state that has diverged must end the simulation with an error instead of counts.
    function = ca.Function("observed", [symbols], [ca.cse(ca.vertcat(q, qd, counts, sound))])
    # One function for outputs and soundness, so that no outputs are shown without the check.
    text = _body(
        function,
        [_state(loop)],
        {"seen": range(2 * n), "counts": range(n), "const int sound": None},
    )
    return f"{text}\n    return sound;"


def _body(
    function: ca.Function, inputs: list[list[tuple[str, int]]], targets: dict[str, range | None]
) -> str:
    """Statements that write the results into arrays, after all inputs have been read."""
    # C of the casadi function: an FMU must run where neither casadi nor Python is.
    lines, values, _ = statements(function, inputs)
    # Statements that depend on fewer inputs come first, since the others use their results.
    listed = "".join(f"    {value},\n" for value in values)
    body = [*lines[UNIFORM], *lines[TIME], *lines[STATE]]
    # The arrays may alias the inputs: store all results before copying the first one.
    body.append(f"const double results[{len(values)}] = {{\n{listed}}};")
    begin = 0
    for name, places in targets.items():
        # A target without places is one flag, declared where it is written.
        count = 1 if places is None else len(places)
        if places is None:
            body.append(f"{name} = results[{begin}] != 0.0;")
        else:
            body.append(f"memcpy({name}, results + {begin}, {count} * sizeof *results);")
        begin += count
    return textwrap.indent("\n".join(body), "    ")


def _count(loop: ClosedLoop) -> int:
    return len(loop.number_names)


def _state(loop: ClosedLoop) -> list[tuple[str, int]]:
    return [(f"state[{i}]", STATE) for i in range(len(loop.state_names))]


def _numbers(loop: ClosedLoop) -> list[tuple[str, int]]:
    """Expressions of all numbers: `f` is that of the instance, the others are constants."""
    p = loop.dynamics.p
    return [
        *((f"f[{i}]", UNIFORM) for i in range(p)),
        *((f"numbers[{i}]", UNIFORM) for i in range(_count(loop) - p)),
    ]
