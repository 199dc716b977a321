"""Symbolic inverse and pivots of a symmetric matrix, so that forward dynamics needs no numeric solver in a kernel."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

__all__ = ["Inverse", "inverse", "pivots"]


class Inverse(NamedTuple):
    """Inverse of a symmetric positive definite matrix A, and what follows from it with fewer divisions.

    Attributes
    ----------
    matrix : casadi SX (n, n)
    minors : list of casadi SX
        All positive if, and only if, A is positive definite.
    alone : casadi SX (n, 1)
        1 / matrix[i, i]: with A the inertia, what an impulse on joint i alone has to move.
    share : casadi SX (n, n)
        -matrix[i, j] / matrix[i, i], with zeros on the diagonal: how much of an impulse on j joint i feels.
    """

    matrix: ca.SX
    minors: list
    alone: ca.SX
    share: ca.SX


def inverse(matrix):
    """Symbolic inverse of a symmetric matrix (n, n), by blocks of two rows."""
    if matrix.shape[0] == 2:
        a, b, c = matrix[0, 0], matrix[0, 1], matrix[1, 1]
        determinant = a * c - b * b
        of = ca.vertcat(ca.horzcat(c, -b), ca.horzcat(-b, a)) / determinant
        share = ca.vertcat(ca.horzcat(0, b / c), ca.horzcat(b / a, 0))
        return Inverse(of, [a, determinant], ca.vertcat(determinant / c, determinant / a), share)
    of, minors = _by_blocks(matrix)
    alone = 1 / ca.diag(of)
    felt = ca.diag(alone) @ of
    return Inverse(of, minors, alone, ca.diag(ca.diag(felt)) - felt)


def _by_blocks(matrix):
    """The inverse by the Schur complement of its first two rows."""
    n = matrix.shape[0]
    if n == 0:
        return ca.SX(0, 0), []
    if n == 1:
        return 1 / matrix, [matrix]
    first, minors, _, _ = inverse(matrix[:2, :2])
    coupling = first @ matrix[:2, 2:]
    last, more = _by_blocks(matrix[2:, 2:] - matrix[2:, :2] @ coupling)
    corner = -coupling @ last
    whole = ca.vertcat(ca.horzcat(first - corner @ coupling.T, corner), ca.horzcat(corner.T, last))
    return whole, [*minors, *more]


def pivots(matrix):
    """Pivots (n,) of Gaussian elimination in a symmetric matrix (n, n); up to the first that is not positive."""
    found = []
    while matrix.shape[0]:
        found.append(matrix[0, 0])
        matrix = matrix[1:, 1:] - matrix[1:, 0] @ matrix[0, 1:] / matrix[0, 0]
    return found
