"""Torque that passes through the gears of a moving arm, and how far it winds them."""

import casadi as ca

from plant.machine.drive import Drive
from plant.machine.rig import Rig
from plant.mechanics.dynamics import Dynamics


def gear_torque(dynamics: Dynamics, rig: Rig, q: ca.SX, qd: ca.SX, qdd: ca.SX, f: ca.SX) -> ca.SX:
    """D(q) qdd + h(q, qd) less springs and what turns the motors (n, 1) [N m], joint side; or on coupled shafts.

    q, qd, qdd (n, 1) are the motion of the links; the rotor inertias of the rig's drive are part of f (p, 1).
    """
    drive = rig.drive
    whole = dynamics.D(q, f) @ qdd + dynamics.h(q, qd, f) - rig.spring_torque(q)
    return drive.coupling.shaft_torque(whole) - drive.reflected_inertia() * drive.coupling.shaft(qdd)


def wound(drive: Drive, torque: ca.SX) -> ca.SX:
    """Motor minus link (n, 1) [rad], as joints on rigid gears would have it, under a torque through the gears [N m]."""
    return drive.coupling.joint(torque / drive.elasticity.stiffness)


def require_elastic(owner: str, rig: Rig) -> None:
    """Refuse a rig that does not tell where motors are to be for the sake of their links: rigid gears, backlash."""
    elasticity = rig.drive.elasticity
    if elasticity is None:
        raise ValueError(f"rig of {owner} must have elastic gears; got rigid ones. Give Drive(elasticity=...).")
    if elasticity.backlash is not None and elasticity.backlash.any():
        raise ValueError(
            f"rig of {owner} must be without backlash; got {elasticity.backlash.max():g} rad, by which motors would "
            "have to jump where the torque reverses. Leave it out here; links are then off by half of it."
        )
    if rig.encoder.side == "link":
        raise ValueError(f"encoders in the rig of {owner} must be on the motors; got the links'. Follow q_r itself.")
