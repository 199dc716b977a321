"""Computed torque from identified parameters: D-hat and h-hat are the arm's own. Source: paper Fig. 2."""

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import correct, filter_gains, regulator_gains
from identification import Identification
from plant import Guards, Law, Rig, Setpoint
from plant.analysis.sampled_loops import SampledLoops
from plant.machine.friction import friction_impulse
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import array, known_options, signs
from plant.parts.part import number, part, structure
from plant.realtime.running import Running

_UNKNOWN, _KNOWN, _FRICTION_TOO = (360.0, 0.0), (145.0, 0.2), (100.0, 0.2)
"""Bandwidth [rad/s] and dead zone by what is known: nothing but f; f with a covariance; friction as well."""

_SAMPLED = 0.3
"""Bandwidth times period, at most, of one that is chosen."""

_SPARE, _SLOWER = 1.4, 0.8
"""Share of the bandwidth that a stable one has to spare, and by which one that has not is lowered."""

_STIFFER = 1.0, 1.2, 1.5, 2.0, 3.0, 5.0
"""Resonances, in shares of the stated, at which it has to be stable: a fast observer can be stable on soft gears, but
no longer where they are a little stiffer."""

_SLIDES, _BEGINS = 30.0, 10.0
"""Speeds [pulses/s] from which on Coulomb friction is fed forward in full, and the start has all of its boost."""

_NEAR = 5.0
"""Error [pulses] beyond which the boost is less in proportion: it would take the torque from limit to limit."""

_SWEEPS = 4
"""Over the joints, of the predicted friction; they start from the impulse of the sample before."""

_MOST, _SETTLES = 0.5, 10.0
"""Bandwidth times period, at most, of a boosted regulator; time constants of an unboosted one, in which it settles."""

_LEARNS, _RECENT = 40.0, 0.4
"""Rate [1/s] at which friction is learnt where a joint turns back, and time constant of what was before [s]."""

_TINY = 1e-9
"""Beside the square of friction torques [N m], where there is no friction."""

_HOLDS = "Give the joint torque that holds the arm now [N m]."
_LEVELS = "Give Coulomb [N m] and viscous [N m s/rad] friction, motor side, as controller.friction."

_SLOWEST = 5.0
"""Bandwidth [rad/s] below which none is tried."""


@part
class ComputedTorque(ModelLaw):
    """tau = D-hat qdd_r + h-hat + friction + delta + J (k1 e + k2 edot): an observer that knows dry friction and cells.

    Once per sample an observer predicts the error e = q_r - q from the torque that was really applied, after the
    amplifier's limit, with D-hat, h-hat and friction as a set: a joint that sticks is predicted to stick. Only by what
    the counts show beyond a share of their quantisation cell it corrects the error, its rate, and a disturbance torque
    delta, joint by joint, with the gains of a Kalman filter. The feedback is that of a linear-quadratic
    regulator, with the inertia J that each joint feels, 1 / (D^-1)_jj. Coulomb friction is fed forward along the speed
    that is desired, qd_r + bandwidth e / 2, in proportion below 30 pulses/s, so that it does not jump where the motion
    turns back.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float, optional
        Of the regulator [rad/s]: its poles have this magnitude. By default with an arm, which does not say how well it
        is known, 360; with an identification 145, or 100 where friction was identified too; at most 0.3 over the
        period, and on its elastic gears one of less that is stable with 40 % to spare; `tune` finds others.
    observer_ratio : float
        Bandwidth of the observer, as a multiple of the regulator's.
    dead_zone : float, optional
        Share of the quantisation cell, 0 to 1, within which an innovation corrects nothing: more is less torque
        chatter, and slower to see what the model lacks. By default 0 with an arm, with an identification 0.2.
    friction : bool
        Know the friction of the rig: fed forward, and predicted.
    learn_friction : bool
        Learn, while the arm runs, by which share Coulomb and viscous friction differ from the rig's: where a joint
        turns back, what turns its sign is friction. Reading, saving, beginning with it: `Running.friction`, `start`.
    learnable : float
        Largest such share, 0 to below 1.
    start_boost, start_time : float
        Where a joint begins to move or turns back, its regulator is `start_boost` times as fast, the observer the
        square root of that, and both settle with the time constant `start_time` [s], by default 10 over the bandwidth:
        until it breaks loose, static friction hides what gravity is off, and what friction is off changes its sign.
    measured : bool
        Evaluate D-hat and h-hat at the observed q and qd instead of the reference.
    delay : int
        Samples, 0 or 1, by which the torque acts later than its own sample (a controller that needs the whole period
        to compute); the observer predicts across it.

    Raises
    ------
    ValueError
        An arm whose D(q) does not exceed the motors' own inertia everywhere (no feedback would be stable), joints that
        do not match, poles that are not positive.

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
    observer_ratio: float = number((), default=1.3)
    dead_zone: float = number((), default=None)
    start_boost: float = number((), default=4.0)
    start_time: float = number((), default=None)
    friction: bool = structure(bool, default=True)
    learn_friction: bool = structure(bool, default=True)
    learnable: float = number((), default=0.4)
    measured: bool = structure(bool, default=False)
    delay: int = structure(default=0)

    def __post_init__(self) -> None:
        bandwidth, dead_zone = _known(self.arm)
        if self.bandwidth is None:
            object.__setattr__(self, "bandwidth", _bandwidth(self.arm, self.rig, bandwidth))
        if self.dead_zone is None:
            object.__setattr__(self, "dead_zone", dead_zone)
        settles = self.start_time is None
        if settles:
            object.__setattr__(self, "start_time", 1.0)
        super().__post_init__()
        positive = ("bandwidth", "observer_ratio", "start_boost", "start_time")
        signs(self, positive=positive, not_negative=("dead_zone", "learnable"))
        if self.dead_zone > 1:
            raise ValueError(f"dead_zone must be a share of the cell, 0 to 1; got {self.dead_zone:g}. 0.2 is usual.")
        if self.learnable >= 1:
            raise ValueError(f"learnable must be a share below 1; got {self.learnable:g}. 0.4 is usual.")
        if settles:
            object.__setattr__(self, "start_time", _SETTLES / self.bandwidth)
        if self.delay not in (0, 1):
            raise ValueError(f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another design.")

    @property
    def _learns(self) -> bool:
        return self.friction and self.learn_friction

    def sliding(self) -> Law:
        """As of every law; learning nothing, which it does where joints turn back alone."""
        return dataclasses.replace(super().sliding(), learn_friction=False)  # type: ignore[call-arg]  # of this class

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """On the reference with nothing applied yet; every joint has all of its boost; no sample taken."""
        return np.concatenate([np.zeros((5 + self.delay + 5 * self._learns) * n), np.ones(n), [0.0]])

    @known_options
    def start(
        self, rig: Rig, pulses: ArrayLike, *, torque: ArrayLike | None = None, friction: ArrayLike | None = None,
        guards: Guards | None = Guards(), torque_limit: ArrayLike | None = None,  # noqa: B008 - frozen
    ) -> Running:  # fmt: skip
        """This law as a running controller, as `Law.start`, that begins with what is known of the arm at rest.

        Parameters
        ----------
        rig : Rig
        pulses : (n,) array_like
        torque : (n,) array_like, optional
            Joint torque [N m] that holds the arm now: what it differs from ĥ by more than static friction explains is
            the disturbance torque to begin with.
        friction : (2, n) array_like, optional
            Coulomb [N m] and viscous [N m s/rad] friction, motor side, that was learnt before: `Running.friction`.
        guards : Guards or None
        torque_limit : (n,) array_like, optional

        Raises
        ------
        ValueError
            As `Law.start`; an unstable loop; a torque beyond the amplifier's, friction that `learnable` does not allow.

        Examples
        --------
        >>> from plant import puma560
        >>> from ctc import ComputedTorque
        >>> law = ComputedTorque(puma560.arm(), puma560.rig())
        >>> controller = law.start(puma560.rig(), (0, 0), friction=[(0.11, 0.09), (8e-4, 14e-4)])
        >>> controller.friction[0]
        array([0.11, 0.09])
        """
        running = super().start(rig, pulses, guards=guards, torque_limit=torque_limit)
        n, known = self.arm.n, np.zeros(len(running.state))
        if torque is not None:
            known[2 * n : 3 * n] = self._lacking(rig, running.pulses, array("torque", torque, (n,), advice=_HOLDS))
        if friction is not None:
            known[self._learnt(n)] = self._differs(array("friction", friction, (2, n), advice=_LEVELS)).ravel()
        running.begin(running.state + known)
        return running

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coulomb [N m] and viscous [N m s/rad] friction (2, n), motor side, as learnt in a state of the law."""
        drive, n = self.rig.drive, self.arm.n
        differs = state[self._learnt(n)].reshape(2, n) if self._learns else 0.0
        return np.array([drive.coulomb, drive.viscous]) * (1 + differs)

    def _learnt(self, n: int) -> slice:
        """Where in the state the learnt shares of Coulomb and viscous friction are."""
        return slice((5 + self.delay) * n, (7 + self.delay) * n)

    def _differs(self, friction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share by which friction, Coulomb and viscous (2, n), differs from the rig's."""
        stated = np.array([self.rig.drive.coulomb, self.rig.drive.viscous])
        differs = np.divide(friction, stated, out=np.where(friction == stated, 1.0, np.inf), where=stated > 0) - 1
        if not (self._learns and (np.abs(differs) <= self.learnable * (1 + 1e-9)).all()):
            allowed = f"within {self.learnable:.0%} of the rig's" if self._learns else "left out where none is learnt"
            raise ValueError(f"friction must be {allowed}; got {friction.tolist()}, the rig's are {stated.tolist()}.")
        return differs

    def _lacking(self, rig: Rig, pulses: NDArray[np.float64], torque: NDArray[np.float64]) -> NDArray[np.float64]:
        """Torque (n,) by which what holds the arm exceeds what model and static friction explain."""
        drive, q = self.rig.drive, rig.cell_centre(pulses)
        if (np.abs(drive.coupling.shaft_torque(torque)) > rig.drive.torque_limit()).any():
            limit = rig.drive.torque_limit().tolist()
            raise ValueError(f"torque must be within the amplifier's {limit} N m; got {torque.tolist()}. {_HOLDS}")
        weight = self.arm.h(q, np.zeros(self.arm.n)) - np.ravel(self.rig.spring_torque(q))
        shaft = drive.coupling.shaft_torque(torque - weight)
        level = drive.joint_coulomb() if self.friction else 0.0
        return drive.coupling.joint_torque(shaft - np.clip(shaft, -level, level))

    def torque_errors(self, n: int) -> tuple[range, ...]:
        """The disturbance torque."""
        return (range(2 * n, 3 * n),)

    def model_torques(self, n: int) -> tuple[range, ...]:
        """What the model needed in the sample before."""
        return (range(3 * n, 4 * n),)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """One sample: what acted -> predict -> correct -> feed back -> torque. Source: paper Fig. 2."""
        n, model, f, drive = self.arm.n, self.arm.dynamics, self.arm.f, self.rig.drive
        e, rate, delta, before, impulse, *pending, fresh = (
            state[i * n : (i + 1) * n] for i in range(6 + self.delay + 5 * self._learns)
        )
        begun, coupling = state[-1], drive.coupling
        if self._learns:
            pending, (coulomb, drag, *recent) = pending[: self.delay], pending[self.delay :]
        q, qd = (setpoint.q - e, setpoint.qd - rate) if self.measured else (setpoint.q, setpoint.qd)
        D, speed = model.D(q, f), coupling.shaft(setpoint.qd)
        mobility = inverse(coupling.shaft_inertia(D))
        viscous, level, needed = ca.SX.zeros(n), ca.SX.zeros(n), D @ setpoint.qdd + self.h(q, qd)
        if self.friction:
            viscous, level = drive.joint_viscous(), drive.joint_coulomb(speed)
            stated = level, viscous * speed
            if self._learns:
                viscous, level = viscous * (1 + drag), level * (1 + coulomb)
            needed = needed + coupling.joint_torque(viscous * speed + drive.joint_offset())

        def predicted(e: ca.SX, rate: ca.SX, impulse: ca.SX, acted: ca.SX, time: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
            """Error and rate after `time` under a torque beyond what was needed, and the impulse of friction (n, 1)."""
            pushing = coupling.shaft_torque(acted - delta) + viscous * coupling.shaft(rate)
            free = rate - time * coupling.joint(mobility.solve(pushing))
            sliding = speed - coupling.shaft(free)
            held = friction_impulse(mobility, -mobility.alone * sliding, impulse, time * level, _SWEEPS)
            impulse = ca.if_else(level > 0, held, 0)  # not even its slope is left without friction, at rest
            after = free - coupling.joint(mobility.solve(impulse))
            return e + time * (rate + after) / 2, after, impulse

        # The reference moved on while the torque was held: what was needed is the mean of then and now.
        e, rate, impulse = predicted(e, rate, impulse, torque - (before + needed) / 2, begun * dt)
        outside = rig.outside_cell(setpoint.q - e - rig.cell_centre(pulses), pulses, self.dead_zone)
        e, outside = e + (1 - begun) * outside, begun * outside  # where it begins, the first counts alone say
        near = _NEAR / ca.fmax(ca.fabs(rig.position_in_pulses(e)), _NEAR)
        boost = 1 + (self.start_boost - 1) * fresh * ca.fabs(self._share(speed, _BEGINS)) * near
        gains = filter_gains(self.observer_ratio * self.bandwidth * ca.sqrt(boost), dt)
        e, rate, found = correct(e, rate, 0, outside, gains, dt)
        delta = delta + coupling.joint_torque(mobility.alone * coupling.shaft(found))

        learnt = []
        if self._learns:
            known, delta, recent = self._learn((coulomb, drag), recent, stated, coupling.shaft_torque(delta), speed, dt)
            level = level + stated[0] * (known[0] - coulomb)
            needed, delta = needed + coupling.joint_torque(stated[1] * (known[1] - drag)), coupling.joint_torque(delta)
            learnt = [*known, *recent]

        # With a delay, what is commanded now acts one sample later: predict the error to then.
        ahead = predicted(e, rate, impulse, pending[0] - needed, dt)[:2] if self.delay else (e, rate)
        bandwidth = ca.fmin(self.bandwidth * boost, ca.fmax(self.bandwidth, _MOST / dt))
        stiffness, damping = regulator_gains(bandwidth, dt)
        error, error_rate = (coupling.shaft(each) for each in ahead)
        # Far off, it comes back no faster than half of the torque that is left can brake: v^2 = 2 a e.
        limit = ca.fabs(drive.torque_limit())
        left = limit - ca.fabs(coupling.shaft_torque(needed + delta))
        braking = ca.fmax(left / 2, limit / 20) * mobility.diagonal
        reach = 4 * braking / self.bandwidth**2
        error = error / ca.sqrt(ca.fmax(ca.fabs(error) / reach, 1))
        sliding = self._share(speed + bandwidth * error / 2, _SLIDES)
        feedback = mobility.alone * (stiffness * error + damping * error_rate) + level * sliding
        wanted = needed + delta + coupling.joint_torque(feedback)
        begins = speed * (speed + dt * coupling.shaft(setpoint.qdd)) <= 0  # from rest, or where it turns back
        fresh = ca.if_else(begins, 1, fresh * ca.exp(-dt / self.start_time))
        acting, coming = (pending[0], [wanted]) if self.delay else (wanted, [])
        return acting, ca.vertcat(e, rate, delta, needed, impulse, *coming, *learnt, fresh, 1)

    def _learn(
        self, known: tuple[ca.SX, ca.SX], recent: list[ca.SX], stated: tuple[ca.SX, ca.SX], delta: ca.SX, speed: ca.SX,
        dt: ca.SX,
    ) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:  # fmt: skip
        """Shares of Coulomb and viscous friction, delta without what they took over, and what was of late.

        Of late, while it moved: the direction, viscous friction, and delta. Where the direction turns against it, what
        turned in delta is projected on what turned in Coulomb and viscous friction, (n, 1) each on the shafts.
        """
        heading = self._share(speed, _SLIDES)
        turned = heading - recent[0]
        changes = stated[0] * turned, stated[1] - recent[1]
        rate = _LEARNS * ca.fabs(heading) * ca.fmax(ca.fabs(turned) - 1, 0)  # a start from rest turns nothing
        step = (1 - ca.exp(-rate * dt)) * (delta - recent[2]) / (changes[0] ** 2 + changes[1] ** 2 + _TINY)
        following = [ca.fmin(ca.fmax(was + step * change, -self.learnable), self.learnable)
                     for was, change in zip(known, changes, strict=True)]  # fmt: skip
        coulomb, drag = following[0] - known[0], following[1] - known[1]
        delta = delta - stated[0] * heading * coulomb - stated[1] * drag
        before = recent[0], recent[1], recent[2] - stated[0] * recent[0] * coulomb - recent[1] * drag
        follow = ca.fabs(heading) * (1 - ca.exp(-dt / _RECENT))
        now = heading, stated[1], delta
        return following, delta, [was + follow * (new - was) for was, new in zip(before, now, strict=True)]

    def _share(self, speed: ca.SX, full: float) -> ca.SX:
        """Speed of the shafts (n, 1) over a stated one [pulses/s], within -1 and 1."""
        pulses = self.rig.encoder.position_in_pulses(ca.fabs(self.rig.drive.gear) * speed) / full
        return ca.fmin(ca.fmax(pulses, -1), 1)


def _known(found: Any) -> tuple[float, float]:
    """Bandwidth [rad/s] and dead zone by what is known of an arm."""
    if not isinstance(found, Identification) or found.covariance is None:
        return _UNKNOWN
    friction = any(name.startswith(("drive.viscous", "drive.coulomb")) for name in found.fit.unknown)
    return _FRICTION_TOO if friction else _KNOWN


def _bandwidth(found: Any, rig: Rig | None, bandwidth: float) -> float:
    """Bandwidth [rad/s] of a law that is given none: at most this, for the period and on the gears of its rig."""
    if isinstance(found, Identification) and rig is None:
        rig = found.rig
    if not isinstance(rig, Rig):  # refused with the other fields
        return bandwidth
    bandwidth = min(bandwidth, _SAMPLED / rig.period)
    if not isinstance(found, Identification):
        return bandwidth
    if rig.drive.elasticity is None:
        return bandwidth
    pose = np.zeros(rig.n) if found.records[0].reference is None else found.records[0].reference(np.zeros(1)).q[0]
    while bandwidth > _SLOWEST:
        law = ComputedTorque(found.arm, rig, bandwidth=_SPARE * bandwidth)
        loops, gears = SampledLoops(found.arm, rig, law, pose), rig.drive.elasticity
        stiffer = (
            {
                f"drive.elasticity.{name}[{i}]": value * factor**power
                for name, power in (("stiffness", 2), ("damping", 1))
                for i, value in enumerate(getattr(gears, name))
            }
            for factor in _STIFFER
        )
        if all(loops.unstable_pole(numbers) is None for numbers in stiffer):
            return bandwidth
        bandwidth *= _SLOWER
    raise ValueError("no bandwidth is stable on these elastic gears with 40 % to spare; take what tune finds.")
