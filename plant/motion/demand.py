"""Torque demand of a motion: peak as a share of the amplifiers' limits, and shortest duration.

Along a path r(s), at speed v = ds/dt and acceleration a = dv/dt, q = r, qd = r' v and qdd = r'' v^2
+ r' a, so the torque is affine in a and v^2 but for friction. Its coefficients follow from D,
coriolis and gravity of `Dynamics` at v = 1 and a = 0, and from the springs of the rig. All torques
are on the shafts, as is `Drive.torque_limit`; without a coupling, each shaft is that of its joint.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from plant.machine import Rig
from plant.mechanics import Arm
from plant.parts import ArrayOrSymbols, Floats, instance, real

# Speed along the path at which Coulomb friction acts in full, and viscous friction not at all.
_CREEP = 1e-9


@dataclasses.dataclass(frozen=True)
class Demand:
    """Torque at N points of a path, by speed v and acceleration a along it.

    The torque on the joints is D r' a + (D r'' + coriolis) v^2 + gravity - springs
    + friction(r' v). All torques below are its equivalent on the shafts.
    """

    rig: Rig
    # r' (N, n) [rad/s].
    along: Floats
    # Torque (N, n) [N m] per a, torque per v^2, and the torque of gravity less that of springs.
    inertial: Floats
    centrifugal: Floats
    holding: Floats

    def torque(
        self, a: ArrayOrSymbols, v: ArrayOrSymbols, friction: ArrayOrSymbols
    ) -> ArrayOrSymbols:
        """Torque (N, n) [N m], with this friction; a and v are numbers, arrays (N, 1) or casadi."""
        return self.inertial * a + self.centrifugal * v**2 + self.holding + friction

    def friction(self, v: ArrayOrSymbols) -> ArrayOrSymbols:
        """Friction torque (N, n) [N m] at a speed along the path."""
        return self.rig.drive.coupling.shaft_torque(self.rig.drive.friction(self.along * v))

    def dry_friction(self) -> Floats:
        """Coulomb friction (N, n) [N m] of a very slow motion along the path."""
        return np.asarray(self.friction(_CREEP))

    def share(self, v: float) -> Floats:
        """Peak torque of each shaft divided by its limit, (n,), at a constant speed v."""
        peak = np.abs(self.torque(0.0, v, self.friction(v))).max(axis=0)
        return peak / self.rig.drive.torque_limit()


def demand(arm: Arm, rig: Rig, motion: Sequence[Floats]) -> Demand:
    """Torque demand of a path, given by the motion (q, qd, qdd) along it at v = 1 and a = 0."""
    # All points at once; casadi wants one column per point.
    values = _coefficients(arm, rig).map(len(motion[0]))(*(x.T for x in motion))
    return Demand(
        rig, motion[1], *(rig.drive.coupling.shaft_torque(value.full().T) for value in values)
    )


@functools.lru_cache(maxsize=8)
def _coefficients(arm: Arm, rig: Rig) -> ca.Function:
    """(q, r', r'') -> the coefficients of a and of v^2, and the rest, on the joints, (n,) each."""
    q, along, bend = (ca.SX.sym(name, arm.n) for name in ("q", "along", "bend"))
    model = arm.dynamics
    # Along the path at unit speed: r' takes the place of qd, and r'' that of qdd.
    f = ca.DM(arm.f)
    D = model.D(q, f)
    parts = [
        D @ along,
        D @ bend + model.coriolis(q, along, f),
        model.gravity(q, f) - rig.spring_torque(q),
    ]
    return ca.Function("demand", [q, along, bend], [ca.densify(part) for part in ca.cse(parts)])


def sampled_demand(arm: Arm, rig: Rig, reference: Any) -> tuple[Floats, Sequence[Floats], Demand]:
    """Closely spaced times, the motion of a reference at them, and its demand."""
    instance("arm", arm, Arm, "The order is arm, rig.")
    instance("rig", rig, Rig, "The order is arm, rig.")
    rig.require_fit(arm.dynamics.chain)
    if reference.n != rig.n:
        raise ValueError(
            f"reference must have {rig.n} joints like the rig; got {reference.n}. Use a matching"
            " one."
        )
    # Sample about once per period, and 4000 times at least, to come close to every peak.
    points = max(4000, round(reference.duration / rig.period)) + 1
    t = np.linspace(0.0, reference.duration, points)
    motion = reference(t)
    needed = demand(arm, rig, motion)
    # NaN is never within a limit: a search for the speed at which it is would not end.
    torque = needed.torque(1.0, 1.0, needed.friction(1.0))
    infinite = np.argwhere(~np.isfinite(torque))
    if infinite.size:
        i, joint = infinite[0]
        raise ValueError(
            "reference must need finite torques;"
            f" {arm.dynamics.chain.joint_labels[joint]} needs {torque[i, joint]} at t ="
            f" {t[i]:.3f} s, q = {np.round(motion[0][i], 3)}. Correct the motion there, or the"
            " springs and the friction of the rig."
        )
    return t, motion, needed


def shortest_duration(arm: Arm, rig: Rig, reference: Any, share: float = 0.9) -> float:
    """Shortest duration [s] of a motion that is scaled in time, within a share of the limits.

    The search assumes that a speed above an impossible one is impossible as well. That may be
    wrong, as where viscous friction brakes the arm for the drive; the duration is possible all the
    same, but not the shortest.
    """
    advice = "Give the part of the limit to use, like 0.9."
    share = real("share", share, advice, positive=True)
    if share > 1:
        raise ValueError(f"share must be at most 1; got {share:g}. {advice}")
    t, motion, needed = sampled_demand(arm, rig, reference)
    # As the motion slows down, all torques but the holding torque and dry friction vanish.
    torque = np.abs(needed.holding + needed.dry_friction())
    limit = share * rig.drive.torque_limit()
    # However slow, a motion needs the torque that holds the arm and overcomes dry friction.
    if (torque >= limit).any():
        # The instant and the joint at which the limit is exceeded most.
        i, joint = np.unravel_index(np.argmax(torque / limit), torque.shape)
        chain = arm.dynamics.chain
        raise ValueError(
            "path must be one along which the drives can hold the arm and creep;"
            f" {chain.joint_labels[joint]} needs {torque[i, joint]:.4g} of {limit[joint]:.4g}"
            f" {chain.joint_units[joint].effort} at t = {t[i]:.3f} s, q ="
            f" {np.round(motion[0][i], 3)}. Raise share or the limit, or leave that place out."
        )

    def within(v: float) -> bool:
        return bool((needed.share(v) <= share).all())

    # 1. Speeds, in units of the motion's own, between which the limit lies.
    low = 1.0
    while not within(low):
        low /= 2
    # A bracket of a factor of two: the speed at the lower end is possible, that at the upper end is
    # not.
    high = 2 * low
    while within(high):
        low = high
        high = 2 * high
        # A motion that may be a billion times as fast meets no limit.
        if high > 2.0**30:
            raise ValueError(
                "motion must meet a limit somewhere; this one takes no torque, however fast. Give"
                " the drive its current_limit, and the path some length."
            )

    # 2. Bisection; friction makes the torque no polynomial in the speed.
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        if within(middle):
            low = middle
        else:
            high = middle
    return reference.duration / low
