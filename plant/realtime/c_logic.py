"""The guards and the stop of a running controller as C: translated from the Python that numba compiles."""

import ast
import inspect
import textwrap

from plant.compiler.c_statements import literal
from plant.compiler.python_to_c import CFunction, CNames
from plant.realtime import memory as layout
from plant.realtime import safety, stopping, watching
from plant.realtime.c_numbers import comment

PREFIX = "running_"
"""Of every function's name: C's library has a read, and a finite."""

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
_OURS = {name for each in _MODULES for name, value in vars(each).items() if inspect.isfunction(value)}

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
    whole, real = [], []
    for module in (layout, *_MODULES):
        for name, value in vars(module).items():
            if not name.isupper() or (module is not layout and hasattr(layout, name)):
                continue  # imported from there
            if isinstance(value, int):
                whole.append(f"{name} = {value}")
            elif isinstance(value, float):
                real.append(f"static const double {name} = {literal(value)};")
    listed = textwrap.fill(
        ", ".join(whole), 112, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
    )
    return f"enum {{\n{listed}\n}};\n" + "\n".join(real) + "\n"


def translated() -> str:
    """All functions as C, each with its docstring; arrays have N joints and SIZE places, which the caller defines."""
    trees = (ast.parse(inspect.getsource(module)) for module in _MODULES)
    made = [CFunction(node, NAMES) for tree in trees for node in tree.body if isinstance(node, ast.FunctionDef)]
    heads = "".join(f"{each.head};\n" for each in made)
    return heads + "\n" + "\n".join(f"{comment(each.said)}\n{each.head}\n{{\n{each.body}\n}}\n" for each in made)
