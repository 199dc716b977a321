"""The closed loop: arm, drives, encoders and law joined into symbolic steps.

Everything that simulates, verifies or differentiates the loop is generated from the functions made here. Time runs in
*sub-steps* of length h; every `steps_per_sample` of them the log takes a *sample*. Order at one instant: the law (if
it has a period and is due), then the log, then the sub-step.

The sub-step is a midpoint (leapfrog) step: everything is evaluated at q + h/2 qd. It adds no numerical damping, which
matters: the P loop has a mode with a damping ratio near 0.005. The Coriolis torque is taken at the mid-step velocity,
by one predictor pass, so that energy is conserved to order h^2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.laws.law import Block, Law
from plant.machine.drive import lagging
from plant.machine.friction import friction_impulse, smooth_impulse
from plant.machine.rig import Rig
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.symmetric_inverse import Inverse
from plant.simulation.correction import Correction
from plant.simulation.sub_step import elastic, rigid

__all__ = ["ClosedLoop", "bounded"]

FAR = 1e6
"""Norm of all positions [rad] and velocities [rad/s] above which the loop has diverged."""

_SETTLED = 20
"""Rounds in which a link finds where it hangs in its spring; each gains a factor of stiffness over weight."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClosedLoop:
    """Symbolic closed loop of an arm with a rig under a law.

    Parameters
    ----------
    dynamics : Dynamics
    rig : Rig
    law : Law
    steps_per_sample : int
        Sub-steps per sample of the log.
    sweeps : int
        Gauss-Seidel sweeps of the friction law per sub-step.
    smooth : bool
        Encoder as identity and friction regularised, for derivatives.
    score : casadi Function, optional
        (log, or its beginning, data, memory) -> number, memory; the number is summed over the samples in the state
        ``score``. `data` is measured, one row per sample; `memory` is state of the score, zero at the start.
    correction : Correction, optional
        Observer gains with which the counted positions (n,) [pulses] correct the simulated ones at every sample;
        `data` then holds these counts, and behind them a weight (1 or 0).

    Attributes
    ----------
    law_step, sample, substep : casadi Function
        Inputs (state, time, numbers), for `sample` also (data); `time` is a row of `time_names`. Outputs (following),
        (following, log), (following, log).
    state_names, time_names, number_names : list of str
    """

    dynamics: Dynamics
    rig: Rig
    law: Law
    steps_per_sample: int
    sweeps: int = 3
    smooth: bool = False
    score: ca.Function | None = None
    correction: Correction | None = None

    def __post_init__(self) -> None:
        for name in ("steps_per_sample", "sweeps"):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(
                    f"{name} must be a whole number of at least 1; got {value!r}. The defaults are 4 and 3."
                )
        self.rig.require_fit(self.dynamics.chain)
        if self.smooth:
            encoder = dataclasses.replace(self.rig.encoder, smooth=True)
            object.__setattr__(self, "rig", dataclasses.replace(self.rig, encoder=encoder, transport=None))
        self.steps_per_law  # noqa: B018 - refuses a period that does not fit
        if self.rig.transport is not None and not self.rig.transport.delay <= (self._block.period or -1):
            raise ValueError(
                f"a rig with a transport needs a law whose period is at least its delay {self.rig.transport.delay:g} "
                f"s; got {self._block.period} s. Use a sampled law, or a shorter delay."
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
    def _block(self) -> Block:
        return self.law.block(self.rig)

    # -- layout of the vectors ---------------------------------------------------------------------------------
    @property
    def state_names(self) -> list[str]:
        """Joint state, friction impulse, torque, states of law, transport and score, the score, and ok (1 or 0).

        With elastic gears ``q`` and ``qd`` are the motors', as joints on rigid gears would have them, and the joints'
        own are ``link`` and ``link_speed``; ``driven`` is the torque of currents that lag.
        """
        per_joint = [f"{name}[{i}]" for name in ("q", "qd", "impulse", "torque") for i in range(self.n)]
        carried = [
            *(f"law[{i}]" for i in range(len(self._block.initial))),
            *(f"{name}[{i}]" for name in ("before", "seen") for i in range(self.n_passing // 2)),
            *(f"{name}[{i}]" for name in self.giving for i in range(self.n)),
            *(f"memory[{i}]" for i in range(self.n_memory)),
        ]
        return [*per_joint, *carried, "score", "ok"]

    @property
    def time_names(self) -> list[str]:
        """Inputs that are known beforehand: the reference, a replayed log, the length of the coming sub-step.

        With a transport also the place of the sub-step after the law's, and which loops lose their counts.
        """
        columns = ("q_r", "qd_r", "qdd_r", "pulses_r", *(["logged"] if self.law.replays else []))
        passing = [] if self.rig.transport is None else ["place", "lost"]
        return [*(f"{name}[{i}]" for name in columns for i in range(self.n)), *passing, "h"]

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

    @property
    def n_passing(self) -> int:
        """State of the transport: the torque before, and the counts that the law read."""
        return 0 if self.rig.transport is None else 2 * self.n

    @cached_property
    def giving(self) -> tuple[str, ...]:
        """Names of the states, n each, that elastic gears and lagging currents add."""
        drive = self.rig.drive
        springs = () if drive.elasticity is None else ("link", "link_speed")
        return springs if drive.current_lag is None else (*springs, "driven")

    @property
    def n_memory(self) -> int:
        """State of the score."""
        return 0 if self.score is None else int(self.score.nnz_in(2))

    @property
    def number_names(self) -> list[str]:
        """f, then the law's numbers, then the rig's, then the correction's."""
        more = [] if self.correction is None else self.correction.number_names("correction.")
        return [*self.dynamics.names, *self._block.names, *more]

    def number_values(self, f: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (k,) of `number_names` with these f (p,)."""
        more = np.empty(0) if self.correction is None else self.correction.number_values()
        return np.concatenate([f, self._block.values, more])

    def initial_state(
        self, q: NDArray[np.float64], qd: NDArray[np.float64], numbers: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """State (s,) of an arm at q, qd (n,) with no torque applied yet.

        With its numbers (k,), links hang in elastic gears; with those of many arms (k, P), their states (s, P).
        """
        q, qd, many = np.asarray(q, float), np.asarray(qd, float), () if numbers is None else numbers.shape[1:]
        giving = [q if numbers is None else self._hanging(q, numbers), qd] if "link" in self.giving else []
        lagging = np.zeros(self.n) if "driven" in self.giving else np.empty(0)
        more = [np.zeros(self.n_passing), *giving, lagging, np.zeros(self.n_memory)]
        rows = [q, qd, np.zeros(2 * self.n), self._block.initial, *more, np.array([0.0, 1.0])]
        return np.concatenate([np.broadcast_to(x if x.ndim > len(many) else x[:, None], (len(x), *many)) for x in rows])

    def _hanging(self, q: NDArray[np.float64], numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where links (n,), or (n, P), are at rest in the gears of motors held at q (n,), with these numbers."""
        link = np.broadcast_to(np.reshape(q, (-1, *[1] * (numbers.ndim - 1))), (self.n, *numbers.shape[1:]))
        for _ in range(_SETTLED):
            link = self._settle(link, q, numbers).full().reshape(link.shape)
        return link

    @cached_property
    def _settle(self) -> ca.Function:
        """(link, q, numbers) -> where the link (n,) would be if its weight stayed that of the given one."""
        link, q, numbers = ca.SX.sym("link", self.n), ca.SX.sym("q", self.n), self._symbols[2]
        *_, f, _, rig = self._parts
        coupling, elasticity = rig.drive.coupling, rig.drive.elasticity
        torque = coupling.shaft_torque(self.dynamics.gravity(link, f))
        play = 0.0 if elasticity.backlash is None else ca.sign(torque) * elasticity.backlash / 2
        hanging = coupling.joint(coupling.shaft(q) - torque / elasticity.stiffness - play)
        return ca.Function("settle", [link, q, numbers], [hanging])

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        state = ca.SX.sym("state", len(self.state_names))
        time = ca.SX.sym("time", len(self.time_names))
        return state, time, ca.SX.sym("numbers", len(self.number_names))

    @cached_property
    def _parts(self) -> tuple[Any, ...]:
        """The symbols, in their groups."""
        state, time, numbers = self._symbols
        n, p = self.n, self.dynamics.p
        q, qd, impulse, torque = (state[i * n : (i + 1) * n] for i in range(4))
        motion = [time[i * n : (i + 1) * n] for i in range(4)]
        block = numbers[p : p + len(self._block.names)]
        rig = self.rig.with_numbers(block[len(self._block.names) - len(self.rig.number_values()) :])
        given = [block, time[4 * n : 5 * n]] if self.law.replays else [block]
        return q, qd, impulse, torque, state[4 * n : -2], state[-2:], motion, time[-1], numbers[:p], given, rig

    def _given(self, name: str) -> ca.SX:
        """Symbols (n, 1) of one of the states that elastic gears and lagging currents add."""
        start = 4 * self.n + len(self._block.initial) + self.n_passing + self.giving.index(name) * self.n
        return self._symbols[0][start : start + self.n]

    def _with_given(self, carried: ca.SX, **following: ca.SX) -> ca.SX:
        """What follows of the carried states, with these of `giving` in it."""
        start = len(self._block.initial) + self.n_passing
        rows = [carried[start + i * self.n : start + (i + 1) * self.n, 0] for i in range(len(self.giving))]
        rows = [following.get(name, row) for name, row in zip(self.giving, rows, strict=True)]
        return ca.vertcat(carried[:start, 0], *rows, carried[start + len(rows) * self.n :, 0])

    # -- the three steps -----------------------------------------------------------------------------------------
    def _applied(self, q: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The law at q: torque after the amplifier's limit (which hides NaN), state, whether the command is finite."""
        *_, torque, carried, _, motion, _, _, given, rig = self._parts
        own, n, pulses = len(self._block.initial), self.n, rig.true_counts(q)
        rest = carried[own:, 0]
        if rig.transport is not None:
            pulses = rig.transport.arrived(pulses, rest[n : 2 * n, 0], self._symbols[1][-2])
            rest = ca.vertcat(torque, pulses, rest[2 * n :, 0])
        asked, following = self._block.step(carried[:own, 0], *motion, pulses, torque, dt, *given)
        return rig.drive.limited(asked), ca.vertcat(following, rest), ca.sum1(ca.fabs(asked)) < ca.inf

    def _function(
        self, name: str, following: Sequence[Any], log: ca.SX | None = None, data: ca.SX | None = None
    ) -> ca.Function:
        outputs = [ca.densify(ca.vertcat(*following))] + ([] if log is None else [ca.densify(log)])
        inputs = [*self._symbols] + ([] if data is None else [data])
        names = ["state", "time", "numbers", "data"], ["following", "log"]
        outputs = ca.cse(outputs)
        return ca.Function(name, inputs, outputs, names[0][: len(inputs)], names[1][: len(outputs)])

    @cached_property
    def law_step(self) -> ca.Function | None:
        """One step of a law with a period; the torque is held until the next. None for a law without one."""
        if not self.steps_per_law:
            return None
        q, qd, impulse, _, _, status, *_ = self._parts
        torque, carried, finite = self._applied(self._encoded(q), ca.SX(self._block.period))
        return self._function("law_step", [q, qd, impulse, torque, carried, status[0], _if(finite, status[1])])

    @cached_property
    def sample(self) -> ca.Function:
        """The log at a sample: error [pulses], joint torque [N m], true q and qd, each (n,), joined.

        With elastic gears these are the links', and q of the motors comes last.
        With a correction the first is the innovation instead, counted minus predicted position, and the following state
        is corrected. Divergence is detected here; what is not finite stays so.
        """
        q, qd, impulse, torque, carried, status, motion, *_, rig = self._parts
        at_sample, ok, seen = torque, status[1], self._encoded(q)
        if not self.steps_per_law:
            at_sample, _, finite = self._applied(seen, ca.SX(self.h))
            ok = _if(finite, ok)
        ok = _if(bounded(ca.vertsplit(ca.vertcat(q, qd))), ok)
        data = ca.SX.sym("data", self.n_data)
        joint = (self._given("link"), self._given("link_speed"), q) if "link" in self.giving else (q, qd)
        if self.correction is None:
            first = motion[3] - rig.true_counts(seen)
        else:
            gains = self.correction.with_numbers(self._symbols[2][-3 * self.n :])
            first = data[:-1] + rig.position_in_pulses(gains.zero) - rig.position_in_pulses(seen)
            known = data[-1] * first
            shift, change = rig.to_angle(gains.position * known), rig.to_angle(gains.speed * known) / rig.period
            q, qd = q + shift, qd + change
            if "link" in self.giving:  # the gear's deflection stays
                carried = self._with_given(carried, link=joint[0] + shift, link_speed=joint[1] + change)
        log = ca.vertcat(first, at_sample, *joint)
        score = status[0]
        if self.score is not None:
            kept = carried.shape[0] - self.n_memory
            added, memory = self.score(log[: self.score.nnz_in(0)], data, carried[kept:, 0])
            score, carried = score + added, ca.vertcat(carried[:kept, 0], memory)
        return self._function("sample", [q, qd, impulse, torque, carried, score, ok], log, data)

    @cached_property
    def substep(self) -> ca.Function:
        """One midpoint step of length h; its log is the motor's true error [pulses] at the middle of the step."""
        q, qd, impulse, torque, carried, status, motion, h, f, _, rig = self._parts
        middle, drive, giving = q + h / 2 * qd, rig.drive, {}
        if "link" in self.giving:
            link = self._given("link") + h / 2 * self._given("link_speed"), self._given("link_speed")
        if not self.steps_per_law:
            torque, carried, _ = self._applied(link[0] if rig.encoder.side == "link" else middle, h)
        acting, own = torque, len(self._block.initial)
        if rig.transport is not None:
            acting = rig.transport.acting(torque, carried[own : own + self.n, 0], self._symbols[1][-3], h)
        if drive.current_lag is not None:
            acting, giving["driven"] = lagging(acting, self._given("driven"), drive.current_lag, h)
        if "link" in self.giving:
            following, links, impulse, positive = elastic(
                self.dynamics, drive, f, (middle, qd), link, acting, impulse, h, self._friction
            )
            giving |= {"link": link[0] + h / 2 * links, "link_speed": links}
        else:
            following, impulse, positive = rigid(
                self.dynamics, drive, f, middle, qd, acting, impulse, h, self._friction
            )
        if self.giving:
            carried = self._with_given(carried, **giving)
        ok = _if(positive > 0, status[1])
        error = rig.position_in_pulses(motion[0]) - rig.position_in_pulses(middle)
        return self._function(
            "substep", [middle + h / 2 * following, following, impulse, torque, carried, status[0], ok], error
        )

    def _encoded(self, q: ca.SX) -> ca.SX:
        """Position with which the encoders turn."""
        return self._given("link") if self.rig.encoder.side == "link" else q

    def _friction(self, mobility: Inverse, stopping: ca.SX, impulse: ca.SX, bound: ca.SX) -> ca.SX:
        if self.smooth:
            return smooth_impulse(mobility, stopping, bound)
        return friction_impulse(mobility, stopping, impulse, bound, self.sweeps)


def bounded(state: Any) -> Any:
    """Whether q and qd, given row by row as casadi's or numpy's, are finite and have not diverged."""
    return sum(value * value for value in state) < FAR**2


def _if(condition: ca.SX, value: ca.SX) -> ca.SX:
    """The value where the condition holds, 0 elsewhere; a NaN in the condition counts as not."""
    return ca.if_else(condition, value, 0)
