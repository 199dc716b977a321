"""What the vectors of a closed loop hold: its state, what is known beforehand, its numbers; and
where a loop starts.
"""

import dataclasses
import itertools
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np

from plant.laws.law import Block, Law
from plant.machine.rig import DRY_FRICTION, Rig, punctual_rig, smooth_rig
from plant.mechanics.dynamics import Dynamics
from plant.parts.arguments import whole
from plant.parts.fields import Floats, Vector
from plant.parts.part import Part, number, part

# rounds in which a link finds where it hangs in its spring; each gains a factor of stiffness over
# weight
_SETTLED = 20


@part
class Correction(Part):
    """Observer gains that correct a simulated loop by the log that it repeats: one-step prediction,
    per motor.

    At every sample the innovation, counted minus simulated position, is fed back into the simulated
    position and speed, as in an alpha-beta filter or a steady-state Kalman filter. Without
    correction the simulation runs in open loop, and model errors (the rounding between two samples,
    above all) accumulate over the log.

    Gains of the position (alpha), 0 to 1, and of the speed, per sample period (beta); `zero`: joint
    positions where the counters read zero [rad].
    """

    position: Vector = number(("n",))
    speed: Vector = number(("n",))
    zero: Vector = number(("n",))

    @classmethod
    def with_memory(cls, n: int, samples: float) -> Self:
        """The gains of n motors that give two equal observer poles with a time constant of so
        many samples.
        """
        pole = np.exp(-1 / samples)
        return cls(position=(1 - pole**2,) * n, speed=((1 - pole) ** 2,) * n, zero=(0.0,) * n)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Layout:
    """The vectors of a `plant.simulation.closed_loop.ClosedLoop`, which says what its parameters
    are.
    """

    dynamics: Dynamics
    rig: Rig
    law: Law
    steps_per_sample: int
    sweeps: int = 3
    smooth: bool = False
    score: ca.Function | None = None
    correction: Correction | None = None
    injected: bool = False

    def __post_init__(self) -> None:
        for name in ("steps_per_sample", "sweeps"):
            whole(name, getattr(self, name), "The defaults are 4 and 3.")
        self.rig.require_fit(self.dynamics.chain)
        if self.smooth:
            object.__setattr__(self, "rig", punctual_rig(smooth_rig(self.rig)))
        if self.law.replays and self.rig.jitter is not None:  # a repeated log reads no counts
            object.__setattr__(self, "rig", dataclasses.replace(self.rig, jitter=None))
        self.steps_per_law  # noqa: B018 - refuses a period that does not fit
        if self.rig.transport is not None and not self.rig.transport.delay <= (
            self._block.period or -1
        ):
            raise ValueError(
                "a rig with a transport needs a law whose period is at least its delay"
                f" {self.rig.transport.delay:g} s; got {self._block.period} s. Use a sampled law,"
                " or a shorter delay."
            )
        if self.rig.jitter is not None and not self.steps_per_law:
            raise ValueError(
                "a rig with jitter needs a law with a period; got none. Use a sampled law."
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.dynamics.n

    @property
    def h(self) -> float:
        """Length of a sub-step [s]."""
        return self.rig.period / self.steps_per_sample

    @cached_property
    def steps_per_law(self) -> int:
        """Sub-steps per step of the law; 0 for a law that is evaluated in every sub-step."""
        if self._block.period is None:
            return 0
        steps = round(self._block.period / self.h)
        if steps < 1 or abs(steps * self.h - self._block.period) > 1e-9 * self._block.period:
            raise ValueError(
                f"the law's period must be a whole multiple of the sub-step {self.h:.6g} s; got "
                f"{self._block.period:.6g} s. Change steps_per_sample or the period."
            )
        return steps

    @cached_property
    def follows_motion(self) -> bool:
        """Whether the law reads q, qd or qdd of its setpoint, beside the commanded counts."""
        step = self._block.step
        symbols = [ca.SX.sym(step.name_in(i), step.size1_in(i)) for i in range(step.n_in())]
        return bool(ca.depends_on(ca.vertcat(*step(*symbols)), ca.vertcat(*symbols[1:4])))

    @cached_property
    def _block(self) -> Block:
        return self.law.block(self.rig)

    @cached_property
    def _places(self) -> dict[str, range]:
        """Where each quantity is in the state: of arm, law, transport, drive and score; ``ok``
        is 1 or 0.
        """
        sizes = dict.fromkeys(("q", "qd", "impulse", "torque"), self.n) | {
            "law": len(self._block.initial)
        }
        passing = 0 if self.rig.transport is None else self.n
        sizes |= {"before": passing, "seen": passing, **dict.fromkeys(self.giving, self.n)}
        sizes |= {
            "memory": 0 if self.score is None else int(self.score.nnz_in(2)),
            "score": 1,
            "ok": 1,
        }
        ends = itertools.accumulate(sizes.values())
        return {name: range(end - sizes[name], end) for name, end in zip(sizes, ends, strict=True)}

    @property
    def state_names(self) -> list[str]:
        """Names of the state, such as ``q[0]``.

        With elastic gears ``q`` and ``qd`` are the motors', as joints on rigid gears would have
        them, and the joints' own are ``link`` and ``link_speed``; ``driven`` is the torque of
        currents that lag, ``bristle`` the deflection of presliding friction, ``drifted`` how far
        the drift of friction has come.
        """
        several = {
            name: places for name, places in self._places.items() if name not in ("score", "ok")
        }
        return [
            *(f"{name}[{i}]" for name, places in several.items() for i in range(len(places))),
            "score",
            "ok",
        ]

    @property
    def time_names(self) -> list[str]:
        """Inputs that are known beforehand: the reference, a replayed log, the length of the coming
        sub-step.

        With an injected torque also that, with a transport the place of the sub-step after the
        law's, and which loops lose their counts, with jitter the draw of the law's instant.
        """
        columns = ["q_r", "qd_r", "qdd_r", "pulses_r", *(["logged"] if self.law.replays else [])]
        columns += ["injected"] if self.injected else []
        passing = [] if self.rig.transport is None else ["place", "lost"]
        drawn = [] if self.rig.jitter is None else ["draw"]
        return [*(f"{name}[{i}]" for name in columns for i in range(self.n)), *passing, *drawn, "h"]

    @property
    def n_log(self) -> int:
        """Numbers in the log of a sample."""
        return (5 if "link" in self.giving else 4) * self.n

    @property
    def n_data(self) -> int:
        """Measured numbers per sample that the score or the correction needs."""
        if self.correction is not None:
            return self.n + 1
        return 0 if self.score is None else int(self.score.nnz_in(1))

    @cached_property
    def giving(self) -> tuple[str, ...]:
        """Names of the states, n each, that the parts of the drive add."""
        drive = self.rig.drive
        added = {
            "link": drive.elasticity,
            "link_speed": drive.elasticity,
            "driven": drive.current_lag,
        }
        added |= {"bristle": drive.presliding, "drifted": drive.friction_drift}
        return tuple(name for name, given in added.items() if given is not None)

    @property
    def number_names(self) -> list[str]:
        """f, then the law's numbers, then the rig's, then the correction's."""
        more = [] if self.correction is None else self.correction.number_names("correction.")
        return [*self.dynamics.names, *self._block.names, *more]

    def number_values(self, f: Floats) -> Floats:
        """Values (k,) of `number_names` with these f (p,)."""
        more = np.empty(0) if self.correction is None else self.correction.number_values()
        return np.concatenate([f, self._block.values, more])

    def sliding_values(self, f: Floats) -> Floats:
        """The same without dry friction, as for joints that slide one way."""
        return np.where(
            [name.startswith(DRY_FRICTION) for name in self.number_names],
            0.0,
            self.number_values(f),
        )

    def initial_state(self, q: Floats, qd: Floats, numbers: Floats | None = None) -> Floats:
        """State (s,) of an arm at q, qd (n,) with no torque applied yet.

        With its numbers (k,), links hang in elastic gears; with those of many arms (k, P), their
        states (s, P).
        """
        q = np.asarray(q, float)
        qd = np.asarray(qd, float)
        many = () if numbers is None else numbers.shape[1:]
        rows = {name: np.zeros(len(places)) for name, places in self._places.items()}
        rows |= {"q": q, "qd": qd, "law": self._block.initial, "ok": np.ones(1)}
        if "link" in self.giving:
            hanging = (
                q if numbers is None else self._settled(q, numbers).full().reshape((self.n, *many))
            )
            rows |= {"link": hanging, "link_speed": qd}
        rows = {name: x if x.ndim > len(many) else x[:, None] for name, x in rows.items()}
        return np.concatenate([np.broadcast_to(x, (len(x), *many)) for x in rows.values()])

    @cached_property
    def _settled(self) -> ca.Function:
        """(q, numbers) -> where the link (n,) is at rest; each pass is the weight of where it
        was before.
        """
        link = ca.SX.sym("link", self.n)
        q = ca.SX.sym("q", self.n)
        numbers = self._symbols[2]
        *_, f, _, rig = self._parts
        coupling = rig.drive.coupling
        elasticity = rig.drive.elasticity
        torque = coupling.shaft_torque(self.dynamics.gravity(link, f) - rig.spring_torque(link))
        play = 0.0 if elasticity.backlash is None else ca.sign(torque) * elasticity.backlash / 2
        hanging = coupling.joint(coupling.shaft(q) - torque / elasticity.stiffness - play)
        settle = ca.Function("settle", [link, q, numbers], [hanging])
        held = ca.MX.sym("q", self.n)
        given = ca.MX.sym("numbers", numbers.numel())
        rest = held
        for _ in range(_SETTLED):
            rest = settle(rest, held, given)
        return ca.Function("settled", [held, given], [rest])

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        state = ca.SX.sym("state", len(self.state_names))
        time = ca.SX.sym("time", len(self.time_names))
        return state, time, ca.SX.sym("numbers", len(self.number_names))

    @cached_property
    def _parts(self) -> tuple[Any, ...]:
        """The symbols, in their groups."""
        state, time, numbers = self._symbols
        n = self.n
        p = self.dynamics.p
        q, qd, impulse, torque = (state[i * n : (i + 1) * n] for i in range(4))
        motion = [time[i * n : (i + 1) * n] for i in range(4)]
        block = numbers[p : p + len(self._block.names)]
        rig = self.rig.with_numbers(block[len(self._block.names) - len(self.rig.number_values()) :])
        given = [block, time[4 * n : 5 * n]] if self.law.replays else [block]
        return (
            q,
            qd,
            impulse,
            torque,
            state[4 * n : -2],
            state[-2:],
            motion,
            time[-1],
            numbers[:p],
            given,
            rig,
        )

    def _given(self, name: str) -> ca.SX:
        """Symbols (n, 1) of one of the states that the parts of the drive add."""
        places = self._places[name]
        return self._symbols[0][places.start : places.stop]

    def _known(self, name: str) -> ca.SX:
        """Symbol of one of the inputs that are known beforehand."""
        return self._symbols[1][self.time_names.index(name)]

    def _with_given(self, carried: ca.SX, **following: ca.SX) -> ca.SX:
        """What follows of the carried states, with these of `giving` in it."""
        first = self._places["law"].start
        rows = [(name, places) for name, places in self._places.items() if places.start >= first][
            :-2
        ]
        return ca.vertcat(
            *(
                following.get(name, carried[at.start - first : at.stop - first, 0])
                for name, at in rows
            )
        )
