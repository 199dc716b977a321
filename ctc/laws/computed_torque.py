"""Computed torque from identified parameters: D-hat and h-hat are the arm's own.
Source: paper Fig. 2.
"""

import dataclasses
import functools
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.laws.default_gains import default_bandwidth, known_gains
from ctc.laws.gear_gains import gear_gains
from ctc.laws.gears import Deviation, braked, gears_along, speed_share
from ctc.laws.model_law import ModelLaw
from ctc.laws.turning_back import boosted, fresh_and_swings, learn, shares, unexplained
from plant import Law, Rig
from plant.laws.law import Setpoint
from plant.machine.friction import friction_impulse
from plant.mechanics.symmetric_inverse import Inverse
from plant.parts.arguments import signs
from plant.parts.part import number, part, structure
from plant.realtime.running import Running

# Speeds [pulses/s] from which on Coulomb friction is fed forward in full, and the start has all of
# its boost.
_SLIDES = 30.0
_BEGINS = 10.0

# By which the dead zone is wider for joints whose reference stands; sweeps of its predicted
# friction.
_STANDING = 2.5
_SWEEPS = 4

_MOST = 0.5  # bandwidth times period, of a boosted regulator


@part
class ComputedTorque(ModelLaw):
    """tau = D-hat qdd_r + h-hat + friction + delta + L J (k1 e + k2 edot): an observer that knows
    friction and cells.

    Once per sample an observer predicts the error e = q_r - q from the torque that was really
    applied, with D-hat, h-hat and friction as a set: a joint that sticks is predicted to stick.
    Only by what the counts show beyond a share of their quantisation cell it corrects the error,
    its rate, and a disturbance torque delta, joint by joint, with a Kalman filter's gains. The
    feedback is a linear-quadratic regulator's, with the inertia J that each joint feels, 1 /
    (D^-1)_jj, on rigid gears carrying the joints after it along (D = L P L^T). Coulomb friction is
    fed forward without jumps. On elastic gears, stated or identified, links are predicted apart
    from motors, which follow q_r.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float, optional
        Of the regulator [rad/s]: its poles have this magnitude. By default with an arm, which does
        not say how well it is known, 360; with an identification 145, with friction identified too
        120, or more where counts are finer than f and friction are known; with gears stated 100; at
        most 0.3 over the period, less on elastic gears.
    observer_ratio : float, optional
        Bandwidth of the observer, as a multiple of the regulator's: 1.3, or 1 with friction
        identified, rigid gears.
    dead_zone : float, optional
        Share of the quantisation cell, 0 to 1, within which an innovation corrects nothing (2.5
        times that where the reference stands): more is quieter, and slower to see what the model
        lacks. By default 0 with an arm, with an identification 0.2, where friction was identified
        too 0.45 (less the more bandwidth that takes), with gears 0.4.
    friction : bool
        Know the friction of the rig: fed forward, and predicted.
    learn_friction, learnable : bool, float
        Learn, where joints turn back, by which share, at most `learnable` (0 to 0.99), Coulomb and
        viscous friction differ from the rig's: `Running.friction` has what was learnt, `start`
        begins with it.
    start_boost, start_time : float, optional
        Where a joint begins to move or turns back, or counts show what the model lacks, its
        regulator is `start_boost` times as fast, the observer the square root of that, both with
        the time constant `start_time` [s]: 4 and 10 over the bandwidth, or with friction
        identified, rigid gears 2.7 and 40; not once they swing, nor on predicted gears.
    measured : bool
        Evaluate D-hat and h-hat at the observed q and qd instead of the reference.
    delay : int
        Samples, 0 or 1, by which the torque acts later than its own sample (a controller that needs
        the whole period to compute); the observer predicts across it.
    gear_gains : (m,) numpy.ndarray, optional
        Worked out from the rest; None on rigid gears, with backlash, too fast for the period,
        encoders on the links.

    Raises
    ------
    ValueError
        An arm whose D(q) does not exceed the motors' inertia everywhere, joints that do not match,
        poles not positive.

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
    learn_friction: bool = structure(bool, default=True)
    learnable: float = number((), default=0.4)
    measured: bool = structure(bool, default=False)
    delay: int = structure(default=0)
    gear_gains: Any = number(("m",), default=None)

    def __post_init__(self) -> None:
        found = self.arm
        if self.bandwidth is None:
            faster = functools.partial(ComputedTorque, getattr(found, "arm", found))
            chosen = default_bandwidth(
                found, self.rig, lambda rig, bandwidth: faster(rig, bandwidth=bandwidth)
            )
            object.__setattr__(self, "bandwidth", chosen)
        known = known_gains(found, self.rig)
        for name in ("dead_zone", "observer_ratio", "start_boost"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(known, name))
        settles = self.start_time is None
        if settles:
            object.__setattr__(self, "start_time", 1.0)  # for now
        object.__setattr__(self, "gear_gains", None)  # for now, too
        super().__post_init__()
        positive = ("bandwidth", "observer_ratio", "start_boost", "start_time")
        signs(self, positive=positive, not_negative=("dead_zone", "learnable"))
        for name, most, usual in (("dead_zone", 1, 0.2), ("learnable", 0.99, 0.4)):
            if getattr(self, name) > most:
                raise ValueError(
                    f"{name} must be a share, 0 to {most}; got {getattr(self, name):g}. {usual} is"
                    " usual."
                )
        if settles:
            object.__setattr__(self, "start_time", known.start_time / self.bandwidth)
        if self.delay not in (0, 1):
            raise ValueError(
                f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another"
                " design."
            )
        gains = gear_gains(self.arm, self.rig, self.bandwidth, self.observer_ratio * self.bandwidth)
        object.__setattr__(self, "gear_gains", gains)

    def sliding(self) -> Law:
        """As of every law; learning nothing, which it does where joints turn back alone."""
        return dataclasses.replace(super().sliding(), learn_friction=False)

    @property
    def _learns(self) -> bool:
        return self.friction and self.learn_friction

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """On the reference with nothing applied yet; every joint has all of its boost; no sample
        taken.
        """
        rows = 5 + self.delay + 5 * self._learns + (2 if self.gear_gains is None else 4)
        return np.concatenate([np.zeros(rows * n), np.ones(n), [0.0]])

    def start(
        self,
        rig: Rig,
        pulses: ArrayLike,
        *,
        torque: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        **options: Any,
    ) -> Running:
        """This law as a running controller, as `Law.start`, that begins with what is known of the
        arm at rest.

        Parameters
        ----------
        torque : (n,) array_like, optional
            Joint torque [N m] that holds the arm now: what it differs from h-hat by more than
            static friction explains is the disturbance torque to begin with.
        friction : (2, n) array_like, optional
            Coulomb [N m] and viscous [N m s/rad] friction, motor side, that was learnt before:
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
        known = np.zeros(len(running.state))
        if torque is not None:
            known[2 * n : 3 * n] = unexplained(torque, self, running.rig, rig.cell_centre(pulses))
        if friction is not None:
            known[self._learnt(n)] = shares(
                friction, self.rig.drive, self.learnable if self._learns else None
            ).ravel()
        running.begin(running.state + known)
        return running

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coulomb [N m] and viscous [N m s/rad] friction (2, n), motor side, as learnt in a
        state of the law.
        """
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
        """One sample: what acted -> predict -> correct -> feed back -> torque.
        Source: paper Fig. 2.
        """
        n = self.arm.n
        drive = self.rig.drive
        e, rate, delta, before, impulse, *pending, fresh = (
            state[i * n : (i + 1) * n] for i in range((state.numel() - 1) // n)
        )
        begun = state[-1]
        coupling = drive.coupling
        rigid = self.gear_gains is None
        pending, kept = (pending[:-2], pending[-2:]) if rigid else (pending[:-4], pending[-4:])
        if self._learns:
            pending, (coulomb, drag, *recent) = (
                pending[: self.delay],
                pending[self.delay : self.delay + 5],
            )
        gears, needed, link = gears_along(
            self, setpoint, (e, rate), [] if rigid else kept, begun, dt
        )
        speed = coupling.shaft(setpoint.qd)
        viscous, level = ca.SX.zeros(n), ca.SX.zeros(n)
        if self.friction:
            viscous, level = drive.joint_viscous(), drive.joint_coulomb(speed)
            stated = level, viscous * speed
            if self._learns:
                viscous = viscous * (1 + drag)
                level = level * (1 + coulomb)
            needed = needed + coupling.joint_torque(viscous * speed + drive.joint_offset())

        def predicted(
            deviation: Deviation, impulse: ca.SX, acted: ca.SX, time: ca.SX
        ) -> tuple[Deviation, ca.SX]:
            """Deviation after `time` under a torque beyond what was needed, and the impulse of
            friction (n, 1).
            """

            def friction(mobility: Inverse, free: ca.SX) -> ca.SX:
                held = friction_impulse(
                    mobility, -mobility.alone * (speed - free), impulse, time * level, _SWEEPS
                )
                # not even its slope is left without friction, at rest
                return ca.if_else(level > 0, held, 0)

            return gears.moved(
                deviation,
                coupling.shaft_torque(acted - delta) + viscous * deviation[1],
                friction,
                time,
            )

        # The reference moved on while the torque was held: what was needed is the mean of then and
        # now.
        deviation = coupling.shaft(e), coupling.shaft(rate), *([] if rigid else kept[:2])
        deviation, impulse = predicted(
            deviation, impulse, torque - (before + needed) / 2, begun * dt
        )
        outside = setpoint.q - coupling.joint(deviation[0]) - rig.cell_centre(pulses)
        seen = begun * rig.position_in_pulses(outside)
        begins = ca.fabs(speed_share(self.rig, speed, _BEGINS))
        share = ca.fmin(self.dead_zone * (_STANDING - (_STANDING - 1) * begins), 1)
        outside = coupling.shaft(rig.outside_cell(outside, pulses, share))
        first = (1 - begun) * outside, 0  # where it begins, the first counts alone say
        deviation = tuple(each + first[i % 2] for i, each in enumerate(deviation))
        distance = rig.position_in_pulses(coupling.joint(deviation[0]))
        boost = boosted(self.start_boost, fresh * begins, distance, kept[1]) if rigid else 1
        deviation, found = gears.corrected(deviation, begun * outside, boost)
        delta = delta + coupling.joint_torque(found)

        learnt = []
        if self._learns:
            heading = speed_share(self.rig, speed, _SLIDES)
            shaft = coupling.shaft_torque(delta)
            known, shaft, recent = learn(
                (coulomb, drag), recent, stated, shaft, heading, self.learnable, dt
            )
            level = level + stated[0] * (known[0] - coulomb)
            needed = needed + coupling.joint_torque(stated[1] * (known[1] - drag))
            delta = coupling.joint_torque(shaft)
            learnt = [*known, *recent]

        # With a delay, what is commanded now acts one sample later: predict the error to then.
        ahead = (
            predicted(deviation, impulse, pending[0] - needed, dt)[0] if self.delay else deviation
        )
        bandwidth = ca.fmin(self.bandwidth * boost, ca.fmax(self.bandwidth, _MOST / dt))
        ahead = braked(
            ahead, self.rig, coupling.shaft_torque(needed + delta), gears, self.bandwidth
        )
        sliding = speed_share(self.rig, speed + bandwidth * ahead[0] / 2, _SLIDES)
        # What is needed moves on to the middle of the sample in which it acts.
        coming = begun * (0.5 + self.delay) * self.rig.period / dt * (needed - before)
        planned = coupling.shaft_torque(needed + coming + delta) + level * sliding
        wanted = coupling.joint_torque(planned + gears.feedback(ahead, bandwidth, planned))
        turns = speed * (speed + dt * coupling.shaft(setpoint.qdd)) <= 0  # back, or from rest
        after = fresh_and_swings(seen, turns, fresh, kept[:2], dt, self)
        fresh, *kept = after if rigid else (fresh, *deviation[2:], *link)
        acting, later = (pending[0], [wanted]) if self.delay else (wanted, [])
        e, rate = (coupling.joint(each) for each in deviation[:2])
        return acting, ca.vertcat(e, rate, delta, needed, impulse, *later, *learnt, *kept, fresh, 1)
