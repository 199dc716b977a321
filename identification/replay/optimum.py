"""Where a model with what its rig leaves out follows a log best, and what its unknowns cannot do there."""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from identification.replay.extended import Extended
from identification.replay.gauss_newton import slopes, variance_inflation, within_bounds
from plant.parts.fields import Floats
from plant.parts.sums import dot, product, products

_ROUNDS, _SETTLED = 6, 1e-4  # of Gauss-Newton, at most, and the relative decrease below which it ends

_LENGTHS = 0.5 ** np.arange(8)  # of a step

_OWN = 1e-3  # a direction of which less than this share is its own is taken for a combination of others


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Where the sum of squared innovations is least.

    `values` (k,). `innovations` (M,): weighted. `rates` (v, M): their changes per step of the varied unknowns. `made`
    (r, v): what orthonormal directions are of these changes. `unknown`: how many of the varied unknowns, the first, are
    not observer gains.
    """

    model: Extended
    values: Floats
    innovations: Floats
    rates: Floats
    made: Floats
    unknown: int

    @property
    def squares(self) -> float:
        """Sum of the squared innovations [pulses^2]."""
        return float((self.innovations**2).sum())

    @functools.cached_property
    def before(self) -> Floats:
        """What of the innovations the varied unknowns cannot do."""
        return self.left(self.innovations)

    def left(self, direction: Floats) -> Floats:
        """What of a direction (M,) the varied unknowns cannot do as well."""
        return np.asarray(direction - np.einsum("v,vm->m", along(self.made, self.rates, direction), self.rates))

    def unit(self, left: Floats) -> float:
        """Variance of what is left, inflated by its autocorrelation."""
        return float((left**2).sum() / (self.model.weights**2).sum() * variance_inflation(left))

    def chi_square(self, after: Floats) -> float:
        """Decrease of the sum of squares from here to what is left afterwards (M,), in its unit."""
        return float(((self.before**2).sum() - (after**2).sum()) / self.unit(after))


def fitted(model: Extended, values: Floats, step: Floats, bounds: Floats) -> Optimum:
    """Gauss-Newton from values (k,), with steps (k,) of the central differences; zero leaves an unknown as it is.

    Raises a ValueError: values with which the model does not follow the log.
    """
    step, values = step.copy(), np.clip(values, *bounds.T)
    varied, innovations = np.flatnonzero(step), model.innovations(values)
    unknown = int((varied < len(values) - len(model.extra) - len(model.gains)).sum())
    if not np.isfinite(innovations).all():
        raise ValueError("the model with what was found does not follow the log")
    own = model.prior.own(_OWN)
    for left in reversed(range(_ROUNDS)):
        rates = slopes(model, values, step, varied).T
        made = directions(rates, own)
        before, solved = (innovations**2).sum(), functools.partial(_solved, made, rates, innovations, own)
        change = within_bounds(solved, values, step, bounds)
        for length in _LENGTHS:
            trial = np.clip(values + length * change, *bounds.T)
            result = model.innovations(trial)
            if np.isfinite(result).all() and (result**2).sum() < before:
                values, innovations = trial, result
                break
        if not left or not (innovations**2).sum() < (1 - _SETTLED) * before:
            break
        rates = np.empty((0, 0))  # not beside the next ones
    return Optimum(model=model, values=values, innovations=innovations, rates=rates, made=made, unknown=unknown)


def _solved(made: Floats, rates: Floats, innovations: Floats, own: float, moving: NDArray[np.bool_]) -> Floats:
    """Coefficients of the rates that move; `made`: directions of all of them."""
    if not moving.all():
        made, rates = directions(rates[moving], own), rates[moving]
    return along(made, rates, innovations)


def directions(rates: Floats, share: float = _OWN) -> Floats:
    """What orthonormal directions are of rates (v, M): (r, v), none for a rate that is a combination of others.

    `share`: of a rate that must be its own.

    By Gram-Schmidt on the products of the rates.
    """
    together = products(rates.T)
    lengths = np.sqrt(np.diag(together))
    lengths = np.where(lengths > 0, lengths, 1.0)
    together, made = together / np.outer(lengths, lengths), np.empty((0, len(rates)))
    for i in range(len(rates)):
        own = (np.arange(len(rates)) == i).astype(float)
        for _ in range(2):
            own = own - product(made.T, product(made, product(together, own)))
        size = np.sqrt(max(dot(own, product(together, own)), 0.0))
        if size > share:
            made = np.vstack([made, own / size])
    return np.asarray(made / lengths)


def along(made: Floats, rates: Floats, target: Floats) -> Floats:
    """Coefficients (v,) of rates (v, M) that make the target; zero of a rate that is a combination of others."""
    return product(made.T, product(made, np.einsum("vm,m->v", rates, target)))
