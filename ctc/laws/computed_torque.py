"""Computed torque from identified parameters: D-hat and h-hat are the arm's own. Source: paper Fig. 2."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import correct, predict
from identification import Identification
from plant import Rig, Setpoint
from plant.analysis.sampled_loops import SampledLoops
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import signs
from plant.parts.part import number, part, structure

_UNKNOWN, _KNOWN, _FRICTION_TOO = 250.0, 200.0, 150.0
"""Bandwidth [rad/s] by what is known: nothing but f; f with a covariance; friction as well."""

_SAMPLED = 0.3
"""Bandwidth times period, at most, of one that is chosen."""

_SPARE, _SLOWER = 1.4, 0.8
"""Share of the bandwidth that a stable one has to spare, and by which one that has not is lowered."""

_STIFFER = 1.0, 1.2, 1.5, 2.0, 3.0, 5.0
"""Resonances, in shares of the stated, at which it has to be stable: a fast observer can be stable on soft gears, but
no longer where they are a little stiffer."""

_AT_ONCE = 8.0
"""Pulses within `start_time` from which on a reference begins at once (tests/benchmarks/from_rest.py)."""

_SLOWEST = 5.0
"""Bandwidth [rad/s] below which none is tried."""


@part
class ComputedTorque(ModelLaw):
    """tau = D-hat(q_r) (qdd_r + v) + h-hat(q_r, qd_r) + friction(qd_r), with v from an observer of the tracking error.

    Once per sample: the encoder counts, read as the middle of their cell, give the measured error; an extended-state
    observer per joint estimates the error e, its rate and a disturbance acceleration x3, driven
    by the torque that was really applied after the amplifier's limit; v = bandwidth^2 e + 2 bandwidth edot + x3.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, too.
    rig : Rig, optional
        The identified rig, ``found.rig``: its friction is fed forward.
    bandwidth : float, optional
        Double pole of the error [rad/s]. By default with an arm, which does not say how well it is known, 250: that
        hides inertias that are wrong by half, at the price of chatter. With an identification 200, or 150 where
        friction was identified too (tests/benchmarks/controller_defaults.py), at most 0.3 over the period, and on its
        elastic gears one of less that is stable with 40 % to spare. So ``ComputedTorque(found)`` is quieter than
        ``ComputedTorque(found.arm, found.rig)``, and warns where `found` is in doubt; `tune` finds quieter laws.
    observer_ratio : float
        Triple pole of the observer, as a multiple of the bandwidth.
    friction : bool
        Feed forward the friction of the rig, from the reference velocity.
    start_boost, start_time : float
        The observer starts `start_boost` times faster than it ends, and settles with the time constant `start_time`
        [s]: at the first samples it knows nothing yet of the disturbance. In full where the first sample of the
        reference asks for a motion of eight pulses within `start_time`, in proportion where it asks for less: along
        a path that begins gently a fast observer would find nothing but rounding, and the friction that holds the arm.
    measured : bool
        Evaluate D-hat and h-hat at the observed q and qd instead of the reference. Both are the computed torque of the
        textbooks; with the reference no measurement noise enters the model, and the tracking error is so small that
        the difference is below the encoder's resolution.
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
    ctc.ComputedTorquePID, ctc.FeedForward, ctc.evaluate, ctc.tune

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> law = ComputedTorque(arm, rig, bandwidth=150)
    >>> evaluate(arm, rig, law, puma560.reference(), duration=0.5).within(1)
    True

    Source: paper Fig. 2.
    """

    bandwidth: float = number((), default=None)
    observer_ratio: float = number((), default=1.5)
    start_boost: float = number((), default=3.0)
    start_time: float = number((), default=0.02)
    friction: bool = structure(bool, default=True)
    measured: bool = structure(bool, default=False)
    delay: int = structure(default=0)

    def __post_init__(self) -> None:
        if self.bandwidth is None:
            object.__setattr__(self, "bandwidth", _bandwidth(self.arm, self.rig))
        super().__post_init__()
        signs(self, positive=("bandwidth", "observer_ratio", "start_boost", "start_time"))
        if self.delay not in (0, 1):
            raise ValueError(f"delay must be 0 or 1 sample; got {self.delay!r}. Longer delays need another design.")

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """Observer at rest on the reference, no torque commanded yet, and the boost of the observer in full."""
        return np.append(np.zeros((5 + 2 * self.delay) * n), 1.0)

    def model_errors(self, n: int) -> tuple[range, ...]:
        """Disturbance, and the feedback accelerations that acted or will: they hold what the model lacks."""
        return tuple(range(i * n, (i + 1) * n) for i in (2, 3, *((5,) if self.delay else ())))

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """One sample: what acted -> predict -> correct -> feed back -> torque. Source: paper Fig. 2."""
        n, model, f = self.arm.n, self.arm.dynamics, self.arm.f
        e, rate, disturbance, v, commanded, *pending = (state[i * n : (i + 1) * n] for i in range(5 + 2 * self.delay))
        fresh = ca.if_else(state[-1] < 1, state[-1], self._asked(rig, setpoint))

        # v and the commanded torque acted since the last sample; what the amplifier cut off is missing from v.
        v = v + inverse(model.D(setpoint.q, f)).solve(torque - commanded)
        omega = self.bandwidth * self.observer_ratio * (1 + (self.start_boost - 1) * fresh)
        measured = setpoint.q - rig.cell_centre(pulses)
        e, rate, disturbance = correct(*predict(e, rate, disturbance, v, dt), measured, omega, dt)

        # With a delay, what is commanded now acts one sample later: predict the error to then.
        ahead = predict(e, rate, disturbance, pending[0], dt) if self.delay else (e, rate, disturbance)
        feedback = self.bandwidth**2 * ahead[0] + 2 * self.bandwidth * ahead[1] + ahead[2]
        q, qd = (setpoint.q - e, setpoint.qd - rate) if self.measured else (setpoint.q, setpoint.qd)
        wanted = model.D(q, f) @ (setpoint.qdd + feedback) + self.h(q, qd)
        if self.friction:
            wanted = wanted + self.rig.drive.friction(setpoint.qd)
        acting, coming = (pending[1], pending) if self.delay else (wanted, ())
        following = [e, rate, disturbance, *coming, feedback, wanted, fresh * ca.exp(-dt / self.start_time)]
        return acting, ca.vertcat(*following)

    def _asked(self, rig: Rig, setpoint: Setpoint) -> ca.SX:
        """How much of the boost a reference asks for that begins so: by the motion within `start_time`, 0 to 1."""
        motion = setpoint.qd * self.start_time + setpoint.qdd * self.start_time**2 / 2
        return ca.fmin(1, ca.mmax(ca.fabs(rig.position_in_pulses(motion))) / _AT_ONCE)


def _bandwidth(found: Any, rig: Rig | None) -> float:
    """Bandwidth [rad/s] of a law that is given none."""
    if not isinstance(found, Identification) or not isinstance(rig, (Rig, type(None))):
        return _UNKNOWN  # what does not fit is refused with the other fields
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
