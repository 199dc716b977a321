"""What a running controller needs of one law and one rig, in casadi.

Each piece is a function from places of the one vector `memory` (`plant.realtime.memory`) to other places of it.
"""

from typing import Any

import casadi as ca

from plant.machine.rig import Rig
from plant.realtime import memory as layout
from plant.realtime.braking import ramp, slowing, smoothed
from plant.realtime.torque_monitor import SLOTS, at_limit, at_the_limit, cause, swing, throughout


def row(index: int, n: int) -> range:
    """Places of one row of numbers per joint."""
    return range(layout.SCALARS + index * n, layout.SCALARS + (index + 1) * n)


def knows_arm(law: Any) -> bool:
    """Whether a law holds the model of an arm."""
    return getattr(law, "arm", None) is not None


def pieces_of(law: Any, rig: Rig, block: Any) -> dict[str, tuple[ca.Function, list[Any], list[Any]]]:
    """Name -> (function, places in the memory of each input, places of each output)."""
    n, s, own = rig.n, len(block.initial), len(law.number_names())
    per_joint = ("COUNTS", "BEFORE", "SPEED", "ANGLE", "Q", "QD", "QDD", "REFERENCE", "TORQUE", "FROM_Q", "FROM_QD")
    monitored = ("RUN", "AT_LIMIT", "MEAN", "SWING", "OVER", "NEWEST", "SATURATION", "CHATTER")
    stopping_too = ("WAS_Q", "WAS_QD", "WAS_QDD", "NEEDED", "LOWER", "UPPER", "FASTEST", "BEYOND", "PLANNED", "LIMITED")
    rows = (*per_joint, "WANTED", "GIVEN", "FROM_TORQUE", *monitored, *stopping_too)
    scalars = ("DT", "SINCE", "DURATION", "WEIGHT", "LEAST", "PASSED", "AGE", "FILLED")
    places: dict[str, range | list[int]] = {name: row(getattr(layout, name), n) for name in rows}
    places |= {name: [getattr(layout, name)] for name in scalars}
    places["OLDER"] = range(row(layout.OLDER, n).start, row(layout.REST, n).start)
    end = layout.SCALARS + layout.ROWS * n
    places |= {"STATE": range(end + s, end + 2 * s), "FOLLOWING": range(end + 2 * s, end + 3 * s)}
    places["NUMBERS"] = range(end + 3 * s, end + 3 * s + len(block.values))
    at = {name: ca.SX.sym(name, len(places[name])) for name in places}
    rig, law = rig.with_numbers(at["NUMBERS"][own:]), law.with_numbers(at["NUMBERS"][:own])

    motion = at["Q"], at["QD"], at["QDD"]
    asked, following = block.step(
        at["STATE"], *motion, at["REFERENCE"], at["COUNTS"], at["TORQUE"], at["DT"], at["NUMBERS"]
    )
    stop = slowing(at["SINCE"], at["DURATION"], at["FROM_Q"], at["FROM_QD"])
    held = law.arm.dynamics.gravity(at["ANGLE"], law.arm.f) - rig.spring_torque(at["ANGLE"]) if knows_arm(law) else 0
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
        "needed": {"NEEDED": _needed(law, rig, motion) - _needed(law, rig, (at["WAS_Q"], at["WAS_QD"], at["WAS_QDD"]))},
        "bounds": {"BEYOND": _bounds(rig, at)},
        "planned": {"PLANNED": rig.position_in_pulses(at["QD"])},
        "limited": {"LIMITED": at_the_limit(at["TORQUE"], rig.drive)},
    }
    pieces = {}
    for name, results in written.items():
        outputs = ca.cse([ca.densify(result) for result in results.values()])
        needed = [symbol for symbol in places if ca.depends_on(ca.vertcat(*outputs), at[symbol])]
        function = ca.Function(name, [at[symbol] for symbol in needed], outputs)
        pieces[name] = function, [places[symbol] for symbol in needed], [places[result] for result in results]
    return pieces


def _needed(law, rig, motion):
    """Torque of a motion by the law's model, less that of springs; zeros without one."""
    q, qd, qdd = motion
    if not knows_arm(law):
        return ca.SX.zeros(rig.n)
    model, f = law.arm.dynamics, law.arm.f
    return model.D(q, f) @ qdd + model.h(q, qd, f) - rig.spring_torque(q)


def _bounds(rig, at):
    """1 beyond a limit of position, 2 of speed, else 0."""
    outside = ca.logic_or(at["ANGLE"] < at["LOWER"], at["ANGLE"] > at["UPPER"])
    return ca.if_else(outside, 1, ca.if_else(ca.fabs(rig.to_angle(at["SPEED"])) > at["FASTEST"], 2, 0))


def _ahead(q, qd, qdd, dt):
    """A motion extrapolated with its acceleration over a time dt."""
    return q + dt * qd + dt * dt / 2 * qdd, qd + dt * qdd, qdd


def _monitored(rig, at):
    """What follows of saturation and chatter, and the cause of a stop per joint."""
    passed = at["PASSED"]
    run, counted = throughout(at["RUN"], at["WANTED"], rig.drive, passed, at["LEAST"])
    time, newest = at_limit(ca.reshape(ca.vertcat(at["NEWEST"], at["OLDER"]), rig.n, SLOTS), counted)
    mean, distance, age = swing(at["MEAN"], at["SWING"], at["GIVEN"], rig.drive, at["AGE"], passed)
    over = cause(time, distance, (at["SATURATION"], at["CHATTER"]), (layout.IS_SATURATED, layout.CHATTERS))
    return {"RUN": run, "AT_LIMIT": time, "NEWEST": newest, "FILLED": at["FILLED"] + passed,
            "MEAN": mean, "SWING": distance, "AGE": age, "OVER": over}  # fmt: skip
