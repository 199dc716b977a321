"""Compiled core of a running controller: guards and safe stop, with the functions of law and rig.

The functions that `plant.realtime.safety` calls of law and rig are written in
`plant.realtime.pieces`. All numbers are in one vector, so that laws and rigs of one structure share
a kernel. `safety` itself, with the modules that it uses, is compiled once, in a kernel of its own:
that takes five times as long as the functions of a law and a rig.
"""

import dataclasses
import functools
import hashlib
import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from plant.compiler import MODULES, STATE, UNIFORM, Kernel, Names, head, switch, translate
from plant.machine import Rig
from plant.parts import Floats
from plant.realtime import calls, memory, safety, stopping, watching
from plant.realtime.guards import Guards
from plant.realtime.memory import JOINT_SIZE, MOTION_SIZE, RUN_SIZE, Layout, view
from plant.realtime.pieces import HELD, SLOT, knows_arm, pieces_of


class Core(NamedTuple):
    """A running controller for a loop that is itself compiled by numba.

    `step` maps (pulses, q_r, qd_r, qdd_r, now, memory, torque) to 0, or to the reason (above 0) of
    a refusal, after which counts, torque and state are those of the call before; it is
    `Running.step` without checks. All but `now` are (n,) arrays, contiguous; `now` is a float [s],
    NaN without a clock; torque is written [N m].
    `memory` (m,) is the controller's whole state, shared with the `Running` that it belongs to.
    """

    step: Callable[..., int]
    memory: Floats

    def law_state(self, n: int) -> Floats:
        """State (s,) of the law, as a view of the memory: an assignment acts on the next step."""
        state: Floats = view(self.memory, n, 0).state
        return state


def compiled(
    law: Any, rig: Rig, block: Any, guards: Guards | None, without: Sequence[str] = ()
) -> Core:
    """Core of a law on a rig, in its initial state; `block` is of that law for that rig."""
    vector = initial_memory(law, rig, block, guards)
    layout = Layout.of(block, rig.n)
    kernel = Kernel(_source(pieces_of(law, rig, block, without), layout), ["step"])
    # The first call compiles; it works on a copy, so the memory stays in its initial state.
    trial = [np.zeros(rig.n) for _ in range(4)]
    return Core(kernel.function("step", *trial, np.nan, vector.copy(), np.zeros(rig.n)), vector)


def initial_memory(law: Any, rig: Rig, block: Any, guards: Guards | None) -> Floats:
    """The memory at the start, but for the counts."""
    n = rig.n
    vector = Layout.of(block, n).vector(block)
    parts = view(vector, n, 0)
    run = parts.run
    joints = parts.joints

    # 1. Settings that follow from law and rig.
    # Fast hardware has no period of its own: its calls are compared with that of the rig.
    run.period = block.period or rig.period
    run.states = len(block.initial)
    run.weight = compensates_gravity(law, guards)
    run.sampled = block.period is not None
    run.slot_length = SLOT
    run.shortest_limit = 0.0 if run.sampled else HELD
    run.whole_counts = not rig.encoder.smooth
    run.modelled = knows_arm(law)
    # NaN compares as no time, and a rate of 1 is that of a sound reference.
    run.now = np.nan
    run.rhythm = 1.0
    # A pulse of each motor may turn the joint where motors are coupled: the sum bounds its angle.
    joints["pulse"] = np.abs([rig.to_angle(unit) for unit in np.eye(n)]).sum(axis=0)

    # 2. The limits: without guards none that can be reached.
    if guards is None:
        run.late = np.inf
        run.longest_step = np.inf
        run.braking = np.inf
        run.slowest_rhythm = -np.inf
        run.fastest_rhythm = np.inf
        # No limit can be reached, so no stop begins; this duration only keeps its equations finite.
        run.duration = 1.0
        for name in _LIMITS:
            joints[name] = np.inf
        joints["lower"] = -np.inf
        return vector
    # Numbers, not flags: the memory is one vector of floats, in numba and in C.
    run.guarded = 1.0
    run.patience = guards.patience
    run.late = guards.late
    run.no_hold = guards.stop != "hold"
    run.duration = guards.duration
    run.braking = guards.braking
    run.slowest_rhythm, run.fastest_rhythm = guards.rhythm_limits()
    # A bridged late call lasts at most so long; the law is not integrated over more.
    run.longest_step = guards.patience + 1 + guards.late
    # The samples that the guards see are those of the law, whatever its inner loop does.
    rig = dataclasses.replace(rig, period=run.period, inner=None)
    limits = (
        *guards.limits(rig),
        *guards.torque_limits(rig),
        guards.rest_band(rig),
        guards.slack(rig),
        *guards.motion_limits(rig),
    )
    for name, limit in zip(_LIMITS, limits, strict=True):
        joints[name] = limit
    # Positions and speeds are compared in every sample, at a cost, only where one has a limit.
    run.bounded = np.isfinite([joints[name] for name in ("lower", "upper", "speed_limit")]).any()
    return vector


# Fields of a joint that guards set, in the order of the methods of `Guards`.
_LIMITS = (
    "jump",
    "stuck",
    "error",
    "friction",
    "saturation",
    "chatter",
    "rest",
    "slack",
    "lower",
    "upper",
    "speed_limit",
    "torque_rate",
)


def compensates_gravity(law: Any, guards: Guards | None) -> bool:
    """Whether a ramp stops with gravity compensation."""
    has_arm = knows_arm(law)
    # A ramp to gravity compensation needs the weight, which only a model knows.
    if guards is not None and guards.stop == "gravity" and not has_arm:
        problem = (
            "stop must be 'hold' or 'zero' for a law without an arm; got 'gravity' for"
            f" {type(law).__name__}"
        )
        raise ValueError(f"{problem}. Give such a law its arm, or stop otherwise.")
    return has_arm and (guards is None or guards.stop != "zero")


@functools.cache
def _common():
    """`plant.realtime.safety` compiled, for every law and rig.

    numba would not see a change of its modules, so the text of the kernel holds their hash.
    """
    # `pieces` is missing here: its functions are compiled per law, under their own hash.
    modules = (memory, calls, stopping, watching, safety)
    text = "".join(inspect.getsource(module) for module in modules)
    digest = hashlib.sha256(text.encode()).hexdigest()
    kernel = Kernel(MODULES + _COMMON.format(digest=digest), ["step"])

    # Compile it by a call that is refused before it calls anything.
    inputs = [np.full(1, np.nan) for _ in range(4)]
    vector = np.zeros(RUN_SIZE + JOINT_SIZE + MOTION_SIZE)
    kernel.call("step", *inputs, np.nan, vector, np.zeros(1), np.uintp(0))
    return kernel


def _source(pieces, layout):
    """Text of a step: the common step with the address of these pieces."""
    lines = {name: _lines(piece, layout) for name, piece in pieces.items()}
    return head() + switch("pieces", lines) + _STEP.format(common=_common().hash)


def _lines(piece, layout):
    inputs = [
        [(f"memory[{position}]", STATE) for position, _ in layout.components(name)]
        for name in piece.sources
    ]
    # The same translation as of the loop, so that a law computes the same bits in both.
    program = translate(piece.function, inputs, Names(), None)
    lines = [*map(str, program.lines[UNIFORM] + program.lines[STATE])]
    # All quantities are read before one is written.
    lines.append(f"results = [{', '.join(program.results)}]")
    positions = [position for name in piece.targets for position, _ in layout.components(name)]
    return [*lines, *(f"memory[{position}] = results[{i}]" for i, position in enumerate(positions))]


_COMMON = """
from plant.compiler.intrinsics import borrowed, inlined
from plant.realtime.memory import view
from plant.realtime.safety import sample

inlined_view = inlined(view)

@compiled
def step_{{h}}(pulses, q_r, qd_r, qdd_r, now, memory, torque, pieces):
    # {digest}
    parts = inlined_view(borrowed(memory), len(torque), pieces)
    return sample(pulses, q_r, qd_r, qdd_r, now, parts, torque)
"""

_STEP = """
from kernel_{common} import step_{common} as common


@compiled
def step_{{h}}(pulses, q_r, qd_r, qdd_r, now, memory, torque):
    return common(pulses, q_r, qd_r, qdd_r, now, memory, torque, pieces_{{h}}())
"""
