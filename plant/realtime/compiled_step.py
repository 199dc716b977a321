"""The compiled core of a running controller: guards and safe stop, which all share, and what they need of law and rig.

What `plant.realtime.safety` needs of law and rig is written here in casadi, each piece as a function from places of
the one vector `memory` to other places of it. All numbers are in that vector, so that laws and rigs of one structure
share a kernel. `safety` itself is compiled once, in a kernel of its own: it takes four times as long as the pieces.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.compiler.instructions import STATE, UNIFORM
from plant.compiler.intrinsics import MODULES, called, head, joined, switch
from plant.compiler.kernel_cache import Kernel
from plant.compiler.translate import Names, translate
from plant.machine.rig import Rig
from plant.realtime import safety
from plant.realtime.braking import ramp, slowing, smoothed
from plant.realtime.guards import Guards
from plant.realtime.torque_monitor import HELD, SLOT, SLOTS, at_limit, cause, swing, throughout

__all__ = ["Core", "compensates_gravity", "compiled", "row"]


class Core(NamedTuple):
    """A running controller for a loop that is itself compiled by numba.

    Attributes
    ----------
    step : numba function
        (pulses, q_r, qd_r, qdd_r, now, memory, torque) -> 0, or the reason (above 0) for which nothing was done. All
        but `now` are (n,) arrays, contiguous; `now` is a float [s], NaN without a clock; torque is written [N m].
        It allocates nothing, and does what `Running.step` does.
    memory : (m,) numpy.ndarray
        The controller's whole state; shared with the `Running` that it belongs to.
    """

    step: Callable[..., int]
    memory: NDArray[np.float64]


def compiled(law: Any, rig: Rig, block: Any, guards: Guards | None) -> Core:
    """Core of a law on a rig, in its initial state.

    Parameters
    ----------
    law : Law
    rig : Rig
    block : Block
        Of that law for that rig.
    guards : Guards or None

    Returns
    -------
    Core
    """
    n, states = rig.n, len(block.initial)
    weight = compensates_gravity(law, guards)
    kernel = Kernel(_source(_pieces(law, rig, block)), ["step"])
    rows, scalars = np.zeros((safety.ROWS, n)), np.zeros(safety.SCALARS)
    rows[safety.JUMP : safety.CHATTER + 1] = np.inf
    scalars[[safety.LATE, safety.DURATION]] = np.inf, 1.0
    if guards is not None:
        rows[safety.JUMP : safety.FRICTION + 1] = guards.limits(rig)
        rows[safety.SATURATION : safety.CHATTER + 1] = guards.torque_limits(rig)
        scalars[[safety.GUARDED, safety.PATIENCE, safety.LATE]] = 1.0, guards.patience, guards.late
        scalars[[safety.STOP, safety.DURATION]] = float(guards.stop != "hold"), guards.duration
    scalars[[safety.NOW, safety.PERIOD, safety.STATES]] = np.nan, block.period or rig.period, states
    sampled = block.period is not None
    scalars[[safety.WEIGHT, safety.SAMPLED, safety.FULL, safety.LEAST, safety.ROUNDS]] = (
        weight, sampled, SLOT, 0.0 if sampled else HELD, not rig.encoder.smooth,
    )  # fmt: skip
    memory = np.concatenate([scalars, rows.ravel(), *[block.initial] * 3, block.values])
    trial = [np.zeros(n) for _ in range(4)]
    return Core(kernel.function("step", *trial, np.nan, memory.copy(), np.zeros(n)), memory)


def row(index: int, n: int) -> range:
    """Places of one row of numbers per joint."""
    return range(safety.SCALARS + index * n, safety.SCALARS + (index + 1) * n)


def compensates_gravity(law: Any, guards: Guards | None) -> bool:
    """Whether a ramp stops with gravity compensation.

    Raises
    ------
    ValueError
        Gravity compensation under a law without an arm.
    """
    known = _knows_arm(law)
    if guards is not None and guards.stop == "gravity" and not known:
        given = f"stop must be 'hold' or 'zero' for a law without an arm; got 'gravity' for {type(law).__name__}"
        raise ValueError(f"{given}. Give such a law its arm, or stop otherwise.")
    return known and (guards is None or guards.stop != "zero")


def _knows_arm(law: Any) -> bool:
    return getattr(law, "arm", None) is not None


def _pieces(law: Any, rig: Rig, block: Any) -> dict[str, tuple[ca.Function, list[Any], list[Any]]]:
    """Name -> (function, places in the memory of each input, places of each output)."""
    n, s, own = rig.n, len(block.initial), len(law.number_names())
    per_joint = ("COUNTS", "BEFORE", "SPEED", "ANGLE", "Q", "QD", "QDD", "REFERENCE", "TORQUE", "FROM_Q", "FROM_QD")
    monitored = ("RUN", "AT_LIMIT", "MEAN", "SWING", "OVER", "NEWEST", "SATURATION", "CHATTER")
    rows = (*per_joint, "WANTED", "GIVEN", "FROM_TORQUE", *monitored)
    scalars = ("DT", "SINCE", "DURATION", "WEIGHT", "LEAST", "PASSED", "AGE", "FILLED")
    places: dict[str, range | list[int]] = {name: row(getattr(safety, name), n) for name in rows}
    places |= {name: [getattr(safety, name)] for name in scalars}
    places["OLDER"] = range(row(safety.OLDER, n).start, row(safety.ROWS, n).start)
    end = safety.SCALARS + safety.ROWS * n
    places |= {"STATE": range(end + s, end + 2 * s), "FOLLOWING": range(end + 2 * s, end + 3 * s)}
    places["NUMBERS"] = range(end + 3 * s, end + 3 * s + len(block.values))
    at = {name: ca.SX.sym(name, len(places[name])) for name in places}
    rig, law = rig.with_numbers(at["NUMBERS"][own:]), law.with_numbers(at["NUMBERS"][:own])

    motion = at["Q"], at["QD"], at["QDD"]
    asked, following = block.step(
        at["STATE"], *motion, at["REFERENCE"], at["COUNTS"], at["TORQUE"], at["DT"], at["NUMBERS"]
    )
    stop = slowing(at["SINCE"], at["DURATION"], at["FROM_Q"], at["FROM_QD"])
    held = law.arm.dynamics.gravity(at["ANGLE"], law.arm.f) - rig.spring_torque(at["ANGLE"]) if _knows_arm(law) else 0
    gravity = at["WEIGHT"] * held
    written = {
        "ahead": dict(zip(("Q", "QD", "QDD"), _ahead(*motion, at["DT"]), strict=True)),
        "moving": {"SPEED": rig.position_in_pulses(at["QD"])},
        "counted": {"REFERENCE": rig.counts(at["Q"]), "ANGLE": rig.cell_centre(at["COUNTS"])},
        "measured": {"SPEED": smoothed(at["SPEED"], at["COUNTS"], at["BEFORE"], at["DT"])},
        "standing": {"FROM_Q": at["ANGLE"], "FROM_QD": rig.to_angle(at["SPEED"])},
        "slowing": dict(zip(("Q", "QD", "QDD"), stop, strict=True)),
        "law": {"WANTED": asked, "GIVEN": rig.drive.limited(asked), "FOLLOWING": following},
        "monitored": _monitored(rig, at),
        "shifted": {"OLDER": ca.vertcat(at["NEWEST"], at["OLDER"][:-n]), "NEWEST": ca.SX.zeros(n), "FILLED": ca.SX(0)},
        "ramp": {"TORQUE": ramp(rig, gravity, at["FROM_TORQUE"], at["SPEED"], at["SINCE"], at["DURATION"])},
    }
    pieces = {}
    for name, results in written.items():
        outputs = ca.cse([ca.densify(result) for result in results.values()])
        needed = [symbol for symbol in places if ca.depends_on(ca.vertcat(*outputs), at[symbol])]
        function = ca.Function(name, [at[symbol] for symbol in needed], outputs)
        pieces[name] = function, [places[symbol] for symbol in needed], [places[result] for result in results]
    return pieces


def _ahead(q, qd, qdd, dt):
    """A motion extrapolated with its acceleration over a time dt."""
    return q + dt * qd + dt * dt / 2 * qdd, qd + dt * qdd, qdd


def _monitored(rig, at):
    """What follows of saturation and chatter, and the cause of a stop per joint."""
    passed = at["PASSED"]
    run, counted = throughout(at["RUN"], at["WANTED"], rig.drive, passed, at["LEAST"])
    time, newest = at_limit(ca.reshape(ca.vertcat(at["NEWEST"], at["OLDER"]), rig.n, SLOTS), counted)
    mean, distance, age = swing(at["MEAN"], at["SWING"], at["GIVEN"], rig.drive, at["AGE"], passed)
    over = cause(time, distance, (at["SATURATION"], at["CHATTER"]), (safety.IS_SATURATED, safety.CHATTERS))
    return {"RUN": run, "AT_LIMIT": time, "NEWEST": newest, "FILLED": at["FILLED"] + passed,
            "MEAN": mean, "SWING": distance, "AGE": age, "OVER": over}  # fmt: skip


_PIECES = ("ahead", "moving", "measured", "counted", "standing", "slowing", "law", "monitored", "shifted", "ramp")
"""What `plant.realtime.safety` calls of a law and a rig, in the order in which it numbers them."""


@functools.cache
def _common():
    """`plant.realtime.safety` compiled, for every law and rig: what is theirs it calls at the address in its memory."""
    text = inspect.getsource(safety)
    functions = re.findall(r"^def (\w+)", text, re.MULTILINE)
    text = re.sub(rf"\b({'|'.join(functions)})(?=\()", r"\1_{h}", text)
    inlined = 'numba.njit(inline="always", error_model="numpy")'  # in half the time that calls take to compile
    made = [f"{name}_{{h}} = {'compiled' if name == 'step' else inlined}({name}_{{h}})" for name in functions]
    calls = [called(name, safety.PIECES, which) for which, name in enumerate(_PIECES)]
    known = [f"{name} = {name}_{{h}}" for name in _PIECES]  # in the place of those that safety names
    text = joined(text, "from llvmlite import ir\n" + MODULES)
    return Kernel("\n".join([text, *made, *calls, *known]) + "\n", ["step"])


def _compiled_common():
    """The same, compiled by a call that is refused before it calls anything."""
    kernel, one = _common(), [np.full(1, np.nan) for _ in range(4)]
    kernel.call("step", *one, np.nan, np.zeros(safety.SCALARS + safety.ROWS), np.zeros(1))
    return kernel


def _source(pieces):
    """Text of a step: `_common` with the address of these pieces."""
    common = _compiled_common().hash
    own = {name: _lines(*pieces[name]) for name in _PIECES}
    return head() + switch("pieces", own) + _STEP.format(common=common, place=safety.PIECES)


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
