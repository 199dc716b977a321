"""Linear least squares with the same bits on any number of threads; cluster-robust covariances.

`least_squares` factorises the columns by Gram-Schmidt, or from their products by Cholesky. The
products are six times faster than an orthonormal basis, and lose half the digits. They are exact
enough where the threshold refuses nearly dependent columns anyway.

Residuals of one segment may be correlated in any way; those of different segments must not be.
`group_std` leaves out the segments one by one (the delete-a-group jackknife). `run_std` serves a
few runs, one of which may dominate: it corrects the residual of each run for the share that the
fit has taken away (bias-reduced linearisation).

Source: B. Efron, C. Stein, The jackknife estimate of variance, Annals of Statistics 9, 1981; R. M.
Bell, D. F. McCaffrey, Bias reduction in standard errors for linear regression with multi-stage
samples, Survey Methodology 28, 2002; J. G. MacKinnon, M. O. Nielsen, M. D. Webb, Cluster-robust
inference, Journal of Econometrics 232, 2023.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant.parts import Floats, Integers, dot, frozen_settings, least, norm, product, products


@frozen_settings
class IdentifiabilitySettings:
    """Thresholds that decide whether the equations can separate an unknown from the others.

    Most of them are the least share of a column that must be independent of the other columns. Each
    source of columns has its own share, since each source has its own accuracy. `certain`, `run`
    and `share` are thresholds of other quantities. All are chosen by hand.

    Parameters
    ----------
    equations : float
        Columns of linear equations, exact but for rounding.
    products : float
        Least share that the products of columns resolve: they lose half of all digits.
    smooth : float
        Differences of simulations without rounding, and increments of f by a load.
    slopes : float
        Differences of simulations with rounding, which are exact to a few digits.
    with_prior : float
        Differences of simulations beside a prior of f, which determines what a log does not.
    remembered : float
        Differences beside the expected state of a law before its log, whose weak directions are
        simulated: exact but for rounding.
    optimum : float
        Differences of an extended model, where a dependent unknown is left out and not refused.
    certain : float
        Spread of a parameter under a prior; below it the parameter follows from others.
    run : float
        Tolerance of `run_moves`: the least eigenvalue of a run's products over the largest one, and
        the least share of a run's residual that the fit must leave in a direction. A direction
        below either of them is ignored.
    share : float
        A message about a dependent column names every column whose share in it exceeds this.
    """

    equations: float = 1e-9
    products: float = 1e-5
    smooth: float = 1e-7
    slopes: float = 1e-4
    with_prior: float = 1e-5
    remembered: float = 1e-13
    optimum: float = 1e-3
    certain: float = 1e-6
    run: float = 1e-9
    share: float = 1e-3


IDENTIFIABLE = IdentifiabilitySettings()


class NotIdentifiableError(ValueError):
    """Unknowns that the equations cannot separate, or that act in none of them.

    `name`: the unknown that could be left out.
    """

    def __init__(self, message: str, name: str) -> None:
        super().__init__(message)
        self.name = name

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (str(self), self.name)


def least_squares(
    names: Sequence[str], rows: Floats, target: Floats, *, dependent: float = IDENTIFIABLE.equations
) -> tuple[Floats, Floats, float]:
    """Solve rows x = target.

    `names`: of the columns, for messages. `rows` (N, k). `target` (N,). `dependent`: a column with
    a smaller independent share is a combination of the others.

    Returns values (k,); covariance (k, k): of the values, where the residual of every row has a
    standard deviation of 1; condition: of the columns, scaled to one length.
    """
    k = rows.shape[1]
    # All columns at one length: shares and the condition then do not depend on units.
    lengths = np.sqrt(np.einsum("mi,mi->i", rows, rows))
    if not lengths.all():
        idle = names[int(np.argmin(lengths))]
        raise NotIdentifiableError(
            f"every unknown must act on the log; {idle} does not in this motion. Leave it out;"
            " where its joint moves, look with record.check() for what is not the machine's: gear,"
            " resolution, units.",
            idle,
        )
    # The products of the columns are six times faster, and exact enough for a coarse threshold.
    factorise = _by_products if dependent >= IDENTIFIABLE.products else _by_rows
    triangle, turned = factorise(rows, lengths, target, _Separable(names, dependent))
    # The inverse of a triangle by back substitution; values and covariance follow from it.
    inverse = np.zeros((k, k))
    for i in reversed(range(k)):
        unit = (np.arange(k) == i).astype(float)
        below = (triangle[i, i + 1 :, None] * inverse[i + 1 :]).sum(axis=0)
        inverse[i] = (unit - below) / triangle[i, i]
    # Sums in place of matrix products: BLAS sums in another order on another number of threads.
    values = (inverse * turned).sum(axis=1) / lengths
    covariance = (inverse[:, None] * inverse[None]).sum(axis=2) / np.outer(lengths, lengths)
    return values, covariance, float(np.linalg.cond(triangle))


class _Separable(NamedTuple):
    """Names of columns, and the independent share that each must have."""

    names: Sequence[str]
    dependent: float

    def check(self, triangle, i):
        """Raise where column i is a combination of those before it."""
        if triangle[i, i] < self.dependent:
            shares = np.linalg.solve(triangle[:i, :i], triangle[:i, i])
            combined = np.flatnonzero(np.abs(shares) > IDENTIFIABLE.share).tolist()
            raise NotIdentifiableError(
                f"unknowns must be separately identifiable; {self.names[i]} is a combination of"
                f" {', '.join(self.names[j] for j in combined)}. Fix one of them, log a motion that"
                " excites more (design_motion), or give identify a prior=.",
                self.names[i],
            )


def _by_rows(rows, lengths, target, separable):
    """Factor R (k, k) of the scaled rows, and Q^T target (k,), by Gram-Schmidt twice.

    The rows (N, k) over the lengths (k,) of their columns are Q R.
    """
    k = rows.shape[1]
    basis = np.ascontiguousarray((rows / lengths).T)
    triangle = np.zeros((k, k))
    work = np.empty(len(rows))
    for i in range(k):
        column = basis[i]
        # The second pass removes what rounding left of the other columns in the first.
        for _ in range(2):
            for j in range(i):
                share = np.multiply(basis[j], column, out=work).sum()
                triangle[j, i] += share
                column -= np.multiply(share, basis[j], out=work)
        triangle[i, i] = np.sqrt((column * column).sum())
        separable.check(triangle, i)
        basis[i] = column / triangle[i, i]
    # The layout of the rows decides the order of a sum, and with it the last bits.
    turned = np.empty_like(rows, dtype=float)
    turned[:] = basis.T
    return triangle, (turned * target[:, None]).sum(axis=0)


def _by_products(rows, lengths, target, separable):
    """The same from the products of columns: Cholesky's factorisation of rows^T rows = R^T R."""
    gram = products(rows) / np.outer(lengths, lengths)
    triangle = np.zeros((rows.shape[1],) * 2)
    turned = np.einsum("mi,m->i", rows, target) / lengths
    for i in range(len(triangle)):
        above = triangle[:i]
        column = triangle[:i, i]
        # Rounding can leave a dependent column a negative square.
        triangle[i, i] = np.sqrt(max(gram[i, i] - (column * column).sum(), 0.0))
        separable.check(triangle, i)
        eliminated = (column[:, None] * above[:, i + 1 :]).sum(axis=0)
        triangle[i, i + 1 :] = (gram[i, i + 1 :] - eliminated) / triangle[i, i]
        turned[i] = (turned[i] - (column * turned[:i]).sum()) / triangle[i, i]
    return triangle, turned


def dependent_columns(
    names: Sequence[str], rows: Floats, *, dependent: float = IDENTIFIABLE.equations
) -> dict[str, tuple[str, ...]]:
    """Names of the dependent columns of `rows` (N, k) -> names of the columns that each combines.

    A column is dependent if it is a combination of the independent columns before it. A column of
    zeros maps to ().
    """
    lengths = np.sqrt((rows * rows).sum(axis=0))
    combinations = {}
    independent = list[int]()
    for i in range(rows.shape[1]):
        # Against the independent ones before it alone: so each dependence is reported once.
        column = rows[:, i] / (lengths[i] or 1.0)
        basis = rows[:, independent] / lengths[independent]
        shares = least(basis, column)
        if norm(column - product(basis, shares)) < dependent:
            combinations[names[i]] = tuple(
                names[j]
                for j, share in zip(independent, shares, strict=True)
                if abs(share) > IDENTIFIABLE.share
            )
        else:
            independent.append(i)
    return combinations


def directions(rates: Floats, dependent: float = IDENTIFIABLE.optimum) -> Floats:
    """Coefficients (r, v) that combine rates (v, M) into r orthonormal rows.

    A dependent rate adds no row.

    `dependent`: least independent share of a rate. By Gram-Schmidt on the products of the rates.
    """
    gram = products(rates.T)
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0, lengths, 1.0)
    gram = gram / np.outer(lengths, lengths)
    basis = np.empty((0, len(rates)))
    for i in range(len(rates)):
        direction = (np.arange(len(rates)) == i).astype(float)
        # The second pass removes what rounding left of the other directions in the first.
        for _ in range(2):
            shares = product(basis, product(gram, direction))
            direction = direction - product(basis.T, shares)
        size = np.sqrt(max(dot(direction, product(gram, direction)), 0.0))
        if size > dependent:
            basis = np.vstack([basis, direction / size])
    return basis / lengths


def along(basis: Floats, rates: Floats, target: Floats) -> Floats:
    """Coefficients (v,) of the combination of rates (v, M) that is nearest to the target (M,).

    `basis` (r, v): what `directions` returns for these rates. A rate that `directions` found
    dependent has the coefficient 0.
    """
    return product(basis.T, product(basis, np.einsum("vm,m->v", rates, target)))


# Least number of segments of all runs together that are compared: with fewer, Student's quantile
# makes the intervals wide; with more, residuals of neighbouring segments are correlated.
SEGMENTS = 10

NORMAL = 1.96  # standard deviations on either side of a normal value that hold 95 %

# Rows that are scaled at once: a scaled copy of all rows of a long log has no room in memory.
_AT_ONCE = 1 << 19


def in_groups(lengths: Sequence[int], prior: int, least: int) -> Integers:
    """Groups (M,) of rows, from 0 without gaps: each length is cut into equally many segments.

    All lengths together have at least `least` segments, unless a length has fewer rows than
    segments: then each of its rows is one.

    The first rows, as many as `prior`, are those of a prior: they are in group -1 and never left
    out.
    """
    # Rounded up.
    per_length = -(-least // len(lengths))
    groups = [np.full(prior, -1)]
    first = 0
    for length in lengths:
        # An empty segment would count as one that agrees with all others.
        segments = min(per_length, length)
        groups.append(first + np.arange(length) * segments // length)
        first += segments
    return np.concatenate(groups)


def group_std(rows: Floats, residual: Floats, groups: Integers) -> Floats:
    """Standard deviations (k,) of the values of a fit, for intervals of 1.96 of them.

    `rows` (M, k): change of the residual with the values. `residual` (M,): of the fit. `groups`
    (M,): number of the group of each row, from 0 without gaps. Few groups make wide intervals:
    Student's, not normal.

    All are infinite if the normal equations without one of the groups are exactly singular.
    """
    count = int(groups.max()) + 1
    k = rows.shape[1]
    # In columns of one length the normal equations keep their digits whatever the units are.
    scale = np.sqrt(np.einsum("mi,mi->i", rows, rows))
    # A column of zeros has no length, and makes all of these equations singular.
    if not scale.all():
        return np.full(k, np.inf)
    normal = np.zeros((k, k))
    moves = np.empty((count, k))
    for begin in range(0, len(rows), _AT_ONCE):
        normal += products(rows[begin : begin + _AT_ONCE] / scale)
    # The values without a group follow from the normal equations less that group's part of them.
    for i in range(count):
        group = rows[groups == i] / scale
        try:
            moves[i] = np.linalg.solve(
                normal - products(group), (group * residual[groups == i, None]).sum(axis=0)
            )
        except np.linalg.LinAlgError:
            return np.full(k, np.inf)
    # Estimates without a group share most rows: the jackknife's factor makes up for that.
    variance = (count - 1) / count * ((moves - moves.mean(axis=0)) ** 2).sum(axis=0)
    return _student(variance, scale, count)


def run_std(rows: Floats, residual: Floats, runs: Integers) -> Floats:
    """Standard deviations (k,) of the values, for a few groups of unequal weight, such as runs.

    The parameters are those of `group_std`. A direction that one run determines alone adds nothing
    to the standard deviations: they are not infinite there.
    """
    moves = run_moves(rows, residual, runs)
    return _student((moves**2).sum(axis=0), np.ones(rows.shape[1]), len(moves))


def run_moves(rows: Floats, residual: Floats, runs: Integers) -> Floats:
    """Change of the values by each group (R, k), corrected for the part that the fit takes away."""
    count = int(runs.max()) + 1
    scale = np.sqrt((rows * rows).sum(axis=0))
    inverse = np.linalg.inv(products(rows / scale))
    scores = np.zeros((count, rows.shape[1]))
    for i in range(count):
        run = rows[runs == i] / scale
        sizes, axes = np.linalg.eigh(products(run))
        shown = sizes > IDENTIFIABLE.run * sizes[-1]
        root = axes[:, shown] * np.sqrt(sizes[shown])
        unroot = axes[:, shown] / np.sqrt(sizes[shown])
        # Leverage: the share of this run's residual that the fit has taken away, per direction. A
        # direction that this run alone determines has no residual, and tells nothing.
        taken, axes_taken = np.linalg.eigh(root.T @ inverse @ root)
        most = 1 - IDENTIFIABLE.run
        remaining = np.where(taken < most, 1 - np.minimum(taken, most), np.inf)
        score = axes_taken.T @ (unroot.T @ (run * residual[runs == i, None]).sum(axis=0))
        # The square root of the remaining share, on the score, corrects the variance (CR2).
        scores[i] = root @ (axes_taken @ (score / np.sqrt(remaining)))
    return scores @ inverse / scale


def _student(variance, scale, count):
    """Standard deviations of values in these scales, widened for the number of groups."""
    return np.sqrt(variance) / scale * wider(count - 1)


def wider(freedom: ArrayLike) -> Floats:
    """Student's 95 % quantile over that of the normal distribution, by degrees of freedom."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.975) / NORMAL)


def at_least(covariance: Floats, std: Floats) -> Floats:
    """A covariance (k, k) with standard deviations of at least these (k,).

    The part that is added has the same correlations: it makes no combination more certain.
    """
    present = np.sqrt(np.diag(covariance))
    # A value keeps its present variance if it is known exactly, or if its `std` is not finite.
    wanted = np.where((present > 0) & np.isfinite(std), std, present)
    added = np.sqrt(np.maximum(wanted**2 - present**2, 0.0))
    # An exact value has no share of what is added: 0 / 0 is not evaluated.
    share = np.divide(added, present, out=np.zeros_like(present), where=present > 0)
    return covariance * (1 + np.outer(share, share))


def covariance_of(names: Sequence[str], estimated: Sequence[str], covariance: Floats) -> Floats:
    """Covariance (m, m) of numbers by their names, from that (k, k) of the estimated numbers.

    Zero of numbers that were not estimated.
    """
    result = np.zeros((len(names),) * 2)
    pairs = [(i, estimated.index(name)) for i, name in enumerate(names) if name in estimated]
    # The reshape serves an empty list, too: then no number was estimated, and all stays zero.
    rows, places = np.array(pairs, int).reshape(-1, 2).T
    result[np.ix_(rows, rows)] = covariance[np.ix_(places, places)]
    return result
