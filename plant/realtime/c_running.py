"""A running controller as C99, with every guard and every stop: its memory, its pieces, and its
logic.

The logic is that of `plant.realtime.safety`, translated (`plant.realtime.c_running`), what it calls
of law and rig that of `plant.realtime.pieces`; the memory begins as that of the controller it is
made from. Two files; nothing is allocated, and there is no state outside the struct.
"""

import ast
import inspect
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from plant.compiler.c_statements import braced, comment, helpers, literal, paragraph, statements
from plant.compiler.instructions import STATE, UNIFORM
from plant.compiler.python_to_c import CFunction, CNames
from plant.machine.rig import Rig
from plant.realtime import memory as layout
from plant.realtime import safety, stopping, watching
from plant.realtime.c_text import HOST, Output, Target, require_exportable, sides, write_files
from plant.realtime.compiled_step import initial_memory
from plant.realtime.guards import Guards
from plant.realtime.pieces import RAMP, numbers_of, pieces_of
from plant.realtime.status import wording

PREFIX = "running_"  # of every function's name: C's library has a read, and a finite

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

_MODULES = stopping, watching, safety
_OURS = {
    name for each in _MODULES for name, value in vars(each).items() if inspect.isfunction(value)
}

NAMES = CNames(
    arrays=("own", "joints", "memory", "pulses", "q_r", "qd_r", "qdd_r", "torque"),
    read=("pulses", "q_r", "qd_r", "qdd_r"),
    functions=_OURS | set(vars(layout)),  # and the pieces, which the memory names
    prefix=PREFIX,
    sizes={"memory": "SIZE"},
    each="N",
)


def constants_of_logic() -> str:
    """Declarations of the constants of all modules: places in the memory, and thresholds."""
    whole = []
    real = []
    for module in (layout, *_MODULES):
        for name, value in vars(module).items():
            if not name.isupper() or (module is not layout and hasattr(layout, name)):
                continue  # imported from there
            if isinstance(value, int):
                whole.append(f"{name} = {value}")
            elif isinstance(value, float):
                real.append(f"static const double {name} = {literal(value)};")
    listed = textwrap.indent(textwrap.fill(", ".join(whole), 108, break_on_hyphens=False), "    ")
    return f"enum {{\n{listed}\n}};\n" + "\n".join(real) + "\n"


def translated() -> str:
    """All functions as C, each with its docstring; arrays have N joints and SIZE places, which
    the caller defines.
    """
    trees = (ast.parse(inspect.getsource(module)) for module in _MODULES)
    made = [
        CFunction(node, NAMES)
        for tree in trees
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    ]
    heads = "".join(f"{each.head};\n" for each in made)
    return (
        heads
        + "\n"
        + "\n".join(f"{comment(each.said)}\n{each.head}\n{{\n{each.body}\n}}\n" for each in made)
    )


_CAUSES = (
    "RUNNING",
    "WAS_LATE",
    "HAD_GAPS",
    "HAS_JUMPED",
    "IS_STUCK",
    "IS_OFF",
    "NO_TORQUE",
    "IS_SATURATED",
    "CHATTERS",
    "NO_COUNTS",
    "IS_DEAD",
    "BAD_TIME",
    "OFF_BEAT",
    "OUTSIDE",
    "TOO_FAST",
    "TOO_STEEP",
    "OPPOSES",
)


def write_running(
    law: Any,
    rig: Rig,
    guards: Guards | None,
    folder: str | Path,
    name: str,
    without: Sequence[str] = (),
    *,
    target: str | None = None,
    precision: str = "double",
    **output: Any,
) -> None:
    """Write the files of `Running.to_c`; `output` are the arguments of `Output.of`."""
    require_exportable(rig, name)
    given = Output.of(law, rig, **output)
    place = Target.of(target, precision, rig, given.largest)
    write_files(
        folder, name, "running", values_of(law, rig, guards, name, given, without, place), place
    )


def values_of(
    law: Any,
    rig: Rig,
    guards: Guards | None,
    name: str,
    given: Output,
    without: Sequence[str] = (),
    place: Target = HOST,
) -> dict[str, Any]:
    """What the templates say of a running controller."""
    block = law.block(rig)
    n = rig.n
    memory = initial_memory(law, rig, block, guards)
    pieces = pieces_of(law, rig, block, without)
    body = "\n".join(
        [*(_piece(which, *pieces[which]) for which in pieces), _giving(given, law, rig, block)]
    )
    limits = "guards and stop" if guards is not None else "stop, without guards"
    about = f"{type(law).__name__}, with the {limits} of the running controller. {sides(without)}"
    causes = [(cause, getattr(layout, cause)) for cause in _CAUSES]
    return (
        given.values
        | place.values
        | {
            "n": n,
            "period": literal(block.period or rig.period),
            "prefix": PREFIX,
            "size": len(memory),
            "about": paragraph(about),
            "ramp": literal(RAMP),
            "causes": "".join(
                f"    {name.upper()}_{cause} = {code},{_in_words(code)}\n" for cause, code in causes
            ),
            "constants": constants_of_logic(),
            "helpers": f"{place.elementary}{HELPERS}\n{helpers(body)}",
            "pieces": body,
            "logic": translated(),
            "initial": braced(memory),
        }
    )


def _in_words(code: int) -> str:
    said = wording(code, "a joint", float("nan"))
    return f" {comment(said.replace('nan ', ''))}" if said else ""


def _piece(name: str, function: Any, sources: Any, targets: Any) -> str:
    """One function from places of the memory to others: all are read before one is written."""
    inputs = [[(f"memory[{place}]", STATE) for place in places] for places in sources]
    lines, values, _ = statements(function, inputs)
    places = [place for each in targets for place in each]
    listed = "".join(f"    {value},\n" for value in values)
    body = [
        *lines[UNIFORM],
        *lines[STATE],
        f"const double results[{len(values)}] = {{\n{listed}}};",
    ]
    body += [f"memory[{place}] = results[{i}];" for i, place in enumerate(places)]
    inner = textwrap.indent("\n".join(body), "    ")
    return f"static void {PREFIX}{name}(double *memory)\n{{\n{inner}\n}}\n"


def _giving(output: Output, law: Any, rig: Rig, block: Any) -> str:
    """The function that makes the output of the torque."""
    n = rig.n
    own = len(law.number_names())
    torque = ca.SX.sym("torque", n)
    numbers = ca.SX.sym("numbers", len(block.values))
    scale = ca.SX.sym("scale", n)
    given = output.converted(scale, rig.with_numbers(numbers[own:]), torque)
    function = ca.Function("give", [torque, numbers, scale], [ca.densify(given)])
    sources = (
        [f"torque[{i}]" for i in range(n)],
        [f"memory[{i}]" for i in numbers_of(block, n)],
        [f"counts_per_ampere[{i}]" for i in range(n)],
    )
    lines, values, used = statements(
        function, [[(text, STATE) for text in texts] for texts in sources]
    )
    body = [
        *([] if any("memory" in text for text in used) else ["(void)memory;"]),
        *lines[UNIFORM],
        *lines[STATE],
    ]
    body += [f"given[{i}] = ({output.kind})({value});" for i, value in enumerate(values)]
    inner = textwrap.indent("\n".join(body), "    ")
    head = (
        f"static void {PREFIX}give(const double *memory, const double *torque, {output.kind}"
        " *given)"
    )
    return f"{output.constant}{head}\n{{\n{inner}\n}}\n"
