"""Computed torque from identified parameters: D-hat and h-hat are those of the arm.
Source: paper Fig. 2.
"""

import dataclasses
import functools
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.laws.computed_torque_settings import SETTINGS, ComputedTorqueSettings
from ctc.laws.default_gains import SETTINGS as GAINS
from ctc.laws.default_gains import DefaultGainSettings, default_gains
from ctc.laws.delay_queue import DelayQueue
from ctc.laws.friction_model import (
    LearntFriction,
    NoFriction,
    ShaftFriction,
    StatedFriction,
    shares,
    speed_share,
    unexplained,
)
from ctc.laws.gear_gains import gear_gains
from ctc.laws.gears import Deviation, ElasticGears, RigidGears, braked
from ctc.laws.late_frames import LateFrames
from ctc.laws.model_law import ModelLaw
from ctc.laws.start_boost import NoBoost, StartBoost
from plant import Fields, Law, Rig, number, part, per_joint, scalars, structure
from plant.laws import Setpoint, Step
from plant.parts import MODEL_TORQUE, TORQUE_ERROR, instance, signs
from plant.realtime import Running


@part
class ComputedTorque(ModelLaw):
    """tau = D-hat qdd_r + h-hat + friction + delta + L J (k1 e + k2 edot), with an observer.

    Once per sample the observer predicts the error e = q_r - q from the torque that was really
    applied. It has D-hat, h-hat and dry friction that can hold a joint: one that sticks is
    predicted to stick. It then corrects the error, its rate and a disturbance torque delta, joint
    by joint, with the gains of a Kalman filter, and only by the part of the innovation that exceeds
    `dead_zone` times half a cell of the encoder. The feedback is that of a linear-quadratic
    regulator. It uses the inertia J = 1 / (D^-1)_jj that each joint feels; on rigid gears the
    factor L of D = L P L^T adds to a joint the torque that moves it along with those before it.
    Coulomb friction is fed forward without jumps. Where `gear_gains` is not None, the observer
    predicts the links apart from the motors, and the motors follow q_r.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float, optional
        Magnitude of the regulator's poles [rad/s]. The default for an arm, whose accuracy is
        unknown, is 360; for an identification 145; with identified friction 120, or more where
        an encoder pulse is smaller than the error from the uncertainty of f and friction; with
        stated gears 100. The default is at most 0.3 / period, and less on elastic gears. Above an
        inner loop, whose stiffness adds to the regulator's, the default is 120 for servos and 50
        for MIT drives, at most 0.45 / period.
    observer_ratio : float, optional
        Bandwidth of the observer over that of the regulator. Default: 1.3; with friction
        identified and rigid gears, but not above an inner loop: 1.
    dead_zone : float, optional
        Share of the quantisation cell, 0 to 1, within which an innovation corrects nothing. Where
        the reference stands it is 2.5 times as large, but at most 1. A larger dead zone reduces
        torque chatter but delays the disturbance estimate. Default with an arm: 0; with an
        identification: 0.2; with friction identified too: 0.45, less with a higher bandwidth; with
        stated gears: 0.4; above an inner loop: 0.2.
    friction : bool
        Whether the model has the friction of the rig: it is fed forward, and predicted.
    learn_friction, learnable : bool, float
        `learn_friction`: whether to learn, where joints turn back, the shares by which Coulomb and
        viscous friction differ from the rig's. `learnable`: the largest such share (0 to 0.99).
        `Running.friction` has the learnt friction, and `start` takes it. Above an inner loop,
        none is learnt by default where the bandwidth is below the rate of learning: the observer is
        then too slow to tell friction from what else changes while a joint turns back.
    start_boost, start_time : float, optional
        Factor on the regulator's bandwidth where a joint begins to move or turns back, or where
        counts show a model error, and the time constant with which it decays [s]; the observer's
        bandwidth is raised by the square root. Default: 4, and 10 over the bandwidth; with friction
        identified and rigid gears: 2.7 and 40; above an inner loop: 2 and 10. The boost is
        disabled after two detected oscillations, and always with elastic gears in the model.
    measured : bool
        Whether to evaluate D-hat and h-hat at the observed q and qd instead of the reference.
    delay : int
        Samples, 0 or 1, by which the torque acts later than its own sample, as with a controller
        that needs the whole period to compute. The observer predicts across it.
    gear_gains : (m,) numpy.ndarray, optional
        Result, computed from the other fields: gains on elastic gears. None for rigid gears, gears
        with backlash, gears too stiff for the period, and encoders on the links.
    settings : ComputedTorqueSettings, optional
        Thresholds and rates that seldom need a change.

    Raises
    ------
    ValueError
        An arm whose D(q) does not exceed the motors' inertia everywhere, joints that do not match,
        a field that is out of its range, elastic gears on which no bandwidth is stable.

    See Also
    --------
    ctc.evaluate, ctc.tune

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> law = ComputedTorque(arm, rig, bandwidth=150)
    >>> evaluate(arm, rig, law, puma560.reference(), duration=0.5).within(1)
    True

    Source: paper Fig. 2; the observer in docs/background/computed_torque.md.
    """

    bandwidth: float = number((), default=None)
    observer_ratio: float = number((), default=None)
    dead_zone: float = number((), default=None)
    start_boost: float = number((), default=None)
    start_time: float = number((), default=None)
    friction: bool = structure(bool, default=True)
    learn_friction: bool = structure(bool, default=None)
    learnable: float = number((), default=0.4)
    measured: bool = structure(bool, default=False)
    delay: int = structure(default=0)
    gear_gains: Any = number(("m",), default=None)
    settings: ComputedTorqueSettings = structure(ComputedTorqueSettings, default=SETTINGS)

    def __post_init__(self) -> None:
        trial = functools.partial(ComputedTorque, getattr(self.arm, "arm", self.arm))
        defaults = default_gains(self.arm, self.rig, self.bandwidth, trial)
        for name in ("bandwidth", "dead_zone", "observer_ratio", "start_boost"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(defaults, name))
        # Computed below; `dataclasses.replace` hands in those of another bandwidth.
        object.__setattr__(self, "gear_gains", None)
        super().__post_init__()
        signs(self, positive=("bandwidth", "observer_ratio", "start_boost"))
        if self.learn_friction is None:
            slow = self.rig.inner is not None and self.bandwidth < self.settings.learning_rate
            object.__setattr__(self, "learn_friction", not slow)
        if self.start_time is None:
            object.__setattr__(self, "start_time", defaults.start_time / self.bandwidth)
        signs(self, positive=("start_time",), not_negative=("dead_zone", "learnable"))
        for name, limit, usual in (("dead_zone", 1, 0.2), ("learnable", 0.99, 0.4)):
            if getattr(self, name) > limit:
                raise ValueError(
                    f"{name} must be a share, 0 to {limit}; got {getattr(self, name):g}. {usual} is"
                    " usual."
                )
        if self.delay not in (0, 1):
            raise ValueError(
                f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another"
                " design."
            )
        gains = gear_gains(
            self.arm,
            self.rig,
            self.bandwidth,
            self.observer_ratio * self.bandwidth,
            self.settings.predicted_stiffness,
        )
        object.__setattr__(self, "gear_gains", gains)

    @classmethod
    def designed(
        cls,
        arm: Any,
        rig: Any = None,
        *,
        gains: DefaultGainSettings = GAINS,
        **fields: Any,
    ) -> Self:
        """The law with default gains from `gains`; `fields` are the fields of the class.

        Raises
        ------
        ValueError
            As the class does; elastic gears on which no bandwidth is stable.
        """
        instance("gains", gains, DefaultGainSettings, "Give DefaultGainSettings.")
        trial = functools.partial(cls, getattr(arm, "arm", arm))
        defaults = default_gains(arm, rig, fields.get("bandwidth"), trial, gains)._asdict()
        # The settings state this time in units of 1 / bandwidth.
        defaults["start_time"] /= fields.get("bandwidth") or defaults["bandwidth"]
        # None asks for the default, which the class would take from the usual gains.
        fields = {
            name: value
            for name, value in fields.items()
            if value is not None or name not in defaults
        }
        return cls(arm, rig, **defaults | fields)

    def describe(self) -> dict[str, Any]:
        """Kind and fields; the usual settings are left out, as older files contain none."""
        description = super().describe()
        if self.settings == SETTINGS:
            del description["settings"]
        return description

    def sliding(self) -> Law:
        """As for every law, but without learning friction, which needs joints that turn back."""
        return dataclasses.replace(super().sliding(), learn_friction=False)

    # -- the blocks -------------------------------------------------------------------------------
    @property
    def gears(self) -> type[RigidGears] | type[ElasticGears]:
        """Gears of the model: elastic where the law has gains for them, otherwise rigid."""
        return RigidGears if self.gear_gains is None else ElasticGears

    @property
    def friction_model(self) -> NoFriction:
        """Friction of the model."""
        if not self.friction:
            return NoFriction(self)
        return LearntFriction(self) if self.learn_friction else StatedFriction(self)

    @property
    def boost(self) -> StartBoost | NoBoost:
        """Faster gains for a while where a joint begins or turns back."""
        return StartBoost(self) if self.gear_gains is None else NoBoost()

    @property
    def queue(self) -> DelayQueue:
        """Torques that do not act yet."""
        return DelayQueue(self.delay)

    @property
    def frames(self) -> LateFrames:
        """Frames that reach an inner loop late."""
        return LateFrames(self.rig)

    @functools.cached_property
    def fields(self) -> Fields:
        """Error and its rate, disturbance torque, torque needed a sample ago, states of the blocks.

        `impulse` is that of the predicted dry friction [N m s]; `begun` is 1 after the first
        sample.
        """
        return Fields(
            error=per_joint(),
            rate=per_joint(),
            disturbance=per_joint(role=TORQUE_ERROR),
            needed=per_joint(role=MODEL_TORQUE),
            impulse=per_joint(),
            queue=self.queue.fields,
            frames=self.frames.fields,
            friction=self.friction_model.fields,
            gears=self.gears.fields,
            boost=self.boost.fields,
            begun=scalars(),
        )

    def start(
        self,
        rig: Rig,
        pulses: ArrayLike,
        *,
        torque: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        **options: Any,
    ) -> Running:
        """This law as a running controller, as `Law.start`, from what is known of the arm at rest.

        Parameters
        ----------
        torque : (n,) array_like, optional
            Joint torque [N m] that holds the arm now. Its difference from h-hat, less what static
            friction explains, is the disturbance torque to begin with.
        friction : (2, n) array_like, optional
            Coulomb [N m] and viscous [N m s/rad] friction, motor side, that an earlier run learnt:
            `Running.friction`.

        Raises
        ------
        ValueError
            As `Law.start`; an unstable loop; a torque beyond the amplifier's, friction that
            `learnable` does not allow.

        Examples
        --------
        >>> from plant import puma560
        >>> from ctc import ComputedTorque
        >>> law = ComputedTorque(puma560.arm(), puma560.rig())
        >>> controller = law.start(puma560.rig(), (0, 0), friction=[(0.11, 0.15), (8e-4, 14e-4)])
        >>> controller.friction[0]
        array([0.11, 0.15])
        """
        running = super().start(rig, pulses, **options)
        n = self.arm.n
        state = self.fields.read(running.state, n)
        disturbance = state.disturbance
        friction_state = state.friction
        if torque is not None:
            centre = rig.cell_centre(pulses)
            disturbance = disturbance + unexplained(torque, self, running.rig, centre)
        if friction is not None:
            learns = isinstance(self.friction_model, LearntFriction)
            limit = self.learnable if learns else None
            coulomb, viscous = shares(friction, self.rig.drive, limit)
            friction_state = friction_state._replace(coulomb=coulomb, viscous=viscous)
        state = state._replace(disturbance=disturbance, friction=friction_state)
        running.begin(self.fields.write(n, **state._asdict()))
        return running

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coulomb [N m] and viscous [N m s/rad] friction (2, n), motor side; learnt or stated."""
        drive = self.rig.drive
        stated = np.array([drive.coulomb, drive.viscous])
        if not isinstance(self.friction_model, LearntFriction):
            return stated
        learnt = self.fields.read(state, self.arm.n).friction
        return stated * (1 + np.array([learnt.coulomb, learnt.viscous]))

    # -- the step ---------------------------------------------------------------------------------
    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: reference -> predict -> correct -> learn friction -> feed back.
        Source: paper Fig. 2.
        """
        n = self.arm.n
        settings = self.settings
        coupling = self.rig.drive.coupling
        before = self.fields.read(state, n)
        begun = before.begun

        # 1. Torque that the reference needs now.
        gears = self.gears.at(self, setpoint, before, dt)
        speed = coupling.shaft(setpoint.qd)
        load = gears.needed - self.rig.drive.rotor_torque(setpoint.qdd)
        friction = self.friction_model.at(before.friction, speed, load)
        needed = gears.needed + friction.needed

        # 2. Predict from the torque that really acted. The reference moved on while this torque
        # was held, so the needed torque is the mean of its last and its present value.
        deviation = gears.deviation(before, coupling)
        acted = self.frames.acted(before.frames, torque)
        pushed = acted - (before.needed + needed) / 2 - before.disturbance
        deviation, impulse = self._predicted(
            gears, friction, deviation, before.impulse, pushed, begun * dt
        )

        # 3. Correct by the part of the innovation beyond the dead zone of the counted cell.
        from_centre = setpoint.q - coupling.joint(deviation.angle) - rig.cell_centre(pulses)
        distance = begun * rig.position_in_pulses(from_centre)
        moving = ca.fabs(speed_share(self.rig, speed, settings.boost_speed))
        widest = settings.standing_dead_zone
        dead_zone = ca.fmin(self.dead_zone * (widest - (widest - 1) * moving), 1)
        innovation = coupling.shaft(rig.outside_cell(from_centre, pulses, dead_zone))
        # Nothing was predicted before the first sample: there the innovation shifts only the angle.
        jump = (1 - begun) * innovation
        deviation = deviation.with_angles(lambda angle: angle + jump)
        error = rig.position_in_pulses(coupling.joint(deviation.angle))
        boost = self.boost.factor(before.boost, moving, error)
        deviation, added = gears.corrected(deviation, begun * innovation, boost)
        disturbance = before.disturbance + coupling.joint_torque(added)

        # 4. Learn friction from the disturbance, where a joint turned back.
        learnt = self.friction_model.learn(before.friction, friction, needed, disturbance, dt)
        friction = learnt.friction
        needed = learnt.needed
        disturbance = learnt.disturbance

        # 5. Feed back the deviation at the instant at which the torque acts.
        ahead = deviation
        late = self.frames.delay
        if self.frames.fields.fields:
            pushed = torque - needed - disturbance
            ahead, _ = self._predicted(gears, friction, ahead, impulse, pushed, late)
        if self.delay:
            pushed = before.queue.commanded - needed - disturbance
            ahead, _ = self._predicted(gears, friction, ahead, impulse, pushed, dt)
        # The sample time limits the boosted bandwidth, but never below the bandwidth itself.
        bandwidth = ca.fmin(
            self.bandwidth * boost, ca.fmax(self.bandwidth, settings.boost_limit / dt)
        )
        holding = coupling.shaft_torque(needed + disturbance)
        ahead = braked(ahead, self.rig, holding, gears, self.bandwidth)
        # The torque against dry friction acts in the direction of the desired speed. This is the
        # reference's speed plus the speed at which the error should decay.
        desired = speed + bandwidth * ahead.angle / 2
        sliding = speed_share(self.rig, desired, settings.sliding_speed)
        # Extrapolate the needed torque to the middle of the sample in which the command acts.
        period = self.rig.period
        coming = begun * (0.5 + self.delay + late / period) * period / dt * (needed - before.needed)
        planned = coupling.shaft_torque(needed + coming + disturbance) + friction.level * sliding
        commanded = coupling.joint_torque(planned + gears.feedback(ahead, bandwidth, planned))

        turns = speed * (speed + dt * coupling.shaft(setpoint.qdd)) <= 0  # back, or at rest
        following = self.fields.write(
            n,
            error=coupling.joint(deviation.angle),
            rate=coupling.joint(deviation.rate),
            disturbance=disturbance,
            needed=needed,
            impulse=impulse,
            queue=self.queue.following(before.queue, commanded),
            frames=self.frames.following(torque),
            friction=learnt.memory,
            gears=gears.memory(deviation),
            boost=self.boost.following(before.boost, distance, turns, dt),
            begun=1,
        )
        return self.queue.acting(before.queue, commanded), following

    def _predicted(
        self,
        gears: RigidGears | ElasticGears,
        friction: ShaftFriction,
        deviation: Deviation,
        impulse: ca.SX,
        pushed: ca.SX,
        time: ca.SX,
    ) -> tuple[Deviation, ca.SX]:
        """Predict the deviation and the impulse of dry friction after `time`.

        `pushed` is the joint torque beyond the needed torque and the disturbance.
        """
        # The needed torque contains viscous friction at the reference's speed. The next
        # line adds the viscous friction that belongs to the deviation's rate.
        push = self.rig.drive.coupling.shaft_torque(pushed) + friction.viscous * deviation.rate
        return gears.moved(
            deviation, push, functools.partial(friction.impulse, impulse, time), time
        )
