"""One sample of an arm's deviation from its reference, on rigid and on elastic gears: predict,
correct, feed back.

Everything is on the motors' shafts, where friction acts and encoders count. A deviation is
reference minus arm, angle and rate of the joints; on elastic gears of the motors and then of the
links, from the motion of links whose motors follow the reference. A push is the torque beyond what
that motion needs, and drives deviations down.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from ctc.laws.observer import correct, filter_gains, regulator_gains
from plant import Rig
from plant.laws.law import Setpoint
from plant.machine.elasticity import joined, spring
from plant.mechanics.symmetric_inverse import Inverse, eliminated, inverse

Deviation = tuple[ca.SX, ...]
# (mobility of the motors, rate without dry friction) -> impulse of dry friction (n, 1) [N m s].
Friction = Callable[[Inverse, ca.SX], ca.SX]

# Of a joint on elastic gears: five gains of its filter and four of its regulator, polynomials of
# its inertia.
GAINS = 9
POWERS = 4

# Share of the stated stiffness with which deviations are predicted: where it is too stiff, they
# grow first.
_SOFTER = 0.8


class RigidGears:
    """An arm whose motors carry the inertia D of their joints.

    `drag`, viscous friction times `dt`, adds to it: friction acts with the rate at the end, so that
    it may be faster. `limit` [N m] is the amplifiers'.
    """

    def __init__(self, D: ca.SX, drag: ca.SX, observer: ca.SX, dt: ca.SX, limit: ca.SX) -> None:
        inertia = D + ca.diag(drag)
        self.mobility, (self._carried, _) = inverse(inertia), eliminated(inertia)
        self._observer, self._dt, self._limit = observer, dt, ca.fabs(limit)

    def moved(
        self, deviation: Deviation, push: ca.SX, friction: Friction, time: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """The deviation after `time` under a push (n, 1) [N m], and the impulse of dry friction
        [N m s].
        """
        e, rate = deviation
        free = rate - time * self.mobility.solve(push)
        impulse = friction(self.mobility, free)
        after = free - self.mobility.solve(impulse)
        return (e + time * (rate + after) / 2, after), impulse

    def corrected(
        self, deviation: Deviation, outside: ca.SX, boost: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """Corrected by an innovation (n, 1) [rad]; and what the disturbance torque gains [N m]."""
        gains = filter_gains(self._observer * ca.sqrt(boost), self._dt)
        e, rate, found = correct(deviation[0], deviation[1], ca.SX(0), outside, gains, self._dt)
        return (e, rate), self.mobility.alone * found

    def feedback(self, deviation: Deviation, bandwidth: ca.SX, planned: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] against a deviation, of a regulator with this bandwidth [rad/s].

        Of each joint alone, and what carries those after it along: what moves a shoulder does not
        shake the wrist. What the amplifier has no room for beside what is `planned` (n, 1) [N m]
        does not act, and carries none along.
        """
        stiffness, damping = regulator_gains(bandwidth, self._dt)
        alone = self.mobility.alone * (stiffness * deviation[0] + damping * deviation[1])
        acts = ca.SX(0, 1)
        carried = ca.SX(0, 1)
        for i in range(alone.numel()):
            carried = ca.vertcat(carried, self._carried[i, :i] @ acts)
            low, high = (side * self._limit[i] - planned[i] - carried[i] for side in (-1, 1))
            acts = ca.vertcat(acts, ca.fmin(ca.fmax(alone[i], low), high))
        return carried + alone


class Springs(NamedTuple):
    """An `Elasticity` without backlash."""

    stiffness: Any
    damping: Any
    backlash: None = None


class ElasticGears:
    """An arm whose links are on the springs of its gears; gains from a table, for the inertia
    that each joint feels.
    """

    def __init__(
        self, D: ca.SX, drag: ca.SX, rotors: ca.SX, elasticity: Any, table: Any = None
    ) -> None:
        self.mobility = inverse(D)
        self._stated = Springs(elasticity.stiffness, elasticity.damping)
        self._springs = Springs(_SOFTER * elasticity.stiffness, elasticity.damping)
        self._rotors, self._links, self._dragged = rotors, D - ca.diag(rotors), rotors + drag
        self._felt = inverse(self._links).alone
        if table is not None:
            self._filter, self._regulator = self._gains(table, D.shape[0])

    def _gains(self, table: Any, n: int) -> tuple[list[ca.SX], list[ca.SX]]:
        """Of filter and regulator at this pose; the torques in them for an inertia of 1 kg m^2."""
        middle, half, *powers = (table[i * n : (i + 1) * n] for i in range(2 + GAINS * POWERS))
        at = ca.fmin(ca.fmax((self._rotors * self.mobility.diagonal - middle) / half, -1), 1)
        rows = (powers[i : i + POWERS] for i in range(0, GAINS * POWERS, POWERS))
        gains = [functools.reduce(lambda sum_, each: sum_ * at + each, row) for row in rows]
        return gains[:5], gains[5:]

    def followed(
        self,
        link: tuple[ca.SX, ...],
        along: tuple[ca.SX, ...],
        weight: ca.SX,
        begun: ca.SX,
        dt: ca.SX,
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Links one sample later whose motors follow the reference, and the torque through their
        gears (n, 1) [N m].

        `link`: their position and speed a sample ago; `along`: position, speed and acceleration of
        the reference now; `weight`: the torque that they take beside inertia. Where it begins,
        links hang at rest.
        """
        (q, qd), (at, speed, acceleration) = link, along
        before = speed - dt * acceleration
        middle = at - dt / 2 * speed + dt * dt / 8 * acceleration
        held = spring(
            self._stated, middle - q - dt / 2 * qd, before - qd, dt, self._rotors, self._felt
        )
        pushed = dt * (held.torque - weight) + held.added * dt * acceleration
        gained = inverse(self._links + ca.diag(held.added)).solve(pushed)
        wound = at - weight / self._stated.stiffness
        q = ca.if_else(begun, q + dt * (qd + gained / 2), wound)
        qd = ca.if_else(begun, qd + gained, speed)
        return q, qd, self._stated.stiffness * (at - q) + self._stated.damping * (speed - qd)

    def moved(
        self, deviation: Deviation, push: ca.SX, friction: Friction, time: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """As of `RigidGears`."""
        e, rate, e_l, rate_l = deviation
        apart = e - e_l + time / 2 * (rate - rate_l)
        held = spring(self._springs, apart, rate - rate_l, time, self._rotors, self._felt)
        both = joined(self._dragged, self._links, held.added)
        kick = -time * (push + held.torque)
        gained = both.links.solve(time * held.torque + both.passed * kick)
        free = both.motors(rate, kick, gained)
        mobility = both.mobility()
        impulse = friction(mobility, free)
        after = free - mobility.solve(impulse)
        after_l = rate_l + gained - both.links.solve(both.passed * impulse)
        return (
            e + time * (rate + after) / 2,
            after,
            e_l + time * (rate_l + after_l) / 2,
            after_l,
        ), impulse

    def corrected(self, deviation: Deviation, outside: ca.SX, _: ca.SX) -> tuple[Deviation, ca.SX]:
        """As of `RigidGears`, without a boost."""
        *gains, found = self._filter
        corrected = tuple(
            each + gain * outside for each, gain in zip(deviation, gains, strict=True)
        )
        return corrected, self.mobility.alone * found * outside

    def feedback(self, deviation: Deviation, *_: Any) -> ca.SX:
        """As of `RigidGears`, with the bandwidth of the table."""
        return self.mobility.alone * sum(
            gain * each for gain, each in zip(self._regulator, deviation, strict=True)
        )


def braked(
    deviation: Deviation,
    rig: Rig,
    needed: ca.SX,
    gears: RigidGears | ElasticGears,
    bandwidth: ca.SX,
) -> Deviation:
    """Deviations for a regulator: far off, a joint comes back no faster than half of its torque
    that is left can brake.

    v^2 = 2 a e; `needed` (n, 1) is the shafts' torque without the regulator's [N m].
    """
    limit = ca.fabs(rig.drive.torque_limit())
    # maybe without a limit: to divide by, no more
    braking = ca.fmax((limit - ca.fabs(needed)) / 2, limit / 20)
    nearer = ca.sqrt(
        ca.fmax(bandwidth**2 / 4 * gears.mobility.alone * ca.fabs(deviation[0]) / braking, 1)
    )
    return tuple(each if i % 2 else each / nearer for i, each in enumerate(deviation))


def speed_share(rig: Rig, speed: ca.SX, full: float) -> ca.SX:
    """Speed of the shafts (n, 1) over a stated one [pulses/s], within -1 and 1."""
    pulses = rig.encoder.position_in_pulses(ca.fabs(rig.drive.gear) * speed) / full
    return ca.fmin(ca.fmax(pulses, -1), 1)


def gears_along(
    law: Any,
    setpoint: Setpoint,
    deviation: Deviation,
    of_links: list[ca.SX],
    begun: ca.SX,
    dt: ca.SX,
) -> tuple[RigidGears | ElasticGears, ca.SX, tuple[ca.SX, ...]]:
    """Gears of a computed torque now, the torque (n, 1) that its reference needs less friction, and
    its links' motion.

    `deviation` is that of the joints (n, 1), `of_links` what is known of links that are predicted
    apart: deviation, and motion a sample ago. Where it begins, they are on the reference and at
    rest.
    """
    drive = law.rig.drive
    coupling = drive.coupling
    rotors = drive.reflected_inertia()
    q = setpoint.q
    qd = setpoint.qd
    along = tuple(coupling.shaft(each) for each in setpoint[:3])
    if of_links:  # at the middle of the sample that is over
        deviation = tuple(coupling.joint(each) for each in of_links[:2])
        before = tuple(
            ca.if_else(begun, each, now) for each, now in zip(of_links[2:], along[:2], strict=True)
        )
        q = coupling.joint(before[0] + begun * dt / 2 * before[1])
        qd = begun * coupling.joint(before[1] + dt / 2 * along[2])
    if law.measured:
        q = q - deviation[0]
        qd = qd - deviation[1]
    D = law.arm.dynamics.D(q, law.arm.f)
    h = law.h(q, qd)
    inertia = coupling.shaft_inertia(D)
    drag = dt * drive.joint_viscous() * law.friction
    if not of_links:
        observer = law.observer_ratio * law.bandwidth
        return (
            RigidGears(inertia, drag, observer, dt, drive.torque_limit()),
            D @ setpoint.qdd + h,
            (),
        )
    gears = ElasticGears(inertia, drag, rotors, drive.elasticity, law.gear_gains)
    *motion, carried = gears.followed(before, along, coupling.shaft_torque(h), begun, dt)
    return gears, coupling.joint_torque(carried + rotors * along[2]), tuple(motion)
