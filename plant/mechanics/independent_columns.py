"""Columns of a matrix that do not depend on each other, taken in an order of preference."""

from __future__ import annotations

import numpy as np

__all__ = ["independent_columns"]


def independent_columns(regressor, order, tolerance):
    """Columns (r,) that stay, taken in this order, and the matrix (r, columns) that says which others join them."""
    lengths = np.linalg.norm(regressor, axis=0)
    order = [column for column in order if lengths[column] > tolerance * lengths.max()]
    kept, basis = [], np.empty((len(regressor), 0))
    for column in order:
        new = regressor[:, column] / lengths[column]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            new = new - basis @ (basis.T @ new)
        if np.linalg.norm(new) > tolerance:
            kept.append(column)
            basis = np.column_stack([basis, new / np.linalg.norm(new)])
    kept.sort()
    matrix = np.zeros((len(kept), regressor.shape[1]))
    shares = np.linalg.lstsq(regressor[:, kept], regressor[:, order], rcond=None)[0]
    matrix[:, order] = np.where(np.abs(shares) > 1e-9, shares, 0.0)
    matrix[:, kept] = np.eye(len(kept))
    return kept, matrix
