"""The closed loop: arm, drives, encoders and law joined into symbolic steps.

Everything that simulates, verifies or differentiates the loop is generated from the functions made
here. Time runs in *sub-steps* of length h; every `steps_per_sample` of them the log takes a
*sample*. Order at one instant: the law (if it has a period and is due), then the log, then the
sub-step.

The sub-step is a midpoint (leapfrog) step: everything is evaluated at q + h/2 qd. It adds no
numerical damping, which matters: the P loop has a mode with a damping ratio near 0.005. The
Coriolis torque is taken at the mid-step velocity, by one predictor pass, so that energy is
conserved to order h^2.
"""

import dataclasses
import functools
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from plant.machine.drive_effects import lagging
from plant.simulation.layout import Layout
from plant.simulation.sub_step import FrictionStep, elastic, rigid

FAR = 1e6  # norm of all positions [rad] and velocities [rad/s] above which the loop has diverged


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClosedLoop(Layout):
    """Symbolic closed loop of an arm with a rig under a law.

    `law_step`, `sample` and `substep` are Functions of (state, time, numbers), `sample` also of
    (data); `time` is a row of `time_names`. They give (following), (following, log), (following,
    log).

    `smooth`: encoder as identity and friction regularised, for derivatives. `injected`: a known
    torque, a time input, acts beside the law's, which does not know of it. The `score` is a casadi
    Function (log, or its beginning, data, memory) -> number, memory; the number is summed over the
    samples in the state ``score``. `data` is measured, one row per sample; `memory` is state of the
    score, zero at the start. A `correction` is of the simulated positions by counted ones (n,)
    [pulses]; these, and behind them a weight (1 or 0), are `data`.
    """

    def _applied(self, q: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The law at q: torque after the amplifier's limit (which hides NaN), state, whether the
        command is finite.
        """
        *_, torque, carried, _, motion, _, _, given, rig = self._parts
        own = len(self._block.initial)
        n = self.n
        pulses = rig.true_counts(q)
        rest = carried[own:, 0]
        if rig.transport is not None:
            pulses = rig.transport.arrived(pulses, rest[n : 2 * n, 0], self._known("lost"))
            rest = ca.vertcat(torque, pulses, rest[2 * n :, 0])
        asked, following = self._block.step(carried[:own, 0], *motion, pulses, torque, dt, *given)
        return (
            rig.drive.limited(asked),
            ca.vertcat(following, rest),
            ca.sum1(ca.fabs(asked)) < ca.inf,
        )

    def _function(
        self,
        name: str,
        following: Sequence[Any],
        log: ca.SX | None = None,
        data: ca.SX | None = None,
    ) -> ca.Function:
        outputs = [ca.densify(ca.vertcat(*following))] + ([] if log is None else [ca.densify(log)])
        inputs = [*self._symbols] + ([] if data is None else [data])
        names = ["state", "time", "numbers", "data"], ["following", "log"]
        outputs = ca.cse(outputs)
        return ca.Function(name, inputs, outputs, names[0][: len(inputs)], names[1][: len(outputs)])

    @cached_property
    def law_step(self) -> ca.Function | None:
        """One step of a law with a period; the torque is held until the next. None for a law
        without one.
        """
        if not self.steps_per_law:
            return None
        q, qd, impulse, _, _, status, *_ = self._parts
        read = self._encoded(q)
        period = ca.SX(self._block.period)
        if self.rig.jitter is not None:
            speed = self._given("link_speed") if self.rig.encoder.side == "link" else qd
            read = read + speed * self._parts[-1].jitter.late(self._known("draw"), period)
        torque, carried, finite = self._applied(read, period)
        return self._function(
            "law_step", [q, qd, impulse, torque, carried, status[0], _if(finite, status[1])]
        )

    @cached_property
    def sample(self) -> ca.Function:
        """The log at a sample: error [pulses], joint torque [N m], true q and qd, each (n,),
        joined.

        With elastic gears these are the links', and q of the motors comes last. With a correction
        the first is the innovation instead, counted minus predicted position, and the following
        state is corrected. Divergence is detected here; what is not finite stays so.
        """
        q, qd, impulse, torque, carried, status, motion, *_, rig = self._parts
        at_sample = torque
        ok = status[1]
        seen = self._encoded(q)
        if not self.steps_per_law:
            at_sample, _, finite = self._applied(seen, ca.SX(self.h))
            ok = _if(finite, ok)
        at_sample = self._with_injected(at_sample)
        ok = _if(bounded(ca.vertsplit(ca.vertcat(q, qd))), ok)
        data = ca.SX.sym("data", self.n_data)
        joint = (
            (self._given("link"), self._given("link_speed"), q)
            if "link" in self.giving
            else (q, qd)
        )
        if self.correction is None:
            first = motion[3] - rig.true_counts(seen)
        else:
            gains = self.correction.with_numbers(self._symbols[2][-3 * self.n :])
            first = data[:-1] + rig.position_in_pulses(gains.zero) - rig.position_in_pulses(seen)
            known = data[-1] * first
            shift = rig.to_angle(gains.position * known)
            change = rig.to_angle(gains.speed * known) / rig.period
            q = q + shift
            qd = qd + change
            if "link" in self.giving:  # the gear's deflection stays
                carried = self._with_given(
                    carried, link=joint[0] + shift, link_speed=joint[1] + change
                )
        log = ca.vertcat(first, at_sample, *joint)
        score = status[0]
        if self.score is not None:
            kept = carried.shape[0] - len(self._places["memory"])
            added, memory = self.score(log[: self.score.nnz_in(0)], data, carried[kept:, 0])
            score = score + added
            carried = ca.vertcat(carried[:kept, 0], memory)
        return self._function("sample", [q, qd, impulse, torque, carried, score, ok], log, data)

    @cached_property
    def substep(self) -> ca.Function:
        """One midpoint step of length h; its log is the motor's true error [pulses] at the
        middle of the step.
        """
        q, qd, impulse, torque, carried, status, motion, h, f, _, rig = self._parts
        middle = q + h / 2 * qd
        drive = rig.drive
        giving = {}
        had = {name: self._given(name) for name in ("bristle", "drifted") if name in self.giving}
        friction = FrictionStep(
            drive=drive, h=h, impulse=impulse, sweeps=self.sweeps, smooth=self.smooth, **had
        )
        if "link" in self.giving:
            link = (
                self._given("link") + h / 2 * self._given("link_speed"),
                self._given("link_speed"),
            )
        if not self.steps_per_law:
            torque, carried, _ = self._applied(link[0] if rig.encoder.side == "link" else middle, h)
        acting = torque
        own = len(self._block.initial)
        if rig.transport is not None:
            acting = rig.transport.acting(
                torque, carried[own : own + self.n, 0], self._known("place"), h
            )
        acting = self._with_injected(acting)
        if drive.current_lag is not None:
            acting, giving["driven"] = lagging(acting, self._given("driven"), drive.current_lag, h)
        if drive.ripple is not None:
            acting = acting + drive.ripple_torque(middle)
        if drive.friction_drift is not None:
            giving["drifted"] = drive.friction_drift.following(had["drifted"], h)
        if "link" in self.giving:
            after = elastic(self.dynamics, rig, f, (middle, qd), link, acting, h, friction)
            giving["link"] = link[0] + h / 2 * after.states["link_speed"]
        else:
            after = rigid(self.dynamics, rig, f, middle, qd, acting, h, friction)
        if self.giving:
            carried = self._with_given(carried, **giving, **after.states)
        ok = _if(after.positive > 0, status[1])
        following = after.speed
        error = rig.position_in_pulses(motion[0]) - rig.position_in_pulses(middle)
        return self._function(
            "substep",
            [middle + h / 2 * following, following, after.impulse, torque, carried, status[0], ok],
            error,
        )

    def _with_injected(self, torque: ca.SX) -> ca.SX:
        """Torque of the motors: the law's, and what was injected beside it, within the
        amplifier's limit.
        """
        if not self.injected:
            return torque
        first = self.time_names.index("injected[0]")
        return self._parts[-1].drive.limited(torque + self._symbols[1][first : first + self.n])

    def _encoded(self, q: ca.SX) -> ca.SX:
        """Position with which the encoders turn."""
        return self._given("link") if self.rig.encoder.side == "link" else q


_shared = functools.lru_cache(maxsize=16)(ClosedLoop)


def closed_loop(**parts: Any) -> ClosedLoop:
    """The loop of these parts; of equal ones the same, whose functions are made once."""
    try:
        hash(tuple(parts.values()))
    except TypeError:  # a user's own law, as a dataclass of arrays
        return ClosedLoop(**parts)
    return _shared(**parts)


def bounded(state: Any) -> Any:
    """Whether q and qd, given row by row as casadi's or numpy's, are finite and have not
    diverged.
    """
    with np.errstate(over="ignore"):  # of one that has
        return sum(value * value for value in state) < FAR**2


def _if(condition: ca.SX, value: ca.SX) -> ca.SX:
    """The value where the condition holds, 0 elsewhere; a NaN in the condition counts as not."""
    return ca.if_else(condition, value, 0)
