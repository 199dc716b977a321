"""Computed torque from identified parameters: D-hat and h-hat are the arm's own. Source: paper Fig. 2."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import correct, filter_gains, regulator_gains
from identification import Identification
from plant import Rig, Setpoint
from plant.analysis.sampled_loops import SampledLoops
from plant.machine.friction import friction_impulse
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import signs
from plant.parts.part import number, part, structure

_UNKNOWN, _KNOWN, _FRICTION_TOO = 300.0, 140.0, 95.0
"""Bandwidth [rad/s] by what is known: nothing but f; f with a covariance; friction as well."""

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

_MOST = 0.5
"""Bandwidth times period, at most, of a regulator that is boosted."""

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
        is known, 300; with an identification 140, or 95 where friction was identified too; at most 0.3 over the
        period, and on its elastic gears one of less that is stable with 40 % to spare; `tune` finds others.
    observer_ratio : float
        Bandwidth of the observer, as a multiple of the regulator's.
    dead_zone : float
        Share of the quantisation cell, 0 to 1, within which an innovation corrects nothing: more is less torque
        chatter, and slower to see what the model lacks.
    friction : bool
        Know the friction of the rig: fed forward, and predicted.
    start_boost, start_time : float
        Where a joint begins to move or turns back, its regulator is `start_boost` times as fast, the observer the
        square root of that, and both settle with the time constant `start_time` [s]: until it breaks loose, static
        friction hides what gravity is off, and what friction is off changes its sign.
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
    observer_ratio: float = number((), default=1.4)
    dead_zone: float = number((), default=0.2)
    start_boost: float = number((), default=4.0)
    start_time: float = number((), default=0.1)
    friction: bool = structure(bool, default=True)
    measured: bool = structure(bool, default=False)
    delay: int = structure(default=0)

    def __post_init__(self) -> None:
        if self.bandwidth is None:
            object.__setattr__(self, "bandwidth", _bandwidth(self.arm, self.rig))
        super().__post_init__()
        positive = ("bandwidth", "observer_ratio", "start_boost", "start_time")
        signs(self, positive=positive, not_negative=("dead_zone",))
        if self.dead_zone > 1:
            raise ValueError(f"dead_zone must be a share of the cell, 0 to 1; got {self.dead_zone:g}. 0.2 is usual.")
        if self.delay not in (0, 1):
            raise ValueError(f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another design.")

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """On the reference with nothing applied yet; every joint has all of its boost; no sample taken."""
        return np.concatenate([np.zeros((5 + self.delay) * n), np.ones(n), [0.0]])

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
        e, rate, delta, before, impulse, *pending, fresh = (state[i * n : (i + 1) * n] for i in range(6 + self.delay))
        begun, coupling = state[-1], drive.coupling
        q, qd = (setpoint.q - e, setpoint.qd - rate) if self.measured else (setpoint.q, setpoint.qd)
        D, speed = model.D(q, f), coupling.shaft(setpoint.qd)
        mobility = inverse(coupling.shaft_inertia(D))
        viscous, level, needed = ca.SX.zeros(n), ca.SX.zeros(n), D @ setpoint.qdd + self.h(q, qd)
        if self.friction:
            viscous, level = drive.joint_viscous(), drive.joint_coulomb(speed)
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

        # With a delay, what is commanded now acts one sample later: predict the error to then.
        ahead = predicted(e, rate, impulse, pending[0] - needed, dt)[:2] if self.delay else (e, rate)
        bandwidth = ca.fmin(self.bandwidth * boost, ca.fmax(self.bandwidth, _MOST / dt))
        stiffness, damping = regulator_gains(bandwidth, dt)
        error, error_rate = (coupling.shaft(each) for each in ahead)
        # Far off, it comes back no faster than half of the torque that is left can brake: v^2 = 2 a e.
        limit = ca.fabs(drive.torque_limit())
        left = limit - ca.fabs(coupling.shaft_torque(needed + delta))
        braking = ca.fmax(left / 2, limit / 20) * mobility.diagonal
        reach = 2 * braking * (damping / stiffness) ** 2
        error = error / ca.sqrt(ca.fmax(ca.fabs(error) / reach, 1))
        sliding = self._share(speed + bandwidth * error / 2, _SLIDES)
        feedback = mobility.alone * (stiffness * error + damping * error_rate) + level * sliding
        wanted = needed + delta + coupling.joint_torque(feedback)
        begins = speed * (speed + dt * coupling.shaft(setpoint.qdd)) <= 0  # from rest, or where it turns back
        fresh = ca.if_else(begins, 1, fresh * ca.exp(-dt / self.start_time))
        acting, coming = (pending[0], [wanted]) if self.delay else (wanted, [])
        return acting, ca.vertcat(e, rate, delta, needed, impulse, *coming, fresh, 1)

    def _share(self, speed: ca.SX, full: float) -> ca.SX:
        """Speed of the shafts (n, 1) over a stated one [pulses/s], within -1 and 1."""
        pulses = self.rig.encoder.position_in_pulses(ca.fabs(self.rig.drive.gear) * speed) / full
        return ca.fmin(ca.fmax(pulses, -1), 1)


def _bandwidth(found: Any, rig: Rig | None) -> float:
    """Bandwidth [rad/s] of a law that is given none."""
    if not isinstance(found, Identification) or not isinstance(rig, (Rig, type(None))):
        # What does not fit is refused with the other fields.
        return min(_UNKNOWN, _SAMPLED / rig.period) if isinstance(rig, Rig) else _UNKNOWN
    rig = found.rig if rig is None else rig
    friction = any(name.startswith(("drive.viscous", "drive.coulomb")) for name in found.fit.unknown)
    known = _FRICTION_TOO if friction else _KNOWN
    bandwidth = min(_UNKNOWN if found.covariance is None else known, _SAMPLED / rig.period)
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
