"""Sums in a fixed order: the same bits for any number of threads of the linear algebra library.

That library (BLAS) shares long products out over its threads, and the order of a sum decides its
last bits. What is as long as a log is summed here, on one thread, which is also the fastest for
matrices so narrow; small matrices go to `numpy.linalg`, which does them on one thread.
"""

import numpy as np

from plant.parts.fields import Floats
from plant.parts.one_thread import one_thread


def dot(a: Floats, b: Floats) -> float:
    """Inner product of two vectors."""
    return float((a * b).sum())


def norm(a: Floats) -> float:
    """Euclidean length of a vector, or of all entries."""
    return float(np.sqrt((a * a).sum()))


@one_thread
def product(rows: Floats, columns: Floats) -> Floats:
    """Rows (N, k) times columns (k,) or (k, m)."""
    return rows @ columns


@one_thread
def products(rows: Floats) -> Floats:
    """Sums of the products (k, k) of the columns of rows (N, k)."""
    # Of one array with itself BLAS computes a triangle, and numpy copies it: exactly symmetric.
    rows = np.ascontiguousarray(rows)
    return rows.T @ rows


@one_thread
def triangle(rows: Floats) -> Floats:
    """R (k, k) of rows (N, k) = Q R; missing rows are zeros if N < k."""
    missing = max(0, rows.shape[1] - len(rows))
    return np.asarray(np.linalg.qr(np.vstack([rows, np.zeros((missing, rows.shape[1]))]), mode="r"))


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
