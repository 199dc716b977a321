"""Symbolic inverse and elimination of a symmetric matrix: kernels need no numeric solver.

casadi's `ldl` rounds otherwise, and gains nothing: of six joints its inverse takes 464 operations
(70 divisions), this one 399 (45); its pivots take 84 instead of 164, in the same 91 ns, most of
which are those of D (602).
"""

from typing import NamedTuple

import casadi as ca
from casadi import SX


class Inverse(NamedTuple):
    """Inverse of a symmetric positive definite A by rows: A^-1 x = diagonal * (x - share x).

    ``alone``, 1 / diagonal: with A the inertia matrix, the inertia against an impulse on joint i
    alone. ``share`` (n, n): minus the inverse, rows divided by their diagonal, and zero there:
    coupling of impulses on joint j to joint i. ``minors``: all positive if, and only if, A is
    positive definite.
    """

    diagonal: SX
    alone: SX
    share: SX
    minors: list[SX]

    def own(self, x: SX) -> SX:
        """Impulses x - share x that change each joint's speed alone as x (n, 1) does."""
        return x - self.share @ x

    def solve(self, x: SX) -> SX:
        """A^-1 x."""
        # An impulse on each joint alone, times the mobility of that joint.
        return self.diagonal * self.own(x)

    def matrix(self):
        """A^-1 (n, n)."""
        return ca.diag(self.diagonal) @ (SX.eye(self.diagonal.shape[0]) - self.share)


def inverse(matrix: SX) -> Inverse:
    """Symbolic inverse of a symmetric matrix (n, n), by blocks of two rows."""
    # Two joints, written out: [[c, -b], [-b, a]] / (a c - b^2), without a recursion's temporaries.
    if matrix.shape[0] == 2:
        a = matrix[0, 0]
        b = matrix[0, 1]
        c = matrix[1, 1]
        determinant = a * c - b * b
        share = ca.vertcat(ca.horzcat(0, b / c), ca.horzcat(b / a, 0))
        return Inverse(
            ca.vertcat(c, a) / determinant, determinant / ca.vertcat(c, a), share, [a, determinant]
        )
    return row_by_row(*_by_blocks(matrix))


def row_by_row(inverted, minors=()):
    """The `Inverse` of a matrix whose inverse is this (n, n)."""
    # Rows divided by their diagonal: 1 on the diagonal, minus the share elsewhere.
    diagonal = ca.diag(inverted)
    scaled = ca.diag(1 / diagonal) @ inverted
    return Inverse(diagonal, 1 / diagonal, ca.diag(ca.diag(scaled)) - scaled, list(minors))


def _by_blocks(matrix: SX) -> tuple[SX, list[SX]]:
    """The inverse by the Schur complement of its first two rows."""
    # The recursion ends with no row or one row: an odd number of joints leaves one.
    n = matrix.shape[0]
    if n == 0:
        return SX(0, 0), []
    if n == 1:
        return 1 / matrix, [matrix]
    a = matrix[0, 0]
    b = matrix[0, 1]
    c = matrix[1, 1]
    determinant = a * c - b * b
    leading = ca.vertcat(ca.horzcat(c, -b), ca.horzcat(-b, a)) / determinant
    if n == 2:
        return leading, [a, determinant]
    # A = [[P, Q], [Q^T, R]]: with W = P^-1 Q and the Schur complement S = R - Q^T W, A^-1 = [[P^-1
    # + W S^-1 W^T, -W S^-1], [-S^-1 W^T, S^-1]]. S is positive exactly where A is, given P.
    coupling = leading @ matrix[:2, 2:]
    trailing, minors = _by_blocks(matrix[2:, 2:] - matrix[2:, :2] @ coupling)
    corner = -coupling @ trailing
    upper = ca.horzcat(leading - corner @ coupling.T, corner)
    return ca.vertcat(upper, ca.horzcat(corner.T, trailing)), [a, determinant, *minors]


def eliminated(matrix: SX) -> tuple[SX, list[SX]]:
    """L, unit lower triangular, and pivots (n,) of a symmetric matrix L diag(pivots) L^T (n, n).

    Entries after a zero pivot are meaningless.
    """
    n = matrix.shape[0]
    columns = []
    pivots = []
    # Gaussian elimination without row exchanges, which a positive definite matrix does not need.
    while matrix.shape[0]:
        pivots.append(matrix[0, 0])
        # Rows above the diagonal are zero.
        columns.append(ca.vertcat(SX.zeros(n - matrix.shape[0]), matrix[:, 0] / matrix[0, 0]))
        matrix = matrix[1:, 1:] - matrix[1:, 0] @ matrix[0, 1:] / matrix[0, 0]
    return ca.horzcat(*columns), pivots
