"""The vectors of a closed loop by name: its state, its inputs in time, its numbers, its log.

A `Layout` declares each vector once as `Fields`. The equations of `plant.simulation.closed_loop`
read records of symbols, such as ``state.q`` and ``time.q_r``, and write the following state by
name. A field that a loop does not need has no numbers, so that the records of all loops are alike.
"""

import dataclasses
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np

from plant.laws import Law
from plant.machine import DRY_FRICTION, Frame, InnerLoop, Rig, punctual_rig, smooth_rig
from plant.mechanics import Dynamics
from plant.parts import Fields, Floats, Part, Vector, number, part, per_joint, scalars, whole

# Passes of the fixed-point iteration for a link that hangs in its spring. Each divides the error by
# the ratio of the gear's stiffness to the slope of the weight.
_PASSES = 20

# Fields that hold one number whatever the loop is; their names have no index.
_SINGLE = "score", "ok", "sending", "place", "lost", "draw", "due", "h"

# Rows of a frame, one number per joint each.
_FRAME = len(Frame._fields)


@part
class Correction(Part):
    """Observer gains, per motor, by which a replayed simulation follows the counts of its log.

    At every sample the innovation, counted minus simulated position, is fed back into the simulated
    position and speed, as in an alpha-beta filter or a steady-state Kalman filter. Without
    correction the simulation runs in open loop, and model errors (the rounding between two samples,
    above all) accumulate over the log.

    """

    # Gain of the position (alpha), 0 to 1.
    position: Vector = number(("n",))
    # Gain of the speed, per sample period (beta).
    speed: Vector = number(("n",))
    # Joint positions at which the counters read zero [rad].
    zero: Vector = number(("n",))

    @classmethod
    def with_memory(cls, n: int, samples: float) -> Self:
        """Gains of n motors for a double observer pole with a time constant of `samples`."""
        # For poles p, p the alpha-beta filter has alpha = 1 - p^2 and beta = (1 - p)^2.
        pole = np.exp(-1 / samples)
        return cls(position=(1 - pole**2,) * n, speed=((1 - pole) ** 2,) * n, zero=(0.0,) * n)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Layout:
    """The vectors of a `plant.simulation.closed_loop.ClosedLoop`, which has the parameters."""

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
        # Derivatives need a loop without rounding, jumps of friction and random instants.
        if self.smooth:
            object.__setattr__(self, "rig", punctual_rig(smooth_rig(self.rig)))
        # A law that repeats a log reads no counts, so their instant has no effect.
        if self.law.replays and self.rig.jitter is not None:
            object.__setattr__(self, "rig", dataclasses.replace(self.rig, jitter=None))
        object.__setattr__(self, "steps_per_sample", self._steps_for_loops())
        self.steps_per_law  # noqa: B018 - refuses a period that does not fit
        # A torque that is later than the next step of the law would need a longer memory.
        transport = self.rig.transport
        if transport is not None and not transport.delay <= (self._block.period or -1):
            raise ValueError(
                "a rig with a transport needs a law whose period is at least its delay"
                f" {transport.delay:g} s; got {self._block.period} s. Use a sampled law,"
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

    @property
    def steps_per_inner(self) -> int:
        """Sub-steps per step of the rig's inner loop; 0 where there is none."""
        inner = self.rig.inner
        return 0 if inner is None else round(inner.period_in(self.rig.period) / self.h)

    def _steps_for_loops(self):
        """Sub-steps per sample: at least those stated, so that each step of a servo has whole ones.

        A servo's loop, be it the law of a log or the loop below a law, is faster than the samples.
        """
        innermost = self.law.innermost
        fast = innermost if isinstance(innermost, InnerLoop) else self.rig.inner
        if fast is None:
            return self.steps_per_sample
        loops = round(self.rig.period / fast.period_in(self.rig.period))
        return -(-self.steps_per_sample // loops) * loops

    @cached_property
    def follows_motion(self) -> bool:
        """Whether the law reads q, qd or qdd of its setpoint, beside the commanded counts."""
        # By the graph of its step, not by its declaration: most laws use a part of the setpoint.
        step = self._block.step
        symbols = [ca.SX.sym(step.name_in(i), step.size1_in(i)) for i in range(step.n_in())]
        return bool(ca.depends_on(ca.vertcat(*step(*symbols)), ca.vertcat(*symbols[1:4])))

    @cached_property
    def _block(self):
        return self.law.block(self.rig)

    # -- the vectors -------------------------------------------------------------------------------
    @cached_property
    def state_fields(self) -> Fields:
        """Fields of the state, in order."""
        drive = self.rig.drive
        inner = self.rig.inner
        transport = _per_joint_if(self.rig.transport)
        return Fields(
            # Position [rad] and velocity [rad/s] of the motors, as joints on rigid gears have them.
            q=per_joint(),
            qd=per_joint(),
            # Impulse of dry friction in the previous step [N m s].
            impulse=per_joint(),
            # Joint torque applied last [N m], and the state of the law.
            torque=per_joint(),
            law=scalars(len(self._block.initial), start=self._block.initial),
            # With a transport the torque before that one, and the counts that the law read last.
            before=transport,
            seen=transport,
            # With an inner loop the frames that were sent last and before, and 1 after the first;
            # the state of that loop, and the torque that it makes [N m].
            sent=per_joint(0 if inner is None else _FRAME),
            sent_before=per_joint(0 if inner is None else _FRAME),
            sending=_single_if(inner),
            inner=scalars(0 if inner is None else inner.fields.length(self.n)),
            made=_per_joint_if(inner),
            # With elastic gears the motion of the joints themselves.
            link=_per_joint_if(self.elastic),
            link_speed=_per_joint_if(self.elastic),
            # Torque of currents that lag [N m].
            driven=_per_joint_if(drive.current_lag),
            # Deflection of the bristles of presliding friction.
            bristle=_per_joint_if(drive.presliding),
            # Progress of the drift of friction, 0 to 1.
            drifted=_per_joint_if(drive.friction_drift),
            # State of the score, and its sum over the samples.
            memory=scalars(0 if self.score is None else int(self.score.nnz_in(2))),
            score=scalars(),
            # 1, and 0 once the loop has diverged. It is last: the kernel's text reads it there.
            ok=scalars(start=1.0),
        )

    @cached_property
    def time_fields(self) -> Fields:
        """Fields of the inputs that are known beforehand for each step, in order."""
        transport = _single_if(self.rig.transport)
        return Fields(
            # The reference [rad, s], and its commanded counts.
            q_r=per_joint(),
            qd_r=per_joint(),
            qdd_r=per_joint(),
            pulses_r=per_joint(),
            # The column of its log that the law repeats.
            logged=_per_joint_if(self.law.replays),
            # Torque beside the law's [N m].
            injected=_per_joint_if(self.injected),
            # Number of the sub-step after the law's step, and the loops whose counts are lost, as
            # the bits of a number.
            place=transport,
            lost=transport,
            # Random draw of the instant at which the law reads its counts.
            draw=_single_if(self.rig.jitter),
            # 1 where a step of the inner loop begins, otherwise 0.
            due=_single_if(self.rig.inner is not None and not self.smooth),
            # Length of the coming sub-step [s].
            h=scalars(start=self.h),
        )

    @cached_property
    def number_fields(self) -> Fields:
        """Fields of the numbers, in order; those of the law's block are the law's and the rig's."""
        rig = len(self.rig.number_values())
        return Fields(
            f=scalars(self.dynamics.p),
            law=scalars(len(self._block.names) - rig),
            rig=scalars(rig),
            # Position and speed gains, and zeros of the counters.
            correction=per_joint(0 if self.correction is None else 3),
        )

    @cached_property
    def log_fields(self) -> Fields:
        """Fields of the log of a sample (`log_fields_of`)."""
        return log_fields_of(self.elastic)

    @cached_property
    def data_fields(self) -> Fields:
        """Fields of the measured data of a sample: a correction's, or those of the score."""
        if self.correction is not None:
            # Counts [pulses], and 1 or 0: a sample that bridges a gap was not measured.
            return Fields(counts=per_joint(), weight=scalars())
        return Fields(score=scalars(0 if self.score is None else int(self.score.nnz_in(1))))

    @property
    def state_names(self) -> list[str]:
        """Names of the state, such as ``q[0]``."""
        return _names(self.state_fields, self.n)

    @property
    def time_names(self) -> list[str]:
        """Names of the inputs in time, such as ``q_r[0]``."""
        return _names(self.time_fields, self.n)

    @property
    def number_names(self) -> list[str]:
        """Names of the numbers, such as ``f1`` and ``drive.gear[0]``."""
        correction = self.correction
        names = [] if correction is None else correction.number_names("correction.")
        return [*self.dynamics.names, *self._block.names, *names]

    @property
    def n_log(self) -> int:
        """Numbers in the log of a sample."""
        return self.log_fields.length(self.n)

    @property
    def n_data(self) -> int:
        """Measured numbers per sample that the score or the correction needs."""
        return self.data_fields.length(self.n)

    @property
    def elastic(self) -> bool:
        """Whether the joints move on elastic gears, apart from their motors."""
        return self.rig.drive.elasticity is not None

    @property
    def drive_states(self) -> tuple[str, ...]:
        """Names of the states, n each, that the parts of the drive add."""
        names = "link", "link_speed", "driven", "bristle", "drifted"
        places = self.state_fields.at(self.n)
        return tuple(name for name in names if places[name])

    # -- records of symbols ------------------------------------------------------------------------
    @cached_property
    def _symbols(self):
        """The vectors of state, time and numbers, the inputs of every function of the loop."""
        state = ca.SX.sym("state", self.state_fields.length(self.n))
        time = ca.SX.sym("time", self.time_fields.length(self.n))
        return state, time, ca.SX.sym("numbers", self.number_fields.length(self.n))

    @cached_property
    def _state(self):
        """Record of the symbols of `state_fields`."""
        return self.state_fields.read(self._symbols[0], self.n)

    @cached_property
    def _time(self):
        """Record of the symbols of `time_fields`."""
        return self.time_fields.read(self._symbols[1], self.n)

    @cached_property
    def _numbers(self):
        """Record of the symbols of `number_fields`."""
        return self.number_fields.read(self._symbols[2], self.n)

    @cached_property
    def _symbolic_rig(self):
        """The rig with symbols in place of its numbers."""
        return self.rig.with_numbers(self._numbers.rig)

    # -- values ------------------------------------------------------------------------------------
    def number_values(self, f: Floats) -> Floats:
        """Values (k,) of `number_names` with these f (p,)."""
        correction = np.empty(0) if self.correction is None else self.correction.number_values()
        return np.concatenate([f, self._block.values, correction])

    def sliding_values(self, f: Floats) -> Floats:
        """Values (k,) without dry friction, as for joints that slide in one direction."""
        dry = [name.startswith(DRY_FRICTION) for name in self.number_names]
        return np.where(dry, 0.0, self.number_values(f))

    def state_with(self, **values: Any) -> Any:
        """The state (s,) at the start, with these fields in place of its own."""
        return _with(self.state_fields, self.n, values)

    def time_with(self, **values: Any) -> Any:
        """Inputs in time (m,) that are zero but for ``h`` and these fields."""
        return _with(self.time_fields, self.n, values)

    def initial_state(self, q: Floats, qd: Floats, numbers: Floats | None = None) -> Floats:
        """State (s,) of an arm at q, qd (n,) with no torque applied yet.

        With its numbers (k,), links hang in elastic gears; with those of many arms (k, P), their
        states (s, P).
        """
        q = np.asarray(q, float)
        qd = np.asarray(qd, float)
        arms = () if numbers is None else numbers.shape[1:]
        start = self.state_fields.initial(self.n)
        state = self.state_fields.read(start, self.n)._replace(q=q, qd=qd)
        if self.elastic:
            # Without numbers the gears are taken as unloaded.
            link = q
            if numbers is not None:
                link = self.hanging(q, numbers).full().reshape((self.n, *arms))
            state = state._replace(link=link, link_speed=qd)
        states = np.empty((len(start), *arms))
        for name, places in self.state_fields.at(self.n).items():
            value = np.asarray(getattr(state, name))
            # One start for all arms, where they do not have one each.
            if arms and value.ndim == 1:
                value = value[:, None]
            states[places.start : places.stop] = value
        return states

    @cached_property
    def hanging(self) -> ca.Function:
        """(q, numbers) -> position (n,) at which links hang at rest behind motors at q."""
        # 1. One pass: the deflection under the weight that the link has at its previous position.
        link = ca.SX.sym("link", self.n)
        q = ca.SX.sym("q", self.n)
        rig = self._symbolic_rig
        coupling = rig.drive.coupling
        elasticity = rig.drive.elasticity
        weight = self.dynamics.gravity(link, self._numbers.f) - rig.spring_torque(link)
        torque = coupling.shaft_torque(weight)
        play = 0.0
        if elasticity.backlash is not None:
            play = ca.sign(torque) * elasticity.backlash / 2
        following = coupling.joint(coupling.shaft(q) - torque / elasticity.stiffness - play)
        settle = ca.Function("settle", [link, q, self._symbols[2]], [following])

        # 2. The passes, beginning at the motor's position.
        motor = ca.MX.sym("q", self.n)
        numbers = ca.MX.sym("numbers", self.number_fields.length(self.n))
        rest = motor
        for _ in range(_PASSES):
            rest = settle(rest, motor, numbers)
        return ca.Function("settled", [motor, numbers], [rest])

    # -- readings of a state -----------------------------------------------------------------------
    def read_state(self, vector: Any) -> Any:
        """Record of a state (s,), or of many (s, P); `state_fields` has the names."""
        return self.state_fields.read(vector, self.n)

    def joint_motion(self, state: Any) -> tuple[Any, Any]:
        """Position [rad] and velocity [rad/s] (n,) of the joints in a record of the state."""
        return (state.link, state.link_speed) if self.elastic else (state.q, state.qd)

    def moving_states(self) -> list[int]:
        """Places of the states of a moving arm: positions, speeds and currents that lag."""
        places = self.state_fields.at(self.n)
        names = "q", "qd", "link", "link_speed", "driven", "inner"
        return [place for name in names for place in places[name]]

    def encoded(self, state: Any) -> Any:
        """Position (n,) [rad] that the encoders measure in a record of the state."""
        return state.link if self.rig.encoder.side == "link" else state.q


def log_fields_of(elastic: bool) -> Fields:
    """Fields of the log of a sample, in order, of joints on rigid or on elastic gears."""
    return Fields(
        # Tracking error [pulses]; with a correction the innovation, counted minus predicted.
        error=per_joint(),
        # Torque of the motors [N m], joint side.
        torque=per_joint(),
        # Position [rad] and velocity [rad/s] of the joints.
        q=per_joint(),
        qd=per_joint(),
        # Position of motors on elastic gears [rad].
        motor=_per_joint_if(elastic),
    )


def _per_joint_if(part):
    """A number per joint if there is a part that needs it, otherwise none."""
    return per_joint(1 if part else 0)


def _single_if(part):
    return scalars(1 if part else 0)


def _names(fields, n):
    """Names of all numbers of a vector, with an index where a field may hold several."""
    names = []
    for name, places in fields.at(n).items():
        if name in _SINGLE:
            names += [name] * len(places)
        else:
            names += [f"{name}[{i}]" for i in range(len(places))]
    return names


def _with(fields, n, values):
    start = fields.read(fields.initial(n), n)
    return fields.write(n, **start._replace(**values)._asdict())
