"""A fit whose slopes hold over whole standard deviations of its values.

Where a joint creeps or sticks, innovations jump as friction lets go, at one value here and at
another there. Differences over a short step count each jump as knowledge: a search ends between
two of them, with deviations that are too small. The sum of squares over a whole deviation tells.
Therefore the principal axes of the covariance, each one deviation long, are simulated as a whole.
Where they change the innovations by much less than the covariance claims, fit, slopes and
covariance are made anew over such axes, until both agree.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.replay.gauss_newton import Solution, noise, slopes
from identification.replay.residual import Reparametrised, Reweighable
from plant.parts.fields import Floats, Integers
from plant.parts.settings import frozen_settings
from plant.parts.sums import dot, norm, products


@frozen_settings
class WholeDeviationSettings:
    """When slopes hold over a deviation; chosen on drawn rigs.

    Parameters
    ----------
    claimed : float
        Least share of the claimed information that a direction must have over a whole deviation.
        Of sound fits of ``tests/benchmarks/any_rig.py`` it is 0.92 and more; of seed 180, whose
        values were 31 of their deviations off, less than 0.001.
    agreed : float
        Share from which on a fit over whole deviations has ended.
    rounds : int
        Most fits over whole deviations.
    lengths : tuple of float
        Shares of a Gauss-Newton step that are tried.
    """

    claimed: float = 0.5
    agreed: float = 0.95
    rounds: int = 8
    lengths: tuple[float, ...] = (1.0, 0.5, 0.25, 0.125)


SETTINGS = WholeDeviationSettings()


class Axes(NamedTuple):
    """Principal axes of a covariance, and what they change.

    `roots` (v, v): of the varied values, in columns that are one deviation long. `along`: the
    innovations as a function of deviations (v,) along them. `changes` (M, v): of the innovations,
    per deviation. `information` (v, v): products of the changes over the noise; the unit matrix
    where the covariance holds.
    """

    roots: Floats
    along: Reparametrised
    changes: Floats
    information: Floats

    @property
    def least(self) -> float:
        """Least share of the claimed information, in any direction."""
        return float(np.linalg.eigvalsh(self.information)[0])

    @property
    def covariance(self) -> Floats:
        """Covariance (v, v) by the changes over whole deviations."""
        return self.roots @ np.linalg.inv(self.information) @ self.roots.T


def over_whole_deviations(residual: Reweighable, solution: Solution, bounds: Floats) -> Solution:
    """The solution itself if its covariance holds over its deviations; else one whose does.

    `bounds` (k, 2): of the values.
    """
    # 1. Values that vary, and are not held by a bound.
    values = solution.values
    low, high = bounds.T
    free = (np.diag(solution.covariance) > 0) & (low < values) & (values < high)
    varied = solution.varied[free[solution.varied]]
    innovations = solution.residual / residual.scales
    covariance = solution.covariance[np.ix_(varied, varied)]

    # 2. Fits over whole deviations, from the one that claims too much.
    try:
        axes = _axes(residual, values, innovations, varied, covariance, bounds)
        if axes.least >= SETTINGS.claimed:
            return solution
        for _ in range(SETTINGS.rounds):
            step = -np.linalg.solve(products(axes.changes), axes.changes.T @ innovations)
            vectors = np.outer(SETTINGS.lengths, step)
            rows = axes.along.all_innovations(vectors)
            costs = [dot(row, row) if np.isfinite(row).all() else np.inf for row in rows]
            best = int(np.argmin(costs))
            if costs[best] < dot(innovations, innovations):
                values = axes.along.values_of(vectors[best])
                innovations = rows[best].copy()
            axes = _axes(residual, values, innovations, varied, axes.covariance, bounds)
            if axes.least >= SETTINGS.agreed:
                break
    except ValueError:  # an axis loses the log, or leaves the bounds, however short it is
        return solution

    # 3. The solution by the changes along the axes; a value on a bound keeps its slope.
    covariance = np.zeros_like(solution.covariance)
    covariance[np.ix_(varied, varied)] = axes.covariance
    by_value = solution.slopes.copy()
    by_value[:, free[solution.varied]] = np.linalg.solve(axes.roots.T, axes.changes.T).T
    unscaled = innovations * residual.scales
    return replace(
        solution,
        values=values,
        covariance=covariance,
        residual=unscaled,
        rms_innovation=float(norm(unscaled) / norm(residual.weights)),
        slopes=by_value,
    )


def _axes(
    residual: Reweighable,
    values: Floats,
    innovations: Floats,
    varied: Integers,
    covariance: Floats,
    bounds: Floats,
) -> Axes:
    """The principal axes of a covariance (v, v) of the varied values (k,)."""
    # Axes of the correlations, in which values of all units are alike.
    deviations = np.sqrt(np.diag(covariance))
    sizes, directions = np.linalg.eigh(covariance / np.outer(deviations, deviations))
    roots = deviations[:, None] * directions * np.sqrt(np.maximum(sizes, np.finfo(float).eps))
    low, high = bounds.T

    def moved(coordinates: Floats) -> Floats:
        vector = values.copy()
        vector[varied] += roots @ coordinates
        # Beyond its bounds a value means nothing: the step is shortened.
        return np.where((low <= vector) & (vector <= high), vector, np.nan)

    names = [residual.unknown[i] for i in varied.tolist()]
    along = Reparametrised(residual, names, moved)
    step = np.ones(len(varied))
    changes = slopes(along, 0 * step, step, np.arange(len(varied))) / step
    return Axes(roots, along, changes, products(changes) / noise(residual, innovations))
