"""What a running controller needs of one law and one rig, in casadi.

Each piece is a function from places of the one vector `memory` (`plant.realtime.memory`) to other
places of it.

Saturation and chatter are those of the shafts, which have the amplifiers' limits; without coupling
they are the joints. *Saturation* is the time at the limit within a sliding window of `WINDOW`, kept
in slots: the oldest is dropped when the newest is full (`SLOT`), so that the window is never
shorter than `WINDOW`, and at most a slot longer. *Chatter* is the mean distance of the torque from
its own running mean. What quantisation or a sound loop adds to the torque is small against the
limit, however much of it changes from one sample to the next; the oscillation of an unstable loop
grows until it is the limit itself, at whatever frequency (`tests/benchmarks/guards.py`). A fast
path moves the mean instead.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from plant.machine.drive import Drive
from plant.machine.rig import Rig
from plant.realtime import memory as layout
from plant.realtime.guards import WINDOW

# smoothing factor of the measured speed: quantisation is much of a change of counts
SMOOTHING = 0.25

# Share of the duration of a stop in which the torque ramps to its end: short, since it may begin at
# the limit.
RAMP = 0.1

SLOTS = 6  # slots of the window of saturation, with the one that is being filled

# Time for which a law without a period must stay at its limit before it counts [s]: one pulse may
# take it there.
HELD = 0.5e-3

_ROUNDING = 1e-9

SLOT = (1 - _ROUNDING) * WINDOW / (SLOTS - 1)  # age at which the newest slot is full [s]

# time constant of the mean that chatter swings about [s]: 100 rad/s, above what a path asks for
MEMORY = 0.01

AVERAGED = 0.05  # time constant over which the swing is averaged [s]


def row(index: int, n: int) -> range:
    """Places of one row of numbers per joint."""
    return range(layout.SCALARS + index * n, layout.SCALARS + (index + 1) * n)


def numbers_of(block: Any, n: int) -> range:
    """Places of the numbers of law and rig."""
    start = layout.SCALARS + layout.ROWS * n + 3 * len(block.initial)
    return range(start, start + len(block.values))


def knows_arm(law: Any) -> bool:
    """Whether a law holds the model of an arm."""
    return getattr(law, "arm", None) is not None


def model_part(law: Any, rig: Rig, without: Sequence[str], motion: tuple[ca.SX, ...]) -> ca.SX:
    """Torque (n, 1) [N m] of these parts of a law's model, at q and with qd, qdd; one that it
    has not is refused.
    """
    parts = law.model_parts(*motion)
    if (
        isinstance(without, str)
        or not set(without) <= set(parts)
        or len(set(without)) < len(without)
    ):
        known = ", ".join(parts) or "none, since it has no model of the arm"
        meant = (
            f"Write ({without!r:.60},)."
            if isinstance(without, str)
            else "Leave out what it has not."
        )
        rule = f"without must be a sequence of parts of {type(law).__name__} ({known}), each once"
        raise ValueError(f"{rule}; got {without!r:.60}. {meant}")
    return sum((parts[each] for each in without), ca.SX.zeros(rig.n))


def pieces_of(
    law: Any, rig: Rig, block: Any, without: Sequence[str] = ()
) -> dict[str, tuple[ca.Function, list[Any], list[Any]]]:
    """Name -> (function, places in the memory of each input, places of each output)."""
    n = rig.n
    s = len(block.initial)
    own = len(law.number_names())
    per_joint = (
        "COUNTS",
        "BEFORE",
        "SPEED",
        "ANGLE",
        "Q",
        "QD",
        "QDD",
        "REFERENCE",
        "TORQUE",
        "FROM_Q",
        "FROM_QD",
    )
    monitored = ("RUN", "AT_LIMIT", "MEAN", "SWING", "OVER", "NEWEST", "SATURATION", "CHATTER")
    stopping_too = (
        "WAS_Q",
        "WAS_QD",
        "WAS_QDD",
        "NEEDED",
        "LOWER",
        "UPPER",
        "FASTEST",
        "BEYOND",
        "PLANNED",
        "LIMITED",
    )
    rows = (*per_joint, "WANTED", "GIVEN", "FROM_TORQUE", *monitored, *stopping_too, "LEFT_OUT")
    scalars = ("DT", "SINCE", "DURATION", "WEIGHT", "LEAST", "PASSED", "AGE", "FILLED", "RELEASED")
    places: dict[str, range | list[int]] = {name: row(getattr(layout, name), n) for name in rows}
    places |= {name: [getattr(layout, name)] for name in scalars}
    places["OLDER"] = range(row(layout.OLDER, n).start, row(layout.REST, n).start)
    end = layout.SCALARS + layout.ROWS * n
    places |= {"STATE": range(end + s, end + 2 * s), "FOLLOWING": range(end + 2 * s, end + 3 * s)}
    places["NUMBERS"] = numbers_of(block, n)
    at = {name: ca.SX.sym(name, len(places[name])) for name in places}
    rig = rig.with_numbers(at["NUMBERS"][own:])
    law = law.with_numbers(at["NUMBERS"][:own])

    motion = at["Q"], at["QD"], at["QDD"]
    asked, following = block.step(
        at["STATE"], *motion, at["REFERENCE"], at["COUNTS"], at["TORQUE"], at["DT"], at["NUMBERS"]
    )
    stop = _slowing(at["SINCE"], at["DURATION"], at["FROM_Q"], at["FROM_QD"])
    held = (
        law.arm.dynamics.gravity(at["ANGLE"], law.arm.f) - rig.spring_torque(at["ANGLE"])
        if knows_arm(law)
        else 0
    )
    gravity = at["WEIGHT"] * held
    follows = at["RELEASED"] == layout.HOLDING  # of a ramp there is no reference
    now = at["ANGLE"], follows * at["QD"], follows * at["QDD"]
    written = {
        "ahead": dict(zip(("Q", "QD", "QDD"), _ahead(*motion, at["DT"]), strict=True)),
        "moving": {"SPEED": rig.position_in_pulses(at["QD"])},
        "counted": {"REFERENCE": rig.counts(at["Q"]), "ANGLE": rig.cell_centre(at["COUNTS"])},
        "measured": {"SPEED": _smoothed(at["SPEED"], at["COUNTS"], at["BEFORE"], at["DT"])},
        "standing": {"FROM_Q": at["ANGLE"], "FROM_QD": rig.to_angle(at["SPEED"])},
        "slowing": dict(zip(("Q", "QD", "QDD"), stop, strict=True)),
        "law": {"WANTED": asked, "GIVEN": rig.drive.limited(asked), "FOLLOWING": following},
        "monitored": _monitored(rig, at),
        "shifted": {
            "OLDER": ca.vertcat(at["NEWEST"], at["OLDER"][:-n]),
            "NEWEST": ca.SX.zeros(n),
            "FILLED": ca.SX(0),
        },
        "ramp": {
            "TORQUE": _ramp(
                rig, gravity, at["FROM_TORQUE"], at["SPEED"], at["SINCE"], at["DURATION"]
            )
        },
        "needed": {
            "NEEDED": (
                _needed(law, rig, motion)
                - _needed(law, rig, (at["WAS_Q"], at["WAS_QD"], at["WAS_QDD"]))
            )
        },
        "bounds": {"BEYOND": _bounds(rig, at)},
        "planned": {"PLANNED": rig.position_in_pulses(at["QD"])},
        "limited": {"LIMITED": _at_the_limit(at["TORQUE"], rig)},
        "left_out": {"LEFT_OUT": model_part(law, rig, without, now)},
    }
    pieces = {}
    for name, results in written.items():
        outputs = ca.cse([ca.densify(result) for result in results.values()])
        needed = [symbol for symbol in places if ca.depends_on(ca.vertcat(*outputs), at[symbol])]
        function = ca.Function(name, [at[symbol] for symbol in needed], outputs)
        pieces[name] = (
            function,
            [places[symbol] for symbol in needed],
            [places[result] for result in results],
        )
    return pieces


def _needed(law, rig, motion):
    """Torque of a motion by the law's model, less that of springs; zeros without one."""
    q, qd, qdd = motion
    if not knows_arm(law):
        return ca.SX.zeros(rig.n)
    model = law.arm.dynamics
    f = law.arm.f
    return model.D(q, f) @ qdd + model.h(q, qd, f) - rig.spring_torque(q)


def _bounds(rig, at):
    """1 beyond a limit of position, 2 of speed, else 0."""
    outside = ca.logic_or(at["ANGLE"] < at["LOWER"], at["ANGLE"] > at["UPPER"])
    return ca.if_else(
        outside, 1, ca.if_else(ca.fabs(rig.to_angle(at["SPEED"])) > at["FASTEST"], 2, 0)
    )


def _ahead(q, qd, qdd, dt):
    """A motion extrapolated with its acceleration over a time dt."""
    return q + dt * qd + dt * dt / 2 * qdd, qd + dt * qdd, qdd


def _smoothed(speed, counts, before, dt):
    """Speed (n, 1) [pulses/s] after a change of counts within dt."""
    return speed + SMOOTHING * ((counts - before) / dt - speed)


def _slowing(since, duration, q, qd):
    """Reference of a stop [SI]: from a speed to rest, accelerations zero at both ends."""
    at = ca.SX.sym("since")
    within = ca.SX.sym("duration")
    s = at / within
    travelled = within * (s - s**3 + s**4 / 2)  # from unit speed: half of the duration in the end
    speed = ca.jacobian(travelled, at)
    made = ca.Function("slowing", [at, within], [travelled, speed, ca.jacobian(speed, at)])
    travelled, speed, acceleration = made(ca.fmin(since, duration), duration)
    return q + travelled * qd, speed * qd, acceleration * qd


def _ramp(rig, gravity, begun, speed, since, duration):
    """Torque (n, 1) [N m] that ends, limited, at gravity compensation (or zero) and damping.

    It begins at `begun` [N m]; `speed` is the measured one [pulses/s]. Under the damping the motors
    alone stop with a time constant of a quarter of the duration.
    """
    drive = rig.drive
    shaft = rig.drive.coupling.shaft(rig.to_angle(speed))
    damping = drive.coupling.joint_torque(drive.reflected_inertia() * shaft / (duration / 4))
    return begun + ca.fmin(1, since / (RAMP * duration)) * (
        drive.limited(gravity - damping) - begun
    )


def _at_the_limit(torque, rig):
    """Which way, 1 or -1, an applied joint torque (n, 1) [N m] at the limit pushes the counts,
    (n, 1); else 0.
    """
    shaft = rig.drive.coupling.shaft_torque(torque)
    direction = ca.sign(shaft) * ca.sign(rig.encoder.position_in_pulses(rig.drive.gear))
    return (ca.fabs(shaft) >= (1 - _ROUNDING) * rig.drive.torque_limit()) * direction


def _monitored(rig, at):
    """What follows of saturation and chatter, and the cause of a stop per joint."""
    drive = rig.drive
    passed = at["PASSED"]
    beyond = ca.fabs(drive.coupling.shaft_torque(at["WANTED"])) >= drive.torque_limit()
    run = ca.if_else(beyond, at["RUN"] + passed, 0)  # without a break
    newest = at["NEWEST"] + ca.if_else(beyond, ca.if_else(run >= at["LEAST"], passed, 0), 0)
    time = newest + ca.sum2(ca.reshape(at["OLDER"], rig.n, SLOTS - 1))
    mean, distance = _swing(at["MEAN"], at["SWING"], at["GIVEN"], drive, at["AGE"], passed)
    over = ca.if_else(distance >= at["CHATTER"], layout.CHATTERS, 0)
    over = ca.if_else(time >= at["SATURATION"], layout.IS_SATURATED, over)
    return {
        "RUN": run,
        "AT_LIMIT": time,
        "NEWEST": newest,
        "FILLED": at["FILLED"] + passed,
        "MEAN": mean,
        "SWING": distance,
        "AGE": at["AGE"] + passed,
        "OVER": over,
    }


def _swing(
    mean: ca.SX, swing: ca.SX, torque: ca.SX, drive: Drive, age: ca.SX, passed: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Running mean of the limited torque and mean swing about it on the shafts, (n, 1) [N m];
    the first is the mean.
    """
    mean = mean + passed / (passed + ca.fmin(age, MEMORY)) * (torque - mean)
    distance = ca.fabs(drive.coupling.shaft_torque(torque - mean))
    return mean, swing + passed / (passed + AVERAGED) * (distance - swing)
