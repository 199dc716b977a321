"""Linear least squares in plain sums, the same bits on any number of threads: by Gram-Schmidt, or of products.

Products of the columns are made six times faster than an orthonormal basis, and lose half the digits: they are exact
enough where columns that are nearly dependent are refused anyway.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plant.parts.fields import Floats
from plant.parts.sums import least, norm, product, products

_EXACT_ENOUGH = 1e-5  # share of its own from which on a column is told from others by their products


class NotIdentifiableError(ValueError):
    """Unknowns that the equations do not tell apart, or that act in none of them.

    `name`: of the one that could be left out.
    """

    def __init__(self, said: str, name: str) -> None:
        super().__init__(said)
        self.name = name

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (str(self), self.name)


def least_squares(
    names: Sequence[str], rows: Floats, target: Floats, *, dependent: float = 1e-9
) -> tuple[Floats, Floats, float]:
    """Solve rows x = target.

    `names`: of the columns, for messages. `rows` (N, k). `target` (N,). `dependent`: a column of which less than this
    share is its own is a combination of the others.

    Returns values (k,); covariance (k, k): of the values, where the residual of every row has a standard deviation of
    1; condition: of the columns, scaled to one length.

    Raises a ValueError: a column that is zero, or a combination of others; with the names.
    """
    k = rows.shape[1]
    lengths = np.sqrt(np.einsum("mi,mi->i", rows, rows))
    if not lengths.all():
        idle = names[int(np.argmin(lengths))]
        raise NotIdentifiableError(
            f"every unknown must act on the log; {idle} does not in this motion. Leave it out; "
            "where its joint moves, look with record.check() for what is not the machine's: gear, resolution, units.",
            idle,
        )
    solved = _by_products if dependent >= _EXACT_ENOUGH else _by_rows
    triangle, along = solved(rows, lengths, target, _Told(names, dependent))
    inverse = np.zeros((k, k))
    for i in reversed(range(k)):
        unit = (np.arange(k) == i).astype(float)
        inverse[i] = (unit - (triangle[i, i + 1 :, None] * inverse[i + 1 :]).sum(axis=0)) / triangle[i, i]
    values = (inverse * along).sum(axis=1) / lengths
    covariance = (inverse[:, None] * inverse[None]).sum(axis=2) / np.outer(lengths, lengths)
    return values, covariance, float(np.linalg.cond(triangle))


class _Told(NamedTuple):
    """Names of columns, and the share of its own that each must have."""

    names: Sequence[str]
    dependent: float

    def apart(self, triangle: Floats, i: int) -> None:
        """Raise where column i is a combination of those before it."""
        if triangle[i, i] < self.dependent:
            shares = np.linalg.solve(triangle[:i, :i], triangle[:i, i])
            others = [self.names[j] for j in np.flatnonzero(np.abs(shares) > 1e-3).tolist()]
            raise NotIdentifiableError(
                f"unknowns must be separately identifiable; {self.names[i]} is a combination of {', '.join(others)}. "
                "Fix one of them, log a motion that excites more (design_motion), or give identify a prior=.",
                self.names[i],
            )


def _by_rows(rows: Floats, lengths: Floats, target: Floats, told: _Told) -> tuple[Floats, Floats]:
    """R (k, k) of rows (N, k) over the lengths (k,) of columns = Q R, and Q^T target (k,): Gram-Schmidt, twice."""
    k = rows.shape[1]
    basis, triangle, work = np.ascontiguousarray((rows / lengths).T), np.zeros((k, k)), np.empty(len(rows))
    for i in range(k):
        column = basis[i]
        for _ in range(2):
            for j in range(i):
                share = np.multiply(basis[j], column, out=work).sum()
                triangle[j, i] += share
                column -= np.multiply(share, basis[j], out=work)
        triangle[i, i] = np.sqrt((column * column).sum())
        told.apart(triangle, i)
        basis[i] = column / triangle[i, i]
    turned = np.empty_like(rows, dtype=float)  # the layout of the rows decides the order of a sum
    turned[:] = basis.T
    return triangle, (turned * target[:, None]).sum(axis=0)


def _by_products(rows: Floats, lengths: Floats, target: Floats, told: _Told) -> tuple[Floats, Floats]:
    """The same from the products of columns: Cholesky's factorisation of rows^T rows = R^T R."""
    together, triangle = products(rows) / np.outer(lengths, lengths), np.zeros((rows.shape[1],) * 2)
    along = np.einsum("mi,m->i", rows, target) / lengths
    for i in range(len(triangle)):
        before, own = triangle[:i], triangle[:i, i]
        triangle[i, i] = np.sqrt(max(together[i, i] - (own * own).sum(), 0.0))
        told.apart(triangle, i)
        triangle[i, i + 1 :] = (together[i, i + 1 :] - (own[:, None] * before[:, i + 1 :]).sum(axis=0)) / triangle[i, i]
        along[i] = (along[i] - (own * along[:i]).sum()) / triangle[i, i]
    return triangle, along


def dependent_columns(names: Sequence[str], rows: Floats, *, dependent: float = 1e-9) -> dict[str, tuple[str, ...]]:
    """Columns (N, k) that are combinations of those before them: name -> names of these, () of a column of zeros."""
    lengths = np.sqrt((rows * rows).sum(axis=0))
    found, kept = dict[str, tuple[str, ...]](), list[int]()
    for i in range(rows.shape[1]):
        column = rows[:, i] / (lengths[i] or 1.0)
        before = rows[:, kept] / lengths[kept]
        shares = least(before, column)
        if norm(column - product(before, shares)) < dependent:
            found[names[i]] = tuple(names[j] for j, share in zip(kept, shares, strict=True) if abs(share) > 1e-3)
        else:
            kept.append(i)
    return found
