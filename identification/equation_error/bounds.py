"""Least squares with friction that is not negative.

A quadratic around its optimum is known by the optimum and its covariance. So the bounded optimum is
the vector without negative entries that is nearest to the free one in the metric of the covariance;
the other unknowns follow by regression. Whatever the true values are, not negative, the bounded
ones are no farther from them in this metric than the free ones: the free covariance stays an upper
bound, and its intervals stay honest.

Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice Hall 1974 (non-negative
least squares).
"""

from collections.abc import Iterable

import numpy as np

from plant.parts import Bools, Floats, product

# Beginnings of the names of friction that brakes, and has no sign.
BRAKES = ("drive.viscous", "drive.coulomb", "drive.load_friction")


def brakes(names: Iterable[str]) -> Bools:
    """Which of these unknowns (k,) must not be negative."""
    return np.array([name.startswith(BRAKES) for name in names], bool)


def bounded(values: Floats, covariance: Floats, bounds: Bools) -> Floats:
    """The least-squares optimum (k,) with these unknowns not negative.

    `values`, `covariance`: of the free optimum. The same values where none of them is negative.
    """
    from scipy.optimize import nnls

    if not (values[bounds] < 0).any():
        return values
    # Standard deviations as units: numbers of different joints differ by orders of magnitude.
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    root = np.linalg.cholesky(correlation[np.ix_(bounds, bounds)])
    whiten = np.linalg.inv(root)
    free = values[bounds] / std[bounds]
    nearest, _ = nnls(whiten, product(whiten, free))
    # The others move as the covariance says that they go together.
    moved = product(whiten.T, product(whiten, nearest - free))
    result = values + std * product(correlation[:, bounds], moved)
    result[bounds] = nearest * std[bounds]
    return result
