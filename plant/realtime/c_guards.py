"""Guards of the torque for the exported C, and the stop that they end in: the running controller's own equations."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from string import Template
from typing import Any

import casadi as ca
import numpy as np

from plant.compiler.c_statements import literal, statements
from plant.compiler.instructions import STATE, UNIFORM
from plant.machine.rig import Rig
from plant.realtime.braking import ramp, smoothed
from plant.realtime.c_numbers import constant, declared, each, identifier
from plant.realtime.compiled_step import compensates_gravity
from plant.realtime.guards import Guards
from plant.realtime.torque_monitor import SLOT, SLOTS, at_limit, cause, swing, throughout

IS_SATURATED, CHATTERS = 2, 3
"""What a step in C gives from such a stop on; 1 is a law without a finite torque."""

_WATCH = Template("""\
/* Saturation and chatter of the commanded torque. */
static void watch(${name}_state *self, const int32_t pulses[$n], const double qd_r[$n], const double asked[$n])
""")

_SHIFT = Template("""\
    if (self->guard[$filled] >= $full) { /* a slot of the window is full */
$moves    }
""")

_STOP = Template("""\
/* The torque of a stop, without the law. */
static void stop(${name}_state *self, const int32_t pulses[$n])
""")

_CALL = """\
    if (sound || self->guard[0] > 0.0) {
        sound = 1;
        watch(self, pulses, qd_r, asked);
    }
    if (self->guard[0] > 0.0)
        stop(self, pulses);
"""


class TorqueGuards:
    """Saturation and chatter of one controller: its state in C, its numbers, and two functions around the law.

    Parameters
    ----------
    law : Law
        With a period: how much time a call stands for is not known of others.
    rig : Rig
    block : Block
        Of that law for that rig.
    guards : Guards
    """

    def __init__(self, law: Any, rig: Rig, block: Any, guards: Guards) -> None:
        n = rig.n
        self.law, self.rig, self.block, self.guards = law, rig, block, guards
        self.gravity = compensates_gravity(law, guards)
        self.sizes = {"cause": 1, "since": 1, "age": 1, "filled": 1, "mean": n, "swing": n, "speed": n, "before": n,
                      "begun": n, "newest": n, "older": n * (SLOTS - 1)}  # fmt: skip

    @classmethod
    def of(cls, law: Any, rig: Rig, block: Any, guards: Guards | None) -> TorqueGuards | None:
        """Those of a sampled law, unless both are off."""
        if guards is None or block.period is None or np.isinf(guards.torque_limits(rig)).all():
            return None
        return cls(law, rig, block, guards)

    # -- texts --------------------------------------------------------------------------------------------------------
    @property
    def size(self) -> int:
        """Numbers of state, all zero at the start; the first is what the step gives."""
        return sum(self.sizes.values())

    @property
    def field(self) -> str:
        """Of the struct."""
        return f"    double guard[{self.size}]; /* of the guards; the first is what a step gives */\n"

    def constants(self) -> list[str]:
        """Declarations of the numbers."""
        saturation, chatter = self.guards.torque_limits(self.rig)
        return [
            constant("saturation", saturation, "Time at the limit within the last 100 ms that stops [s]."),
            constant("chatter", chatter, "Mean distance of the torque from its mean that stops, joint side [N m]."),
            constant("stop_duration", self.guards.duration, "The torque ramps to its end within a tenth of this [s]."),
        ]

    def said(self) -> str:
        """The stop in words."""
        end = "gravity compensation" if self.gravity else "zero"
        return (
            f"It gives {IS_SATURATED} from the sample on at which a joint's torque has been at its limit for too long "
            f"(saturation), and {CHATTERS} where it swings too far about its mean (chatter). The law then acts no more "
            f"until the controller starts anew: the torque goes from its mean to {end} within a tenth of "
            f"stop_duration, and damps what still moves."
        )

    def functions(self, name: str, converted: Callable[[ca.SX, Rig, ca.SX], ca.SX] | None) -> tuple[str, set[str]]:
        """The two functions, and which of the numbers they use.

        Parameters
        ----------
        name : str
            Of the controller.
        converted : callable or None
            (counts per ampere, rig, joint torque) -> counts of the converter, where it has one.
        """
        n, law_numbers = self.rig.n, len(self.law.number_values())
        sizes = {"guard": self.size, "pulses": n, "qd": n, "asked": n, "numbers": len(self.block.names), "dt": 1,
                 "saturation": n, "chatter": n, "duration": 1, "scale": n}  # fmt: skip
        symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
        guard, pulses, qd, asked, numbers, dt, saturation, chatter, duration, scale = symbols
        rig, law = self.rig.with_numbers(numbers[law_numbers:]), self.law.with_numbers(numbers[:law_numbers])
        inputs = [
            [(f"self->guard[{i}]", STATE) for i in range(self.size)],
            [(f"(double)pulses[{i}]", STATE) for i in range(n)],
            *([(f"{x}[{i}]", STATE) for i in range(n)] for x in ("qd_r", "asked")),
            [(identifier(number), UNIFORM) for number in self.block.names],
            [("period", UNIFORM)],
            *([(f"{x}[{i}]", UNIFORM) for i in range(n)] for x in ("saturation", "chatter")),
            [("stop_duration", UNIFORM)],
            [(f"counts_per_ampere[{i}]", UNIFORM) for i in range(n)],
        ]
        watching = {"guard": self._watched(rig, guard, asked, pulses, qd, dt, (saturation, chatter))}
        stopping = {"torque": self._stopped(law, rig, guard, pulses, duration)}
        if converted is not None:
            stopping["counts"] = converted(scale, rig, stopping["torque"])
        text, used = [], set()
        for heading, results in ((_WATCH, watching), (_STOP, stopping)):
            function = ca.Function("guard", symbols, ca.cse([ca.densify(result) for result in results.values()]))
            lines, values, those = statements(function, inputs)
            read = any("pulses[" in expression for expression in those)
            body, following = [*([] if read else ["(void)pulses;"]), *lines[UNIFORM], *lines[STATE]], iter(values)
            for quantity, result in results.items():
                kind = "int32_t" if quantity == "counts" else "double"
                body.append(declared(f"{quantity}_now", kind, [next(following) for _ in range(result.numel())]))
            stored = "".join(each(result.numel(), f"self->{x}[i] = {x}_now[i];") for x, result in results.items())
            inner = textwrap.indent("\n".join(body), "    ")
            shift = self._shift() if heading is _WATCH else ""
            text.append(f"{heading.substitute(name=name, n=n)}{{\n{inner}\n{stored}{shift}}}\n")
            used |= those
        return "/* -- the guards -- */\n" + "\n".join(text) + "\n", used

    def _shift(self) -> str:
        starts = dict(zip(self.sizes, np.cumsum([0, *self.sizes.values()]), strict=False))
        older = range(self.size - 1, starts["older"] - 1, -1)
        moves = [f"self->guard[{i}] = self->guard[{i - self.rig.n}];" for i in older]
        moves += [f"self->guard[{i}] = 0.0;" for i in (*range(starts["newest"], starts["older"]), starts["filled"])]
        text = textwrap.indent("\n".join(moves), "        ")
        return _SHIFT.substitute(filled=starts["filled"], full=literal(SLOT), moves=f"{text}\n")

    step = _CALL
    result = "sound ? (int)self->guard[0] : 1"

    # -- equations ----------------------------------------------------------------------------------------------------
    def _watched(
        self, rig: Rig, state: ca.SX, asked: ca.SX, pulses: ca.SX, qd: ca.SX, dt: ca.SX, limits: Sequence[ca.SX]
    ) -> ca.SX:
        """State that follows, but the older slots; after a stop what `_stopped` needs of it does not depend on the law.

        Parameters
        ----------
        rig : Rig
        state : casadi SX
        asked : casadi SX (n, 1)
            Commanded torque, before the limit [N m].
        pulses : casadi SX (n, 1)
        qd : casadi SX (n, 1)
            Speed of the reference [rad/s]: that of the arm at the start.
        dt : casadi SX
            Sampling period [s].
        limits : pair of casadi SX (n, 1)
            Of saturation and chatter.
        """
        at, n = self._parts(state), rig.n
        _, counted = throughout(ca.SX.zeros(n), asked, rig.drive, dt, 0.0)
        time, newest = at_limit(ca.reshape(ca.vertcat(at["newest"], at["older"]), n, SLOTS), counted)
        mean, distance, age = swing(at["mean"], at["swing"], rig.drive.limited(asked), rig.drive, at["age"], dt)
        speed = smoothed(at["speed"], pulses, at["before"], dt)
        stopped, now = at["cause"] > 0, at["cause"]
        for code in ca.vertsplit(cause(time, distance, limits, (IS_SATURATED, CHATTERS))):
            now = ca.if_else(now > 0, now, code)
        following = {
            "cause": now, "since": ca.if_else(stopped, at["since"] + dt, 0), "age": age,
            "filled": at["filled"] + dt, "newest": newest,
            "mean": mean, "swing": distance, "begun": ca.if_else(stopped, at["begun"], mean), "before": pulses,
            "speed": ca.if_else(at["age"] > 0, speed, rig.position_in_pulses(qd)),
        }  # fmt: skip
        return ca.vertcat(*(following[name] for name in self.sizes if name in following))

    def _stopped(self, law: Any, rig: Rig, state: ca.SX, pulses: ca.SX, duration: ca.SX) -> ca.SX:
        """Joint torque (n, 1) [N m] once `_watched` has stopped the law, from the state that followed."""
        at, gravity = self._parts(state), ca.SX.zeros(rig.n)
        if self.gravity:
            q = rig.cell_centre(pulses)
            gravity = law.arm.dynamics.gravity(q, law.arm.f) - rig.spring_torque(q)
        return ramp(rig, gravity, at["begun"], at["speed"], at["since"], duration)

    def _parts(self, state: ca.SX) -> dict[str, ca.SX]:
        return dict(zip(self.sizes, ca.vertsplit(state, [0, *np.cumsum([*self.sizes.values()])]), strict=True))
