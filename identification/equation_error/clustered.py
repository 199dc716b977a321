"""Covariance of a least-squares fit from how it differs between segments, or between runs: cluster-robust.

Residuals of one segment may be correlated in any way; those of different segments must not be. What a model lacks in
one segment and not in another shows, and what it lacks everywhere alike does not. Segments are left out one by one
(the delete-a-group jackknife). Of a few runs, of which one may tell most, each one's share in the equations is
corrected by what of it the fit has taken away (bias-reduced linearisation).

Source: B. Efron, C. Stein, The jackknife estimate of variance, Annals of Statistics 9, 1981; R. M. Bell,
D. F. McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey Methodology
28, 2002; J. G. MacKinnon, M. O. Nielsen, M. D. Webb, Cluster-robust inference, Journal of Econometrics 232, 2023.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.parts.fields import Floats
from plant.parts.sums import products

RUNS, SEGMENTS = 3, 10
"""From how many runs on, and of how many segments of all runs at least, values are compared."""

_NORMAL = 1.96

_OWN = 1e-9  # share of a direction below which one run alone determines it: of that nothing is known


def group_std(rows: Floats, residual: Floats, groups: NDArray[np.intp]) -> Floats:
    """Standard deviations (k,) of the values of a fit, for intervals of 1.96 of them.

    `rows` (M, k): change of the residual with the values. `residual` (M,): of the fit. `groups` (M,): number of the
    group of each row, from 0. Few groups make wide intervals: Student's, not normal.

    Inf where the rest of the groups does not determine all values.
    """
    count, k = int(groups.max()) + 1, rows.shape[1]
    scale = np.sqrt((rows * rows).sum(axis=0))
    whole, moves = products(rows / scale), np.empty((count, k))
    for i in range(count):
        own = rows[groups == i] / scale
        try:
            moves[i] = np.linalg.solve(whole - products(own), (own * residual[groups == i, None]).sum(axis=0))
        except np.linalg.LinAlgError:
            return np.full(k, np.inf)
    return _student((count - 1) / count * ((moves - moves.mean(axis=0)) ** 2).sum(axis=0), scale, count)


def run_std(rows: Floats, residual: Floats, runs: NDArray[np.intp]) -> Floats:
    """The same for a few groups of unequal weight, such as runs; parameters as for `group_std`."""
    moves = run_moves(rows, residual, runs)
    return _student((moves**2).sum(axis=0), np.ones(rows.shape[1]), len(moves))


def run_moves(rows: Floats, residual: Floats, runs: NDArray[np.intp]) -> Floats:
    """How far each group moves the values (R, k), corrected by what of it the fit takes away."""
    count, scale = int(runs.max()) + 1, np.sqrt((rows * rows).sum(axis=0))
    inverse, scores = np.linalg.inv(products(rows / scale)), np.zeros((count, rows.shape[1]))
    for i in range(count):
        own = rows[runs == i] / scale
        sizes, axes = np.linalg.eigh(products(own))
        shown = sizes > _OWN * sizes[-1]
        root, unroot = axes[:, shown] * np.sqrt(sizes[shown]), axes[:, shown] / np.sqrt(sizes[shown])
        taken, directions = np.linalg.eigh(root.T @ inverse @ root)  # by the fit, of what this run shows
        left = np.where(taken < 1 - _OWN, 1 - np.minimum(taken, 1 - _OWN), np.inf)
        score = directions.T @ (unroot.T @ (own * residual[runs == i, None]).sum(axis=0))
        scores[i] = root @ (directions @ (score / np.sqrt(left)))
    return np.asarray(scores @ inverse / scale)


def _student(variance: Floats, scale: Floats, count: int) -> Floats:
    """Standard deviations of values in these scales, as wide as Student's quantile of so many groups has them."""
    return np.asarray(np.sqrt(variance) / scale * wider(count - 1))


def wider(freedom: ArrayLike) -> Floats:
    """Student's quantile of 95 % for these degrees of freedom, in that of the normal distribution."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.975) / _NORMAL)


def at_least(covariance: Floats, std: Floats) -> Floats:
    """A covariance (k, k) with the same correlations and standard deviations of at least these (k,)."""
    own = np.sqrt(np.diag(covariance))
    wider = np.where((own > 0) & np.isfinite(std), np.maximum(std, own) / np.where(own > 0, own, 1.0), 1.0)
    return np.asarray(covariance * np.outer(wider, wider))
