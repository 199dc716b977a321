"""Speeds after one sub-step, with rigid or with elastic gears.

Everything is on the motors' shafts, where friction acts; without coupling they are the joints.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import casadi as ca

from plant.machine.drive import Drive
from plant.machine.elasticity import joined, spring
from plant.machine.friction import (
    Bristles,
    bristle_impulse,
    friction_impulse,
    smooth_bristle_impulse,
    smooth_impulse,
)
from plant.machine.rig import Rig
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.symmetric_inverse import Inverse, inverse


@dataclasses.dataclass(frozen=True, kw_only=True)
class FrictionStep:
    """Friction of all motors in one sub-step of length h [s].

    ``impulse`` is that of dry friction in the step before [N m s], ``bristle`` the deflection of
    the bristles where the drive has presliding, ``drifted`` how much of its way the drift of
    friction has done; ``smooth`` is differentiable.
    """

    drive: Drive
    h: ca.SX
    impulse: ca.SX
    bristle: ca.SX | None = None
    drifted: ca.SX | None = None
    sweeps: int
    smooth: bool

    @property
    def viscous(self) -> Any:
        """Viscous friction [N m s/rad]."""
        return self._drifted(self.drive.joint_viscous())

    def __call__(
        self, inverse: Inverse, stopping: ca.SX, speed: ca.SX, load: ca.SX | None = None
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Impulse of dry friction (n, 1) [N m s], and the states that follow, by name.

        ``inverse``, ``stopping`` as of `friction_impulse`; the speed at the start of the step
        [rad/s]; ``load``: the torque that the gears transmit [N m], where friction depends on it.
        """
        drive = self.drive
        h = self.h
        level = drive.joint_coulomb(speed)
        if load is not None:
            level = level + drive.load_friction.level(load)
        bound = h * self._drifted(level)
        if drive.presliding is None:
            if self.smooth:
                return smooth_impulse(inverse, stopping, bound), {}
            return friction_impulse(inverse, stopping, self.impulse, bound, self.sweeps), {}
        bristles = Bristles(self.bristle, *drive.joint_presliding())
        if self.smooth:
            impulse, following = smooth_bristle_impulse(inverse, stopping, bristles, bound, h)
        else:
            half = bristles.bent(speed, h / 2)
            impulse, following = bristle_impulse(
                inverse, stopping, self.impulse, half, bound, h, self.sweeps
            )
        return impulse, {"bristle": following}

    def _drifted(self, friction: Any) -> Any:
        drift = self.drive.friction_drift
        return friction if drift is None else friction * drift.factor(self.drifted)


class Following(NamedTuple):
    """What follows a step: `speed` (n, 1) [rad/s] of the joints, with elastic gears of the motors
    as rigid joints.

    Beside it the `impulse` (n, 1) of dry friction [N m s], a number that is `positive` where D is,
    and by name the `states` (n, 1) that the drive adds: ``link_speed``, ``bristle``.
    """

    speed: ca.SX
    impulse: ca.SX
    positive: ca.SX
    states: dict[str, ca.SX]


def rigid(
    dynamics: Dynamics,
    rig: Rig,
    f: ca.SX,
    middle: ca.SX,
    qd: ca.SX,
    torque: ca.SX,
    h: ca.SX,
    friction: FrictionStep,
) -> Following:
    """The step, of length h [s], of an arm on rigid gears.

    q (n, 1) [rad] at its middle, qd (n, 1) [rad/s] at its start, and the torque (n, 1) that acts on
    the joints [N m].
    """
    drive = rig.drive
    coupling = rig.drive.coupling
    viscous = friction.viscous
    speed = coupling.shaft(qd)
    mobility = inverse(coupling.shaft_inertia(dynamics.D(middle, f)) + ca.diag(h / 2 * viscous))
    pushing = coupling.shaft_torque(
        torque - (dynamics.gravity(middle, f) - rig.spring_torque(middle))
    )
    pushing = pushing - viscous * speed - drive.joint_offset()

    def left(at: ca.SX) -> ca.SX:
        return pushing - coupling.shaft_torque(dynamics.coriolis(middle, coupling.joint(at), f))

    # torque on each, as if it were alone
    own = mobility.own(left(speed + h / 2 * mobility.solve(left(speed))))
    load = None
    if drive.load_friction is not None:
        gained = mobility.diagonal * (h * own + mobility.own(friction.impulse))
        load = _transmitted(drive, friction, torque, speed, gained)
    impulse, states = friction(mobility, -(mobility.alone * speed + h * own), speed, load)
    following = coupling.joint(speed + mobility.diagonal * (h * own + mobility.own(impulse)))
    return Following(following, impulse, functools.reduce(ca.fmin, mobility.minors), states)


def elastic(
    dynamics: Dynamics,
    rig: Rig,
    f: ca.SX,
    motor: tuple[ca.SX, ca.SX],
    link: tuple[ca.SX, ca.SX],
    torque: ca.SX,
    h: ca.SX,
    friction: FrictionStep,
) -> Following:
    """The step of motors and of links behind their gears; torque, h and friction as of `rigid`.

    Motors and links are `joined` by what a spring adds to the inertia of both. `motor` and `link`
    are positions at the middle of the step and speeds at its start, (n, 1) each; motors as joints
    on rigid gears would have them.
    """
    drive = rig.drive
    viscous = friction.viscous
    coupling, rotors = drive.coupling, drive.reflected_inertia()
    speed = coupling.shaft(motor[1])
    v = coupling.shaft(link[1])
    inertia = coupling.shaft_inertia(dynamics.D(link[0], f)) - ca.diag(rotors)
    held = spring(
        drive.elasticity, coupling.shaft(motor[0] - link[0]), speed - v, h, rotors, ca.diag(inertia)
    )
    both = joined(rotors + h / 2 * viscous, inertia, held.added)
    pushing = h * (
        coupling.shaft_torque(torque) - viscous * speed - drive.joint_offset() - held.torque
    )
    weight = coupling.shaft_torque(dynamics.gravity(link[0], f) - rig.spring_torque(link[0]))

    def change(at: ca.SX) -> ca.SX:
        resisting = coupling.shaft_torque(dynamics.coriolis(link[0], coupling.joint(at), f))
        return both.links.solve(h * (held.torque - weight - resisting) + both.passed * pushing)

    gained = change(v + change(v) / 2)
    free = both.motors(speed, pushing, gained)
    mobility = both.mobility()
    load = None
    if drive.load_friction is not None:
        load = _transmitted(
            drive, friction, torque, speed, free + mobility.solve(friction.impulse) - speed
        )
    impulse, states = friction(mobility, -mobility.alone * free, speed, load)
    motors = coupling.joint(free + mobility.solve(impulse))
    links = coupling.joint(v + gained + both.links.solve(both.passed * impulse))
    positive = functools.reduce(ca.fmin, [*both.links.minors, *ca.vertsplit(ca.diag(inertia))])
    return Following(motors, impulse, positive, {"link_speed": links, **states})


def _transmitted(
    drive: Drive, friction: FrictionStep, torque: ca.SX, speed: ca.SX, gained: ca.SX
) -> ca.SX:
    """Torque that the gears pass on [N m]: what their motors leave, with the dry friction of the
    step before.

    `speed` and `gained` (n, 1) are of the shafts, at the start of the step, and what it would add
    [rad/s].
    """
    h = friction.h
    taken = (
        friction.viscous * (speed + gained / 2)
        + drive.joint_offset()
        + drive.reflected_inertia() * gained / h
    )
    return drive.coupling.shaft_torque(torque) + friction.impulse / h - taken
