"""Symbolic L D L^T, so that forward dynamics needs no numeric solver inside a kernel."""

from __future__ import annotations

import casadi as ca

__all__ = ["factorise", "solve"]


def factorise(matrix):
    """Symbolic L D L^T of a symmetric matrix (n, n): unit lower triangle and pivots; positive pivots mean > 0.

    Returns
    -------
    lower : casadi SX (n, n)
    pivots, inverse_pivots : casadi SX (n, 1)
        The second so that only n divisions are needed, however often the factors are used.
    """
    n = matrix.shape[0]
    lower, pivots, inverse = ca.SX.eye(n), ca.SX(n, 1), ca.SX(n, 1)
    for j in range(n):
        pivots[j] = matrix[j, j] - sum((lower[j, k] ** 2 * pivots[k] for k in range(j)), ca.SX(0))
        inverse[j] = 1 / pivots[j]
        for i in range(j + 1, n):
            rest = matrix[i, j] - sum((lower[i, k] * lower[j, k] * pivots[k] for k in range(j)), ca.SX(0))
            lower[i, j] = rest * inverse[j]
    return lower, pivots, inverse


def solve(factors, right):
    """Symbolic solution (n, m) of L D L^T x = right (n, m)."""
    lower, _, inverse = factors
    n = lower.shape[0]
    rows = [right[i, :] for i in range(n)]
    for i in range(n):
        for k in range(i):
            rows[i] = rows[i] - lower[i, k] * rows[k]
    rows = [rows[i] * inverse[i] for i in range(n)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            rows[i] = rows[i] - lower[k, i] * rows[k]
    return ca.vertcat(*rows)
