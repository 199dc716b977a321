"""Splines through the commanded counts of a log: as smooth as their rounding allows, and made
once per log.
"""

import hashlib
from typing import Any

import numpy as np

from plant.parts.fields import Floats

_QUINTIC = 5  # degree of the splines through commanded counts: accelerations are smooth

# Ratio of the numbers of knots that are tested, and samples that each has at least.
_MORE_KNOTS = 1.3
_SAMPLES_PER_KNOT = 8

# splines of some logs: a law is run many times along one log
_FOUND = dict[bytes, list[Any]]()
_KEPT = 16


def smooth_splines(t: Floats, columns: Floats, rounded: bool, finer: float) -> list[Any]:
    """Quintic splines through columns (N, n) at times t (N,) [s]; of rounded ones, through the
    middles of their cells.

    Their even knots are as few as leave no more than rounding does, a mean square of 1/12.
    """
    from scipy.interpolate import make_interp_spline

    key = hashlib.blake2b(repr((columns.shape, rounded, finer)).encode())
    for part in (t, columns):
        key.update(np.ascontiguousarray(part).data)
    splines = _FOUND.get(key.digest())
    if splines is None:
        if rounded and len(t) > 2 * (_QUINTIC + 1):
            splines = _fewest_knots(t, columns, finer)
        else:
            splines = [
                make_interp_spline(t, column, k=min(_QUINTIC, len(t) - 1)) for column in columns.T
            ]
        if len(_FOUND) >= _KEPT:
            _FOUND.clear()
        _FOUND[key.digest()] = splines
    return splines


def _fewest_knots(t: Floats, columns: Floats, finer: float) -> list[Any]:
    count = len(t)
    knots = 1
    splines = dict[int, Any]()
    enough = (1 + 2 / np.sqrt(count)) / 12
    open_ones = list(range(columns.shape[1]))
    while open_ones and (not splines or knots * _SAMPLES_PER_KNOT <= count):
        inner = np.linspace(t[0], t[-1], int(np.ceil(finer * knots)) + 1)
        try:
            some, left = _least_squares_splines(
                t, columns[:, open_ones], np.pad(inner, _QUINTIC, "edge")
            )
        except np.linalg.LinAlgError:  # a gap in the log is longer than the knots are apart
            break
        splines |= dict(zip(open_ones, some, strict=True))
        open_ones = [j for j, square in zip(open_ones, left, strict=True) if square > enough]
        knots = int(np.ceil(_MORE_KNOTS * knots))
    return [splines[j] for j in range(columns.shape[1])]


def _least_squares_splines(t: Floats, columns: Floats, knots: Floats) -> tuple[list[Any], Floats]:
    """Splines on these knots, and the mean square that each leaves: from the products of
    neighbouring B-splines.
    """
    from scipy.interpolate import BSpline
    from scipy.linalg import solveh_banded

    each = _QUINTIC + 1
    size = len(knots) - _QUINTIC - 1
    design = BSpline.design_matrix(t, knots, _QUINTIC)
    value = design.data.reshape(-1, each)
    place = design.indices.reshape(-1, each)
    products = np.zeros((each, size))
    for i in range(each):
        for j in range(i + 1):
            products[i - j] += np.bincount(place[:, j], value[:, i] * value[:, j], size)
    target = [
        sum(np.bincount(place[:, i], value[:, i] * column, size) for i in range(each))
        for column in columns.T
    ]
    found = solveh_banded(products, np.column_stack(target), lower=True)
    left = [
        np.mean(((value * own[place]).sum(axis=1) - column) ** 2)
        for own, column in zip(found.T, columns.T, strict=True)
    ]
    return [BSpline(knots, own, _QUINTIC) for own in found.T], np.array(left)
