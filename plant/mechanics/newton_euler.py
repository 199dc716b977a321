"""Recursive Newton-Euler over modified Denavit-Hartenberg frames: the one torque; its terms
collected; kinematics.

Source: paper eq. (1); Craig, Introduction to Robotics, ch. 6.
"""

import itertools
from collections.abc import Iterable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.mechanics.chain import Chain
from plant.mechanics.lumping import STANDARD, Lumping
from plant.parts.arguments import array
from plant.parts.checked_function import CheckedFunction
from plant.parts.fields import Floats


def torque(
    chain: Chain, q: ca.SX, qd: ca.SX, qdd: ca.SX, pi: ca.SX, gravity: Iterable[float]
) -> ca.SX:
    """Joint torques tau (n, 1) [N m], joint side, of a chain with standard parameters pi (11 n, 1),
    without friction.

    q, qd, qdd are casadi (n, 1), joint side; pi is in the order of
    `plant.mechanics.lumping.STANDARD`; gravity (3,) [m/s^2] is in the base frame. A positive torque
    turns the joint in the positive sense of z.

    Source: paper eq. (1), left side.
    """
    axis = ca.vertcat(0, 0, 1)
    w = ca.SX(3, 1)
    wd = ca.SX(3, 1)
    acceleration = ca.SX(-ca.DM(list(gravity)))
    frames = []
    forces = []
    moments = []
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        frames.append((rotation, origin))
        m, mc, inertia, _ = _standard(pi, i)
        acceleration = rotation.T @ (
            ca.cross(wd, origin) + ca.cross(w, ca.cross(w, origin)) + acceleration
        )
        w = rotation.T @ w
        wd = rotation.T @ wd
        if link.prismatic:
            acceleration += axis * qdd[i] + 2 * ca.cross(w, axis * qd[i])
        else:
            wd += ca.cross(w, axis * qd[i]) + axis * qdd[i]
            w += axis * qd[i]
        forces.append(m * acceleration + ca.cross(wd, mc) + ca.cross(w, ca.cross(w, mc)))
        moments.append(inertia @ wd + ca.cross(w, inertia @ w) + ca.cross(mc, acceleration))
    tau = ca.SX(chain.n, 1)
    rotors = ca.SX(chain.n, 1)
    force = ca.SX(3, 1)
    moment = ca.SX(3, 1)
    for i in reversed(range(chain.n)):
        force = force + forces[i]
        moment = moment + moments[i]
        *_, rotors[i] = _standard(pi, i)
        tau[i] = (force if chain.links[i].prismatic else moment)[2]
        rotation, origin = frames[i]
        force, moment = rotation @ force, rotation @ moment + ca.cross(origin, rotation @ force)
    return tau + chain.coupling.joint_torque(rotors * chain.coupling.shaft(qdd))


def lumped_torque(
    chain: Chain, lumping: Lumping, q: ca.SX, qd: ca.SX, qdd: ca.SX, f: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Inertial torque (n, 1) and gravity torque (n, 1) [N m] of f (p, 1), each by the fewest
    links' parameters.
    """
    rest = ca.SX.zeros(chain.n)
    strength = float(np.linalg.norm(chain.gravity))
    moving = torque(chain, q, qd, qdd, ca.SX(lumping.inertial_section()) @ f, (0, 0, 0))
    down = np.array(chain.gravity) / strength if strength else np.zeros(3)
    return moving, torque(
        chain, q, rest, rest, strength * (ca.SX(lumping.gravity_section()) @ f), down
    )


def _standard(pi: ca.SX, i: int) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Mass, first moment (3,), inertia (3, 3) about the origin and reflected rotor inertia of
    link i.
    """
    m, mx, my, mz, ixx, ixy, ixz, iyy, iyz, izz, rotor = ca.vertsplit(
        pi[len(STANDARD) * i : len(STANDARD) * (i + 1)]
    )
    inertia = ca.vertcat(
        ca.horzcat(ixx, ixy, ixz), ca.horzcat(ixy, iyy, iyz), ca.horzcat(ixz, iyz, izz)
    )
    return m, ca.vertcat(mx, my, mz), inertia, rotor


def collected(expression: ca.SX, q: ca.SX, f: ca.SX) -> ca.SX:
    """The same as sums over f: terms cancelled, constant ones apart, and multiples of one sum
    worked out once.

    In eq. (2), for instance, D11 holds twice the terms of D12.
    """
    slopes = ca.densify(ca.jacobian(ca.vec(expression), f))
    poses = np.random.default_rng(0).uniform(-1, 1, (4, q.shape[0]))
    at = np.array([ca.Function("slopes", [q], [slopes])(pose).full() for pose in poses])
    moves = np.abs(at - at[0]).max(axis=0) > 1e-12 * np.abs(at).max(initial=1e-300)
    rows: list[ca.SX] = [ca.SX()] * len(moves)
    sums: list[tuple[Floats, ca.SX]] = []
    for i in sorted(range(len(moves)), key=lambda i: np.linalg.norm(at[:, i, moves[i]])):
        pattern = np.where(moves[i], at[:, i], 0.0)
        total = _multiple(pattern, sums)
        if total is None:
            total = ca.dot(ca.SX(moves[i].astype(float)) * slopes[i, :].T, f)
            sums.append((pattern, total))
        rows[i] = total + ca.dot(ca.SX((~moves[i]).astype(float)) * slopes[i, :].T, f)
    return ca.vertcat(*rows)


def _multiple(pattern: Floats, sums: list[tuple[Floats, ca.SX]]) -> ca.SX | None:
    """The sum, times a number, that has this pattern; None if there is none."""
    for other, total in sums:
        largest = np.unravel_index(np.abs(other).argmax(), other.shape)
        ratio = pattern[largest] / other[largest] if other[largest] else 0.0
        if np.allclose(
            pattern, ratio * other, rtol=0, atol=1e-12 * np.abs(pattern).max(initial=1e-300)
        ):
            return (round(ratio) if abs(ratio - round(ratio)) < 1e-12 else ratio) * total
    return None


def by_speeds(coriolis: ca.SX, q: ca.SX, qd: ca.SX, f: ca.SX) -> ca.SX:
    """The same torque as sum over j <= k of c_jk(q, f) qd_j qd_k, so that speeds enter by their
    products alone.
    """
    pairs = list(itertools.combinations_with_replacement(range(qd.shape[0]), 2))
    slopes = [
        ca.jacobian(ca.jacobian(coriolis, qd[j]), qd[k]) / (2 if j == k else 1) for j, k in pairs
    ]
    c = ca.reshape(collected(ca.horzcat(*slopes), q, f), -1, len(pairs))
    return sum((c[:, i] * (qd[j] * qd[k]) for i, (j, k) in enumerate(pairs)), ca.SX(0))


def joint_positions(chain: Chain, tip: ArrayLike = (0.0, 0.0, 0.0)) -> CheckedFunction:
    """Positions (3, n + 2) [m] of the base, the origins of the links' frames and the tip, as a
    function of q (n,).

    All in the base frame; the tip (3,) is a point in the frame of the last link [m].
    """
    tip = array("tip", tip, (3,), advice="Give x, y and z in the frame of the last link [m].")
    q = ca.SX.sym("q", chain.n)
    orientation = ca.SX.eye(3)
    position = ca.SX(3, 1)
    positions = [position]
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        position = position + orientation @ origin
        orientation = orientation @ rotation
        positions.append(position)
    positions.append(position + orientation @ tip)
    return CheckedFunction(
        ca.Function("joints", [q], [ca.densify(ca.horzcat(*positions))], ["q"], ["positions"])
    )
