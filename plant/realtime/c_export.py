"""C99 of a law for an embedded controller: header, source, replay program and Makefile.

The equations are those of `Law.block`, of the rig's encoder and of its amplifier's limit; here they
are put into files. With guards, the C is that of the running controller
(`plant.realtime.c_running`). The C needs the standard library alone, allocates nothing and has no
global state.
"""

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from plant.compiler import (
    STATE,
    TIME,
    UNIFORM,
    braced,
    constant,
    helpers,
    literal,
    paragraph,
    statements,
)
from plant.machine import Frame, Rig
from plant.parts import instance, meanings
from plant.realtime.c_running import write_running
from plant.realtime.c_text import (
    HOST,
    ONE_CONTROLLER,
    Output,
    fragment,
    require_exportable,
    rig_of,
    sides,
    struct,
    write_files,
)
from plant.realtime.guards import Guards
from plant.realtime.pieces import model_part

_SECTIONS = {
    UNIFORM: "from the numbers alone: evaluated by the compiler",
    TIME: "from the reference alone",
    STATE: "from counts and state",
}


def write_c(
    law: Any,
    folder: str | Path,
    rig: Rig | None,
    guards: Guards | None,
    name: str,
    without: Sequence[str] = (),
    **output: Any,
) -> None:
    """Write the files of `Law.to_c`."""
    rig = rig_of(law, rig, "to_c(folder, rig)")
    if guards is not None:
        instance("guards", guards, Guards, "Give Guards(...), or None for none.").warn_of_units(rig)
        # Guards watch samples; fast hardware has none, and exports the law alone.
        if law.period is not None:
            write_running(law, rig, guards, folder, name, without, **output)
            return
    require_exportable(rig, name)
    values = _values(law, rig, Output.of(law, rig, **output), without, name)
    write_files(folder, name, HOST.values | values)


def _values(law, rig, output, without, controller):
    """Values of the templates for a law alone."""
    block = law.block(rig)
    if output.sends is None:
        block.require_torque("the C of a law")
    n = rig.n
    period = block.period or rig.period
    states = len(block.initial)
    function, inputs = _step(law, block, rig, output, without)
    lines, results, used = statements(function, inputs)

    # 1. The results of a step. The state stores the output, too, to repeat it after a torque that
    # is not finite; without a conversion it is the torque itself.
    stored = "counts" if output.scale is not None else "given" if without else "torque"
    stored = output.sends or stored
    outputs = output.size(n) if stored != "torque" else 0
    arrays = []
    # In the order of the outputs: each array takes its numbers from what is left.
    results = iter(results)
    for quantity, kind, size in (
        ("asked", "double", n),
        ("torque_now", "double", n),
        ("following", "double", states),
        (f"{stored}_now", output.kind, outputs),
    ):
        arrays += [declared(quantity, kind, [next(results) for _ in range(size)])] if size else []

    # 2. The step: declarations by the time of their evaluation, and the results.
    blocks = [
        f"/* {heading} */\n" + "\n".join(lines[kind])
        for kind, heading in _SECTIONS.items()
        if lines[kind]
    ]
    # The compiler would warn of arguments that the law does not read.
    unread = [
        x
        for x in ("pulses", "q_r", "qd_r", "qdd_r")
        if not any(text.startswith((f"{x}[", f"(double){x}[")) for text in used)
    ]
    unread = [" ".join(f"(void){x};" for x in unread)] if unread else []
    body = "\n\n".join([*blocks, "\n".join(arrays), *unread])

    # 3. The state: its declaration, its initial values, and their update.
    members = [
        f"double torque[{n}]; /* acting now: joint torque after the amplifier's limit [N m] */"
    ]
    start = ""
    if outputs:
        members.append(f"{output.kind} {stored}[{outputs}]; /* output of the last step */")
    if states:
        members.append(f"double state[{states}]; /* of the law */")
        start = f"static const double state[{states}] = {braced(block.initial)};\n"
    memory = (
        ("torque", n, "0.0", "torque_now"),
        # A goal of 0 would be a place; no servo takes INT32_MIN. A frame of zeros gives no torque.
        (stored, outputs, "INT32_MIN" if output.sends == "goal" else "0", f"{stored}_now"),
        ("state", states, "state[i]", "following"),
    )
    initial = (each(size, f"self->{field}[i] = {begin};") for field, size, begin, _ in memory)
    stores = "".join(each(size, f"self->{field}[i] = {now}[i];") for field, size, _, now in memory)

    # 4. The numbers that occur, and all values together.
    timing = (
        constant("period", period, "From one step to the next [s].") if "period" in used else ""
    )
    # Only numbers that occur: an unused constant is a warning of the compiler.
    numbers = filter(None, (constants(law, rig, used), timing, output.constant))
    values = {"n": n, "size": output.size(n), **output.values}
    if output.sends == "goal":
        values["meaning"] += "; INT32_MIN before the first step that gave 0"
    step = {
        "lines": textwrap.indent(body, "    "),
        "check": each(states, "sound = sound && isfinite(following[i]);"),
        "store": textwrap.indent(stores, "    "),
        "stored": stored,
    }
    return values | {
        "period": literal(period),
        "about": _about(law, rig, block, without),
        "types": f"{ONE_CONTROLLER}{struct(members, f'{controller}_state')}",
        "refusal": paragraph(_REFUSAL),
        "numbers": "/* -- numbers -- */\n" + "\n".join(numbers),
        "helpers": helpers(body),
        "start": textwrap.indent(start, "    ") + "".join(initial),
        "step": fragment("law.c", values | step),
        # Only a running controller has these.
        **dict.fromkeys(("clock", "clock_meaning", "code", "initial_counts"), ""),
        **dict.fromkeys(("other_declarations", "other_definitions"), ""),
    }


_REFUSAL = (
    "Gives 0. Where the law has no finite torque (a NaN or an infinity came in) it gives 1, nothing"
    " in *self changes, and the output is that of the last torque: the caller decides how to stop."
)


def _step(law, block, rig, output, without):
    """Casadi function of one step, and the C expressions of its inputs.

    The inputs are (state, torque, q_r, qd_r, qdd_r, pulses, numbers, dt, scale).
    """
    n = rig.n
    # The symbols of the numbers replace those of law and rig, so the C has them as named constants.
    # Of these, the numbers of the law come before those of the rig.
    rig_numbers = len(rig.number_values())
    sizes = {
        "state": len(block.initial),
        "torque": n,
        "q_r": n,
        "qd_r": n,
        "qdd_r": n,
        "pulses": n,
        "numbers": len(block.names),
        "dt": 1,
        "scale": n,
    }
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    state, torque, q, qd, qdd, pulses, numbers, dt, factor = symbols
    named = rig.with_numbers(numbers[len(block.names) - rig_numbers :])
    asked, following = block.step(state, q, qd, qdd, named.counts(q), pulses, torque, dt, numbers)
    # The state keeps the whole limited torque, which acts; the output leaves out the firmware's
    # part.
    limited = named.limited(asked)
    # The law's numbers as symbols too, so that the firmware's part is made of the same constants.
    own_law = law.with_numbers(numbers[: len(block.names) - rig_numbers])
    converted = limited - model_part(own_law, named, without, (named.cell_centre(pulses), qd, qdd))
    results = [asked, limited, following]
    if output.sends is not None:
        # As of `Running`: the frame by which this torque acts beside the reference.
        inner = own_law.rig_of_frames(named).inner
        frame = Frame(*ca.vertsplit(block.sent(q, qd, qdd, pulses, converted, numbers), n))
        results.append(inner.values(named, frame))
    elif output.scale is not None or without:
        results.append(output.converted(factor, named, converted))
    # Dense results keep their number and order where some are zero for every input.
    function = ca.Function("step", symbols, ca.cse([ca.densify(result) for result in results]))
    # The kinds let the compiler evaluate what follows from numbers, and separate the reference from
    # the counts.
    inputs = [
        [(f"self->state[{i}]", STATE) for i in range(len(block.initial))],
        [(f"self->torque[{i}]", STATE) for i in range(n)],
        *([(f"{x}[{i}]", TIME) for i in range(n)] for x in ("q_r", "qd_r", "qdd_r")),
        [(f"(double)pulses[{i}]", STATE) for i in range(n)],
        [(identifier(number), UNIFORM) for number in block.names],
        [("period", UNIFORM)],
        [(f"counts_per_ampere[{i}]", UNIFORM) for i in range(n)],
    ]
    return function, inputs


def _about(law, rig, block, without):
    """Text of the header: the law with its options, the rate of its calls, sides and units."""
    options = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    flags = ", ".join(
        f"{key} = {value}" for key, value in options.items() if isinstance(value, (bool, int, str))
    )
    # The first paragraph of the docstring, as the reader of the C has no Python beside it.
    summary = inspect.cleandoc(type(law).__doc__ or "").split("\n\n")[0]
    schedule = f"Once every {block.period or rig.period:.9g} s."
    if not law.has_memory(rig.n):
        schedule = (
            "A law without memory, for fast hardware: as often as possible, at least once per"
            " period."
        )
    title = f"{type(law).__name__}{f' ({flags})' if flags else ''}: {summary}"
    return "\n *\n".join(map(paragraph, (title, f"{schedule} {sides(without)}")))


def declared(name: str, kind: str, values: Collection[str]) -> str:
    """Declaration of an array of expressions, of kind double or int32_t."""
    values = [f"(int32_t)({value})" for value in values] if kind == "int32_t" else values
    return (
        f"const {kind} {name}[{len(values)}] = {{\n"
        + "".join(f"    {value},\n" for value in values)
        + "};"
    )


def each(count: int, statement: str) -> str:
    """A statement for every i below a count."""
    return f"    for (int i = 0; i < {count}; i++)\n        {statement}\n" if count else ""


def identifier(name: str) -> str:
    """C identifier of a number: ``springs[1].at`` is ``springs_1_at``."""
    return re.sub(r"\[(\d+)\]\.", r"_\1_", name).replace(".", "_")


def constants(law: Any, rig: Rig, used: Collection[str]) -> str:
    """Declarations of the numbers whose expressions are in `used`, in the order of `Law.block`."""
    text = []
    for name, owner, field, value in (*law._leaves("law."), *rig._leaves()):
        name = identifier(name)
        if name in used or any(expression.startswith(f"{name}[") for expression in used):
            text.append(constant(name, value, _meaning(owner, field.name)))
    return "\n".join(text)


def _meaning(owner: Any, field: str) -> str:
    """Description of a field from its class or a base class; that of `f` names its parameters."""
    cls: type = type(owner)
    meaning = meanings(cls).get(field) or f"{field} of {cls.__name__}"
    names = getattr(getattr(owner, "dynamics", None), "names", None)
    return f"{meaning} {', '.join(names)}" if names and field == "f" else meaning
