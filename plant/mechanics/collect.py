"""Expressions as sums over f and over products of speeds, in which terms have cancelled and multiples are shared."""

import itertools

import casadi as ca
import numpy as np
from numpy.typing import NDArray


def collected(expression: ca.SX, q: ca.SX, f: ca.SX) -> ca.SX:
    """The same as sums over f: terms cancelled, constant ones apart, and multiples of one sum worked out once.

    In eq. (2), for instance, D11 holds twice the terms of D12.
    """
    slopes = ca.densify(ca.jacobian(ca.vec(expression), f))
    poses = np.random.default_rng(0).uniform(-1, 1, (4, q.shape[0]))
    at = np.array([ca.Function("slopes", [q], [slopes])(pose).full() for pose in poses])
    moves = np.abs(at - at[0]).max(axis=0) > 1e-12 * np.abs(at).max(initial=1e-300)
    rows: list[ca.SX] = [ca.SX()] * len(moves)
    sums: list[tuple[NDArray[np.float64], ca.SX]] = []
    for i in sorted(range(len(moves)), key=lambda i: np.linalg.norm(at[:, i, moves[i]])):
        pattern = np.where(moves[i], at[:, i], 0.0)
        total = _multiple(pattern, sums)
        if total is None:
            total = ca.dot(ca.SX(moves[i].astype(float)) * slopes[i, :].T, f)
            sums.append((pattern, total))
        rows[i] = total + ca.dot(ca.SX((~moves[i]).astype(float)) * slopes[i, :].T, f)
    return ca.vertcat(*rows)


def _multiple(pattern: NDArray[np.float64], sums: list[tuple[NDArray[np.float64], ca.SX]]) -> ca.SX | None:
    """The sum, times a number, that has this pattern; None if there is none."""
    for other, total in sums:
        largest = np.unravel_index(np.abs(other).argmax(), other.shape)
        ratio = pattern[largest] / other[largest] if other[largest] else 0.0
        if np.allclose(pattern, ratio * other, rtol=0, atol=1e-12 * np.abs(pattern).max(initial=1e-300)):
            return (round(ratio) if abs(ratio - round(ratio)) < 1e-12 else ratio) * total
    return None


def by_speeds(coriolis: ca.SX, q: ca.SX, qd: ca.SX, f: ca.SX) -> ca.SX:
    """The same torque as sum over j <= k of c_jk(q, f) qd_j qd_k, so that speeds enter by their products alone."""
    pairs = list(itertools.combinations_with_replacement(range(qd.shape[0]), 2))
    slopes = [ca.jacobian(ca.jacobian(coriolis, qd[j]), qd[k]) / (2 if j == k else 1) for j, k in pairs]
    c = ca.reshape(collected(ca.horzcat(*slopes), q, f), -1, len(pairs))
    return sum((c[:, i] * (qd[j] * qd[k]) for i, (j, k) in enumerate(pairs)), ca.SX(0))
