"""Speeds after one sub-step, with rigid or with elastic gears.

Everything is on the motors' shafts, where friction acts; without coupling they are the joints.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import casadi as ca

from plant.machine import (
    Bristles,
    Drive,
    Rig,
    bristle_impulse,
    friction_impulse,
    joined,
    smooth_bristle_impulse,
    smooth_impulse,
    spring,
)
from plant.mechanics import Dynamics, Inverse, inverse


@dataclasses.dataclass(frozen=True, kw_only=True)
class FrictionStep:
    """Friction of all motors in one sub-step."""

    drive: Drive
    # Length of the step [s].
    h: ca.SX
    # Impulse of dry friction in the previous step (n, 1) [N m s], from which the sweeps begin.
    impulse: ca.SX
    # Deflection of the bristles, if the drive has presliding.
    bristle: ca.SX
    # Progress of the drift of friction, 0 to 1, if the drive has one.
    drifted: ca.SX
    # Gauss-Seidel sweeps over the joints.
    sweeps: int
    # Whether the friction is regularised, and so differentiable.
    smooth: bool

    def viscous(self, speed: ca.SX) -> Any:
        """Viscous friction per speed of the shafts [N m s/rad], at their speed [rad/s]."""
        return self._drifted(self.drive.joint_viscous(speed))

    def __call__(
        self, inverse: Inverse, stopping: ca.SX, speed: ca.SX, load: ca.SX | None = None
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Impulse of dry friction (n, 1) [N m s], and the following states by name.

        ``inverse``, ``stopping`` as of `friction_impulse`; the speed at the start of the step
        [rad/s]; ``load``: the torque that the gears transmit [N m], where friction depends on it.
        """
        drive = self.drive
        h = self.h
        # The bound of the impulse: friction's level, times the length of the step.
        level = drive.joint_coulomb(speed)
        if load is not None:
            level = level + drive.load_friction.level(load)
        bound = h * self._drifted(level)
        if drive.presliding is None:
            if self.smooth:
                return smooth_impulse(inverse, stopping, bound), {}
            return friction_impulse(inverse, stopping, self.impulse, bound, self.sweeps), {}
        bristles = Bristles(self.bristle, *drive.joint_presliding())
        # Smooth friction has no set of values, and needs no sweeps over the joints.
        if self.smooth:
            impulse, following = smooth_bristle_impulse(inverse, stopping, bristles, bound, h)
        else:
            # The step takes the bristles as they are at its middle.
            half = bristles.bent(speed, h / 2)
            impulse, following = bristle_impulse(
                inverse, stopping, self.impulse, half, bound, h, self.sweeps
            )
        return impulse, {"bristle": following}

    def _drifted(self, friction):
        drift = self.drive.friction_drift
        return friction if drift is None else friction * drift.factor(self.drifted)


class Following(NamedTuple):
    """Results of a sub-step."""

    # Speed (n, 1) [rad/s] of the joints; with elastic gears of the motors, as joints on rigid ones.
    speed: ca.SX
    # Impulse of dry friction (n, 1) [N m s].
    impulse: ca.SX
    # A number that is positive if D is positive definite.
    positive: ca.SX
    # By name the states (n, 1) that the drive adds: ``link_speed``, ``bristle``.
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
    """A step of length h [s] of an arm on rigid gears.

    Position `middle` (n, 1) [rad] at its middle, qd (n, 1) [rad/s] at its start, and the torque
    (n, 1) that acts on the joints [N m].
    """
    drive = rig.drive
    coupling = drive.coupling
    speed = coupling.shaft(qd)
    viscous = friction.viscous(speed)
    # Viscous friction acts at the mean of both speeds: half of it joins the inertia, so that a step
    # of any length is stable.
    mobility = inverse(coupling.shaft_inertia(dynamics.D(middle, f)) + ca.diag(h / 2 * viscous))
    torque_at_rest = coupling.shaft_torque(
        torque - (dynamics.gravity(middle, f) - rig.spring_torque(middle))
    )
    torque_at_rest = torque_at_rest - viscous * speed - drive.joint_offset()

    def net_torque(shaft_speed):
        joint_speed = coupling.joint(shaft_speed)
        return torque_at_rest - coupling.shaft_torque(dynamics.coriolis(middle, joint_speed, f))

    # The Coriolis torque at the speed of the middle, which one pass predicts. Then the torque on
    # each shaft as if it moved alone.
    predicted = speed + h / 2 * mobility.solve(net_torque(speed))
    alone = mobility.own(net_torque(predicted))
    load = None
    if drive.load_friction is not None:
        # The load that the gears transmit, with the impulse of the previous step.
        change = mobility.diagonal * (h * alone + mobility.own(friction.impulse))
        load = _transmitted(drive, friction, torque, speed, change)
    impulse, states = friction(mobility, -(mobility.alone * speed + h * alone), speed, load)
    following = coupling.joint(speed + mobility.diagonal * (h * alone + mobility.own(impulse)))
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
    """A step of motors and of links behind their gears; torque, h and friction as of `rigid`.

    Motors and links are `joined` by the spring, which adds to the inertia of both. `motor` and
    `link` are positions at the middle of the step and speeds at its start, (n, 1) each; motors as
    joints on rigid gears would have them.
    """
    drive = rig.drive
    coupling = drive.coupling
    rotors = drive.reflected_inertia()
    motor_position, motor_speed = motor
    link_position, link_speed = link
    speed = coupling.shaft(motor_speed)
    viscous = friction.viscous(speed)
    v = coupling.shaft(link_speed)

    # 1. The spring between both. D contains the rotors, which are the motors' part.
    inertia = coupling.shaft_inertia(dynamics.D(link_position, f)) - ca.diag(rotors)
    deflection = coupling.shaft(motor_position - link_position)
    gear = spring(drive.elasticity, deflection, speed - v, h, rotors, ca.diag(inertia))
    both = joined(rotors + h / 2 * viscous, inertia, gear.added)
    # Impulse on the motors but for dry friction, and weight on the links.
    motor_impulse = h * (
        coupling.shaft_torque(torque) - viscous * speed - drive.joint_offset() - gear.torque
    )
    weight = coupling.shaft_torque(
        dynamics.gravity(link_position, f) - rig.spring_torque(link_position)
    )

    def change(shaft_speed):
        """Change of the links' speed, with the Coriolis torque at a speed of their shafts."""
        joint_speed = coupling.joint(shaft_speed)
        coriolis = coupling.shaft_torque(dynamics.coriolis(link_position, joint_speed, f))
        return both.links.solve(h * (gear.torque - weight - coriolis) + both.passed * motor_impulse)

    # 2. Speeds without dry friction, and the impulse by which it changes them.
    # The Coriolis torque at the speed of the middle, which one pass predicts, as for rigid gears.
    link_change = change(v + change(v) / 2)
    free = both.motors(speed, motor_impulse, link_change)
    mobility = both.mobility()
    load = None
    if drive.load_friction is not None:
        motor_change = free + mobility.solve(friction.impulse) - speed
        load = _transmitted(drive, friction, torque, speed, motor_change)
    impulse, states = friction(mobility, -mobility.alone * free, speed, load)
    motors = coupling.joint(free + mobility.solve(impulse))
    links = coupling.joint(v + link_change + both.links.solve(both.passed * impulse))
    # Positive if the matrix of the links is positive definite, and each inertia without its rotor
    # is positive.
    positive = functools.reduce(ca.fmin, [*both.links.minors, *ca.vertsplit(ca.diag(inertia))])
    return Following(motors, impulse, positive, {"link_speed": links, **states})


def _transmitted(drive, friction, torque, speed, change):
    """Torque that the gears transmit [N m]: the motors', less friction and the rotors' inertia.

    Dry friction is that of the previous step. `speed` (n, 1) of the shafts at the start of the
    step, and its `change` in the step [rad/s].
    """
    h = friction.h
    # Viscous friction at the mean speed of the step, offset, and acceleration of the rotor.
    motor_share = (
        friction.viscous(speed) * (speed + change / 2)
        + drive.joint_offset()
        + drive.reflected_inertia() * change / h
    )
    return drive.coupling.shaft_torque(torque) + friction.impulse / h - motor_share
