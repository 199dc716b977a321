"""A running controller as C99, with every guard and every stop: its memory and its functions.

The guards are those of `plant.realtime.safety`, translated; the functions of law and rig are those
of `plant.realtime.pieces`; the struct has the fields of `plant.realtime.memory` and begins as the
memory of the controller. Two files; nothing is allocated, and there is no state outside the struct.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from plant.compiler import (
    STATE,
    UNIFORM,
    CFunction,
    CNames,
    braced,
    comment,
    helpers,
    literal,
    paragraph,
    statements,
)
from plant.machine import Rig
from plant.parts import Floats
from plant.realtime import safety, stopping, watching
from plant.realtime.c_text import (
    HOST,
    ONE_CONTROLLER,
    Output,
    Target,
    fragment,
    require_exportable,
    sides,
    struct,
    write_files,
)
from plant.realtime.calls import PIECES
from plant.realtime.compiled_step import initial_memory
from plant.realtime.guards import Guards
from plant.realtime.memory import (
    CAUSES,
    JOINT_FIELDS,
    LAW_STATES,
    RUN_FIELDS,
    SIZES,
    Layout,
    view,
)
from plant.realtime.pieces import RAMP, ROUNDING, SINGLE_ROUNDING, Piece, pieces_of, sent_by
from plant.realtime.status import wording

# Prefix of every function's name: C's library has a read, and a finite.
PREFIX = "running_"

HELPERS = """\
/* As Python's min and max: of two that do not compare, the first. */
static double least(double a, double b)
{
    return b < a ? b : a;
}

static double greatest(double a, double b)
{
    return b > a ? b : a;
}
"""

# In the order in which their constants are declared.
_MODULES = (stopping, watching, safety)


def names_of(name: str) -> CNames:
    """C names of the guards of a controller; the names of its structs begin with `name`."""
    # Names of C are known before a text is translated, since functions call each other.
    functions = [node.name for node in _functions()]
    return CNames(
        arrays=("pulses", "q_r", "qd_r", "qdd_r", "torque"),
        read=("pulses", "q_r", "qd_r", "qdd_r"),
        records={
            "memory": f"{name}_state",
            "run": f"{name}_run",
            "joint": f"{name}_joint",
            "neighbour": f"{name}_joint",
        },
        functions={*functions, *PIECES},
        prefix=PREFIX,
        sizes={"memory.state": "STATES", "memory.following": "STATES"},
        length="N",
    )


def _functions() -> list[ast.FunctionDef]:
    # Python is the one home of the guards: C is translated from its syntax trees.
    trees = [ast.parse(inspect.getsource(module)) for module in _MODULES]
    return [node for tree in trees for node in tree.body if isinstance(node, ast.FunctionDef)]


def constants_of_logic(target: Target) -> str:
    """Declarations of the constants of the guards: codes, and thresholds."""
    constants = {
        name: value
        for module in _MODULES
        for name, value in vars(module).items()
        # Types and settings in capitals are no constants of C.
        if name.isupper() and isinstance(value, (int, float))
    } | target.constants
    # Whole numbers become an enum: C allows its names as array sizes and cases.
    codes = [f"{name} = {value}" for name, value in constants.items() if isinstance(value, int)]
    # 108 columns and an indentation of 4 keep the lines of the C within 112.
    lines = textwrap.fill(", ".join(codes), 108, break_on_hyphens=False)
    reals = [
        f"static const double {name} = {literal(value)};\n"
        for name, value in constants.items()
        if isinstance(value, float)
    ]
    return f"enum {{\n{textwrap.indent(lines, '    ')}\n}};\n{''.join(reals)}"


def translated(name: str) -> str:
    """All functions of the guards as C, each with its docstring."""
    names = names_of(name)
    # Each docstring becomes the comment of its C function.
    functions = [CFunction(node, names) for node in _functions()]
    # Declarations come before the definitions, since a function may call a later one.
    heads = "".join(f"{function.head};\n" for function in functions)
    texts = [
        f"{comment(function.summary)}\n{function.head}\n{{\n{function.body}\n}}\n"
        for function in functions
    ]
    return heads + "\n" + "\n".join(texts)


def structs(name: str, layout: Layout) -> str:
    """Declarations of the memory as C structs, with the meaning of each field."""
    # From the tables that make numba's records, so that both memories have one layout.
    run = struct(_fields(RUN_FIELDS), f"{name}_run")
    joint = struct(_fields(JOINT_FIELDS), f"{name}_joint")
    motion = struct(["double q, qd, qdd;"], f"{name}_motion")
    # C has no empty arrays; a law may have no states.
    states = max(layout.states, 1)
    n = layout.n
    state = [
        f"{name}_run run;",
        f"{name}_joint joints[{n}];",
        f"double {', '.join(f'{state}[{states}]' for state in LAW_STATES)}; /* of the law */",
        f"double numbers[{layout.numbers}]; /* of law and rig */",
        f"{name}_motion motions[{n}][{n}]; /* of all joints, where one came to rest */",
    ]
    return f"{run}\n{joint}\n{motion}\n{ONE_CONTROLLER}{struct(state, f'{name}_state')}"


def _fields(fields: Mapping[str, str]) -> Iterable[str]:
    for name, meaning in fields.items():
        # Most fields hold one number.
        size = f"[{SIZES[name]}]" if name in SIZES else ""
        yield f"double {name}{size}; {comment(meaning)}"


def initial_struct(vector: Floats, layout: Layout) -> str:
    """Initialiser of the memory, without the fields that are zero."""
    memory = view(vector, layout.n, 0)
    # The places of the numbers follow from the layout, which the struct shares.
    numbers = vector[[position for position, _ in layout.components("numbers")]]
    joints = ",\n".join(_initialiser(joint, JOINT_FIELDS) for joint in memory.joints)
    # A field that an initialiser leaves out is zero in C.
    members = [f".run = {_initialiser(memory.run, RUN_FIELDS)}", f".joints = {{\n{joints}}}"]
    if layout.states:
        members += [f".{name} = {braced(getattr(memory, name))}" for name in LAW_STATES]
    members.append(f".numbers = {braced(numbers)}")
    return "{\n" + ",\n".join(members) + ",\n}"


def _initialiser(record: Any, fields: Iterable[str]) -> str:
    """Initialiser of a record, without its zeros."""
    values = [
        f".{name} = {literal(record[name])}" for name in fields if np.any(record[name] != 0.0)
    ]
    lines = textwrap.fill(", ".join(values), 108, break_on_hyphens=False)
    return "{\n" + textwrap.indent(lines, "    ") + "}"


def write_running(
    law: Any,
    rig: Rig,
    guards: Guards | None,
    folder: str | Path,
    name: str,
    without: Sequence[str] = (),
    *,
    begin: Floats | None = None,
    target: str | None = None,
    precision: str = "double",
    **output: Any,
) -> None:
    """Write the files of `Running.to_c`; `output` are the arguments of `Output.of`.

    The law begins in the state `begin` (s,), by default in its own initial state.
    """
    # What cannot be exported is refused before a file is touched.
    require_exportable(rig, name)
    # Output before target: single precision is refused by the largest count.
    form = Output.of(law, rig, **output)
    place = Target.of(target, precision, rig, form.largest)
    values = values_of(law, rig, guards, name, form, without, place, begin)
    write_files(folder, name, values, place)


def values_of(
    law: Any,
    rig: Rig,
    guards: Guards | None,
    name: str,
    output: Output,
    without: Sequence[str] = (),
    target: Target = HOST,
    begin: Floats | None = None,
) -> dict[str, Any]:
    """Values of the templates for a running controller that begins as in `write_running`."""
    # The controller and its guards would have functions of the same name.
    if f"{name}_" == PREFIX:
        raise ValueError(
            f"name must differ from the prefix of the guards; got {name!r}. Rename it."
        )
    # The same block as in Python, so that C and Python compute the same equations.
    block = law.block(rig)
    if output.sends is None:
        # The torque beside a goal or a frame is no torque of a motor.
        block.require_torque("the C of a controller with guards")
    layout = Layout.of(block, rig.n)
    vector = initial_memory(law, rig, block, guards)
    if begin is not None:
        parts = view(vector, rig.n, 0)
        parts.initial[:] = parts.state[:] = begin
    rounding = SINGLE_ROUNDING if target.single else ROUNDING
    pieces = pieces_of(law, rig, block, without, rounding)
    memory = f"{name}_state *memory"
    # 1. The functions of law, rig and output, from casadi.
    functions = [_function(piece, pieces[piece], memory, layout) for piece in pieces]
    if output.sends is None:
        giving = _giving(output, law, rig, memory, layout)
    else:
        giving = _sending(output, sent_by(law, rig, block, guards, without), memory, layout)
    body = "\n".join([*functions, giving])
    limits = "guards and stop" if guards is not None else "stop, without guards"
    about = f"{type(law).__name__}, with the {limits} of the running controller. {sides(without)}"
    # 2. The values that the fixed parts of the running controller need, too.
    n = rig.n
    values: dict[str, Any] = output.values | target.values
    values |= {"name": name, "n": n, "prefix": PREFIX, "ramp": literal(RAMP)}
    values |= {"size": output.size(n)}
    passed = values["passed"]
    sizes = f"#define N {n}\n#define STATES {layout.states}\n"
    # 3. The parts that differ from those of a law alone.
    return values | {
        "period": literal(block.period or rig.period),
        "about": f"{paragraph(about)}\n * {values['precision']}",
        "types": _types(name, layout),
        "initial_counts": f", const int32_t pulses[{n}]",
        "clock_meaning": f"{_CLOCK}\n",
        "refusal": paragraph(_REFUSAL.format(output=values["output"])),
        "other_declarations": fragment("guarded.h", values),
        "numbers": f"{sizes}\n/* -- codes and thresholds -- */\n{constants_of_logic(target)}",
        "helpers": f"{target.elementary}{HELPERS}\n{helpers(body)}",
        "code": (
            f"\n/* -- of the law and the rig -- */\n{body}\n/* -- guards and stop -- */\n"
            f"{translated(name)}\n"
        ),
        "start": _START.format(name=name, initial=initial_struct(vector, layout)),
        "step": _STEP.format(name=name, passed=passed, output=values["output"]),
        "other_definitions": fragment("guarded.c", values),
    }


_CLOCK = (
    " * now               time of a steady clock [s], NAN without one; in single precision there is"
    " none"
)
_REFUSAL = (
    "Gives 0. A call that nothing can answer gives more, and changes neither *self nor {output}:"
    " without guards NaN or an infinity, with them only where the first call has one."
)

_START = """\
    static const {name}_state initial = {initial};
    *self = initial;
    for (int i = 0; i < N; i++)
        self->joints[i].counts = self->joints[i].held_counts = (double)pulses[i];
"""

_STEP = """\
    double measured[N];
    for (int i = 0; i < N; i++)
        measured[i] = (double)pulses[i];
    return {name}_sample(self, measured, q_r, qd_r, qdd_r{passed}, {output});
"""


def _types(name: str, layout: Layout) -> str:
    """Declarations of the causes of a stop, and of the memory."""
    causes = "".join(
        f"    {name.upper()}_{cause} = {code},{_in_words(code)}\n"
        for code, cause in enumerate(CAUSES)
    )
    guarded = "/* the running controller: it reads a clock, and stops the arm */"
    return (
        f"#define {name.upper()}_GUARDED 1 {guarded}\n\n"
        f"/* Why it stopped the arm, or what it bridged last. */\nenum {{\n{causes}}};\n\n"
        f"{structs(name, layout)}"
    )


def _in_words(code: int) -> str:
    # NaN stands for the amount; the sentence without it states the cause alone.
    text = wording(code, "a joint", float("nan"))
    return f" {comment(text.replace('nan ', ''))}" if text else ""


def _function(name: str, piece: Piece, memory: str, layout: Layout) -> str:
    """One function from quantities of the memory to others: all are read before one is written."""
    inputs = [
        [(expression, STATE) for _, expression in layout.components(source)]
        for source in piece.sources
    ]
    # The functions write no output arrays: their results go straight to fields of the struct.
    lines, values, _ = statements(piece.function, inputs)
    targets = [text for name in piece.targets for _, text in layout.components(name)]
    # The array of results makes the order safe: a target may be a source, too.
    results = "".join(f"    {value},\n" for value in values)
    body = [
        *lines[UNIFORM],
        *lines[STATE],
        f"const double results[{len(values)}] = {{\n{results}}};",
        *(f"{target} = results[{i}];" for i, target in enumerate(targets)),
    ]
    return _defined(f"{name}({memory})", body)


def _giving(output: Output, law: Any, rig: Rig, memory: str, layout: Layout) -> str:
    """The function that converts the torque to the output."""
    n = rig.n
    torque = ca.SX.sym("torque", n)
    numbers = ca.SX.sym("numbers", layout.numbers)
    scale = ca.SX.sym("scale", n)
    # The numbers of the law come first in the memory, and those of the rig follow.
    named = rig.with_numbers(numbers[len(law.number_names()) :])
    converted = output.converted(scale, named, torque)
    function = ca.Function("give", [torque, numbers, scale], [ca.densify(converted)])
    sources = (
        [f"torque[{i}]" for i in range(n)],
        [expression for _, expression in layout.components("numbers")],
        [f"counts_per_ampere[{i}]" for i in range(n)],
    )
    inputs = [[(text, STATE) for text in texts] for texts in sources]
    lines, values, used = statements(function, inputs)
    # Compilers warn of an argument that is not read.
    body = [] if any("memory" in text for text in used) else ["(void)memory;"]
    body += [*lines[UNIFORM], *lines[STATE]]
    body += [f"given[{i}] = ({output.kind})({value});" for i, value in enumerate(values)]
    # The memory is an argument, since the converter uses numbers of the rig.
    head = f"give(const {memory}, const double *torque, {output.kind} *given)"
    return output.constant + _defined(head, body)


def _sending(output: Output, piece: Piece, memory: str, layout: Layout) -> str:
    """The function that converts torque and reference to goals or frames."""
    inputs = [
        [(expression, STATE) for _, expression in layout.components(source)]
        for source in piece.sources
    ]
    lines, values, _ = statements(piece.function, inputs)
    # The memory has the torque, and the part of it that the firmware adds.
    body = ["(void)torque;", *lines[UNIFORM], *lines[STATE]]
    body += [f"given[{i}] = ({output.kind})({value});" for i, value in enumerate(values)]
    return _defined(f"give(const {memory}, const double *torque, {output.kind} *given)", body)


def _defined(head: str, body: Iterable[str]) -> str:
    inner = textwrap.indent("\n".join(body), "    ")
    return f"static void {PREFIX}{head}\n{{\n{inner}\n}}\n"
