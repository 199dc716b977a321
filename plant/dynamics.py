"""Equations of motion D(q; f) qdd + h(q, qd; f) = tau of a serial chain, from one symbolic torque.

Source: paper eq. (1), (2); recursive Newton-Euler over modified Denavit-Hartenberg frames (Craig, Introduction to
Robotics, ch. 6). The recursion is written once, in `torque`; D, h, C and Y are read off it.
"""

from __future__ import annotations

import itertools
from functools import cached_property

import casadi as ca
import numpy as np

from plant.arm import Arm
from plant.body import Body
from plant.check import array, instance
from plant.checked import CheckedFunction
from plant.links import Chain
from plant.lumping import STANDARD, Lumping, standard_parameters
from plant.part import Part, part, structure

__all__ = ["Dynamics", "torque"]


def torque(chain, q, qd, qdd, pi, gravity):
    """Joint torques of a chain with given standard parameters.

    Parameters
    ----------
    chain : Chain
    q, qd, qdd : casadi SX (n, 1)
        Joint side [rad, rad/s, rad/s^2].
    pi : casadi SX or DM (11 n, 1)
        Standard parameters in the order of `plant.lumping.STANDARD`.
    gravity : sequence of 3
        [m/s^2] in the base frame.

    Returns
    -------
    casadi SX (n, 1)
        tau [N m], joint side, without friction; positive turns the joint in the positive sense of z.

    Source: paper eq. (1), left side.
    """
    axis = ca.vertcat(0, 0, 1)
    w, wd, acceleration = ca.SX(3, 1), ca.SX(3, 1), -ca.DM(list(gravity))
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


def _standard(pi, i):
    """Mass, first moment (3,), inertia (3, 3) about the origin and reflected motor inertia of link i."""
    m, mx, my, mz, ixx, ixy, ixz, iyy, iyz, izz, rotor = ca.vertsplit(pi[len(STANDARD) * i : len(STANDARD) * (i + 1)])
    inertia = ca.vertcat(ca.horzcat(ixx, ixy, ixz), ca.horzcat(ixy, iyy, iyz), ca.horzcat(ixz, iyz, izz))
    return m, ca.vertcat(mx, my, mz), inertia, rotor


_FEW = 3
"""Joints up to which sums over f and over products of speeds are shorter than what the recursion gives."""


def _collected(expression, q, f):
    """The same as sums over f: what cancels is gone, what is constant stands apart, and multiples are worked out once.

    In eq. (2), for instance, D11 holds twice what D12 holds.
    """
    slopes = ca.densify(ca.jacobian(ca.vec(expression), f))
    poses = np.random.default_rng(0).uniform(-1, 1, (4, q.shape[0]))
    at = np.array([ca.Function("slopes", [q], [slopes])(pose).full() for pose in poses])
    moves = np.abs(at - at[0]).max(axis=0) > 1e-12 * np.abs(at).max(initial=1e-300)
    rows, sums = [None] * len(moves), []
    for i in sorted(range(len(moves)), key=lambda i: np.linalg.norm(at[:, i, moves[i]])):
        pattern = np.where(moves[i], at[:, i], 0.0)
        total = _multiple(pattern, sums)
        if total is None:
            total = ca.dot(ca.SX(moves[i].astype(float)) * slopes[i, :].T, f)
            sums.append((pattern, total))
        rows[i] = total + ca.dot(ca.SX((~moves[i]).astype(float)) * slopes[i, :].T, f)
    return ca.vertcat(*rows)


def _multiple(pattern, sums):
    """The one of these sums, times a number, that has this pattern; None if there is none."""
    for other, total in sums:
        largest = np.unravel_index(np.abs(other).argmax(), other.shape)
        ratio = pattern[largest] / other[largest] if other[largest] else 0.0
        if np.allclose(pattern, ratio * other, rtol=0, atol=1e-12 * np.abs(pattern).max(initial=1e-300)):
            return (round(ratio) if abs(ratio - round(ratio)) < 1e-12 else ratio) * total
    return None


def _by_speeds(coriolis, q, qd, f):
    """The same torque as sum over j <= k of c_jk(q, f) qd_j qd_k, so that speeds enter by their products alone."""
    pairs = list(itertools.combinations_with_replacement(range(qd.shape[0]), 2))
    slopes = [ca.jacobian(ca.jacobian(coriolis, qd[j]), qd[k]) / (2 if j == k else 1) for j, k in pairs]
    slopes = ca.reshape(_collected(ca.horzcat(*slopes), q, f), -1, len(pairs))
    return sum((slopes[:, i] * (qd[j] * qd[k]) for i, (j, k) in enumerate(pairs)), ca.SX(0))


@part
class Dynamics(Part):
    """The equations of an arm with f open.

    Parameters
    ----------
    chain : Chain
    lumping : Lumping
        What f means.
    ranges : (p, 2) nested tuple, optional
        Where each f is searched for when nothing else is said.

    Raises
    ------
    ValueError
        The lumping does not describe the motion of this chain.

    Notes
    -----
    Of a prismatic joint q is in m and tau a force [N].

    `D(q, f)` (n, n), `h(q, qd, f)` (n, 1), `C(q, qd, f)` (n, n) with h = C qd + gravity and Ddot - 2 C skew, and
    `Y(q, qd, qdd)` (n, p) with tau = Y f, or `Y(q, qd, qd_r, qdd_r)` with D qdd_r + C qd_r + gravity = Y f. All can be
    called with numpy arrays (giving casadi DM) or with casadi symbols.
    """

    chain: Chain = structure(Chain)
    lumping: Lumping = structure(Lumping)
    ranges: tuple = structure(default=None)

    def __repr__(self):
        return f"Dynamics({self.n} joints, f: {', '.join(self.names)})"

    def __post_init__(self):
        width = len(STANDARD) * self.chain.n
        if len(self.lumping.matrix[0]) != width:
            raise ValueError(f"lumping must have {width} columns; got {len(self.lumping.matrix[0])}. Match the chain.")
        if self.ranges is not None:
            ranges = array("ranges", self.ranges, (self.p, 2), advice="Give a low and a high end for each f.")
            object.__setattr__(self, "ranges", tuple(tuple(row) for row in ranges.tolist()))
        self._prove()

    @classmethod
    def from_chain(cls, chain, *, rotors=True):
        """The equations of a chain in its base parameters, with motor inertias or without (`plant.base`)."""
        from plant.base import base_lumping  # which needs the torque of this file

        return cls(chain=chain, lumping=base_lumping(chain, rotors=rotors))

    @property
    def n(self):
        """Number of joints."""
        return self.chain.n

    @property
    def p(self):
        """Number of parameters f."""
        return len(self.lumping.names)

    @property
    def names(self):
        """Names of f."""
        return self.lumping.names

    def f(self, bodies=None):
        """Parameters f (p,) of an arm whose links are these bodies, one per link; by default those of the chain."""
        bodies = self.chain.bodies if bodies is None else tuple(bodies)
        if not bodies:
            raise ValueError("bodies must be known to work out f; this chain has none. Give the Chain its bodies.")
        if len(bodies) != self.n:
            raise ValueError(f"bodies must be {self.n}, one per link; got {len(bodies)}. Join a tool to its link.")
        for body in bodies:
            instance("each of the bodies", body, Body, "Give mass, com and inertia.")
        in_place = [body.seen_from(link.frame) for body, link in zip(bodies, self.chain.links, strict=True)]
        return np.array(self.lumping.matrix) @ standard_parameters(in_place)

    def arm(self, f):
        """The arm with these f (p,)."""
        return Arm(dynamics=self, f=f)

    # -- everything below is read off one torque ----------------------------------------------------------------
    @cached_property
    def _symbols(self):
        q, qd, qdd = (ca.SX.sym(name, self.n) for name in ("q", "qd", "qdd"))
        return q, qd, qdd, ca.SX.sym("f", self.p)

    @cached_property
    def _equations(self):
        """D, Coriolis and gravity torque; with few joints collected in f, as sums of (d/df) f: what cancels is gone."""
        q, qd, qdd, f = self._symbols
        lumping, rest = self.lumping, ca.SX.zeros(self.n)
        moving = torque(self.chain, q, qd, qdd, ca.SX(lumping.inertial_section()) @ f, (0, 0, 0))
        strength = float(np.linalg.norm(self.chain.gravity))
        down = np.array(self.chain.gravity) / strength if strength else np.zeros(3)
        hanging = torque(self.chain, q, rest, rest, strength * (ca.SX(lumping.gravity_section()) @ f), down)
        D, coriolis = ca.jacobian(moving, qdd), ca.substitute(moving, qdd, rest)
        if self.n <= _FEW:
            D = ca.reshape(_collected(D, q, f), self.n, self.n)
            coriolis = _by_speeds(coriolis, q, qd, f)
            unit = ca.substitute(hanging, f, f / strength) if strength else hanging
            hanging = ca.substitute(_collected(unit, q, f), f, strength * f)
        return ca.tril2symm(ca.tril(D)), coriolis, hanging

    @cached_property
    def D(self):
        """Inertia matrix D(q, f) (n, n) [kg m^2], motor inertias included. Source: paper eq. (1), (2)."""
        q, _, _, f = self._symbols
        return CheckedFunction(ca.Function("D", [q, f], [self._equations[0]], ["q", "f"], ["D"]))

    @cached_property
    def h(self):
        """Coriolis, centrifugal and gravity torque h(q, qd, f) (n, 1) [N m]. Source: paper eq. (1), (2)."""
        q, qd, _, f = self._symbols
        _, coriolis, gravity = self._equations
        return CheckedFunction(ca.Function("h", [q, qd, f], [coriolis + gravity], ["q", "qd", "f"], ["h"]))

    @cached_property
    def coriolis(self):
        """Coriolis and centrifugal torque C(q, qd, f) qd (n, 1) [N m], the part of h that moving adds."""
        q, qd, _, f = self._symbols
        return CheckedFunction(
            ca.Function("coriolis", [q, qd, f], [self._equations[1]], ["q", "qd", "f"], ["coriolis"])
        )

    @cached_property
    def gravity(self):
        """Torque of gravity (q, f) -> (n, 1) [N m], the part of h at rest. Source: paper eq. (2), last term."""
        q, _, _, f = self._symbols
        return CheckedFunction(ca.Function("gravity", [q, f], [self._equations[2]], ["q", "f"], ["gravity"]))

    @cached_property
    def C(self):
        """Coriolis matrix C(q, qd, f) (n, n) from the Christoffel symbols of D: Ddot - 2 C is skew."""
        q, qd, _, f = self._symbols
        D = self._equations[0]
        dD = [ca.jacobian(D[:, k], q) for k in range(self.n)]  # dD[k][i, j] = dD_ik / dq_j
        rate = ca.reshape(ca.jacobian(ca.vec(D), q) @ qd, self.n, self.n)
        skewed = ca.SX(self.n, self.n)
        for i in range(self.n):
            for j in range(self.n):
                skewed[i, j] = sum(((dD[k][i, j] - dD[k][j, i]) * qd[k] for k in range(self.n)), ca.SX(0))
        return CheckedFunction(ca.Function("C", [q, qd, f], [(rate + skewed) / 2], ["q", "qd", "f"], ["C"]))

    @cached_property
    def _regressor(self):
        q, qd, qdd, f = self._symbols
        D, coriolis, gravity = self._equations
        Y = ca.jacobian(D @ qdd + coriolis + gravity, f)
        return CheckedFunction(ca.Function("Y", [q, qd, qdd], [ca.densify(Y)], ["q", "qd", "qdd"], ["Y"]))

    @cached_property
    def _passive_regressor(self):
        q, qd, _, f = self._symbols
        qd_r, qdd_r = ca.SX.sym("qd_r", self.n), ca.SX.sym("qdd_r", self.n)
        D, _, gravity = self._equations
        Y = ca.jacobian(D @ qdd_r + self.C(q, qd, f) @ qd_r + gravity, f)
        names = ["q", "qd", "qd_r", "qdd_r"]
        return CheckedFunction(ca.Function("Y", [q, qd, qd_r, qdd_r], [ca.densify(Y)], names, ["Y"]))

    def Y(self, q, qd, *accelerations):
        """Regressor (n, p): tau = Y(q, qd, qdd) f, or D qdd_r + C qd_r + gravity = Y(q, qd, qd_r, qdd_r) f."""
        return (self._passive_regressor if len(accelerations) == 2 else self._regressor)(q, qd, *accelerations)

    def _prove(self):
        """Refuse a lumping that says something else than the chain: compare both at random points.

        A lumping that knows of no motor inertia at all is for an arm without.
        """
        random, matrix = np.random.default_rng(0), np.array(self.lumping.matrix)
        rotors = slice(STANDARD.index("J"), None, len(STANDARD))
        q, qd, qdd, f = self._symbols
        pi = ca.SX.sym("pi", len(STANDARD) * self.n)
        chain_torque = ca.Function("tau", [q, qd, qdd, pi], [torque(self.chain, q, qd, qdd, pi, self.chain.gravity)])
        for _ in range(3):
            point = [random.normal(size=self.n) for _ in range(3)]
            links = random.uniform(0.5, 1.5, len(STANDARD) * self.n)
            links[rotors] *= matrix[:, rotors].any()
            expected = chain_torque(*point, links).full().ravel()
            got = self.Y(*point).full() @ (matrix @ links)
            if not np.allclose(got, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()):
                raise ValueError(
                    f"lumping must describe the motion of the chain; its torque is {got}, the chain's {expected}. "
                    "Correct the equation for f or the table of links."
                )
