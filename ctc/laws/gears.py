"""One sample of an arm's deviation from its reference, on rigid or elastic gears.

Both classes predict it, correct it and feed it back. Deviations and pushes are on the motors'
shafts, where friction acts and encoders count; `needed` is on the joints. A deviation is reference
minus arm. On elastic gears motors and links have one each. That of the links is relative to the
motion of links whose motors follow the reference. A push is the torque beyond what the reference
needs; a positive push decreases the deviation.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from ctc.laws.computed_torque_settings import SETTINGS
from ctc.laws.observer import correct, filter_gains, regulator_gains
from plant import Fields, Rig, per_joint
from plant.laws import Setpoint
from plant.machine import joined, spring
from plant.mechanics import Inverse, eliminated, inverse

# Of a joint on elastic gears: five gains of its filter and four of its regulator, each a polynomial
# of the joint's inertia with so many coefficients.
FILTER_GAINS = 5
GAINS = 9
POWERS = 4

# (mobility of the motors, rate without dry friction) -> impulse of dry friction (n, 1) [N m s].
Friction = Callable[[Inverse, ca.SX], ca.SX]


class Deviation(NamedTuple):
    """Angle [rad] and rate [rad/s] (n, 1) of motors, and of links where these are apart."""

    angle: ca.SX
    rate: ca.SX
    link_angle: ca.SX | None = None
    link_rate: ca.SX | None = None

    def with_angles(self, change: Callable[[ca.SX], ca.SX]) -> "Deviation":
        """The same rates, and angles after a change."""
        # Rigid gears have no links apart from their motors.
        link_angle = self.link_angle
        if link_angle is not None:
            link_angle = change(link_angle)
        return self._replace(angle=change(self.angle), link_angle=link_angle)


class Restoring(NamedTuple):
    """Inner loop of a servo or drive below the law: a spring and a damper to the reference.

    `stiffness` [N m/rad] and `damping` [N m s/rad] (n,) on the shafts.
    """

    stiffness: Any
    damping: Any

    @classmethod
    def of(cls, rig: Rig) -> "Restoring | None":
        """That of a rig, or None where the torque is the law's own."""
        inner = rig.inner
        return None if inner is None else cls(inner.stiffness_of(rig), inner.damping_of(rig))

    def inertia(self, dt: ca.SX) -> ca.SX:
        """Inertia (n, 1) [kg m^2] by which the loop resists a change of rate within a sample.

        The loop's torque depends on the mean angle of the sample and on the rate after it. That
        rate enters the mean angle with the factor dt/4. The step is stable for any stiffness.
        """
        return dt * (self.damping + dt / 4 * self.stiffness)

    def push(self, deviation: "Deviation", time: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] at a constant rate; `inertia` adds that of the change of rate."""
        ahead = deviation.angle + time / 2 * deviation.rate
        return self.stiffness * ahead + self.damping * deviation.rate


class _Model(NamedTuple):
    """The arm at one pose: `D` and `h` on the joints, `inertia` and `drag` on the shafts."""

    D: ca.SX
    h: ca.SX
    inertia: ca.SX
    drag: ca.SX


def _model_at(law: Any, q: ca.SX, qd: ca.SX, speed: ca.SX, dt: ca.SX) -> _Model:
    """The model at q and qd; `speed` (n, 1) of the reference's shafts decides on the friction."""
    D = law.arm.dynamics.D(q, law.arm.f)
    drive = law.rig.drive
    # A law that knows no friction predicts none: `friction` is 0 or 1 here.
    drag = dt * drive.joint_viscous(speed) * law.friction
    return _Model(D, law.h(q, qd), drive.coupling.shaft_inertia(D), drag)


class RigidGears:
    """An arm whose motors carry the inertia D of their joints.

    `drag`, viscous friction times `dt`, adds to it: friction acts with the rate at the end of the
    step, which is stable however large it is. `limit` [N m] is the amplifiers'.
    """

    fields = Fields()
    needed: ca.SX

    def __init__(
        self,
        D: ca.SX,
        drag: ca.SX,
        observer: ca.SX,
        dt: ca.SX,
        limit: ca.SX,
        inner: Restoring | None = None,
    ) -> None:
        # Implicit viscous friction b: M rate' = M rate - dt (push + b rate') adds drag = dt b to
        # the inertia M.
        inertia = D + ca.diag(drag if inner is None else drag + inner.inertia(dt))
        self.mobility = inverse(inertia)
        # L of D = L P L^T, by which a joint's torque is carried to the joints after it.
        self._carried, _ = eliminated(inertia)
        self._observer = observer
        self._dt = dt
        self._limit = ca.fabs(limit)
        self._inner = inner

    @classmethod
    def at(cls, law: Any, setpoint: Setpoint, state: Any, dt: ca.SX) -> "RigidGears":
        """The gears of a computed torque in this sample.

        ``needed`` (n, 1) [N m] is the joint torque that the reference takes, less friction.
        """
        q = setpoint.q
        qd = setpoint.qd
        # Measured: the arm's own place and speed, the reference less the deviation.
        if law.measured:
            q = q - state.error
            qd = qd - state.rate
        speed = law.rig.drive.coupling.shaft(setpoint.qd)
        model = _model_at(law, q, qd, speed, dt)
        # The observer's poles are a multiple of the regulator's, both in rad/s.
        observer = law.observer_ratio * law.bandwidth
        limit = law.rig.drive.torque_limit()
        gears = cls(model.inertia, model.drag, observer, dt, limit, Restoring.of(law.rig))
        # The torque of the reference's motion: D qdd_r + h. Friction is added by its own block.
        gears.needed = model.D @ setpoint.qdd + model.h
        return gears

    def deviation(self, state: Any, coupling: Any) -> Deviation:
        """The deviation as the law's state has it."""
        return Deviation(coupling.shaft(state.error), coupling.shaft(state.rate))

    def memory(self, deviation: Deviation) -> Any:
        """The gears' part of the law's state: none."""
        return {}

    def moved(
        self, deviation: Deviation, push: ca.SX, friction: Friction, time: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """Deviation after `time` under a push (n, 1) [N m], and friction's impulse [N m s]."""
        if self._inner is not None:
            push = push + self._inner.push(deviation, time)
        # A push drives the deviation down: deviation is reference minus arm.
        free = deviation.rate - time * self.mobility.solve(push)
        impulse = friction(self.mobility, free)
        rate = free - self.mobility.solve(impulse)
        # The angle changes with the mean of the rates before and after: exact for a constant
        # torque.
        return Deviation(deviation.angle + time * (deviation.rate + rate) / 2, rate), impulse

    def corrected(
        self, deviation: Deviation, innovation: ca.SX, boost: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """Deviation corrected by an innovation (n, 1) [rad], and disturbance torque to add [N m].

        The filter sees the rounding of counts, so its boost is the root of the regulator's.
        """
        gains = filter_gains(self._observer * ca.sqrt(boost), self._dt)
        # Disturbance acceleration starts at zero: what the filter adds to it becomes torque by the
        # inertia of the joint alone.
        angle, rate, acceleration = correct(
            deviation.angle, deviation.rate, ca.SX(0), innovation, gains, self._dt
        )
        return Deviation(angle, rate), self.mobility.alone * acceleration

    def feedback(self, deviation: Deviation, bandwidth: ca.SX, planned: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] against a deviation, of a regulator with this bandwidth [rad/s].

        An inner loop adds its own torque, which takes no room here because it acts within samples.
        Each joint gets the torque that moves it alone, and the torque that carries it along with
        the joints before it (D = L P L^T): a shoulder then does not shake the wrist. The torque for
        which the amplifier has no room beside what is `planned` (n, 1) [N m] does not act, and
        carries no joint along.
        """
        stiffness, damping = regulator_gains(bandwidth, self._dt)
        alone = self.mobility.alone * (stiffness * deviation.angle + damping * deviation.rate)
        # Joint by joint from the base: the torque that acts on the joints before decides what the
        # next must add.
        acts = ca.SX(0, 1)
        carried = ca.SX(0, 1)
        for i in range(alone.numel()):
            carried = ca.vertcat(carried, self._carried[i, :i] @ acts)
            # The room of the amplifier beside the planned and the carried torque.
            low, high = (sign * self._limit[i] - planned[i] - carried[i] for sign in (-1, 1))
            acts = ca.vertcat(acts, ca.fmin(ca.fmax(alone[i], low), high))
        return carried + alone


class Springs(NamedTuple):
    """An `Elasticity` without backlash."""

    stiffness: Any
    damping: Any
    backlash: None = None


class ElasticGears:
    """An arm whose links are on the springs of its gears.

    The gains come from a table, at the inertia that each joint feels. Deviations are predicted with
    the share `softness` of the stated stiffness: a model that is too stiff loses stability first.
    """

    # deviation of the links, and their motion while the motors follow the reference, a sample ago
    fields = Fields(
        link_error=per_joint(),
        link_rate=per_joint(),
        link_angle=per_joint(),
        link_speed=per_joint(),
    )
    needed: ca.SX
    _link: tuple[ca.SX, ca.SX]

    def __init__(
        self,
        D: ca.SX,
        drag: ca.SX,
        rotors: ca.SX,
        elasticity: Any,
        table: Any = None,
        softness: float = SETTINGS.predicted_stiffness,
    ) -> None:
        # The mobility of the motors with their links on them; the springs are part of the step, not
        # of D.
        self.mobility = inverse(D)
        self._stated = Springs(elasticity.stiffness, elasticity.damping)
        # A model that is too stiff loses stability first, so the prediction uses a share of the
        # stated stiffness.
        self._springs = Springs(softness * elasticity.stiffness, elasticity.damping)
        self._rotors = rotors
        # Inertia of the links alone: D holds the rotors on its diagonal.
        self._links = D - ca.diag(rotors)
        self._dragged = rotors + drag
        # Inertia that a link feels while the other links are free.
        self._felt = inverse(self._links).alone
        if table is not None:
            self._filter, self._regulator = self._gains(table, D.shape[0])

    @classmethod
    def at(cls, law: Any, setpoint: Setpoint, state: Any, dt: ca.SX) -> "ElasticGears":
        """As of `RigidGears`."""
        drive = law.rig.drive
        coupling = drive.coupling
        rotors = drive.reflected_inertia()
        memory = state.gears
        begun = state.begun
        reference = tuple(coupling.shaft(row) for row in setpoint[:3])
        # At the first sample the links are on the reference.
        angle = ca.if_else(begun, memory.link_angle, reference[0])
        speed = ca.if_else(begun, memory.link_speed, reference[1])

        # The model at the links' place in the middle of the sample that is over.
        q = coupling.joint(angle + begun * dt / 2 * speed)
        qd = begun * coupling.joint(speed + dt / 2 * reference[2])
        if law.measured:
            q = q - coupling.joint(memory.link_error)
            qd = qd - coupling.joint(memory.link_rate)
        model = _model_at(law, q, qd, reference[1], dt)
        softness = law.settings.predicted_stiffness
        gears = cls(model.inertia, model.drag, rotors, drive.elasticity, law.gear_gains, softness)
        # Gravity and velocity torques of the links go through the gears, so they belong on the
        # shafts.
        weight = coupling.shaft_torque(model.h)
        angle, speed, carried = gears.followed((angle, speed), reference, weight, begun, dt)
        # The motion of the links is state: it becomes the memory of the next sample.
        gears._link = angle, speed
        gears.needed = coupling.joint_torque(carried + rotors * reference[2])
        return gears

    def deviation(self, state: Any, coupling: Any) -> Deviation:
        """As of `RigidGears`."""
        angle = coupling.shaft(state.error)
        rate = coupling.shaft(state.rate)
        return Deviation(angle, rate, state.gears.link_error, state.gears.link_rate)

    def memory(self, deviation: Deviation) -> Any:
        """The gears' part of the law's state."""
        angle, speed = self._link
        return {
            "link_error": deviation.link_angle,
            "link_rate": deviation.link_rate,
            "link_angle": angle,
            "link_speed": speed,
        }

    def _gains(self, table: Any, n: int) -> tuple[list[ca.SX], list[ca.SX]]:
        """Gains of filter and regulator at this pose; torques in them are for 1 kg m^2."""
        rows = ca.vertsplit(table, n)
        middle = rows[0]
        half = rows[1]
        coefficients = rows[2:]
        # The joint's inertia share, scaled to -1..1 over the range of all poses, is where the
        # polynomials are evaluated.
        inertia_share = self._rotors * self.mobility.diagonal
        x = ca.fmin(ca.fmax((inertia_share - middle) / half, -1), 1)
        gains = []
        for i in range(0, GAINS * POWERS, POWERS):
            # Horner's rule, from the highest power on
            gains.append(
                functools.reduce(lambda sum_, c: sum_ * x + c, coefficients[i : i + POWERS])
            )
        return gains[:FILTER_GAINS], gains[FILTER_GAINS:]

    def followed(
        self,
        link: tuple[ca.SX, ca.SX],
        reference: tuple[ca.SX, ...],
        weight: ca.SX,
        begun: ca.SX,
        dt: ca.SX,
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Angle and speed (n, 1) of links whose motors follow the reference, and gear torque [N m].

        `link`: angle and speed of the links a sample ago; `reference`: angle, speed and
        acceleration now; `weight`: the torque that links take beside inertia. At the first sample
        the links hang in their gears and move at the motors' speed.
        """
        q, qd = link
        angle, speed, acceleration = reference
        # The motors at the start and in the middle of the sample that is over.
        speed_before = speed - dt * acceleration
        middle = angle - dt / 2 * speed + dt * dt / 8 * acceleration
        # The spring's winding at the middle of the sample, where its torque is taken.
        wound = middle - q - dt / 2 * qd
        held = spring(self._stated, wound, speed_before - qd, dt, self._rotors, self._felt)
        pushed = dt * (held.torque - weight) + held.added * dt * acceleration
        gained = inverse(self._links + ca.diag(held.added)).solve(pushed)
        # At the first sample the links hang in their gears, at the speed of the reference.
        hanging = angle - weight / self._stated.stiffness
        q = ca.if_else(begun, q + dt * (qd + gained / 2), hanging)
        qd = ca.if_else(begun, qd + gained, speed)
        # Spring and damper torque now, which the motors must supply beside their own inertia.
        torque = self._stated.stiffness * (angle - q) + self._stated.damping * (speed - qd)
        return q, qd, torque

    def moved(
        self, deviation: Deviation, push: ca.SX, friction: Friction, time: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """As of `RigidGears`."""
        e, rate, link_e, link_rate = deviation
        apart = e - link_e + time / 2 * (rate - link_rate)
        held = spring(self._springs, apart, rate - link_rate, time, self._rotors, self._felt)
        both = joined(self._dragged, self._links, held.added)
        kick = -time * (push + held.torque)
        gained = both.links.solve(time * held.torque + both.passed * kick)
        free = both.motors(rate, kick, gained)
        mobility = both.mobility()
        impulse = friction(mobility, free)
        after = free - mobility.solve(impulse)
        link_after = link_rate + gained - both.links.solve(both.passed * impulse)
        e = e + time * (rate + after) / 2
        link_e = link_e + time * (link_rate + link_after) / 2
        return Deviation(e, after, link_e, link_after), impulse

    def corrected(
        self, deviation: Deviation, innovation: ca.SX, _: ca.SX
    ) -> tuple[Deviation, ca.SX]:
        """As of `RigidGears`, without a boost."""
        state_gains = self._filter[:-1]
        torque_gain = self._filter[-1]
        rows = (row + gain * innovation for row, gain in zip(deviation, state_gains, strict=True))
        return Deviation(*rows), self.mobility.alone * torque_gain * innovation

    def feedback(self, deviation: Deviation, *_: Any) -> ca.SX:
        """As of `RigidGears`, with the bandwidth of the table."""
        rows = zip(self._regulator, deviation, strict=True)
        return self.mobility.alone * sum(gain * row for gain, row in rows)


def braked(
    deviation: Deviation,
    rig: Rig,
    needed: ca.SX,
    gears: RigidGears | ElasticGears,
    bandwidth: ca.SX,
) -> Deviation:
    """Deviation for a regulator, reduced where the joint is far off.

    A regulator of this `bandwidth` then returns the joint from an angle e at a speed v with
    v^2 = 2 a e, where half of the remaining torque brakes it with a. `needed` (n, 1) [N m] is the
    shafts' torque without the regulator's.
    """
    limit = ca.fabs(rig.drive.torque_limit())
    # A divisor must stay positive, also where nothing remains: a twentieth of the limit does.
    braking = ca.fmax((limit - ca.fabs(needed)) / 2, limit / 20)
    distance = bandwidth**2 / 4 * gears.mobility.alone * ca.fabs(deviation.angle) / braking
    reduction = ca.sqrt(ca.fmax(distance, 1))
    return deviation.with_angles(lambda angle: angle / reduction)
