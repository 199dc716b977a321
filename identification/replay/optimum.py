"""Where a model with what its rig leaves out follows a log best, and what its unknowns cannot do there."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from identification.replay.extended import Extended
from identification.replay.gauss_newton import slopes, variance_inflation

__all__ = ["Optimum", "fitted", "orthonormal"]

_ROUNDS, _SETTLED = 6, 1e-4
"""Of Gauss-Newton, at most, and the relative decrease below which it ends."""

_LENGTHS = 0.5 ** np.arange(8)
"""Of a step."""

_OWN = 1e-3
"""A direction of which less than this share is its own is taken for a combination of others."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Where the sum of squared innovations is least.

    Attributes
    ----------
    model : Extended
    values : (k,) numpy.ndarray
    innovations : (M,) numpy.ndarray
        Weighted.
    rates : (v, M) numpy.ndarray
        Their changes per step of the varied unknowns.
    basis : (r, M) numpy.ndarray
        Orthonormal directions of these changes.
    unknown : int
        How many of the varied unknowns, the first, are not observer gains.
    """

    model: Extended
    values: NDArray[np.float64]
    innovations: NDArray[np.float64]
    rates: NDArray[np.float64]
    basis: NDArray[np.float64]
    unknown: int

    @property
    def squares(self) -> float:
        """Sum of the squared innovations [pulses^2]."""
        return float((self.innovations**2).sum())

    def left(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """What of directions (..., M) the varied unknowns cannot do as well."""
        for own in self.basis:
            directions = directions - (directions * own).sum(axis=-1, keepdims=True) * own
        return directions

    def unit(self, left: NDArray[np.float64]) -> float:
        """Variance of what is left, inflated by its autocorrelation."""
        return float((left**2).sum() / (self.model.weights**2).sum() * variance_inflation(left))

    def chi_square(self, after: NDArray[np.float64]) -> float:
        """Decrease of the sum of squares from here to what is left afterwards (M,), in its unit."""
        before = self.left(self.innovations)
        return float(((before**2).sum() - (after**2).sum()) / self.unit(after))


def fitted(
    model: Extended, values: NDArray[np.float64], step: NDArray[np.float64], bounds: NDArray[np.float64]
) -> Optimum:
    """Gauss-Newton from values (k,), with steps (k,) of the central differences; zero leaves an unknown as it is.

    Raises
    ------
    ValueError
        Values with which the model does not follow the log.
    """
    step, values = step.copy(), np.clip(values, *bounds.T)
    varied, innovations = np.flatnonzero(step), model.innovations(values)
    unknown = int((varied < len(values) - len(model.extra) - len(model.gains)).sum())
    if not np.isfinite(innovations).all():
        raise ValueError("the model with what was found does not follow the log")
    for _ in range(_ROUNDS):
        rates = slopes(model, values, step, varied).T
        basis, free = orthonormal(rates, innovations)
        move, before = _move(values, rates, free, innovations, step, varied, bounds), (innovations**2).sum()
        for length in _LENGTHS:
            trial = np.clip(values - length * move, *bounds.T)
            result = model.innovations(trial)
            if np.isfinite(result).all() and (result**2).sum() < before:
                values, innovations = trial, result
                break
        if not (innovations**2).sum() < (1 - _SETTLED) * before:
            break
    return Optimum(
        model=model, values=values, innovations=innovations, rates=rates, basis=basis, unknown=unknown
    )  # fmt: skip


def _move(
    values: NDArray[np.float64],
    rates: NDArray[np.float64],
    free: NDArray[np.float64],
    innovations: NDArray[np.float64],
    step: NDArray[np.float64],
    varied: NDArray[np.intp],
    bounds: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Gauss-Newton's change (k,), to be subtracted; what is pushed over its bound stays, the others make up for it.

    Free are the coefficients (v,) of the rates while nothing is pushed.
    """
    moving, found = np.ones(len(varied), bool), free
    while True:
        move, some = np.zeros(len(values)), varied[moving]
        move[some] = found * step[some]
        low, high = bounds.T
        pushed = ((values <= low) & (move > 0)) | ((values >= high) & (move < 0))
        if not pushed[some].any():
            return move
        moving &= ~pushed[varied]
        found = orthonormal(rates[moving], innovations)[1]


def orthonormal(
    rates: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Orthonormal directions (r, M) of rates (v, M), and their coefficients (v,) that make the target, in plain sums.

    The coefficient of a rate that is a combination of others is zero.
    """
    basis: list[NDArray[np.float64]] = []
    made: list[NDArray[np.float64]] = []  # each direction, in rates
    for i, row in enumerate(rates):
        length = np.sqrt((row**2).sum()) or 1.0
        own, of = row / length, (np.arange(len(rates)) == i) / length
        for _ in range(2):
            for other, others in zip(basis, made, strict=True):
                share = (other * own).sum()
                own, of = own - share * other, of - share * others
        size = np.sqrt((own**2).sum())
        if size > _OWN:
            basis.append(own / size)
            made.append(of / size)
    found = np.zeros(len(rates))
    for own, of in zip(basis, made, strict=True):
        found = found + (own * target).sum() * of
    return np.reshape(basis, (-1, rates.shape[1])), found
