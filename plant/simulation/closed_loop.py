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
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from plant.laws import Setpoint
from plant.machine import Frame, lagging
from plant.simulation.layout import Layout
from plant.simulation.sub_step import FrictionStep, elastic, rigid

FAR = 1e6  # norm of all positions [rad] and velocities [rad/s] above which the loop has diverged


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClosedLoop(Layout):
    """Symbolic closed loop of an arm with a rig under a law.

    `law_step`, `sample` and `substep` are Functions of (state, time, numbers); `sample` also takes
    (data). `law_step` gives (following), the other two give (following, log). `Layout` names the
    fields of these vectors.

    `smooth` replaces the encoder by the identity and regularises friction, for derivatives.
    `injected` adds a known torque, one of the time inputs, to the law's; the law does not know it.
    The `score` is a casadi Function from (log, data, memory) to (number, memory); it may take the
    beginning of the log alone. The state ``score`` sums the numbers of the samples. `data` is
    measured, one row per sample; `memory` is the state of the score, zero at the start. A
    `correction` corrects the simulated motion by counted positions; `data` is then these positions
    (n,) [pulses], followed by a weight (1 or 0).
    """

    @cached_property
    def law_step(self) -> ca.Function | None:
        """One step of a law with a period, whose torque is held until the next; or None."""
        if not self.steps_per_law:
            return None
        state = self._state
        rig = self._symbolic_rig
        position = self.encoded(state)
        period = ca.SX(self._block.period)
        if rig.jitter is not None:
            # The counts are read late by a part of the period; meanwhile the encoders move on.
            speed = state.link_speed if rig.encoder.side == "link" else state.qd
            position = position + speed * rig.jitter.late(self._time.draw, period)
        following, finite = self._with_law(position, period)
        return self._function("law_step", following._replace(ok=_if(finite, state.ok)))

    @cached_property
    def sample(self) -> ca.Function:
        """The log at a sample (`log_fields`), and the state that the score and a correction leave.

        With a correction, the log's error is the innovation: counted minus predicted position.
        Only this Function checks whether the motion has diverged; that suffices, since a position
        or speed that is not finite remains so.
        """
        state = self._state
        rig = self._symbolic_rig
        data = ca.SX.sym("data", self.n_data)
        position = self.encoded(state)

        # 1. The torque that acts now. A law without a period has a new one at every instant.
        torque = state.torque
        ok = state.ok
        if not self.steps_per_law:
            evaluated, finite = self._with_law(position, ca.SX(self.h))
            torque = evaluated.torque
            ok = _if(finite, ok)
        if rig.inner is not None:
            torque = state.made
        # The log has this torque with the injected part, but before the current lag and the ripple,
        # and, without an inner loop, before the transport.
        torque = self._with_injected(torque)
        ok = _if(bounded(ca.vertsplit(ca.vertcat(state.q, state.qd))), ok)

        # 2. The tracking error, or the innovation by which the state is corrected. The log has the
        # motion as predicted, before this correction.
        following = state._replace(ok=ok)
        if self.correction is None:
            error = self._time.pulses_r - rig.true_counts(position)
        else:
            counted = self.data_fields.read(data, self.n)
            gains = self.correction.with_numbers(self._numbers.correction)
            error = (
                counted.counts
                + rig.position_in_pulses(gains.zero)
                - rig.position_in_pulses(position)
            )
            innovation = counted.weight * error
            shift = rig.to_angle(gains.position * innovation)
            change = rig.to_angle(gains.speed * innovation) / rig.period
            following = following._replace(q=state.q + shift, qd=state.qd + change)
            if self.elastic:
                # Motors and links move by the same angle, so that the gears' deflection stays.
                following = following._replace(
                    link=state.link + shift, link_speed=state.link_speed + change
                )
        q, qd = self.joint_motion(state)
        motor = state.q if self.elastic else ca.SX(0, 1)
        log = self.log_fields.write(self.n, error=error, torque=torque, q=q, qd=qd, motor=motor)

        # 3. The score of this sample.
        if self.score is not None:
            # A score may read the beginning of the log alone, such as its errors.
            added, memory = self.score(log[: self.score.nnz_in(0)], data, state.memory)
            following = following._replace(score=state.score + added, memory=memory)
        return self._function("sample", following, log, data)

    @cached_property
    def substep(self) -> ca.Function:
        """A midpoint step of length h; it logs the motors' true error [pulses] at the midpoint."""
        state = self._state
        rig = self._symbolic_rig
        drive = rig.drive
        h = self._time.h
        middle = state.q + h / 2 * state.qd
        # A law without a period, friction and springs are evaluated in the middle of the step.
        link_middle = state.link + h / 2 * state.link_speed if self.elastic else middle
        following = state

        # 1. The torque of the law, delayed by the transport, or that of the inner loop below the
        # law; then the effects of the drive on this torque.
        if not self.steps_per_law:
            at_law = link_middle if rig.encoder.side == "link" else middle
            following, _ = self._with_law(at_law, h)
        torque = following.torque
        if rig.transport is not None:
            torque = rig.transport.acting(torque, state.before, self._time.place, h)
        if rig.inner is not None:
            following = self._with_inner(state)
            torque = following.made
        torque = self._with_injected(torque)
        # After the amplifier's limit, the currents lag behind their command, and the motors add
        # their torque ripple.
        if drive.current_lag is not None:
            torque, driven = lagging(torque, state.driven, drive.current_lag, h)
            following = following._replace(driven=driven)
        if drive.ripple is not None:
            torque = torque + drive.ripple_torque(middle)

        # 2. The speeds after the step, with the friction of its middle.
        friction = FrictionStep(
            drive=drive,
            h=h,
            impulse=state.impulse,
            bristle=state.bristle,
            drifted=state.drifted,
            sweeps=self.sweeps,
            smooth=self.smooth,
        )
        if drive.friction_drift is not None:
            drifted = drive.friction_drift.following(state.drifted, h)
            following = following._replace(drifted=drifted)
        f = self._numbers.f
        if self.elastic:
            # The links move by half a step at their old speed and half at the new one.
            motors = middle, state.qd
            links = link_middle, state.link_speed
            step = elastic(self.dynamics, rig, f, motors, links, torque, h, friction)
            following = following._replace(link=link_middle + h / 2 * step.states["link_speed"])
        else:
            step = rigid(self.dynamics, rig, f, middle, state.qd, torque, h, friction)

        # 3. The second half of the step, at the new speeds. The loop has diverged where the inertia
        # matrix is not positive definite.
        following = following._replace(
            q=middle + h / 2 * step.speed,
            qd=step.speed,
            impulse=step.impulse,
            ok=_if(step.positive > 0, state.ok),
            **step.states,
        )
        # The true error, with fractions of a pulse: no encoder rounds it.
        error = rig.position_in_pulses(self._time.q_r) - rig.position_in_pulses(middle)
        return self._function("substep", following, error)

    def _with_law(self, position, dt):
        """The state after a step of the law at a position of the encoders (n, 1) [rad].

        Its torque is within the amplifier's limit, which hides a NaN; hence the second result,
        which says whether the command is finite.
        """
        state = self._state
        time = self._time
        rig = self._symbolic_rig
        pulses = rig.true_counts(position)
        following = state
        if rig.transport is not None:
            pulses = rig.transport.arrived(pulses, state.seen, time.lost)
            following = state._replace(before=state.torque, seen=pulses)
        setpoint = time.q_r, time.qd_r, time.qdd_r, time.pulses_r
        numbers = ca.vertcat(self._numbers.law, self._numbers.rig)
        inputs = [state.law, *setpoint, pulses, state.torque, dt, numbers]
        if self.law.replays:
            inputs.append(time.logged)
        # The law of a loop reads the torque applied last, before the transport delays it.
        command, law = self._block.step(*inputs)
        finite = ca.sum1(ca.fabs(command)) < ca.inf
        following = following._replace(law=law, torque=rig.limited(command))
        if rig.inner is not None:
            sent = self._block.sent(*setpoint[:3], pulses, command, numbers)
            # Before the first frame, the inner loop is taken to have run under an equal frame.
            before = ca.if_else(state.sending, state.sent, sent)
            following = following._replace(sent=sent, sent_before=before, sending=1)
        return following, finite

    def _with_inner(self, state):
        """The state after a run of the inner loop at a sub-step's beginning, with its torque."""
        rig = self._symbolic_rig
        inner = rig.inner
        sent = state.sent
        if rig.transport is not None:
            sent = rig.transport.acting(sent, state.sent_before, self._time.place, self._time.h)
        frame = Frame(*ca.vertsplit(sent, self.n))
        pulses = inner.counts(rig, self.encoded(state))
        setpoint = Setpoint(frame.pulses, frame.qd, ca.SX.zeros(self.n), frame.pulses)
        # Derivatives take the loop as continuous; otherwise it runs where a period of it begins.
        dt = self._time.h if self.smooth else self._time.h * self.steps_per_inner
        own, memory = inner.equations(rig, state.inner, setpoint, pulses, state.made, dt)
        made = rig.drive.limited(own + frame.torque)
        if not self.smooth:
            due = self._time.due
            made = ca.if_else(due, made, state.made)
            memory = ca.if_else(due, memory, state.inner)
        return state._replace(made=made, inner=memory)

    def _with_injected(self, torque):
        """Torque of the motors within the amplifier's limit: the law's and the injected one."""
        if not self.injected:
            return torque
        return self._symbolic_rig.drive.limited(torque + self._time.injected)

    def _function(self, name, following, log=None, data=None):
        """The Function of the vectors that gives the following state, and a log."""
        # The kernels number all outputs, so that none may be sparse.
        outputs = [ca.densify(self.state_fields.write(self.n, **following._asdict()))]
        output_names = ["following"]
        if log is not None:
            outputs.append(ca.densify(log))
            output_names.append("log")
        inputs = [*self._symbols]
        input_names = ["state", "time", "numbers"]
        if data is not None:
            inputs.append(data)
            input_names.append("data")
        return ca.Function(name, inputs, ca.cse(outputs), input_names, output_names)

    def sound(self, state: Any) -> Any:
        """Whether a loop with this state (s,), or each of many (s, P), has not diverged."""
        # The bounds of the motion were last checked at a sample.
        ok, motion = self._watched
        return (state[ok] > 0) & bounded(state[motion])

    @cached_property
    def _watched(self):
        """Places of ``ok``, and of ``q`` and ``qd``, that say whether a loop has diverged."""
        places = self.state_fields.at(self.n)
        return places["ok"].start, [*places["q"], *places["qd"]]


_shared = functools.lru_cache(maxsize=16)(ClosedLoop)


def closed_loop(**parts: Any) -> ClosedLoop:
    """The loop of these parts; equal ones share a loop, whose functions are made once."""
    try:
        hash(tuple(parts.values()))
    except TypeError:  # a user's own law, as a dataclass of arrays
        return ClosedLoop(**parts)
    return _shared(**parts)


def bounded(state: Any) -> Any:
    """Whether the rows of q and qd, casadi's or numpy's, are finite and have not diverged."""
    with np.errstate(over="ignore"):  # the squares of a loop that has diverged
        return sum(value * value for value in state) < FAR**2


def _if(condition, value):
    """The value where the condition holds, otherwise 0; a comparison with a NaN does not hold."""
    return ca.if_else(condition, value, 0)
