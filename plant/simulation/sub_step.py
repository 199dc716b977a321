"""Speeds after one sub-step, with rigid or with elastic gears.

Everything is on the motors' shafts, where friction acts; without coupling they are the joints.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import casadi as ca

from plant.machine.drive import Drive
from plant.machine.spring import spring
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.symmetric_inverse import Inverse, inverse, row_by_row

__all__ = ["elastic", "rigid"]

Friction = Callable[[Inverse, ca.SX, ca.SX, ca.SX], ca.SX]
"""(mobility, stopping impulse, last impulse, bound) -> impulse of Coulomb friction."""


def rigid(
    dynamics: Dynamics, drive: Drive, f: ca.SX, middle: ca.SX, qd: ca.SX, torque: ca.SX, impulse: ca.SX, h: ca.SX,
    friction: Friction,
) -> tuple[ca.SX, ca.SX, ca.SX]:  # fmt: skip
    """Joint speeds (n, 1) after the step, the impulse of friction, and a number that is positive where D is.

    Parameters
    ----------
    middle : casadi SX (n, 1)
        q at the middle of the step [rad].
    qd : casadi SX (n, 1)
        At its start [rad/s].
    torque : casadi SX (n, 1)
        That acts on the joints [N m].
    impulse : casadi SX (n, 1)
        Of friction in the step before [N m s].
    h : casadi SX
        Length of the step [s].
    """
    coupling, viscous = drive.coupling, drive.joint_viscous()
    speed = coupling.shaft(qd)
    mobility = inverse(coupling.shaft_inertia(dynamics.D(middle, f)) + ca.diag(h / 2 * viscous))
    pushing = coupling.shaft_torque(torque - dynamics.gravity(middle, f))
    pushing = pushing - viscous * speed - drive.joint_offset()

    def left(at: ca.SX) -> ca.SX:
        return pushing - coupling.shaft_torque(dynamics.coriolis(middle, coupling.joint(at), f))

    own = mobility.own(left(speed + h / 2 * mobility.solve(left(speed))))  # torque on each, as if it were alone
    impulse = friction(mobility, -(mobility.alone * speed + h * own), impulse, h * drive.joint_coulomb(speed))
    following = coupling.joint(speed + mobility.diagonal * (h * own + mobility.own(impulse)))
    return following, impulse, functools.reduce(ca.fmin, mobility.minors)


def elastic(
    dynamics: Dynamics, drive: Drive, f: ca.SX, motor: tuple[ca.SX, ca.SX], link: tuple[ca.SX, ca.SX], torque: ca.SX,
    impulse: ca.SX, h: ca.SX, friction: Friction,
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:  # fmt: skip
    """Speeds (n, 1) of motors and of links, the impulse of friction, and a number that is positive where D is.

    Motors and links are joined by what a spring adds to the inertia of both (`plant.machine.spring`). Motors feel each
    other through the links alone, so they are eliminated, and one matrix (n, n) is left.

    Parameters
    ----------
    motor, link : tuple of casadi SX (n, 1)
        Positions at the middle of the step, speeds at its start; motors as joints on rigid gears would have them.
    torque, impulse, h
        As of `rigid`.
    """
    coupling, viscous, rotors = drive.coupling, drive.joint_viscous(), drive.reflected_inertia()
    speed, v = coupling.shaft(motor[1]), coupling.shaft(link[1])
    inertia = coupling.shaft_inertia(dynamics.D(link[0], f)) - ca.diag(rotors)
    held = spring(drive.elasticity, coupling.shaft(motor[0] - link[0]), speed - v, h, rotors, ca.diag(inertia))
    alone = rotors + h / 2 * viscous
    passed = held.added / (alone + held.added)  # share of a motor's impulse that its link gets
    joined = inverse(inertia + ca.diag(passed * alone))
    pushing = h * (coupling.shaft_torque(torque) - viscous * speed - drive.joint_offset() - held.torque)
    weight = coupling.shaft_torque(dynamics.gravity(link[0], f))

    def change(at: ca.SX) -> ca.SX:
        resisting = coupling.shaft_torque(dynamics.coriolis(link[0], coupling.joint(at), f))
        return joined.solve(h * (held.torque - weight - resisting) + passed * pushing)

    gained = change(v + change(v) / 2)
    free = speed + pushing / (alone + held.added) + passed * gained
    mobility = row_by_row(ca.diag(1 / (alone + held.added)) + ca.diag(passed) @ joined.matrix() @ ca.diag(passed))
    impulse = friction(mobility, -mobility.alone * free, impulse, h * drive.joint_coulomb(speed))
    motors = coupling.joint(free + mobility.solve(impulse))
    links = coupling.joint(v + gained + joined.solve(passed * impulse))
    return motors, links, impulse, functools.reduce(ca.fmin, [*joined.minors, *ca.vertsplit(ca.diag(inertia))])
