"""Splines through the commanded counts of a log, as smooth as their rounding allows."""

import hashlib
from typing import Any

import numpy as np

from plant.parts import Floats

# Degree of the splines: quintic ones have smooth accelerations.
_DEGREE = 5

# Splines of the last logs, by the hash of times and columns: a law is run many times along one log.
_FOUND = dict[bytes, list[Any]]()


def smooth_splines(t: Floats, columns: Floats, rounded: bool, finer: float) -> list[Any]:
    """Quintic splines through columns (N, n) at times t (N,) [s].

    Rounded columns are fitted by least squares, with the fewest even knots at which the residual is
    that of rounding, a mean square of 1/12; then there are `finer` times as many.
    """
    from scipy.interpolate import make_interp_spline

    # A hash of the data, since arrays of equal logs are different objects.
    key = hashlib.blake2b(repr((columns.shape, rounded, finer)).encode())
    for part in (t, columns):
        key.update(np.ascontiguousarray(part).data)
    splines = _FOUND.get(key.digest())
    if splines is None:
        if rounded and len(t) > 2 * (_DEGREE + 1):
            splines = _fewest_knots(t, columns, finer)
        else:
            degree = min(_DEGREE, len(t) - 1)
            splines = [make_interp_spline(t, column, k=degree) for column in columns.T]
        # Old logs are forgotten, to bound the memory.
        if len(_FOUND) >= 16:
            _FOUND.clear()
        _FOUND[key.digest()] = splines
    return splines


def _fewest_knots(t, columns, finer):
    """Splines with as few even intervals as the rounding of the columns allows."""
    count = len(t)
    intervals = 1
    splines = {}
    # The mean square of rounding, and about two standard deviations of its estimate above it.
    enough = (1 + 2 / np.sqrt(count)) / 12
    remaining = list(range(columns.shape[1]))
    # At least eight samples per interval: with fewer, a spline follows the rounding itself.
    while remaining and (not splines or 8 * intervals <= count):
        knots = np.linspace(t[0], t[-1], int(np.ceil(finer * intervals)) + 1)
        try:
            fits, squares = _least_squares_splines(
                t, columns[:, remaining], np.pad(knots, _DEGREE, "edge")
            )
        except np.linalg.LinAlgError:  # a gap in the log is longer than the knots are apart
            break
        splines |= dict(zip(remaining, fits, strict=True))
        remaining = [j for j, square in zip(remaining, squares, strict=True) if square > enough]
        # By 30 % each time: few fits, and a number of knots close to the smallest.
        intervals = int(np.ceil(1.3 * intervals))
    return [splines[j] for j in range(columns.shape[1])]


def _least_squares_splines(t, columns, knots):
    """Least-squares splines on these knots, and the mean square of each residual.

    The normal equations are banded: a B-spline overlaps with its neighbours alone.
    """
    from scipy.interpolate import BSpline
    from scipy.linalg import solveh_banded

    # 1. At each time the values of the B-splines that are not zero, and their places.
    order = _DEGREE + 1
    size = len(knots) - order
    # The knots are even, but padded at both ends: each time lies in one interval, whose six
    # B-splines alone are not zero.
    design = BSpline.design_matrix(t, knots, _DEGREE)
    # Each row of the sparse matrix has as many entries as the order.
    value = design.data.reshape(-1, order)
    place = design.indices.reshape(-1, order)

    # 2. Their products, by diagonals, and those with the columns.
    products = np.zeros((order, size))
    for i in range(order):
        for j in range(i + 1):
            # `bincount` adds up the samples of each place, always in the same order.
            products[i - j] += np.bincount(place[:, j], value[:, i] * value[:, j], size)
    target = [
        sum(np.bincount(place[:, i], value[:, i] * column, size) for i in range(order))
        for column in columns.T
    ]
    solution = solveh_banded(products, np.column_stack(target), lower=True)

    # 3. The residuals.
    splines = []
    squares = []
    for coefficients, column in zip(solution.T, columns.T, strict=True):
        splines.append(BSpline(knots, coefficients, _DEGREE))
        # The values of the B-splines are at hand, so no spline is evaluated again.
        residual = (value * coefficients[place]).sum(axis=1) - column
        squares.append(np.mean(residual**2))
    return splines, np.array(squares)
