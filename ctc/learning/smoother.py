"""Fixed-interval smoother: the torque that was missing in a log, from what was applied and what was counted.

Source: Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973): the modified
Bryson-Frazier smoother.
"""

import itertools
from typing import Any, NamedTuple

import numpy as np

from ctc.learning.path_plant import PathPlant
from plant import Rig
from plant.parts.fields import Floats

_OMEGA = 100.0
"""Bandwidth of the estimate [rad/s]."""

_STANDS, _MEMORY = 0.02, 0.05
"""How long the count of a joint stands that sticks, and for how long its friction is taken to hold on [s]."""


class Missing(NamedTuple):
    """Torque (N, n) that was missing [N m], which joints stood (N, n), mean normalised innovation."""

    torque: Floats
    stands: Floats
    innovation: float


def missing_torque(
    plant: PathPlant, rig: Rig, inertia: Floats, beyond: Floats, e: Floats, counts: Floats, moves: Any
) -> Missing:  # fmt: skip
    """The torque that was missing along a path.

    `inertia` (n,) is that which each joint feels [kg m^2]; (N, n) are the applied torque `beyond` what the model needs,
    `e`, middle of the quantisation cell less the reference [rad], counts, and where the reference moves: there
    innovations count.
    """
    N, n = e.shape
    dt, m = rig.period, plant.transition.shape[1] - n
    pulse = np.asarray(rig.to_angle(np.eye(n))).T
    R = pulse @ pulse.T / 12
    walk = (inertia * _OMEGA**3) ** 2 * np.diag(R) * dt
    least = round(_STANDS / dt)
    stands = standing(counts, least)
    for pairs in (counts // 2, (counts + 1) // 2):  # between two cells
        stands = np.where(moves, stands, np.maximum(stands, standing(pairs, least)))
    level = rig.drive.joint_coulomb(np.zeros(n)) ** 2 * _MEMORY / dt
    one, H = np.eye(m + n), np.eye(n, m + n)
    Q = np.zeros_like(one)
    Q[m:, m:] = np.diag(walk * dt)
    P = np.zeros_like(one)
    P[: m // 2, : m // 2] = np.kron(np.eye(m // 2 // n), 12 * R)
    P[m // 2 : m, m // 2 : m] = np.kron(np.eye(m // 2 // n), 12 * R * _OMEGA**2)
    P[m:, m:] = np.diag(walk)  # what it walks in 1 s
    z, total, kept = np.zeros(m + n), 0.0, []
    for k in range(N):
        inverse = np.linalg.inv(P[:n, :n] + R)
        nu = e[k] - z[:n]
        total += float(nu**2 / np.diag(P[:n, :n] + R) @ moves[k])
        gain = P[:, :n] @ inverse
        kept.append((z, P, inverse, nu, gain))
        z, P = z + gain @ nu, P - gain @ P[:n]
        step = plant.transition[k]
        push = step[:, m:].copy()
        push[m:] = 0.0
        z, P = step @ z + push @ beyond[k], step @ P @ step.T + Q + (push * (level * stands[k])) @ push.T
        P = (P + P.T) / 2
    torque, adjoint = np.empty((N, n)), np.zeros(m + n)
    for k in range(N - 1, -1, -1):
        z, P, inverse, nu, gain = kept[k]
        after = plant.transition[k].T @ adjoint
        adjoint = after - H.T @ (gain.T @ after + inverse @ nu)
        torque[k] = (P @ adjoint - z)[m:]  # a torque that acts beside the motors' is missing with the other sign
    return Missing(torque, stands, total / max(int(moves.sum()), 1))


def standing(counts: Floats, least: int) -> Floats:
    """Whether the count of each joint stood (N, n), for so many samples at least."""
    found = np.zeros(counts.shape)
    for column, stood in zip(counts.T, found.T, strict=True):
        edges = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
        for a, b in itertools.pairwise(edges):
            stood[a:b] = b - a >= least
    return found
