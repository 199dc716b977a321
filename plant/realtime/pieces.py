"""Functions of law and rig that a running controller calls, in casadi.

Each function reads some quantities of the memory (`plant.realtime.memory`) and writes others.

Saturation and chatter are those of the shafts, which have the amplifiers' limits; without coupling
they are the joints. *Saturation* is the time at the limit within a sliding window of `WINDOW`. The
window consists of slots: the oldest is dropped when the newest is full (`SLOT`). So the window is
never shorter than `WINDOW`; it is longer by one slot at most, and by less than a period per slot.
*Chatter* is the mean distance of the torque from its running mean. Quantisation, or a sound loop,
moves the torque by a small share of the limit, even if it does so in every sample; the oscillation
of an unstable loop grows until it reaches the limit, at any frequency
(`tests/benchmarks/guards.py`). A fast path moves the mean instead.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from plant.machine import Frame, Rig
from plant.realtime.calls import PIECES
from plant.realtime.guards import WINDOW, Guards
from plant.realtime.memory import (
    CHATTERS,
    HOLDING,
    IS_SATURATED,
    JOINT_FIELDS,
    LAW_STATES,
    RUN_FIELDS,
    SLOTS,
    Layout,
)

# Smoothing factor of the measured speed: quantisation is much of a change of counts.
SMOOTHING = 0.25

# Share of the duration of a stop in which the torque ramps to its end: short, since it may begin at
# the limit.
RAMP = 0.1

# Time [s] from which on a visit of a law without a period to its limit counts: one pulse may take
# the torque there.
HELD = 0.5e-3

# Relative rounding error of sums of periods, and of a torque at its limit.
ROUNDING = 1e-9

# That of a torque at its limit in single precision.
SINGLE_ROUNDING = 1e-5

# Age at which the newest slot is full [s].
SLOT = (1 - ROUNDING) * WINDOW / (SLOTS - 1)

# Time constant of the running mean [s]: 100 rad/s, above the frequencies of a path.
MEMORY = 0.01

# Time constant over which the swing is averaged [s].
AVERAGED = 0.05

# Names of the reference in the memory.
_MOTION = ("q", "qd", "qdd")


def knows_arm(law: Any) -> bool:
    """Whether a law holds the model of an arm."""
    return getattr(law, "arm", None) is not None


def model_part(law: Any, rig: Rig, without: Sequence[str], motion: tuple[ca.SX, ...]) -> ca.SX:
    """Torque (n, 1) [N m] of these parts of a law's model for a motion (q, qd, qdd).

    ValueError for a part that the model does not have, or that occurs twice.
    """
    parts = law.model_parts(*motion)
    # A string is a sequence of its letters, and needs an advice of its own.
    single = isinstance(without, str)
    try:
        sound = not single and set(without) <= set(parts) and len(set(without)) == len(without)
    except TypeError:
        # It is no sequence, or has an element that is no name.
        sound = False
    if not sound:
        names = ", ".join(parts) or "none, since it has no model of the arm"
        advice = f"Write ({without!r:.60},)." if single else "Give (), or a tuple of such parts."
        rule = f"without must be a sequence of parts of {type(law).__name__} ({names}), each once"
        raise ValueError(f"{rule}; got {without!r:.60}. {advice}")
    return sum((parts[name] for name in without), ca.SX.zeros(rig.n))


class Piece(NamedTuple):
    """A function from quantities of the memory, by their names, to others."""

    function: ca.Function
    sources: list[str]
    targets: list[str]


def pieces_of(
    law: Any, rig: Rig, block: Any, without: Sequence[str] = (), rounding: float = ROUNDING
) -> dict[str, Piece]:
    """The functions of `plant.realtime.calls` by name, for one law and one rig.

    A torque is at its limit, too, where `rounding` (relative) has put it below.
    """
    n = rig.n
    layout = Layout.of(block, n)
    names = (*RUN_FIELDS, *JOINT_FIELDS, *LAW_STATES, "numbers")
    # Symbols take the place of the numbers, so laws and rigs of one structure share a kernel.
    memory = {name: ca.SX.sym(name, len(layout.components(name))) for name in names}
    numbers = memory["numbers"]
    law_numbers = len(law.number_names())
    rig = rig.with_numbers(numbers[law_numbers:])
    law = law.with_numbers(numbers[:law_numbers])

    motion = memory["q"], memory["qd"], memory["qdd"]
    commanded, following = block.step(
        memory["state"],
        *motion,
        memory["reference"],
        memory["counts"],
        memory["torque"],
        memory["dt"],
        numbers,
    )
    # The firmware adds its parts for the measured position and the motion of the reference.
    angle = memory["angle"]
    rest_motion = memory["rest_q"], memory["rest_qd"], memory["rest_qdd"]
    # A ramp has no reference.
    follows = memory["released"] == HOLDING
    arm_motion = angle, follows * memory["qd"], follows * memory["qdd"]
    results = {
        "ahead": dict(zip(_MOTION, _ahead(*motion, memory["dt"]), strict=True)),
        "moving": {"speed": rig.position_in_pulses(memory["qd"])},
        "counted": {
            "reference": rig.counts(memory["q"]),
            "angle": rig.cell_centre(memory["counts"]),
        },
        "measured": {"speed": _smoothed(memory)},
        "standing": {"begin_q": angle, "begin_qd": rig.to_angle(memory["speed"])},
        "slowing": dict(zip(_MOTION, _slowing(memory), strict=True)),
        "law": {
            "commanded": commanded,
            "limited": rig.limited(commanded),
            "following": following,
        },
        "monitored": _monitored(rig, memory),
        # Components of `older` come slot by slot: the newest slot moves in front, and the last
        # drops out.
        "shifted": {
            "older": ca.vertcat(memory["newest"], memory["older"][:-n]),
            "newest": ca.SX.zeros(n),
            "filled": ca.SX(0),
        },
        "ramp": {"torque": _ramp(law, rig, memory)},
        "needed": {"model_change": _needed(law, rig, motion) - _needed(law, rig, rest_motion)},
        "bounds": {"beyond": _bounds(rig, memory)},
        "planned": {"reference_speed": rig.position_in_pulses(memory["qd"])},
        "limited": {"direction": _direction(memory["torque"], rig, rounding)},
        "left_out": {"left_out": model_part(law, rig, without, arm_motion)},
    }
    return {name: _piece(name, results[name], memory) for name in PIECES}


def _piece(name: str, results: dict[str, ca.SX], memory: dict[str, ca.SX]) -> Piece:
    """A piece that reads only the quantities on which its results depend."""
    # Conversions to pulses and sines occur in several results; `cse` computes them once.
    outputs = ca.cse([ca.densify(result) for result in results.values()])
    joined = ca.vertcat(*outputs)
    sources = [symbol for symbol in memory if ca.depends_on(joined, memory[symbol])]
    function = ca.Function(name, [memory[symbol] for symbol in sources], outputs)
    return Piece(function, sources, list(results))


def sent_by(
    law: Any, rig: Rig, block: Any, guards: Guards | None, without: Sequence[str] = ()
) -> Piece:
    """What the inner loop of a rig gets of a call: the rows of `Running.goal` or `.frame`."""
    n = rig.n
    layout = Layout.of(block, n)
    joints = ("q", "qd", "qdd", "counts", "held_counts", "torque", "left_out")
    memory = {
        name: ca.SX.sym(name, len(layout.components(name)))
        for name in ("released", "calls", *joints, "numbers")
    }
    numbers = memory["numbers"]
    law_numbers = len(law.number_names())
    rig = rig.with_numbers(numbers[law_numbers:])
    known = law.with_numbers(numbers[:law_numbers]).rig_of_frames(rig)

    # A stop without the law has no reference, and before the first call there is none yet: the
    # servo holds its place, or goes along with the counts where a stop lets the arm go.
    limp = guards is not None and guards.stop == "zero"
    rest = memory["counts" if limp else "held_counts"]
    free = ca.logic_or(memory["released"] != HOLDING, memory["calls"] == 0)
    q = ca.if_else(free, rig.cell_centre(rest), memory["q"])
    qd, qdd = (ca.if_else(free, 0, memory[name]) for name in ("qd", "qdd"))

    # The same equations as in the simulator convert a torque to goal or frame.
    torque = memory["torque"] - (memory["left_out"] if without else 0)
    sent = block.sent(q, qd, qdd, memory["counts"], torque, numbers)
    frame = Frame(*ca.vertsplit(sent, n))
    return _piece("sent", {known.inner.sends: known.inner.values(rig, frame)}, memory)


def _needed(law, rig, motion):
    """Torque of a motion by the law's model, less that of springs; zeros without a model."""
    q, qd, qdd = motion
    if not knows_arm(law):
        return ca.SX.zeros(rig.n)
    # D qdd + h, from which the springs take their part; friction is left out.
    model = law.arm.dynamics
    f = law.arm.f
    return model.D(q, f) @ qdd + model.h(q, qd, f) - rig.spring_torque(q)


def _bounds(rig, memory):
    """1 beyond a limit of position, 2 of speed, else 0."""
    angle = memory["angle"]
    outside = ca.logic_or(angle < memory["lower"], angle > memory["upper"])
    fast = ca.fabs(rig.to_angle(memory["speed"])) > memory["speed_limit"]
    return ca.if_else(outside, 1, ca.if_else(fast, 2, 0))


def _ahead(q, qd, qdd, dt):
    """A motion extrapolated with its acceleration over a time dt."""
    return q + dt * qd + dt * dt / 2 * qdd, qd + dt * qdd, qdd


def _smoothed(memory):
    """Speed (n, 1) [pulses/s] after this change of counts."""
    speed = memory["speed"]
    change = (memory["counts"] - memory["previous_counts"]) / memory["dt"]
    return speed + SMOOTHING * (change - speed)


def _slowing(memory):
    """Reference of a stop [SI]: from a speed to rest, accelerations zero at both ends."""
    q = memory["begin_q"]
    qd = memory["begin_qd"]
    duration = memory["duration"]

    # The path of unit initial speed; its length is half of the duration.
    time = ca.SX.sym("since")
    total = ca.SX.sym("duration")
    s = time / total
    path = total * (s - s**3 + s**4 / 2)
    speed = ca.jacobian(path, time)
    profile = ca.Function("slowing", [time, total], [path, speed, ca.jacobian(speed, time)])

    path, speed, acceleration = profile(ca.fmin(memory["since"], duration), duration)
    return q + path * qd, speed * qd, acceleration * qd


def _ramp(law, rig, memory):
    """Torque (n, 1) [N m] that ends, limited, at gravity compensation (or zero) and damping.

    It begins at `begin_torque`. The damping acts on the measured speed; under it the motors alone
    stop with a time constant of a quarter of the duration.
    """
    drive = rig.drive
    angle = memory["angle"]
    duration = memory["duration"]
    begin = memory["begin_torque"]
    # The weight less the part that springs bear; a law without a model knows neither.
    gravity = 0
    if knows_arm(law):
        gravity = law.arm.dynamics.gravity(angle, law.arm.f) - rig.spring_torque(angle)
    gravity = memory["weight"] * gravity
    shaft = drive.coupling.shaft(rig.to_angle(memory["speed"]))
    damping = drive.coupling.joint_torque(drive.reflected_inertia() * shaft / (duration / 4))
    end = drive.limited(gravity - damping)
    return begin + ca.fmin(1, memory["since"] / (RAMP * duration)) * (end - begin)


def _direction(torque, rig, rounding):
    """Direction (n, 1), 1 or -1, in which a joint torque at its limit pushes the counts; else 0."""
    # A motor turns its counts down where gear or encoder have a negative sign.
    shaft = rig.drive.coupling.shaft_torque(torque)
    direction = ca.sign(shaft) * ca.sign(rig.encoder.position_in_pulses(rig.drive.gear))
    # Conversions round, so a limited torque may come out just below the limit.
    return (ca.fabs(shaft) >= (1 - rounding) * rig.drive.torque_limit()) * direction


def _monitored(rig, memory):
    """Saturation and chatter after this sample, and the cause of a stop per joint."""
    drive = rig.drive
    passed = memory["passed"]
    limit = drive.torque_limit()

    # Saturation: a short visit to the limit, by one pulse, does not count.
    beyond = ca.fabs(drive.coupling.shaft_torque(memory["commanded"])) >= limit
    run = ca.if_else(beyond, memory["limit_run"] + passed, 0)
    lasting = ca.if_else(run >= memory["shortest_limit"], passed, 0)
    newest = memory["newest"] + ca.if_else(beyond, lasting, 0)
    older = ca.reshape(memory["older"], rig.n, SLOTS - 1)
    window = newest + ca.sum2(older)

    # Chatter: the mean is that of all samples until they last longer than its time constant.
    torque = memory["limited"]
    mean = memory["mean_torque"]
    mean = mean + passed / (passed + ca.fmin(memory["age"], MEMORY)) * (torque - mean)
    distance = ca.fabs(drive.coupling.shaft_torque(torque - mean))
    swing = memory["swing"]
    swing = swing + passed / (passed + AVERAGED) * (distance - swing)

    over = ca.if_else(swing >= memory["chatter"], CHATTERS, 0)
    over = ca.if_else(window >= memory["saturation"], IS_SATURATED, over)
    return {
        "limit_run": run,
        "limit_window": window,
        "newest": newest,
        "filled": memory["filled"] + passed,
        "mean_torque": mean,
        "swing": swing,
        "age": memory["age"] + passed,
        "over": over,
    }
