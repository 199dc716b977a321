"""Recursive Newton-Euler over modified Denavit-Hartenberg frames: the one torque.

Source: paper eq. (1); Craig, Introduction to Robotics, ch. 6.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from plant.mechanics.lumping import STANDARD, Lumping

if TYPE_CHECKING:
    from plant.mechanics.chain import Chain


def torque(chain: Chain, q: ca.SX, qd: ca.SX, qdd: ca.SX, pi: ca.SX, gravity: Iterable[float]) -> ca.SX:
    """Joint torques of a chain with given standard parameters.

    Parameters
    ----------
    chain : Chain
    q, qd, qdd : casadi SX (n, 1)
        Joint side [rad, rad/s, rad/s^2].
    pi : casadi SX or DM (11 n, 1)
        Standard parameters in the order of `plant.mechanics.lumping.STANDARD`.
    gravity : sequence of 3
        [m/s^2] in the base frame.

    Returns
    -------
    casadi SX (n, 1)
        tau [N m], joint side, without friction; positive turns the joint in the positive sense of z.

    Source: paper eq. (1), left side.
    """
    axis = ca.vertcat(0, 0, 1)
    w, wd, acceleration = ca.SX(3, 1), ca.SX(3, 1), ca.SX(-ca.DM(list(gravity)))
    frames, forces, moments = [], [], []
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        frames.append((rotation, origin))
        m, mc, inertia, _ = _standard(pi, i)
        acceleration = rotation.T @ (ca.cross(wd, origin) + ca.cross(w, ca.cross(w, origin)) + acceleration)
        w, wd = rotation.T @ w, rotation.T @ wd
        if link.prismatic:
            acceleration += axis * qdd[i] + 2 * ca.cross(w, axis * qd[i])
        else:
            wd += ca.cross(w, axis * qd[i]) + axis * qdd[i]
            w += axis * qd[i]
        forces.append(m * acceleration + ca.cross(wd, mc) + ca.cross(w, ca.cross(w, mc)))
        moments.append(inertia @ wd + ca.cross(w, inertia @ w) + ca.cross(mc, acceleration))
    tau, rotors = ca.SX(chain.n, 1), ca.SX(chain.n, 1)
    force, moment = ca.SX(3, 1), ca.SX(3, 1)
    for i in reversed(range(chain.n)):
        force, moment = force + forces[i], moment + moments[i]
        *_, rotors[i] = _standard(pi, i)
        tau[i] = (force if chain.links[i].prismatic else moment)[2]
        rotation, origin = frames[i]
        force, moment = rotation @ force, rotation @ moment + ca.cross(origin, rotation @ force)
    return tau + chain.coupling.joint_torque(rotors * chain.coupling.shaft(qdd))


def lumped_torque(
    chain: Chain, lumping: Lumping, q: ca.SX, qd: ca.SX, qdd: ca.SX, f: ca.SX
) -> tuple[ca.SX, ca.SX]:  # fmt: skip
    """Inertial torque (n, 1) and gravity torque (n, 1) [N m] of f (p, 1), each by the fewest links' parameters."""
    rest, strength = ca.SX.zeros(chain.n), float(np.linalg.norm(chain.gravity))
    moving = torque(chain, q, qd, qdd, ca.SX(lumping.inertial_section()) @ f, (0, 0, 0))
    down = np.array(chain.gravity) / strength if strength else np.zeros(3)
    return moving, torque(chain, q, rest, rest, strength * (ca.SX(lumping.gravity_section()) @ f), down)


def _standard(pi: ca.SX, i: int) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Mass, first moment (3,), inertia (3, 3) about the origin and reflected rotor inertia of link i."""
    m, mx, my, mz, ixx, ixy, ixz, iyy, iyz, izz, rotor = ca.vertsplit(pi[len(STANDARD) * i : len(STANDARD) * (i + 1)])
    inertia = ca.vertcat(ca.horzcat(ixx, ixy, ixz), ca.horzcat(ixy, iyy, iyz), ca.horzcat(ixz, iyz, izz))
    return m, ca.vertcat(mx, my, mz), inertia, rotor
