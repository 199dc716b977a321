"""The closed loop: arm, drives, encoders and law joined into symbolic steps.

Everything that simulates, verifies or differentiates the loop is generated from the functions made here. Time runs in
*sub-steps* of length h; every `steps_per_sample` of them the log takes a *sample*. Order at one instant: the law (if
it has a period and its time has come), then the log, then the sub-step.

The sub-step is a midpoint (leapfrog) step: everything is evaluated at q + h/2 qd. It adds no damping of its own, which
matters: the P loop has a mode with a damping ratio near 0.005. The Coriolis torque is taken at the mid-step velocity,
by one predictor pass, so that energy is kept to order h^2.
"""

from __future__ import annotations

import dataclasses
import functools
from functools import cached_property

import casadi as ca
import numpy as np

from plant.laws.law import Law
from plant.machine.drive import lagging
from plant.machine.friction import friction_impulse, smooth_impulse
from plant.machine.rig import Rig
from plant.machine.spring import spring
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.symmetric_inverse import inverse, row_by_row
from plant.simulation.correction import Correction

__all__ = ["ClosedLoop", "bounded"]

FAR = 1e6
"""Where the positions [rad] and velocities [rad/s] of all joints have a length beyond this, the loop has diverged."""

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
        (log, data, memory) -> number, memory; the number is added up over the samples in the state ``score``. `data` is
        measured, one row a sample; `memory` is state of the score, zero at the start.
    correction : Correction, optional
        How the counted positions (n,) [pulses], then in `data` with a weight (1 or 0) behind them, correct the
        simulated ones at every sample.

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

    def __post_init__(self):
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
    def n(self):
        """Number of joints."""
        return self.dynamics.n

    @property
    def h(self):
        """Length of a sub-step [s]."""
        return self.rig.period / self.steps_per_sample

    @cached_property
    def steps_per_law(self):
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
    def _block(self):
        return self.law.block(self.rig)

    # -- layout of the vectors ---------------------------------------------------------------------------------
    @property
    def state_names(self):
        """Joint state, friction impulse, torque, state of law and so on, the score, and if all is well (1 or 0).

        Where gears give, ``q`` and ``qd`` are the motors', as the joints would have them were the gears rigid, and the
        joints' own are ``link`` and ``link_speed``; ``driven`` is the torque of currents that lag.
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
    def time_names(self):
        """What changes with time and is known beforehand: the reference, a log, the length of the coming sub-step.

        With a transport also the place of the sub-step after the law's, and which loops lose their counts.
        """
        columns = ("q_r", "qd_r", "qdd_r", "pulses_r", *(["logged"] if self.law.replays else []))
        passing = [] if self.rig.transport is None else ["place", "lost"]
        return [*(f"{name}[{i}]" for name in columns for i in range(self.n)), *passing, "h"]

    @property
    def n_data(self):
        """Measured numbers per sample that the score or the correction needs."""
        if self.correction is not None:
            return self.n + 1
        return 0 if self.score is None else self.score.nnz_in(1)

    @property
    def n_passing(self):
        """State of the transport: the torque before, and the counts that the law saw."""
        return 0 if self.rig.transport is None else 2 * self.n

    @cached_property
    def giving(self):
        """Names of the states, n each, that a drive which gives or lags adds."""
        drive = self.rig.drive
        springs = () if drive.elasticity is None else ("link", "link_speed")
        return springs if drive.current_lag is None else (*springs, "driven")

    @property
    def n_memory(self):
        """State of the score."""
        return 0 if self.score is None else self.score.nnz_in(2)

    @property
    def number_names(self):
        """f, then the law's numbers, then the rig's, then the correction's."""
        more = [] if self.correction is None else self.correction.number_names("correction.")
        return [*self.dynamics.names, *self._block.names, *more]

    def number_values(self, f):
        """Values (k,) of `number_names` with these f (p,)."""
        more = np.empty(0) if self.correction is None else self.correction.number_values()
        return np.concatenate([f, self._block.values, more])

    def initial_state(self, q, qd, f=None):
        """State (s,) of an arm at q, qd (n,) with nothing applied yet.

        Gears that give hold the links at rest below that, where f (p,) is known.
        """
        giving = dict.fromkeys(self.giving, np.zeros(self.n))
        if "link" in giving:
            giving |= {"link": q if f is None else self._hanging(q, f), "link_speed": qd}
        more = [np.zeros(self.n_passing), *giving.values(), np.zeros(self.n_memory)]
        return np.concatenate([q, qd, np.zeros(2 * self.n), self._block.initial, *more, [0.0, 1.0]])

    def _hanging(self, q, f):
        """Where links (n,) hang in the springs of motors held at q (n,)."""
        coupling, elasticity, link = self.rig.drive.coupling, self.rig.drive.elasticity, np.array(q, float)
        for _ in range(_SETTLED):
            torque = coupling.shaft_torque(self.dynamics.gravity(link, f).full().ravel())
            half = 0.0 if elasticity.backlash is None else np.sign(torque) * elasticity.backlash / 2
            link = coupling.joint(coupling.shaft(q) - torque / elasticity.stiffness - half)
        return link

    @cached_property
    def _symbols(self):
        state = ca.SX.sym("state", len(self.state_names))
        time = ca.SX.sym("time", len(self.time_names))
        return state, time, ca.SX.sym("numbers", len(self.number_names))

    @cached_property
    def _parts(self):
        """Symbols by what they are."""
        state, time, numbers = self._symbols
        n, p = self.n, self.dynamics.p
        q, qd, impulse, torque = (state[i * n : (i + 1) * n] for i in range(4))
        motion = [time[i * n : (i + 1) * n] for i in range(4)]
        block = numbers[p : p + len(self._block.names)]
        rig = self.rig.with_numbers(block[len(self._block.names) - len(self.rig.number_values()) :])
        given = [block, time[4 * n : 5 * n]] if self.law.replays else [block]
        return q, qd, impulse, torque, state[4 * n : -2], state[-2:], motion, time[-1], numbers[:p], given, rig

    def _given(self, name):
        """Symbols of what a drive that gives adds to the state."""
        start = 4 * self.n + len(self._block.initial) + self.n_passing + self.giving.index(name) * self.n
        return self._symbols[0][start : start + self.n]

    def _joint(self, own, name="link"):
        """The joints' position or speed: the links', where gears give."""
        return self._given(name) if "link" in self.giving else own

    def _read(self, q, link, rig):
        """What the encoders turn with."""
        return link if rig.encoder.side == "link" else q

    # -- the three steps -----------------------------------------------------------------------------------------
    def _asked(self, q, dt):
        """Torque that the law asks for at q, after the amplifier's limit (which swallows NaN), its state, if finite."""
        *_, torque, carried, _, motion, _, _, given, rig = self._parts
        own, n, pulses = len(self._block.initial), self.n, rig.true_counts(q)
        rest = carried[own:, 0]
        if rig.transport is not None:
            pulses = rig.transport.arrived(pulses, rest[n : 2 * n, 0], self._symbols[1][-2])
            rest = ca.vertcat(torque, pulses, rest[2 * n :, 0])
        asked, following = self._block.step(carried[:own, 0], *motion, pulses, torque, dt, *given)
        return rig.drive.limited(asked), ca.vertcat(following, rest), ca.sum1(ca.fabs(asked)) < ca.inf

    def _function(self, name, following, log=None, data=None):
        outputs = [ca.densify(ca.vertcat(*following))] + ([] if log is None else [ca.densify(log)])
        inputs = [*self._symbols] + ([] if data is None else [data])
        names = ["state", "time", "numbers", "data"], ["following", "log"]
        outputs = ca.cse(outputs)
        return ca.Function(name, inputs, outputs, names[0][: len(inputs)], names[1][: len(outputs)])

    @cached_property
    def law_step(self):
        """One step of a law with a period; the torque is held until the next. None for a law without one."""
        if not self.steps_per_law:
            return None
        q, qd, impulse, _, _, status, *_, rig = self._parts
        torque, carried, finite = self._asked(self._read(q, self._joint(q), rig), ca.SX(self._block.period))
        return self._function("law_step", [q, qd, impulse, torque, carried, status[0], _if(finite, status[1])])

    @cached_property
    def sample(self):
        """The log at a sample: error [pulses], joint torque [N m], true q and qd, each (n,), joined.

        With a correction the first is the counted position minus the predicted one instead, and the state that goes on
        is corrected. Here divergence is found: what is not finite stays so.
        """
        q, qd, impulse, torque, carried, status, motion, *_, rig = self._parts
        at_sample, ok = torque, status[1]
        joint, joint_speed = self._joint(q), self._joint(qd, "link_speed")
        seen = self._read(q, joint, rig)
        if not self.steps_per_law:
            at_sample, _, finite = self._asked(seen, ca.SX(self.h))
            ok = _if(finite, ok)
        ok = _if(bounded(ca.vertsplit(ca.vertcat(q, qd))), ok)
        data = ca.SX.sym("data", self.n_data)
        if self.correction is None:
            log = ca.vertcat(motion[3] - rig.true_counts(seen), at_sample, joint, joint_speed)
        else:
            shares = self.correction.with_numbers(self._symbols[2][-3 * self.n :])
            surprise = data[:-1] + rig.position_in_pulses(shares.zero) - rig.position_in_pulses(seen)
            log = ca.vertcat(surprise, at_sample, joint, joint_speed)
            known = data[-1] * surprise
            q, qd = q + rig.to_angle(shares.position * known), qd + rig.to_angle(shares.speed * known) / rig.period
        score = status[0]
        if self.score is not None:
            kept = carried.shape[0] - self.n_memory
            added, memory = self.score(log, data, carried[kept:, 0])
            score, carried = score + added, ca.vertcat(carried[:kept, 0], memory)
        return self._function("sample", [q, qd, impulse, torque, carried, score, ok], log, data)

    @cached_property
    def substep(self):
        """One midpoint step of length h; its log is the joint's true error [pulses] at the middle of the step.

        Where gears give it is the motor's error, as a joint on a rigid gear would have it.
        """
        q, qd, impulse, torque, carried, status, motion, h, f, _, rig = self._parts
        middle, drive = q + h / 2 * qd, rig.drive
        springs = "link" in self.giving
        link_middle = self._given("link") + h / 2 * self._given("link_speed") if springs else middle
        if not self.steps_per_law:
            torque, carried, _ = self._asked(self._read(middle, link_middle, rig), h)
        acting, own = torque, len(self._block.initial)
        if rig.transport is not None:
            acting = rig.transport.acting(torque, carried[own : own + self.n, 0], self._symbols[1][-3], h)
        giving = []
        if drive.current_lag is not None:
            acting, driven = lagging(acting, self._given("driven"), drive.current_lag, h)
        if springs:
            step = self._sprung(middle, link_middle, qd, self._given("link_speed"), impulse, acting, h, f, drive)
            following, link_following, impulse, positive = step
            giving += [link_middle + h / 2 * link_following, link_following]
        else:
            following, impulse, positive = self._rigid(middle, qd, impulse, acting, h, f, drive)
        if drive.current_lag is not None:
            giving.append(driven)
        if giving:
            start, rows = own + self.n_passing, ca.vertcat(*giving)
            carried = ca.vertcat(carried[:start, 0], rows, carried[start + rows.shape[0] :, 0])
        ok = _if(positive > 0, status[1])
        error = rig.position_in_pulses(motion[0]) - rig.position_in_pulses(middle)
        return self._function(
            "substep", [middle + h / 2 * following, following, impulse, torque, carried, status[0], ok], error
        )

    def _rigid(self, middle, qd, impulse, acting, h, f, drive):
        """Speeds (n, 1) after a step, the impulse of friction, and the least of what must be positive."""
        # On the motors' shafts, where friction acts; without coupling they are the joints.
        coupling, viscous = drive.coupling, drive.joint_viscous()
        speed = coupling.shaft(qd)
        mobility = inverse(coupling.shaft_inertia(self.dynamics.D(middle, f)) + ca.diag(h / 2 * viscous))
        pushing = coupling.shaft_torque(acting - self.dynamics.gravity(middle, f))
        pushing = pushing - viscous * speed - drive.joint_offset()

        def left(at):
            return pushing - coupling.shaft_torque(self.dynamics.coriolis(middle, coupling.joint(at), f))

        own = mobility.own(left(speed + h / 2 * mobility.solve(left(speed))))  # torque on each, as if it were alone
        impulse = self._friction(mobility, -(mobility.alone * speed + h * own), impulse, h * drive.joint_coulomb(speed))
        following = coupling.joint(speed + mobility.diagonal * (h * own + mobility.own(impulse)))
        return following, impulse, functools.reduce(ca.fmin, mobility.minors)

    def _sprung(self, middle, link_middle, qd, link_speed, impulse, acting, h, f, drive):
        """The same with gears that give: speeds of motors and links, each (n, 1).

        Motors and links are joined by what a spring adds to the inertia of both (`plant.machine.spring`). With the
        motors eliminated, which feel each other through the links alone, what is left is one matrix (n, n).
        """
        coupling, viscous, motor = drive.coupling, drive.joint_viscous(), drive.reflected_inertia()
        speed, v = coupling.shaft(qd), coupling.shaft(link_speed)
        links = coupling.shaft_inertia(self.dynamics.D(link_middle, f)) - ca.diag(motor)
        held = spring(drive.elasticity, coupling.shaft(middle - link_middle), speed - v, h, motor, ca.diag(links))
        alone = motor + h / 2 * viscous
        passed = held.added / (alone + held.added)  # share of a motor's impulse that its link gets
        joined = inverse(links + ca.diag(passed * alone))
        pushing = h * (coupling.shaft_torque(acting) - viscous * speed - drive.joint_offset() - held.torque)
        weight = coupling.shaft_torque(self.dynamics.gravity(link_middle, f))

        def change(at):
            resisting = coupling.shaft_torque(self.dynamics.coriolis(link_middle, coupling.joint(at), f))
            return joined.solve(h * (held.torque - weight - resisting) + passed * pushing)

        link_change = change(v + change(v) / 2)
        free = speed + pushing / (alone + held.added) + passed * link_change
        mobility = row_by_row(ca.diag(1 / (alone + held.added)) + ca.diag(passed) @ joined.matrix() @ ca.diag(passed))
        impulse = self._friction(mobility, -mobility.alone * free, impulse, h * drive.joint_coulomb(speed))
        following = coupling.joint(free + mobility.solve(impulse))
        link_following = coupling.joint(v + link_change + joined.solve(passed * impulse))
        positive = functools.reduce(ca.fmin, [*joined.minors, *ca.vertsplit(ca.diag(links))])
        return following, link_following, impulse, positive

    def _friction(self, mobility, stopping, impulse, bound):
        if self.smooth:
            return smooth_impulse(mobility, stopping, bound)
        return friction_impulse(mobility, stopping, impulse, bound, self.sweeps)


def bounded(state):
    """Whether q and qd, given row by row as casadi's or numpy's, are finite and have not diverged."""
    return sum(value * value for value in state) < FAR**2


def _if(condition, value):
    """The value where the condition holds, 0 elsewhere; a NaN in the condition counts as not."""
    return ca.if_else(condition, value, 0)
