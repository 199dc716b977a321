"""The step of `simulate` as C: a geared arm as the model of an FMU, torque in, counts out.

The functions are those of `plant.simulation.closed_loop`; here they are put into text.
"""

import textwrap

import casadi as ca
import numpy as np

from plant.compiler.c_statements import braced, comment, helpers, statements
from plant.compiler.instructions import STATE, TIME, UNIFORM
from plant.mechanics.arm import Arm
from plant.simulation.closed_loop import ClosedLoop, bounded


def arm_values(arm: Arm, loop: ClosedLoop) -> dict[str, str]:
    """What the templates arm.c and arm.h need of it."""
    p = arm.dynamics.p
    start = np.concatenate([np.zeros(3 * arm.n), arm.f, np.zeros(2 * arm.n)])
    numbers = loop.number_values(arm.f)[p:]
    bodies = {"settled": _settled(loop), "moved": _moved(loop), "observed": _observed(loop)}
    return {
        "h": repr(loop.h), "steps": str(loop.steps_per_sample), "states": str(len(loop.state_names)),
        "listed": comment(", ".join(loop.number_names[p:]))[3:-3], "numbers": braced(numbers),
        "helpers": helpers("\n".join(bodies.values())), "start": braced(start), **bodies,
    }  # fmt: skip


def _settled(loop: ClosedLoop) -> str:
    """The state at the start."""
    q, qd, numbers = (ca.SX.sym(name, size) for name, size in (("q", loop.n), ("qd", loop.n), ("f", _count(loop))))
    places = loop._places
    state = ca.SX(loop.initial_state(np.zeros(loop.n), np.zeros(loop.n)))
    given = {"q": q, "qd": qd}
    if "link" in loop.giving:
        given |= {"link": loop._settled.expand()(q, numbers), "link_speed": qd}
    for name, value in given.items():
        state[places[name].start : places[name].stop] = value
    function = ca.Function("settled", [q, qd, numbers], [state])
    rows = [[(f"{name}[{i}]", STATE) for i in range(loop.n)] for name in ("q", "qd")]
    return _body(function, [*rows, _numbers(loop)], {"state": range(len(loop.state_names))})


def _moved(loop: ClosedLoop) -> str:
    """One sub-step."""
    logged = loop.time_names.index("logged[0]")
    times = [("0.0", UNIFORM)] * len(loop.time_names)
    times[logged : logged + loop.n] = [(f"torque[{i}]", TIME) for i in range(loop.n)]
    times[-1] = (repr(loop.h), UNIFORM)
    state, time, numbers = (ca.SX.sym(name, loop.substep.size1_in(i)) for i, name in enumerate(("x", "t", "numbers")))
    function = ca.Function("moved", [state, time, numbers], loop.substep(state, time, numbers)[:1])
    return _body(function, [_state(loop), times, _numbers(loop)], {"state": range(len(loop.state_names))})


def _observed(loop: ClosedLoop) -> str:
    """Position, velocity and counts of a state, and whether they are bounded."""
    n, places, state = loop.n, loop._places, ca.SX.sym("state", len(loop.state_names))
    rows = {name: state[at.start : at.stop] for name, at in places.items()}
    q, qd = (rows["link"], rows["link_speed"]) if "link" in loop.giving else (rows["q"], rows["qd"])
    counts = loop.rig.true_counts(q if loop.rig.encoder.side == "link" else rows["q"])
    sound = ca.logic_and(rows["ok"] > 0, bounded(ca.vertsplit(ca.vertcat(rows["q"], rows["qd"]))))
    function = ca.Function("observed", [state], [ca.cse(ca.vertcat(q, qd, counts, sound))])
    text = _body(function, [_state(loop)], {"seen": range(2 * n), "counts": range(n), "const int sound": None})
    return f"{text}\n    return sound;"


def _body(function: ca.Function, inputs: list[list[tuple[str, int]]], targets: dict[str, range | None]) -> str:
    """Statements that write the results, joined, into arrays; all are read before one is written."""
    lines, values, _ = statements(function, inputs)
    listed = "".join(f"    {value},\n" for value in values)
    body = [*lines[UNIFORM], *lines[TIME], *lines[STATE]]
    body.append(f"const double results[{len(values)}] = {{\n{listed}}};")
    first = 0
    for name, places in targets.items():
        count = 1 if places is None else len(places)
        last = f"{name} = results[{first}] != 0.0;"
        body.append(last if places is None else f"memcpy({name}, results + {first}, {count} * sizeof *results);")
        first += count
    return textwrap.indent("\n".join(body), "    ")


def _count(loop: ClosedLoop) -> int:
    return len(loop.number_names)


def _state(loop: ClosedLoop) -> list[tuple[str, int]]:
    return [(f"state[{i}]", STATE) for i in range(len(loop.state_names))]


def _numbers(loop: ClosedLoop) -> list[tuple[str, int]]:
    """F of the instance, and the numbers that are fixed."""
    p = loop.dynamics.p
    return [*((f"f[{i}]", UNIFORM) for i in range(p)), *((f"numbers[{i}]", UNIFORM) for i in range(_count(loop) - p))]
