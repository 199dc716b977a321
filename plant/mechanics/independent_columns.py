"""Linearly independent columns of a regressor, chosen in an order of preference."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def independent_columns(
    regressor: NDArray[np.float64], order: Iterable[int], tolerance: float
) -> tuple[list[int], NDArray[np.float64]]:
    """The independent columns (r,), preferred in this order, and all columns as combinations (r, columns) of them."""
    lengths = np.linalg.norm(regressor, axis=0)
    order = [column for column in order if lengths[column] > tolerance * lengths.max()]
    kept: list[int] = []
    basis = np.empty((len(regressor), 0))
    for column in order:
        new = regressor[:, column] / lengths[column]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            new = new - basis @ (basis.T @ new)
        if np.linalg.norm(new) > tolerance:
            kept.append(column)
            basis = np.column_stack([basis, new / np.linalg.norm(new)])
    kept.sort()
    matrix = np.zeros((len(kept), regressor.shape[1]))
    combinations = np.linalg.lstsq(regressor[:, kept], regressor[:, order], rcond=None)[0]
    matrix[:, order] = np.where(np.abs(combinations) > 1e-9, combinations, 0.0)
    matrix[:, kept] = np.eye(len(kept))
    return kept, matrix
