"""The compiled core of a running controller: guards and safe stop, which all share, and what they
need of law and rig.

What `plant.realtime.safety` needs of law and rig is written in `plant.realtime.pieces`. All numbers
are in one vector, so that laws and rigs of one structure share a kernel. `safety` itself, with the
modules that it is made of, is compiled once, in a kernel of its own: it takes five times as long as
the pieces.
"""

import functools
import inspect
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.compiler.instructions import STATE, UNIFORM
from plant.compiler.intrinsics import MODULES, called, head, joined, switch
from plant.compiler.kernel_cache import Kernel
from plant.compiler.translate import Names, translate
from plant.machine.rig import Rig
from plant.realtime import memory as layout
from plant.realtime import safety, stopping, watching
from plant.realtime.guards import Guards
from plant.realtime.pieces import HELD, SLOT, knows_arm, pieces_of


class Core(NamedTuple):
    """A running controller for a loop that is itself compiled by numba.

    `step` does what `Running.step` does, (pulses, q_r, qd_r, qdd_r, now, memory, torque) -> 0, or
    the reason (above 0) for which nothing was done. All but `now` are (n,) arrays, contiguous;
    `now` is a float [s], NaN without a clock; torque is written [N m]. `memory` (m,) is the
    controller's whole state; shared with the `Running` that it belongs to.
    """

    step: Callable[..., int]
    memory: NDArray[np.float64]

    def law_state(self, n: int) -> NDArray[np.float64]:
        """The law's state (s,) of a controller of n joints, in place: what is written there acts
        on the next step.
        """
        states = int(self.memory[layout.STATES])
        rows = layout.SCALARS + layout.ROWS * n
        return self.memory[rows + states : rows + 2 * states]


def compiled(
    law: Any, rig: Rig, block: Any, guards: Guards | None, without: Sequence[str] = ()
) -> Core:
    """Core of a law on a rig, in its initial state; `block` is of that law for that rig."""
    memory = initial_memory(law, rig, block, guards)
    kernel = Kernel(_source(pieces_of(law, rig, block, without)), ["step"])
    trial = [np.zeros(rig.n) for _ in range(4)]
    return Core(kernel.function("step", *trial, np.nan, memory.copy(), np.zeros(rig.n)), memory)


def initial_memory(law: Any, rig: Rig, block: Any, guards: Guards | None) -> NDArray[np.float64]:
    """The memory at the start, but for the counts."""
    n = rig.n
    states = len(block.initial)
    weight = compensates_gravity(law, guards)
    rows = np.zeros((layout.ROWS, n))
    scalars = np.zeros(layout.SCALARS)
    rows[layout.JUMP : layout.CHATTER + 1] = np.inf
    rows[[layout.REST, layout.UPPER, layout.FASTEST, layout.RATE, layout.SLACK]] = np.inf
    rows[layout.LOWER] = -np.inf
    rows[layout.LEAST_STEP] = np.abs([rig.to_angle(one) for one in np.eye(n)]).sum(axis=0)
    scalars[[layout.LATE, layout.DURATION, layout.FASTER, layout.HURRIED, layout.AT_MOST]] = np.inf
    scalars[[layout.DURATION, layout.RHYTHM, layout.SLOWER, layout.MODELLED]] = (
        1.0,
        1.0,
        -np.inf,
        knows_arm(law),
    )
    if guards is not None:
        rows[layout.JUMP : layout.FRICTION + 1] = guards.limits(rig)
        rows[layout.SATURATION : layout.CHATTER + 1] = guards.torque_limits(rig)
        scalars[[layout.GUARDED, layout.PATIENCE, layout.LATE]] = 1.0, guards.patience, guards.late
        scalars[[layout.STOP, layout.DURATION]] = float(guards.stop != "hold"), guards.duration
        _given(rig, guards, rows, scalars)
    scalars[[layout.NOW, layout.PERIOD, layout.STATES]] = np.nan, block.period or rig.period, states
    sampled = block.period is not None
    scalars[[layout.WEIGHT, layout.SAMPLED, layout.FULL, layout.LEAST, layout.ROUNDS]] = (
        weight,
        sampled,
        SLOT,
        0.0 if sampled else HELD,
        not rig.encoder.smooth,
    )
    return np.concatenate(
        [scalars, rows.ravel(), *[block.initial] * 3, block.values, np.zeros(3 * n * n)]
    )


def _given(rig, guards, rows, scalars):
    """Write limits of what the arm may do, at work and in a stop."""
    rows[layout.REST], rows[layout.SLACK] = guards.rest_band(rig), guards.slack(rig)
    rows[[layout.LOWER, layout.UPPER, layout.FASTEST, layout.RATE]] = limits = guards.motion_limits(
        rig
    )
    scalars[[layout.SLOWER, layout.FASTER]] = guards.rhythm_limits()
    scalars[[layout.BOUNDED, layout.AT_MOST]] = np.isfinite(limits[:3]).any(), guards.braking
    scalars[layout.HURRIED] = guards.patience + 1 + guards.late


def compensates_gravity(law: Any, guards: Guards | None) -> bool:
    """Whether a ramp stops with gravity compensation."""
    known = knows_arm(law)
    if guards is not None and guards.stop == "gravity" and not known:
        given = (
            "stop must be 'hold' or 'zero' for a law without an arm; got 'gravity' for"
            f" {type(law).__name__}"
        )
        raise ValueError(f"{given}. Give such a law its arm, or stop otherwise.")
    return known and (guards is None or guards.stop != "zero")


# What `plant.realtime.safety` calls of a law and a rig, in the order in which it numbers them.
_PIECES = (
    "ahead",
    "moving",
    "measured",
    "counted",
    "standing",
    "slowing",
    "law",
    "monitored",
    "shifted",
    "ramp",
    "needed",
    "bounds",
    "planned",
    "limited",
    "left_out",
)


@functools.cache
def _common():
    """`plant.realtime.safety` compiled, for every law and rig: what is theirs it calls at the
    address in its memory.
    """
    text = "\n".join(inspect.getsource(module) for module in (layout, stopping, watching, safety))
    text = re.sub(r"^from plant\.[^(\n]*(\([^)]*\))?.*$", "", text, flags=re.MULTILINE)
    functions = re.findall(r"^def (\w+)", text, re.MULTILINE)
    text = re.sub(rf"\b({'|'.join(functions)})(?=\()", r"\1_{h}", text)
    made = [f"{name}_{{h}} = {_how(name, text)}({name}_{{h}})" for name in functions]
    calls = [called(name, layout.PIECES, which) for which, name in enumerate(_PIECES)]
    # in the place of those that safety names
    known = [f"{name} = {name}_{{h}}" for name in _PIECES]
    text = joined(text, "from llvmlite import ir\n" + MODULES)
    return Kernel("\n".join([text, *made, *calls, *known]) + "\n", ["step"])


def _how(name, text):
    """Decorator of a function: inlined where it is called once, a call where more often, as
    compiles soonest.
    """
    if name == "step":
        return "compiled"
    once = len(re.findall(rf"\b{name}_{{h}}\(", text)) == 2
    alone = "no_cpython_wrapper=True, no_cfunc_wrapper=True"  # nothing but `step` calls them
    return f'numba.njit(inline="{"always" if once else "never"}", error_model="numpy", {alone})'


def _compiled_common():
    """The same, compiled by a call that is refused before it calls anything."""
    kernel = _common()
    one = [np.full(1, np.nan) for _ in range(4)]
    kernel.call("step", *one, np.nan, np.zeros(layout.SCALARS + layout.ROWS + 3), np.zeros(1))
    return kernel


def _source(pieces):
    """Text of a step: `_common` with the address of these pieces."""
    common = _compiled_common().hash
    own = {name: _lines(*pieces[name]) for name in _PIECES}
    return head() + switch("pieces", own) + _STEP.format(common=common, place=layout.PIECES)


def _lines(function, sources, targets):
    inputs = [[(f"memory[{place}]", STATE) for place in places] for places in sources]
    program = translate(function, inputs, Names(), None)
    lines = [*map(str, program.lines[UNIFORM] + program.lines[STATE])]
    places = [place for each in targets for place in each]
    lines += [f"results = [{', '.join(program.results)}]"]  # all are read before one is written
    return [*lines, *(f"memory[{place}] = results[{i}]" for i, place in enumerate(places))]


_STEP = """
from kernel_{common} import step_{common} as common


@compiled
def step_{{h}}(pulses, q_r, qd_r, qdd_r, now, memory, torque):
    memory[{place}] = pieces_{{h}}()
    refusal = common(pulses, q_r, qd_r, qdd_r, now, memory, torque)
    memory[{place}] = 0.0
    return refusal
"""
