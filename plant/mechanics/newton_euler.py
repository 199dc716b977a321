"""Recursive Newton-Euler algorithm over modified Denavit-Hartenberg frames, and kinematics.

Source: paper eq. (1); Craig, Introduction to Robotics, ch. 6.
"""

import itertools
from collections.abc import Iterable

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import ArrayLike

from plant.mechanics.chain import Chain
from plant.mechanics.lumping import STANDARD, Lumping
from plant.parts import CheckedFunction, Floats, array


def torque(chain: Chain, q: SX, qd: SX, qdd: SX, pi: SX, gravity: Iterable[float]) -> SX:
    """Joint torques tau (n, 1) [N m], joint side, without friction, of parameters pi (11 n, 1).

    q, qd, qdd are casadi (n, 1), joint side; pi is in the order of
    `plant.mechanics.lumping.STANDARD`; gravity (3,) [m/s^2] is in the base frame. A positive torque
    turns the joint in the positive sense of z.

    Source: paper eq. (1), left side.
    """
    axis = ca.vertcat(0, 0, 1)
    w = SX(3, 1)
    wd = SX(3, 1)
    # A base that accelerates upwards feels the same forces as one at rest under gravity.
    acceleration = SX(-ca.DM(list(gravity)))
    frames = []
    forces = []
    moments = []
    # 1. Outwards: speeds and accelerations of the frames, each in its own frame, and the force and
    # the moment that each link needs there. w, wd [rad/s, rad/s^2] are those of the previous link
    # until its rotation is applied.
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        frames.append((rotation, origin))
        m, mc, inertia, _ = _standard(pi, i)
        # Acceleration of this frame's origin, a point of the previous link. It needs that link's w
        # and wd, so it precedes their rotation.
        acceleration = rotation.T @ (
            ca.cross(wd, origin) + ca.cross(w, ca.cross(w, origin)) + acceleration
        )
        w = rotation.T @ w
        wd = rotation.T @ wd
        if link.prismatic:
            # A slide adds its own acceleration and the Coriolis acceleration 2 w x v.
            acceleration += axis * qdd[i] + 2 * ca.cross(w, axis * qd[i])
        else:
            # w x (qd z) takes the speed without this joint's part, so wd precedes w.
            wd += ca.cross(w, axis * qd[i]) + axis * qdd[i]
            w += axis * qd[i]
        # About the frame's origin both are linear in mass, first moment and inertia; about the
        # centre of mass they are not.
        forces.append(m * acceleration + ca.cross(wd, mc) + ca.cross(w, ca.cross(w, mc)))
        moments.append(inertia @ wd + ca.cross(w, inertia @ w) + ca.cross(mc, acceleration))
    tau = SX(chain.n, 1)
    rotors = SX(chain.n, 1)
    force = SX(3, 1)
    moment = SX(3, 1)
    # 2. Inwards: the torque of a joint is the z component of all that the links behind it need.
    for i in reversed(range(chain.n)):
        force = force + forces[i]
        moment = moment + moments[i]
        rotors[i] = _standard(pi, i)[-1]
        tau[i] = (force if chain.links[i].prismatic else moment)[2]
        rotation, origin = frames[i]
        # The same force and moment, in the frame and about the origin of the previous link.
        moment = rotation @ moment + ca.cross(origin, rotation @ force)
        force = rotation @ force
    # A rotor resists the acceleration of its shaft, C^T J C qdd; gyroscopic torques of rotors are
    # neglected.
    return tau + chain.coupling.joint_torque(rotors * chain.coupling.shaft(qdd))


def lumped_torque(chain: Chain, lumping: Lumping, q: SX, qd: SX, qdd: SX, f: SX) -> tuple[SX, SX]:
    """Inertial torque and gravity torque, each (n, 1) [N m], of f (p, 1)."""
    rest = SX.zeros(chain.n)
    strength = float(np.linalg.norm(chain.gravity))
    # Without gravity the recursion gives the inertial torque, at rest the gravity torque. Each of
    # the two takes the fewest parameters that produce it.
    moving = torque(chain, q, qd, qdd, SX(lumping.inertial_section()) @ f, (0, 0, 0))
    down = np.array(chain.gravity) / strength if strength else np.zeros(3)
    weights = strength * (SX(lumping.gravity_section()) @ f)
    return moving, torque(chain, q, rest, rest, weights, down)


def _standard(pi: SX, i: int) -> tuple[SX, SX, SX, SX]:
    """Mass, first moment, inertia (3, 3) about the origin and reflected rotor inertia of link i."""
    m, mx, my, mz, ixx, ixy, ixz, iyy, iyz, izz, rotor = ca.vertsplit(
        pi[len(STANDARD) * i : len(STANDARD) * (i + 1)]
    )
    inertia = ca.vertcat(
        ca.horzcat(ixx, ixy, ixz), ca.horzcat(ixy, iyy, iyz), ca.horzcat(ixz, iyz, izz)
    )
    return m, ca.vertcat(mx, my, mz), inertia, rotor


def collected(expression: SX, q: SX, f: SX) -> SX:
    """The same expression as sums over f, in which terms have cancelled.

    Constant terms stand apart, and a multiple of another sum is computed from it.

    In eq. (2), for instance, D11 holds twice the terms of D12.
    """
    # tau is linear in f: the slopes are the coefficients of the sums, and terms cancel in them.
    slopes = ca.densify(ca.jacobian(ca.vec(expression), f))
    # Coefficients that four random poses leave equal are constant. They are added apart: a sum with
    # a constant in it is hardly ever a multiple of another one.
    poses = np.random.default_rng(0).uniform(-1, 1, (4, q.shape[0]))
    at = np.array([ca.Function("slopes", [q], [slopes])(pose).full() for pose in poses])
    moves = np.abs(at - at[0]).max(axis=0) > 1e-12 * np.abs(at).max(initial=1e-300)
    rows: list[SX] = [SX()] * len(moves)
    sums: list[tuple[Floats, SX]] = []
    # The smallest sum first: larger ones become small whole multiples of it.
    for i in sorted(range(len(moves)), key=lambda i: np.linalg.norm(at[:, i, moves[i]])):
        pattern = np.where(moves[i], at[:, i], 0.0)
        total = _multiple(pattern, sums)
        if total is None:
            total = ca.dot(SX(moves[i].astype(float)) * slopes[i, :].T, f)
            sums.append((pattern, total))
        rows[i] = total + ca.dot(SX((~moves[i]).astype(float)) * slopes[i, :].T, f)
    return ca.vertcat(*rows)


def _multiple(pattern: Floats, sums: list[tuple[Floats, SX]]) -> SX | None:
    """An existing sum times a number, if that has this pattern; None otherwise."""
    for reference, total in sums:
        # The ratio is read where the reference pattern is largest, the safest place to divide.
        largest = np.unravel_index(np.abs(reference).argmax(), reference.shape)
        ratio = pattern[largest] / reference[largest] if reference[largest] else 0.0
        tolerance = 1e-12 * np.abs(pattern).max(initial=1e-300)
        if np.allclose(pattern, ratio * reference, rtol=0, atol=tolerance):
            # A whole ratio stays an exact factor.
            return (round(ratio) if abs(ratio - round(ratio)) < 1e-12 else ratio) * total
    return None


def by_speeds(coriolis: SX, q: SX, qd: SX, f: SX) -> SX:
    """The Coriolis torque as a sum over j <= k of c_jk(q, f) qd_j qd_k."""
    # The torque is a quadratic form in the speeds: its second derivatives are the coefficients, on
    # the diagonal twice them.
    pairs = list(itertools.combinations_with_replacement(range(qd.shape[0]), 2))
    slopes = [
        ca.jacobian(ca.jacobian(coriolis, qd[j]), qd[k]) / (2 if j == k else 1) for j, k in pairs
    ]
    c = ca.reshape(collected(ca.horzcat(*slopes), q, f), -1, len(pairs))
    return sum((c[:, i] * (qd[j] * qd[k]) for i, (j, k) in enumerate(pairs)), SX(0))


def joint_positions(chain: Chain, tip: ArrayLike = (0.0, 0.0, 0.0)) -> CheckedFunction:
    """Positions (3, n + 2) [m] of base, link origins and tip as a function of q (n,).

    All in the base frame; the tip (3,) is a point in the frame of the last link [m].
    """
    tip = array("tip", tip, (3,), advice="Give x, y and z in the frame of the last link [m].")
    q = SX.sym("q", chain.n)
    orientation = SX.eye(3)
    position = SX(3, 1)
    positions = [position]
    # Outwards: each origin is a fixed offset in the frame of the previous link.
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        position = position + orientation @ origin
        orientation = orientation @ rotation
        positions.append(position)
    positions.append(position + orientation @ tip)
    columns = ca.densify(ca.horzcat(*positions))
    return CheckedFunction(ca.Function("joints", [q], [columns], ["q"], ["positions"]))
