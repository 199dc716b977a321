"""Linear least squares in plain sums, the same bits on any number of threads, and cluster-robust
covariances.

By Gram-Schmidt, or of products: products of the columns are made six times faster than an
orthonormal basis, and lose half the digits: they are exact enough where columns that are nearly
dependent are refused anyway.

Residuals of one segment may be correlated in any way; those of different segments must not be.
Segments are left out one by one (the delete-a-group jackknife). Of a few runs, of which one may
tell most, each one's share in the equations is corrected by what of it the fit has taken away
(bias-reduced linearisation).

Source: B. Efron, C. Stein, The jackknife estimate of variance, Annals of Statistics 9, 1981; R. M.
Bell, D. F. McCaffrey, Bias reduction in standard errors for linear regression with multi-stage
samples, Survey Methodology 28, 2002; J. G. MacKinnon, M. O. Nielsen, M. D. Webb, Cluster-robust
inference, Journal of Econometrics 232, 2023.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.parts.fields import Floats
from plant.parts.sums import least, norm, product, products

# share of its own from which on a column is told from others by their products
_EXACT_ENOUGH = 1e-5


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

    `names`: of the columns, for messages. `rows` (N, k). `target` (N,). `dependent`: a column of
    which less than this share is its own is a combination of the others.

    Returns values (k,); covariance (k, k): of the values, where the residual of every row has a
    standard deviation of 1; condition: of the columns, scaled to one length.
    """
    k = rows.shape[1]
    lengths = np.sqrt(np.einsum("mi,mi->i", rows, rows))
    if not lengths.all():
        idle = names[int(np.argmin(lengths))]
        raise NotIdentifiableError(
            f"every unknown must act on the log; {idle} does not in this motion. Leave it out;"
            " where its joint moves, look with record.check() for what is not the machine's: gear,"
            " resolution, units.",
            idle,
        )
    solved = _by_products if dependent >= _EXACT_ENOUGH else _by_rows
    triangle, along = solved(rows, lengths, target, _Told(names, dependent))
    inverse = np.zeros((k, k))
    for i in reversed(range(k)):
        unit = (np.arange(k) == i).astype(float)
        inverse[i] = (
            unit - (triangle[i, i + 1 :, None] * inverse[i + 1 :]).sum(axis=0)
        ) / triangle[i, i]
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
                f"unknowns must be separately identifiable; {self.names[i]} is a combination of"
                f" {', '.join(others)}. Fix one of them, log a motion that excites more"
                " (design_motion), or give identify a prior=.",
                self.names[i],
            )


def _by_rows(rows: Floats, lengths: Floats, target: Floats, told: _Told) -> tuple[Floats, Floats]:
    """R (k, k) of rows (N, k) over the lengths (k,) of columns = Q R, and Q^T target (k,):
    Gram-Schmidt, twice.
    """
    k = rows.shape[1]
    basis = np.ascontiguousarray((rows / lengths).T)
    triangle = np.zeros((k, k))
    work = np.empty(len(rows))
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


def _by_products(
    rows: Floats, lengths: Floats, target: Floats, told: _Told
) -> tuple[Floats, Floats]:
    """The same from the products of columns: Cholesky's factorisation of rows^T rows = R^T R."""
    together = products(rows) / np.outer(lengths, lengths)
    triangle = np.zeros((rows.shape[1],) * 2)
    along = np.einsum("mi,m->i", rows, target) / lengths
    for i in range(len(triangle)):
        before = triangle[:i]
        own = triangle[:i, i]
        triangle[i, i] = np.sqrt(max(together[i, i] - (own * own).sum(), 0.0))
        told.apart(triangle, i)
        triangle[i, i + 1 :] = (
            together[i, i + 1 :] - (own[:, None] * before[:, i + 1 :]).sum(axis=0)
        ) / triangle[i, i]
        along[i] = (along[i] - (own * along[:i]).sum()) / triangle[i, i]
    return triangle, along


def dependent_columns(
    names: Sequence[str], rows: Floats, *, dependent: float = 1e-9
) -> dict[str, tuple[str, ...]]:
    """Columns (N, k) that are combinations of those before them: name -> names of these, () of a
    column of zeros.
    """
    lengths = np.sqrt((rows * rows).sum(axis=0))
    found = dict[str, tuple[str, ...]]()
    kept = list[int]()
    for i in range(rows.shape[1]):
        column = rows[:, i] / (lengths[i] or 1.0)
        before = rows[:, kept] / lengths[kept]
        shares = least(before, column)
        if norm(column - product(before, shares)) < dependent:
            found[names[i]] = tuple(
                names[j] for j, share in zip(kept, shares, strict=True) if abs(share) > 1e-3
            )
        else:
            kept.append(i)
    return found


SEGMENTS = 10  # of all runs, at least, of which values are compared

NORMAL = 1.96  # standard deviations on either side of a normal value that hold 95 %

_AT_ONCE = 1 << 19  # rows that are scaled at once

# share of a direction below which one run alone determines it: of that nothing is known
_OWN = 1e-9


def in_groups(lengths: Sequence[int], before: int, least: int) -> NDArray[np.intp]:
    """Groups (M,) of rows: each of these lengths is as many segments as make at least so many, of
    all.

    Rows `before` them, a prior's, are in none, -1: never left out.
    """
    each = -(-least // len(lengths))
    return np.concatenate(
        [np.full(before, -1), *(each * i + np.arange(n) * each // n for i, n in enumerate(lengths))]
    )


def group_std(rows: Floats, residual: Floats, groups: NDArray[np.intp]) -> Floats:
    """Standard deviations (k,) of the values of a fit, for intervals of 1.96 of them.

    `rows` (M, k): change of the residual with the values. `residual` (M,): of the fit. `groups`
    (M,): number of the group of each row, from 0. Few groups make wide intervals: Student's, not
    normal.

    Inf where the rest of the groups does not determine all values.
    """
    count = int(groups.max()) + 1
    k = rows.shape[1]
    scale = np.sqrt(np.einsum("mi,mi->i", rows, rows))
    whole = np.zeros((k, k))
    moves = np.empty((count, k))
    for start in range(0, len(rows), _AT_ONCE):
        whole += products(rows[start : start + _AT_ONCE] / scale)
    for i in range(count):
        own = rows[groups == i] / scale
        try:
            moves[i] = np.linalg.solve(
                whole - products(own), (own * residual[groups == i, None]).sum(axis=0)
            )
        except np.linalg.LinAlgError:
            return np.full(k, np.inf)
    return _student(
        (count - 1) / count * ((moves - moves.mean(axis=0)) ** 2).sum(axis=0), scale, count
    )


def run_std(rows: Floats, residual: Floats, runs: NDArray[np.intp]) -> Floats:
    """The same for a few groups of unequal weight, such as runs; parameters as for `group_std`."""
    moves = run_moves(rows, residual, runs)
    return _student((moves**2).sum(axis=0), np.ones(rows.shape[1]), len(moves))


def run_moves(rows: Floats, residual: Floats, runs: NDArray[np.intp]) -> Floats:
    """How far each group moves the values (R, k), corrected by what of it the fit takes away."""
    count = int(runs.max()) + 1
    scale = np.sqrt((rows * rows).sum(axis=0))
    inverse = np.linalg.inv(products(rows / scale))
    scores = np.zeros((count, rows.shape[1]))
    for i in range(count):
        own = rows[runs == i] / scale
        sizes, axes = np.linalg.eigh(products(own))
        shown = sizes > _OWN * sizes[-1]
        root = axes[:, shown] * np.sqrt(sizes[shown])
        unroot = axes[:, shown] / np.sqrt(sizes[shown])
        # by the fit, of what this run shows
        taken, directions = np.linalg.eigh(root.T @ inverse @ root)
        left = np.where(taken < 1 - _OWN, 1 - np.minimum(taken, 1 - _OWN), np.inf)
        score = directions.T @ (unroot.T @ (own * residual[runs == i, None]).sum(axis=0))
        scores[i] = root @ (directions @ (score / np.sqrt(left)))
    return np.asarray(scores @ inverse / scale)


def _student(variance: Floats, scale: Floats, count: int) -> Floats:
    """Standard deviations of values in these scales, as wide as Student's quantile of so many
    groups has them.
    """
    return np.asarray(np.sqrt(variance) / scale * wider(count - 1))


def wider(freedom: ArrayLike) -> Floats:
    """Student's quantile of 95 % for these degrees of freedom, in that of the normal
    distribution.
    """
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.975) / NORMAL)


def at_least(covariance: Floats, std: Floats) -> Floats:
    """A covariance (k, k) with standard deviations of at least these (k,).

    What is added has the same correlations: no combination is known better than before.
    """
    own = np.sqrt(np.diag(covariance))
    added = np.sqrt(np.maximum(np.where((own > 0) & np.isfinite(std), std, own) ** 2 - own**2, 0.0))
    share = np.divide(added, own, out=np.zeros_like(own), where=own > 0)
    return np.asarray(covariance * (1 + np.outer(share, share)))


def covariance_of(names: Sequence[str], known: Sequence[str], covariance: Floats) -> Floats:
    """Covariance (m, m) of numbers by their names, of one (k, k) of those that are known; zero
    of others.
    """
    found = np.zeros((len(names),) * 2)
    own = [(i, known.index(name)) for i, name in enumerate(names) if name in known]
    rows, places = np.array(own, int).reshape(-1, 2).T
    found[np.ix_(rows, rows)] = covariance[np.ix_(places, places)]
    return found
