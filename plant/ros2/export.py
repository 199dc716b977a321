"""A control law as a package of ROS 2: a ros2_control plugin around the C of its controller.

The C and its guards are those of `plant.realtime.c_running`; the C++ around it is a template that
holds no equation: counts of angles, angles of counts, and the polynomial between two points of a
trajectory are generated, too.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

import casadi as ca
from numpy.typing import ArrayLike

from plant.compiler import STATE, TIME, UNIFORM, helpers, paragraph, statements
from plant.laws import Law
from plant.machine import Rig
from plant.parts import instance, known_options
from plant.realtime import (
    CONTROLLER,
    Guards,
    Output,
    limited,
    require_exportable,
    rig_of,
    values_of,
    write_templates,
)

_TEMPLATES = Path(__file__).with_name("templates")
# Relative difference that the rates of manager and law may have; the controller checks 0.1 %.
_RATE = 0.9e-3
_FILES = {
    "package.xml": "package.xml",
    "CMakeLists.txt": "CMakeLists.txt",
    "{}_plugin.xml": "plugin.xml",
    "{}_controller.hpp": "controller.hpp",
    "{}_controller.cpp": "controller.cpp",
    "{}.yaml": "parameters.yaml",
    "{}.launch.py": "launch.txt",
    "README.md": "README.md",
}


class Commands(NamedTuple):
    """What the plugin writes: interfaces of each joint, and texts of its templates."""

    interfaces: tuple[str, ...]
    rows: tuple[str, ...]
    deactivated: str
    on_deactivation: str
    write: str


_NOTHING = """\
  const std::array<double, ROWS * JOINTS> none{};
  const bool written = write(none.data());
  return written ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;"""

# A first call with NaN is refused: then no torque acts.
_AS_GIVEN = """\
  if (refusal != 0) {{
    {output}.fill(0.0);
  }}
  unwritten_ = write({output}.data()) ? 0 : unwritten_ + 1;"""

_LIMP = "it commands zero torque: the brakes first"

_COMMANDS = {
    "torque": Commands(
        interfaces=("effort",),
        rows=("N m, joint side, after the amplifier's limit",),
        deactivated=_LIMP,
        on_deactivation=_NOTHING,
        write=_AS_GIVEN.format(output="torque"),
    ),
    "goal": Commands(
        interfaces=("position",),
        rows=("goal of the servo: a whole count, in rad or counts (parameter `unit`)",),
        deactivated="it writes nothing more, and the servos hold their last goals",
        on_deactivation="  return CallbackReturn::SUCCESS;",
        # After a refusal nothing is written, and the servos stay where they are.
        write="""\
  std::array<double, JOINTS> command{};
  std::copy(goal.begin(), goal.end(), command.begin());
  if (unit_ == "rad") {
    const std::array<double, JOINTS> goals = command;
    positions_of(goals.data(), command.data());
  }
  unwritten_ = refusal == 0 && write(command.data()) ? 0 : unwritten_ + 1;""",
    ),
    "frame": Commands(
        interfaces=("position", "velocity", "stiffness", "damping", "effort"),
        rows=(
            "q of the MIT frame [rad], joint side",
            "qd [rad/s]",
            "kp [N m/rad]",
            "kd [N m s/rad]",
            "tau [N m], beside kp and kd",
        ),
        deactivated=_LIMP,
        on_deactivation=_NOTHING,
        write=_AS_GIVEN.format(output="frame"),
    ),
}


def _command_values(commands: Commands) -> dict[str, Any]:
    """Values of the templates for these commands."""
    # One list serves code, parameters and table, so that they cannot name other interfaces.
    quoted = [f'"{interface}"' for interface in commands.interfaces]
    several = len(quoted) > 1
    parameter = "command_interfaces" if several else "command_interface"
    value = f'get_node()->get_parameter("{parameter}")'
    table = [
        f"| command, written | `<joint>/{interface}` | {meaning} |"
        for interface, meaning in zip(commands.interfaces, commands.rows, strict=True)
    ]
    return {
        "rows": len(quoted),
        "command_parameter": parameter,
        "command_type": "std::vector<std::string>" if several else "std::string",
        "commands": f"{{{', '.join(quoted)}}}" if several else quoted[0],
        "commands_of_parameter": f"{value}.as_string_array()"
        if several
        else f"{{{value}.as_string()}}",
        "commands_in_yaml": f"[{', '.join(commands.interfaces)}]"
        if several
        else commands.interfaces[0],
        "commands_in_table": "\n".join(table),
        "deactivated": commands.on_deactivation,
        "deactivated_in_words": commands.deactivated,
        "written": commands.write,
    }


@known_options
def to_ros2_control(
    law: Law,
    folder: str | Path,
    rig: Rig | None = None,
    *,
    name: str = "arm_controller",
    joints: Sequence[str] | None = None,
    guards: Guards = Guards(),  # noqa: B008 - frozen
    torque_limit: ArrayLike | None = None,
    without: Sequence[str] = (),
) -> None:
    """Export a control law as a ros2_control controller: a package for ROS 2 Jazzy and colcon.

    It reads `position` (rad, or counts) of each joint, follows a ``JointTrajectory`` or the
    controller before it, and has every guard and stop of ``law.start(rig, pulses, guards=guards)``.
    It writes `effort` [N m]; above a `PositionServo` `position`, the goal; above a `MitDrive`
    `position`, `velocity`, `stiffness`, `damping` and `effort`, the fields of its frame.

    Parameters
    ----------
    law : Law
        With a period; the controller manager has to run at its rate.
    folder : str or Path
        Made if it is not there; an earlier export of the same name in it is overwritten, nothing
        else is.
    rig : Rig, optional
        What the controller drives; by default the rig that the law holds, if it does.
    name : str
        Of the package and the controller; small letters, digits and single underscores.
    joints : sequence of str, optional
        Names of the joints in ROS, in the order of the law; by default those of the arm, with _ for
        each space; of numbers, and where there are none, joint1 and so on.
    guards : Guards
    torque_limit : (n,) array_like, optional
        As of `Law.start`: a limit below the amplifier's [N m].
    without : sequence of str
        Parts of the model that the hardware adds; as `Law.start`.

    Raises
    ------
    ValueError
        No rig; a law that repeats a log, or has no period, or one that is no whole rate; names that
        ROS could not have; a file in the folder that is not an earlier export.

    See Also
    --------
    plant.Law, plant.Guards

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from ctc import ComputedTorque
    >>> from plant import puma560, to_ros2_control
    >>> folder = Path(tempfile.mkdtemp()) / "arm_controller"
    >>> to_ros2_control(ComputedTorque(puma560.arm(), puma560.rig()), folder)
    >>> (folder / "arm_controller_plugin.xml").exists()
    True
    """
    instance(
        "law",
        law,
        Law,
        "Pass a control law, such as ComputedTorque(found), with guards= and without=.",
    )
    rig = rig_of(law, rig, "to_ros2_control(law, folder, rig)")
    kind = type(law).__name__
    instance("guards", guards, Guards, "Give Guards(...).").warn_of_units(rig)
    if law.replays:
        raise ValueError(f"a law at work must be a controller; {kind} repeats a log. Use another.")
    if law.period is None:
        raise ValueError(
            f"law must have a period, to run in update; {kind} has none. Use to_c for fast"
            " hardware."
        )
    # Before the export: the guards of the C check the lower limit, too.
    rig = limited(rig, torque_limit)
    require_exportable(rig, name)
    # ROS forbids both in the names of packages.
    if "__" in name or name.endswith("_"):
        raise ValueError(
            f"name must have single underscores, and none at its end, in ROS; got {name!r}."
            " Rename it."
        )
    hertz = 1 / (law.period or rig.period)
    # The update rate of the controller manager is an integer [Hz].
    if abs(round(hertz) / hertz - 1) > _RATE:
        low = int(hertz)
        # Offer the whole rates on both sides of the present one.
        high = int(hertz) + 1
        took = f"got {1 / hertz:g} s, {hertz:.6g} Hz. Make the law for 1 / {low} or 1 / {high} s"
        raise ValueError(
            f"law must have a rate in whole Hz, as the controller manager has; {took}."
        )
    names = _joint_names(law, rig, joints)
    sends = None if rig.inner is None else rig.inner.sends
    values = values_of(law, rig, guards, name, Output(None, 0, sends), without)
    # One set of templates for all three outputs: only these values differ.
    values |= _command_values(_COMMANDS[sends or "torque"])
    # Text of the user goes into comments of C and into XML, so it is wrapped and escaped there.
    summary = (
        f"{kind} for {', '.join(names)}, with the guards and the stop of the running controller"
    )
    functions = "\n".join(_functions(rig, goals=sends == "goal"))
    # Helpers of the three functions once, since C knows no second definition.
    functions = helpers(functions) + functions
    values |= {
        "about": f"{paragraph(summary)}\n *\n{values['about']}",
        # The name of a law may have letters beyond ASCII.
        "summary": escape(summary).encode("ascii", "xmlcharrefreplace").decode("ascii"),
        "functions": functions,
        "joints": ", ".join(f'"{joint}"' for joint in names),
        "joints_said": ", ".join(names),
        "rate": round(hertz),
    }
    # The C is that of `to_c`; the remaining files make it a package of ROS.
    package = {file.format(name): _TEMPLATES / template for file, template in _FILES.items()}
    code = {f"{name}{suffix}": template for suffix, template in CONTROLLER.items()}
    write_templates(folder, name, code | package, values)


def _joint_names(law: Law, rig: Rig, joints: Sequence[str] | None) -> list[str]:
    """Names of the joints in ROS."""
    arm = getattr(law, "arm", None)
    labels = rig.drive.joints if arm is None else [link.name for link in arm.dynamics.chain.links]
    # ROS needs a name for every joint.
    labels = labels or [str(i + 1) for i in range(rig.n)]
    # A name in ROS begins with a letter; digits alone are those of a chain without names.
    names = [f"joint{label}" if label.isdigit() else label.replace(" ", "_") for label in labels]
    # A str is a sequence of letters, and would pass as one name per letter.
    if isinstance(joints, str):
        raise ValueError(
            f"joints must be a sequence of names; got {joints!r:.60}. Write ({joints!r:.60},)."
        )
    names = names if joints is None else list(joints)
    for label in names:
        if not isinstance(label, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]{0,99}", label):
            rule = "be letters, digits, _, - or ., and begin with a letter"
            raise ValueError(
                f"joints must {rule}, in ROS; got {label!r:.60}. Give joints=(...), as the URDF has"
                " them."
            )
    # Two joints of one name would read the same encoder.
    if len(names) != rig.n or len(set(names)) != rig.n:
        raise ValueError(
            f"joints must be {rig.n} different names; got {', '.join(names)}. Give one per joint."
        )
    return names


def _functions(rig: Rig, *, goals: bool) -> Iterator[str]:
    """Generated C of the plugin: counts of angles and back, motion between two points."""
    n = rig.n
    q = ca.SX.sym("positions", n)
    counts = ca.SX.sym("counts", n)
    # Halves round up on both sides of zero, unlike those of C's `round`.
    yield _function(
        "counts_of",
        [("positions", q)],
        "counts",
        ca.floor(rig.position_in_pulses(q) + 0.5),
    )
    yield _function("angles_of", [("counts", counts)], "angles", rig.cell_centre(counts))
    if goals:
        # As a driver makes angles of counts: without the half of a cell.
        yield _function("positions_of", [("goals", counts)], "positions", rig.to_angle(counts))
    begun = ca.SX.sym("begun", 3)
    ended = ca.SX.sym("ended", 3)
    span = ca.SX.sym("span")
    at = ca.SX.sym("at")
    inputs = [("begun", begun), ("ended", ended), ("span", span), ("at", at)]
    yield _function("between", inputs, "motion", _between(begun, ended, span, at))


def _between(begun: ca.SX, ended: ca.SX, span: ca.SX, at: ca.SX) -> ca.SX:
    """Position, velocity and acceleration (3, 1) on the quintic between two points."""
    # Position, velocity and acceleration of the beginning fix three coefficients; the three higher
    # ones follow from those at the end, in units of the span so that the matrix is constant.
    higher = ca.SX.sym("higher", 3)
    # The powers of the share of the span keep the higher coefficients in rad.
    share = at / span
    position = begun[0] + begun[1] * at + begun[2] / 2 * at**2
    position += ca.dot(higher, ca.vertcat(share**3, share**4, share**5))
    # casadi differentiates once, so that the three formulas cannot disagree.
    velocity = ca.jacobian(position, at)
    motion = ca.vertcat(position, velocity, ca.jacobian(velocity, at))
    # The end conditions are linear in the higher coefficients: solve them by the inverse of their
    # matrix, which depends on nothing once the span is 1.
    missing = ca.substitute(ended - motion, at, span) * ca.vertcat(1, span, span**2)
    matrix = ca.evalf(ca.substitute(-ca.jacobian(missing, higher), span, 1))
    return ca.substitute(
        motion, higher, ca.inv(matrix) @ ca.substitute(missing, higher, ca.SX.zeros(3))
    )


def _function(name: str, inputs: list[tuple[str, ca.SX]], output: str, value: ca.SX) -> str:
    """A C function that writes the components of a vector."""
    # Only these two are passed by value; a vector of one joint stays a pointer.
    scalar = {
        argument
        for argument, symbol in inputs
        if symbol.numel() == 1 and argument in ("span", "at")
    }
    sources = [
        (
            [(argument, STATE)]
            if argument in scalar
            else [(f"{argument}[{i}]", STATE) for i in range(symbol.numel())]
        )
        for argument, symbol in inputs
    ]
    function = ca.Function(name, [symbol for _, symbol in inputs], [ca.densify(ca.cse(value))])
    # Every number may change from call to call, so all inputs count as state.
    lines, values, _ = statements(function, sources)
    taken = ", ".join(
        f"double {argument}" if argument in scalar else f"const double * {argument}"
        for argument, _ in inputs
    )
    body = [*lines[UNIFORM], *lines[TIME], *lines[STATE]]
    body += [f"{output}[{i}] = {text};" for i, text in enumerate(values)]
    return (
        f"void {name}({taken}, double * {output})\n{{\n"
        + "".join(f"  {line}\n" for line in body)
        + "}\n"
    )
