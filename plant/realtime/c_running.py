"""A running controller as C99, with every guard and every stop: its memory, its pieces, and its logic.

The logic is that of `plant.realtime.safety`, translated (`plant.realtime.c_running`), what it calls of law and rig that
of `plant.realtime.pieces`; the memory begins as that of the controller it is made from. Two files; nothing is
allocated, and there is no state outside the struct.
"""

import ast
import inspect
import textwrap
from pathlib import Path
from string import Template
from typing import Any

from plant.compiler.c_statements import SIGN, literal, statements
from plant.compiler.instructions import STATE, UNIFORM
from plant.compiler.python_to_c import CFunction, CNames
from plant.realtime import memory as layout
from plant.realtime import safety, stopping, watching
from plant.realtime.braking import RAMP
from plant.realtime.c_export import free_folder, require_name
from plant.realtime.c_numbers import braced, comment
from plant.realtime.pieces import pieces_of
from plant.realtime.status import wording
from plant.version import __version__

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


_CAUSES = ("RUNNING", "WAS_LATE", "HAD_GAPS", "HAS_JUMPED", "IS_STUCK", "IS_OFF", "NO_TORQUE", "IS_SATURATED",
           "CHATTERS", "NO_COUNTS", "IS_DEAD", "BAD_TIME", "OFF_BEAT", "OUTSIDE", "TOO_FAST", "TOO_STEEP")  # fmt: skip

_HEADER = Template("""\
/* $made
 *
$about
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_JOINTS $n
#define ${NAME}_PERIOD $period /* [s], from one call of ${name}_step to the next */

/* Why it stopped the arm, or what it bridged last. */
enum {
$causes};

/* One controller; several do not know of each other. */
typedef struct {
    double memory[$size];
} ${name}_state;

/* To be called first, and after a stop: encoder counts now. */
void ${name}_init(${name}_state *self, const int32_t pulses[$n]);

/* One sample: what to apply until the next call.
 *
 * pulses            encoder counts of the motors, read now
 * q_r, qd_r, qdd_r  reference for now, joint side [rad, rad/s, rad/s^2]
 * now               time of a steady clock [s]; NAN without one
 * torque            of the joints, after the amplifier's limit [N m]
 *
 * Gives 0. A call that nothing can answer gives more, and changes neither *self nor torque: without guards NaN or an
 * infinity, with them only where the first call has one.
 */
int ${name}_step(${name}_state *self, const int32_t pulses[$n], const double q_r[$n], const double qd_r[$n],
    const double qdd_r[$n], double now, double torque[$n]);

/* 0 while it runs, otherwise why it stops the arm, until ${name}_init. */
int ${name}_stopped(const ${name}_state *self);

/* The last cause that was bridged or stopped, its joint from 0, and the number of the call. */
int ${name}_event(const ${name}_state *self, int *joint, long *call);

/* 1 where the mechanical brakes should hold the arm: the law does so no longer. */
int ${name}_brake(const ${name}_state *self);

#ifdef __cplusplus
}
#endif

#endif
""")

_SOURCE = Template("""\
/* $made */
#include "$name.h"

#include <math.h>

#define N $n
#define SIZE $size

/* -- places in the memory, and thresholds -- */
$constants
$helpers
/* -- of the law and the rig -- */
$pieces
/* -- guards and stop -- */
$logic
/* -- the controller -- */
void ${name}_init(${name}_state *self, const int32_t pulses[N])
{
    static const double initial[SIZE] = $initial;
    for (int i = 0; i < SIZE; i++)
        self->memory[i] = initial[i];
    for (int i = 0; i < N; i++)
        self->memory[SCALARS + COUNTS * N + i] = (double)pulses[i];
}

int ${name}_step(${name}_state *self, const int32_t pulses[N], const double q_r[N], const double qd_r[N],
    const double qdd_r[N], double now, double torque[N])
{
    double counts[N];
    for (int i = 0; i < N; i++)
        counts[i] = (double)pulses[i];
    return (int)${prefix}step(counts, q_r, qd_r, qdd_r, now, self->memory, torque);
}

int ${name}_stopped(const ${name}_state *self)
{
    return (int)self->memory[CAUSE];
}

int ${name}_event(const ${name}_state *self, int *joint, long *call)
{
    *joint = (int)self->memory[EVENT_JOINT];
    *call = (long)self->memory[EVENT_CALL];
    return (int)self->memory[EVENT];
}

int ${name}_brake(const ${name}_state *self)
{
    const double released = self->memory[RELEASED];
    return released == LATCHED || (released != HOLDING && self->memory[SINCE] >= $ramp * self->memory[DURATION]);
}
""")


def write_running(running: Any, folder: str | Path, name: str) -> None:
    """Write the files of `Running.to_c`."""
    rig, law, n = running.rig, running.law, running.n
    if rig.encoder.smooth:
        raise ValueError("rig must have an encoder that counts; got a smooth one. Use Encoder(..., smooth=False).")
    require_name(name)
    pieces = pieces_of(law, rig, law.block(rig))
    made = [_piece(which, *pieces[which]) for which in pieces]
    body = "\n".join(made)
    limits = "guards and stop" if running.guards is not None else "stop, without guards"
    about = (
        f"{type(law).__name__}, with the {limits} of the running controller that it was made from. Counts are those of "
        "the motors' encoders, with their sign; reference and torque are joint side, SI units. Compile without "
        "-ffast-math, which would leave NaN unseen."
    )
    causes = [(cause, getattr(layout, cause)) for cause in _CAUSES]
    common = {
        "name": name, "NAME": name.upper(), "n": n, "period": literal(running.period), "prefix": PREFIX,
        "size": len(running.core.memory), "about": f" * {comment(about)[3:-3]}", "ramp": literal(RAMP),
        "causes": "".join(
            f"    {name.upper()}_{cause} = {code},{_in_words(code)}\n" for cause, code in causes
        ),
        "constants": constants_of_logic(), "helpers": HELPERS + (f"\n{SIGN}" if "sign(" in body else ""),
        "pieces": body, "logic": translated(), "initial": braced(running.initial_memory),
    }  # fmt: skip
    title = f"made by onepulse {__version__} for {name}"
    templates = {f"{name}.h": _HEADER, f"{name}.c": _SOURCE}
    place = free_folder(folder, templates, name)
    place.mkdir(parents=True, exist_ok=True)
    for file, text in templates.items():
        (place / file).write_bytes(text.substitute(common, made=f"{file} - {title}").encode("ascii"))


def _in_words(code: int) -> str:
    said = wording(code, "a joint", float("nan"))
    return f" {comment(said.replace('nan ', ''))}" if said else ""


def _piece(name: str, function: Any, sources: Any, targets: Any) -> str:
    """One function from places of the memory to others: all are read before one is written."""
    inputs = [[(f"memory[{place}]", STATE) for place in places] for places in sources]
    lines, values, _ = statements(function, inputs)
    places = [place for each in targets for place in each]
    listed = "".join(f"    {value},\n" for value in values)
    body = [*lines[UNIFORM], *lines[STATE], f"const double results[{len(values)}] = {{\n{listed}}};"]
    body += [f"memory[{place}] = results[{i}];" for i, place in enumerate(places)]
    inner = textwrap.indent("\n".join(body), "    ")
    return f"static void {PREFIX}{name}(double *memory)\n{{\n{inner}\n}}\n"
