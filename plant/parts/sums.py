"""Sums in a fixed order: the same bits for any number of threads of the linear algebra library.

That library (BLAS) shares long products out over its threads, and the order of a sum decides its
last bits. What is as long as a log is summed here; small matrices go to `numpy.linalg`, which does
them on one thread.
"""

import numpy as np

from plant.parts.fields import Floats

# Columns of a block. Its products with the columns before it follow from symmetry, so that a small
# block saves work, and a large one calls of `einsum`; chosen by hand.
_AT_ONCE = 8


def dot(a: Floats, b: Floats) -> float:
    """Inner product of two vectors."""
    return float((a * b).sum())


def norm(a: Floats) -> float:
    """Euclidean length of a vector, or of all entries."""
    return float(np.sqrt((a * a).sum()))


def product(rows: Floats, columns: Floats) -> Floats:
    """Rows (N, k) times columns (k,) or (k, m)."""
    if columns.ndim == 1:
        return np.asarray((rows * columns).sum(axis=1))
    sums = [(rows * column).sum(axis=1) for column in columns.T]
    return np.column_stack(sums) if sums else np.empty((len(rows), 0))


def products(rows: Floats) -> Floats:
    """Sums of the products (k, k) of the columns of rows (N, k)."""
    sums = np.empty((rows.shape[1],) * 2)
    for i in range(0, len(sums), _AT_ONCE):
        sums[i : i + _AT_ONCE, i:] = np.einsum("mi,mj->ij", rows[:, i : i + _AT_ONCE], rows[:, i:])
        # The matrix is symmetric: copy the block below the diagonal.
        sums[i:, i : i + _AT_ONCE] = sums[i : i + _AT_ONCE, i:].T
    return sums


def triangle(rows: Floats) -> Floats:
    """R (k, k) of rows (N, k) = Q R, by reflections; missing rows are zeros if N < k.

    Source: A. Householder, Unitary triangularization of a nonsymmetric matrix, Journal of the ACM
    5, 1958.
    """
    k = rows.shape[1]
    reduced = np.vstack([rows, np.zeros((max(0, k - len(rows)), k))]).astype(float)
    # Reflect each column onto its first entry; zero columns stay as they are.
    for i in range(k):
        mirror = reduced[i:, i].copy()
        length = norm(mirror)
        if length:
            # The sign of the first entry avoids cancellation.
            mirror[0] += np.copysign(length, mirror[0])
            mirror /= norm(mirror)
            reduced[i:, i:] -= 2 * mirror[:, None] * (mirror[:, None] * reduced[i:, i:]).sum(axis=0)
    return np.triu(reduced[:k])


def least(rows: Floats, target: Floats, rcond: float | None = None) -> Floats:
    """Least-squares solution x of rows (N, k) x = target, (N,) or (N, m), of minimum norm.

    `rcond` as in `numpy.linalg.lstsq`.
    """
    k = rows.shape[1]
    # QR of [rows, target] leaves few short rows, for which one thread is enough; the condition is
    # that of the rows, not its square as with normal equations.
    both = triangle(np.column_stack([rows, target]))
    # The default of numpy, for the size of the long system.
    rcond = np.finfo(float).eps * max(rows.shape) if rcond is None else rcond
    solution = np.asarray(np.linalg.lstsq(both[:k, :k], both[:k, k:], rcond=rcond)[0], float)
    return solution.reshape(k, *target.shape[1:])
