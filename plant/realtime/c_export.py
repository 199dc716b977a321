"""C99 code of a law for an embedded controller: header, source, a program that replays a record, and a Makefile.

The equations are those of `Law.block`, of the rig's encoder and of its amplifier's limit; here they are put into files.
The C needs the standard library alone, allocates nothing and has no global state.
"""

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.compiler.c_statements import SIGN, literal, statements
from plant.compiler.instructions import STATE, TIME, UNIFORM
from plant.machine.rig import Rig
from plant.parts.arguments import array, choice, instance, real
from plant.realtime.c_guards import TorqueGuards
from plant.realtime.c_numbers import braced, comment, constant, constants, declared, each, identifier
from plant.realtime.c_templates import HEADER, MAIN, MAKEFILE, SOURCE
from plant.realtime.guards import Guards
from plant.version import __version__

_SECTIONS = {
    UNIFORM: "from the numbers alone: evaluated by the compiler",
    TIME: "from the reference alone",
    STATE: "from counts and state",
}


def write_c(
    law: Any,
    folder: str | Path,
    rig: Rig | None,
    *,
    name: str,
    output: str,
    counts_per_ampere: ArrayLike | None,
    largest_count: int,
    guards: Guards | None,
) -> None:
    """Write the files of `Law.to_c`."""
    rig = getattr(law, "rig", None) if rig is None else rig
    if rig is None:
        raise ValueError(f"rig must be given, since {type(law).__name__} holds none. Call to_c(folder, rig).")
    instance("rig", rig, Rig, "Pass found.rig.")
    if rig.encoder.smooth:
        raise ValueError("rig must have an encoder that counts; got a smooth one. Use Encoder(..., smooth=False).")
    require_name(name)
    if guards is not None:
        instance("guards", guards, Guards, "Give Guards(...), or None for none.")
    scale = None
    if choice("output", output, ("torque", "dac")) == "dac":
        scale = _scale(law, rig, counts_per_ampere, largest_count)
    elif counts_per_ampere is not None:
        raise ValueError("counts_per_ampere must be left out for output='torque'; got one. Choose output='dac'.")
    texts = _texts(law, rig, name, scale, largest_count, guards)
    place = free_folder(folder, texts, name)
    place.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (place / file).write_bytes(text)


def _scale(law: Any, rig: Rig, counts_per_ampere: Any, largest: int) -> NDArray[np.float64]:
    """Counts per ampere (n,) of a converter that covers the amplifier's range."""
    advice = "Give one number per joint, with the sign of its wiring."
    scale = array("counts_per_ampere", counts_per_ampere, (rig.n,), advice=advice)
    if (scale == 0).any():
        raise ValueError(f"counts_per_ampere must not be zero; got {scale}. {advice}")
    real("largest_count", largest, "32767 is that of 16 bits.", positive=True)
    if largest != int(largest) or largest > 2**31 - 1:
        raise ValueError(f"largest_count must be whole and below 2^31; got {largest}. 32767 is that of 16 bits.")
    short = np.flatnonzero(largest / np.abs(scale) < rig.drive.current_limit)
    if len(short):
        joint = int(short[0])
        raise ValueError(
            f"largest_count must reach the current limit, {rig.drive.current_limit[joint]:g} A at "
            f"{law.joint_labels(rig)[joint]}; it ends at {largest / abs(scale[joint]):g} A. Lower drive.current_limit, "
            "so that the law knows the applied torque."
        )
    return scale


def require_name(name: Any) -> None:
    """Refuse what C could not have as a name.

    Raises
    ------
    ValueError
    """
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name) or name == "main":
        rule = "be a small letter and up to 39 small letters, digits or _, and not main"
        raise ValueError(f"name must {rule}; got {name!r:.60}. It names the files and the functions.")


def free_folder(given: str | Path, texts: Iterable[str], name: str) -> Path:
    """The folder, if no file in it would be lost; earlier exports of this name may be overwritten."""
    try:
        folder = Path(given)
    except TypeError:
        raise ValueError(f"folder must be a path; got {given!r:.60}. Give the name of a folder.") from None
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder must be a folder; {folder} is a file. Name another.")
    for file in texts:
        path = folder / file
        if path.is_symlink() or path.exists():
            own = path.is_file() and not path.is_symlink()
            first = path.read_bytes().split(b"\n", 1)[0] if own else b""
            if not re.search(rf"made by onepulse \S+ for {name}\b".encode(), first):
                raise ValueError(f"{path} must not exist, or be an export of {name}; it is another. Name a new folder.")
    return folder


# -- the texts -------------------------------------------------------------------------------------------------------
def _texts(law, rig, name, scale, largest, guards):
    """File name -> text, in ASCII."""
    block, n = law.block(rig), rig.n
    period, states = block.period or rig.period, len(block.initial)
    guarded = TorqueGuards.of(law, rig, block, guards)
    function, inputs = _step(block, rig, scale, largest)
    lines, results, used = statements(function, inputs)
    arrays, results = [], iter(results)
    for quantity, kind, size in (("asked", "double", n), ("torque_now", "double", n), ("following", "double", states),
                                 ("counts_now", "int32_t", n if scale is not None else 0)):  # fmt: skip
        arrays += [declared(quantity, kind, [next(results) for _ in range(size)])] if size else []
    blocks = [f"/* {said} */\n" + "\n".join(lines[kind]) for kind, said in _SECTIONS.items() if lines[kind]]
    unread = [x for x in ("pulses", "q_r", "qd_r", "qdd_r") if not any(f"{x}[" in name for name in used)]
    unread = [" ".join(f"(void){x};" for x in unread)] if unread else []
    body = "\n\n".join([*blocks, "\n".join(arrays), *unread])
    watching = ""
    if guarded is not None:
        watching, more = guarded.functions(name, None if scale is None else partial(_converted, largest))
        used |= more
    numbers = [constants(law, rig, used)]
    if "period" in used:
        numbers.append(constant("period", period, "From one step to the next [s]."))
    if guarded is not None:
        numbers += guarded.constants()
    if scale is not None:
        numbers.append(constant("counts_per_ampere", scale, "Counts of the converter per motor current [1/A]."))
    start = f"static const double state[{states}] = {braced(block.initial)};\n"
    dac = scale is not None
    common = {
        "name": name,
        "NAME": name.upper(),
        "n": n,
        "period": literal(period),
        "output": "counts" if dac else "torque",
        "type": "int32_t" if dac else "double",
        "format": '%" PRId32 "' if dac else "%.17g",
        "meaning": f"of the converter: rounded, within +-{largest:.0f}" if dac
        else "of the joints, after the amplifier's limit [N m]",
        "about": _about(law, rig, block),
        "stops": "" if guarded is None else f" *\n{_paragraph(guarded.said())}\n",
        "guards": watching,
        "guard": "" if guarded is None else guarded.step,
        "result": "!sound" if guarded is None else guarded.result,
        "state": (f"    int32_t counts[{n}]; /* of the converter, for it */\n" if dac else "")
        + (f"    double state[{states}]; /* of the law */\n" if states else "")
        + ("" if guarded is None else guarded.field),
        "numbers": "\n".join(text for text in numbers if text),
        "helpers": SIGN if re.search(r"\bsign\(", body + watching) else "",
        "start": textwrap.indent(start, "    ") if states else "",
        "initial": each(n, "self->torque[i] = 0.0;")
        + each(n * dac, "self->counts[i] = 0;")
        + each(states, "self->state[i] = state[i];")
        + each(0 if guarded is None else guarded.size, "self->guard[i] = 0.0;"),
        "body": textwrap.indent(body, "    "),
        "check": each(states, "sound = sound && isfinite(following[i]);"),
        "store": textwrap.indent(
            each(n, "self->torque[i] = torque_now[i];")
            + each(n * dac, "self->counts[i] = counts_now[i];")
            + each(states, "self->state[i] = following[i];"),
            "    ",
        ),
    }  # fmt: skip
    templates = {f"{name}.h": HEADER, f"{name}.c": SOURCE, "main.c": MAIN, "Makefile": MAKEFILE}
    made = f"made by onepulse {__version__} for {name}"
    return {file: text.substitute(common, made=f"{file} - {made}").encode("ascii") for file, text in templates.items()}


def _step(block, rig, scale, largest):
    """One step as a Function of (state, torque, q_r, qd_r, qdd_r, pulses, numbers, dt, scale), and C for its inputs."""
    n, own = rig.n, len(rig.number_values())
    sizes = {"state": len(block.initial), "torque": n, "q_r": n, "qd_r": n, "qdd_r": n, "pulses": n,
             "numbers": len(block.names), "dt": 1, "scale": n}  # fmt: skip
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    state, torque, q, qd, qdd, pulses, numbers, dt, factor = symbols
    named = rig.with_numbers(numbers[len(block.names) - own :])
    asked, following = block.step(state, q, qd, qdd, named.counts(q), pulses, torque, dt, numbers)
    limited = named.drive.limited(asked)
    results = [asked, limited, following]
    if scale is not None:
        results.append(_converted(largest, factor, named, limited))
    function = ca.Function("step", symbols, ca.cse([ca.densify(result) for result in results]))
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


def _converted(largest, factor, rig, torque):
    """Whole counts of the converter for a joint torque."""
    nearest = ca.floor(factor * rig.drive.current(torque) + 0.5)
    return ca.fmin(ca.fmax(nearest, -largest), largest)


def _about(law, rig, block):
    """Text of the header: the law, its options, sides and units, and how often it is to be called."""
    options = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    flags = ", ".join(f"{key} = {value}" for key, value in options.items() if isinstance(value, (bool, int, str)))
    summary = inspect.cleandoc(type(law).__doc__ or "").split("\n\n")[0]
    called = f"Once every {block.period or rig.period:.9g} s."
    if not law.has_memory(rig.n):
        called = "A law without memory, for fast hardware: as often as possible, at least once per period."
    said = [
        f"{type(law).__name__}{f' ({flags})' if flags else ''}: {summary}",
        f"{called} Counts are those of the motors' encoders, with their sign; reference and torque are joint side, SI "
        "units. Compile without -ffast-math, which would leave NaN unseen.",
    ]
    return "\n *\n".join(_paragraph(text) for text in said)


def _paragraph(text):
    """Lines of a comment that has begun."""
    return f" * {comment(text)[3:-3]}"
