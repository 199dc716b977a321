"""Symbolic inverse and pivots of a symmetric matrix, so that forward dynamics needs no numeric solver in a kernel."""

from __future__ import annotations

import casadi as ca

__all__ = ["inverse", "pivots"]


def inverse(matrix):
    """Symbolic inverse of a symmetric positive definite matrix (n, n), by blocks of two rows: n / 2 divisions.

    Returns
    -------
    inverse : casadi SX (n, n)
    minors : list of casadi SX
        All positive if, and only if, the matrix is positive definite.
    """
    n = matrix.shape[0]
    if n == 0:
        return ca.SX(0, 0), []
    if n == 1:
        return 1 / matrix, [matrix]
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    determinant = a * c - b * b
    first = ca.vertcat(ca.horzcat(c, -b), ca.horzcat(-b, a)) / determinant
    if n == 2:
        return first, [a, determinant]
    coupling = first @ matrix[:2, 2:]
    last, minors = inverse(matrix[2:, 2:] - matrix[2:, :2] @ coupling)
    corner = -coupling @ last
    whole = ca.vertcat(ca.horzcat(first - corner @ coupling.T, corner), ca.horzcat(corner.T, last))
    return whole, [a, determinant, *minors]


def pivots(matrix):
    """Pivots (n,) of Gaussian elimination in a symmetric matrix (n, n); up to the first that is not positive."""
    found = []
    while matrix.shape[0]:
        found.append(matrix[0, 0])
        matrix = matrix[1:, 1:] - matrix[1:, 0] @ matrix[0, 1:] / matrix[0, 0]
    return found
