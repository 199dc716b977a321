"""Computed torque from identified parameters: D-hat and h-hat are the arm's own. Source: paper Fig. 2."""

import dataclasses
import functools
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.laws.default_gains import default_bandwidth, known_gains
from ctc.laws.learnt_friction import HOLDS, learn, shares, unexplained
from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import correct, filter_gains, regulator_gains
from plant import Law, Rig, Setpoint
from plant.machine.friction import friction_impulse
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import array, signs
from plant.parts.part import number, part, structure
from plant.realtime.running import Running

_SLIDES, _BEGINS, _NEAR = 30.0, 10.0, 5.0
"""Speeds [pulses/s] from which on Coulomb friction is fed forward in full, and the start has all of its boost; and the
error [pulses] beyond which the boost is less in proportion: it would take the torque from limit to limit."""

_SWEEPS = 4
"""Over the joints, of the predicted friction; they start from the impulse of the sample before."""

_MOST, _SETTLES = 0.5, 10.0
"""Bandwidth times period, at most, of a boosted regulator; time constants of an unboosted one, in which it settles."""


@part
class ComputedTorque(ModelLaw):
    """tau = D-hat qdd_r + h-hat + friction + delta + J (k1 e + k2 edot): an observer that knows dry friction and cells.

    Once per sample an observer predicts the error e = q_r - q from the torque that was really applied, with D-hat,
    h-hat and friction as a set: a joint that sticks is predicted to stick. Only by what the counts show beyond a share
    of their quantisation cell it corrects the error, its rate, and a disturbance torque delta, joint by joint, with a
    Kalman filter's gains. The feedback is a linear-quadratic regulator's, with the inertia J that each joint feels,
    1 / (D^-1)_jj. Coulomb friction, fed forward along the desired speed, does not jump where the motion turns back.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float, optional
        Of the regulator [rad/s]: its poles have this magnitude. By default with an arm 360, since it does not say how
        well it is known; with an identification 145, or 100 where friction was identified too; at most 0.3 over the
        period, and less on its elastic gears, so that it is stable with 40 % to spare; `tune` finds others.
    observer_ratio : float
        Bandwidth of the observer, as a multiple of the regulator's.
    dead_zone : float, optional
        Share of the quantisation cell, 0 to 1, within which an innovation corrects nothing: more is less torque
        chatter, and slower to see what the model lacks. By default 0 with an arm, with an identification 0.2.
    friction : bool
        Know the friction of the rig: fed forward, and predicted.
    learn_friction : bool
        Learn, where joints turn back, by which share Coulomb and viscous friction differ from the rig's, at most
        `learnable`: `Running.friction` has what was learnt, `start` begins with it.
    learnable : float
        Largest share by which friction may be learnt to differ, 0 to 0.99.
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
        found = self.arm
        if self.bandwidth is None:
            faster = functools.partial(ComputedTorque, getattr(found, "arm", found))
            chosen = default_bandwidth(found, self.rig, lambda rig, bandwidth: faster(rig, bandwidth=bandwidth))
            object.__setattr__(self, "bandwidth", chosen)
        if self.dead_zone is None:
            object.__setattr__(self, "dead_zone", known_gains(found)[1])
        settles = self.start_time is None
        if settles:
            object.__setattr__(self, "start_time", 1.0)  # for now
        super().__post_init__()
        positive = ("bandwidth", "observer_ratio", "start_boost", "start_time")
        signs(self, positive=positive, not_negative=("dead_zone", "learnable"))
        for name, most, usual in (("dead_zone", 1, 0.2), ("learnable", 0.99, 0.4)):
            if getattr(self, name) > most:
                raise ValueError(f"{name} must be a share, 0 to {most}; got {getattr(self, name):g}. {usual} is usual.")
        if settles:
            object.__setattr__(self, "start_time", _SETTLES / self.bandwidth)
        if self.delay not in (0, 1):
            raise ValueError(f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another design.")

    def sliding(self) -> Law:
        """As of every law; learning nothing, which it does where joints turn back alone."""
        return dataclasses.replace(super().sliding(), learn_friction=False)

    @property
    def _learns(self) -> bool:
        return self.friction and self.learn_friction

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """On the reference with nothing applied yet; every joint has all of its boost; no sample taken."""
        return np.concatenate([np.zeros((5 + self.delay + 5 * self._learns) * n), np.ones(n), [0.0]])

    def start(
        self, rig: Rig, pulses: ArrayLike, *, torque: ArrayLike | None = None, friction: ArrayLike | None = None,
        **options: Any,
    ) -> Running:  # fmt: skip
        """This law as a running controller, as `Law.start`, that begins with what is known of the arm at rest.

        Parameters
        ----------
        torque : (n,) array_like, optional
            Joint torque [N m] that holds the arm now: what it differs from h-hat by more than static friction explains
            is the disturbance torque to begin with.
        friction : (2, n) array_like, optional
            Coulomb [N m] and viscous [N m s/rad] friction, motor side, that was learnt before: `Running.friction`.

        Raises
        ------
        ValueError
            As `Law.start`; an unstable loop; a torque beyond the amplifier's, friction that `learnable` does not allow.

        Examples
        --------
        >>> from plant import puma560
        >>> from ctc import ComputedTorque
        >>> law = ComputedTorque(puma560.arm(), puma560.rig())
        >>> controller = law.start(puma560.rig(), (0, 0), friction=[(0.11, 0.15), (8e-4, 14e-4)])
        >>> controller.friction[0]
        array([0.11, 0.15])
        """
        running, n = super().start(rig, pulses, **options), self.arm.n
        known = np.zeros(len(running.state))
        if torque is not None:
            held, q = array("torque", torque, (n,), advice=HOLDS), rig.cell_centre(pulses)
            weight = self.arm.h(q, np.zeros(n)) - np.ravel(self.rig.spring_torque(q))
            known[2 * n : 3 * n] = unexplained(held, weight, rig.drive, self.rig.drive if self.friction else None)
        if friction is not None:
            learnt = array("friction", friction, (2, n), advice="Give that of a running controller, motor side.")
            known[self._learnt(n)] = shares(learnt, self.rig.drive, self.learnable if self._learns else None).ravel()
        running.begin(running.state + known)
        return running

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coulomb [N m] and viscous [N m s/rad] friction (2, n), motor side, as learnt in a state of the law."""
        differs = state[self._learnt(self.arm.n)].reshape(2, -1) if self._learns else 0.0
        return np.array([self.rig.drive.coulomb, self.rig.drive.viscous]) * (1 + differs)

    def _learnt(self, n: int) -> slice:
        """Where in the state the learnt shares of Coulomb and viscous friction are."""
        return slice((5 + self.delay) * n, (7 + self.delay) * n)

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
            heading, shaft = self._share(speed, _SLIDES), coupling.shaft_torque(delta)
            known, shaft, recent = learn((coulomb, drag), recent, stated, shaft, heading, self.learnable, dt)
            level = level + stated[0] * (known[0] - coulomb)
            needed, delta = needed + coupling.joint_torque(stated[1] * (known[1] - drag)), coupling.joint_torque(shaft)
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

    def _share(self, speed: ca.SX, full: float) -> ca.SX:
        """Speed of the shafts (n, 1) over a stated one [pulses/s], within -1 and 1."""
        pulses = self.rig.encoder.position_in_pulses(ca.fabs(self.rig.drive.gear) * speed) / full
        return ca.fmin(ca.fmax(pulses, -1), 1)
