"""The numbers of a law and its rig as constants in C, each under its description from the class's docstring."""

import inspect
import re
import textwrap
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.compiler.c_statements import literal
from plant.machine.rig import Rig


def declared(name: str, kind: str, values: Collection[str]) -> str:
    """Declaration of an array of expressions, of kind double or int32_t."""
    values = [f"(int32_t)({value})" for value in values] if kind == "int32_t" else values
    return f"const {kind} {name}[{len(values)}] = {{\n" + "".join(f"    {value},\n" for value in values) + "};"


def each(count: int, statement: str) -> str:
    """A statement for every i below a count."""
    return f"    for (int i = 0; i < {count}; i++)\n        {statement}\n" if count else ""


def identifier(name: str) -> str:
    """A number's name as C writes it: ``drive.gear[0]`` is ``drive_gear[0]``, ``springs[1].at`` is ``springs_1_at``."""
    return re.sub(r"\[(\d+)\]\.", r"_\1_", name).replace(".", "_")


def comment(text: str, width: int = 116) -> str:
    """A C comment of one or more lines, without what could end it or is not ASCII."""
    text = re.sub(r"[^\w\s()\[\]{}+\-^.,:;=*<>'/|%]", " ", text, flags=re.ASCII)
    text = " ".join(text.replace("*/", "* /").replace("/*", "/ *").split())
    return "/* " + "\n * ".join(textwrap.wrap(text, width)) + " */"


def braced(values: NDArray[np.float64]) -> str:
    """Values of an array, on as many lines as they need."""
    inner = "{" + ", ".join(literal(value) for value in values) + "}"
    if len(inner) < 70:
        return inner
    return "{\n" + textwrap.fill(inner[1:-1], 112, initial_indent="    ", subsequent_indent="    ") + ",\n}"


def constant(name: str, values: Any, said: str) -> str:
    """Declaration of a constant, or of an array of constants, under a comment."""
    if np.ndim(values):
        return f"{comment(said)}\nstatic const double {name}[{len(values)}] = {braced(values)};\n"
    return f"{comment(said)}\nstatic const double {name} = {literal(values)};\n"


def constants(law: Any, rig: Rig, used: Collection[str]) -> str:
    """Declarations of the numbers whose expressions are in `used`, in the order of `Law.block`."""
    text = []
    for name, owner, field, value in (*law._leaves("law."), *rig._leaves()):
        name = identifier(name)
        if name in used or any(each.startswith(f"{name}[") for each in used):
            text.append(constant(name, value, _said(owner, field.name)))
    return "\n".join(text)


def _said(owner: Any, field: str) -> str:
    """Description of a field from the docstring of a part, or of a base class; of f with its parameters' names."""
    for cls in type(owner).__mro__:
        text = inspect.cleandoc(cls.__doc__ or "") + "\n"
        entry = re.search(rf"^(?:\w+, )*{field}(?:, \w+)* : .*\n((?:[ \t]+\S.*\n|\n(?=[ \t]))+)", text, re.MULTILINE)
        if entry:
            said = entry[1]
            break
    else:
        said = f"{field} of {type(owner).__name__}"
    names = getattr(getattr(owner, "dynamics", None), "names", None)
    return f"{said} {', '.join(names)}" if names and field == "f" else said
