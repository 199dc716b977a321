"""Residuals: the vectors whose least sum of squares a fit looks for, and how they are combined.

`Residual` says what `gauss_newton` asks for. `Reparametrised` has other unknowns, `WithPrior`
further rows that say how far unknowns are from their expected values, `Stacked` the rows of several
records one after another. `Prediction` is the residual that all fits of positions begin with.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from identification.equation_error import PriorRows
from plant.parts import Floats


class Innovations(Protocol):
    """Weighted innovations as a function of unknowns: enough for slopes and for `descend`.

    Attributes
    ----------
    unknown : sequence of str
        Names of the k unknowns, for messages.
    weights : (M,) array
        Root of the number of independent readings behind each row; 0 for a row that is no reading.
    """

    @property
    def unknown(self) -> Sequence[str]: ...

    @property
    def weights(self) -> Floats: ...

    def innovations(self, values: Floats) -> Floats:
        """Rows (M,) at values (k,); inf where the simulation diverges."""
        ...

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        """Rows (M,) at each of several vectors (k,), simulated side by side."""
        ...


class Residual(Innovations, Protocol):
    """Innovations with all that `gauss_newton` needs to refuse a start and to give a covariance.

    Attributes
    ----------
    scales : (M,) array
        Divisors of the rows; a row times its divisor is in pulses.
    dependent : float
        Least share of the slope of an unknown that must be independent of the other slopes.
    """

    @property
    def scales(self) -> Floats: ...

    @property
    def dependent(self) -> float: ...

    def lost(self, values: Floats) -> str:
        """Label of the first record whose simulation diverges; "" for a single record."""
        ...


class Reweighable(Residual, Protocol):
    """A residual whose records and joints can be weighted by the innovations of a solution."""

    def reweigh(self, values: Floats) -> bool:
        """Take the weights from the innovations at values (k,); whether that changes them."""
        ...


class Batched:
    """A residual that simulates several vectors side by side."""

    def innovations(self, values: Floats) -> Floats:
        """Weighted innovations (M,), scaled, at values (k,); inf where the simulation diverges."""
        # One way into the simulation: a single vector is a batch of one.
        return self.all_innovations([values])[0]

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        """The same at each of several vectors."""
        raise NotImplementedError


class Reparametrised(Batched):
    """A residual as a function of other unknowns.

    `unknown`: names of the coordinates. `values_of`: coordinates (j,) -> values (k,) of the
    unknowns of the inner residual; NaN where there are none, which counts as a diverged simulation.
    """

    def __init__(
        self, residual: Reweighable, unknown: Sequence[str], values_of: Callable[[Floats], Floats]
    ) -> None:
        self.residual = residual
        self.unknown = tuple(unknown)
        self.values_of = values_of
        # Shares of slopes are the same in any unit of an unknown, and about so in other unknowns.
        self.dependent = residual.dependent

    @property
    def weights(self) -> Floats:
        return self.residual.weights

    @property
    def scales(self) -> Floats:
        return self.residual.scales

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        # Impossible values are not simulated: a kernel would return NaN, which no search can order.
        values = [self.values_of(coordinates) for coordinates in vectors]
        possible = [np.isfinite(vector).all() for vector in values]
        # One call for all possible values: they are simulated side by side.
        simulated = iter(
            self.residual.all_innovations(
                [vector for vector, sound in zip(values, possible, strict=True) if sound]
            )
        )
        return [
            next(simulated) if sound else np.full(len(self.weights), np.inf) for sound in possible
        ]

    def lost(self, coordinates: Floats) -> str:
        return self.residual.lost(self.values_of(coordinates))

    def reweigh(self, coordinates: Floats) -> bool:
        return self.residual.reweigh(self.values_of(coordinates))


class WithPrior(Batched):
    """A residual, and behind it how far unknowns are from their expected values.

    `deviations`: unknowns (k,) -> deviations (count,), each in its standard deviations. `noise`:
    what they are multiplied with [pulses], so that their rows vary as much as those of the
    innovations.
    """

    def __init__(
        self,
        residual: Reweighable,
        deviations: Callable[[Floats], Floats],
        count: int,
        noise: float,
    ) -> None:
        self.residual = residual
        self.unknown = residual.unknown
        self.dependent = residual.dependent
        self.deviations = deviations
        self.count = count
        self.noise = noise

    @property
    def weights(self) -> Floats:
        """Weight of each row; 0 of a deviation, which is no reading of the log."""
        return np.append(self.residual.weights, np.zeros(self.count))

    @property
    def scales(self) -> Floats:
        # Deviations have their scale in `noise`, which is set apart from the records' weights.
        return np.append(self.residual.scales, np.ones(self.count))

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        vectors = list(vectors)
        # The iterable serves twice: for the innovations, and for the deviations behind them.
        rows = self.residual.all_innovations(vectors)
        # Behind the rows of the log, so that these keep their places.
        return [self._behind(row, values) for row, values in zip(rows, vectors, strict=True)]

    def _behind(self, row, values):
        """A row (M,), and the deviations behind it; inf of values that no part can have."""
        # Deviations need values that exist: where the simulation diverged, there may be none.
        if np.isinf(row).all():
            return np.append(row, np.full(self.count, np.inf))
        return np.append(row, self.noise * self.deviations(values))

    def lost(self, values: Floats) -> str:
        return self.residual.lost(values)

    def reweigh(self, values: Floats) -> bool:
        return self.residual.reweigh(values)


class Stacked(Batched):
    """The rows of several records one after another: first a prior's of f, last expected values.

    `weights`: of the innovations of each record; `expected`: of the last rows. A class that derives
    from it says in `parts` how the rows of each record are made.
    """

    def __init__(
        self, prior: PriorRows, weights: Sequence[Floats], expected: Floats | tuple[()] = ()
    ) -> None:
        self.prior = prior
        # A prior is no reading of the log: it has no weight.
        self.weights = np.concatenate([np.zeros(prior.count), *weights, expected])
        # In pulses at first: a scale needs innovations, and these a fit.
        self.scales = np.ones(len(self.weights))

    def parts(self, vectors: Sequence[Floats]) -> Iterator[list[Floats]]:
        """Rows of each part, a list with an array per vector: the records', then what follows."""
        raise NotImplementedError

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        """Weighted innovations (M,) at each of several vectors, simulated side by side."""
        vectors = list(vectors)
        # From a list of vectors per part to a list of parts per vector.
        rows = zip(map(self.prior.of, vectors), *self.parts(vectors), strict=True)
        return [joined(row, self.scales) for row in rows]


def joined(parts: Sequence[Floats], scales: Floats) -> Floats:
    """Parts one after another (M,), divided by scales (M,); a single part is divided in place."""
    parts = [part for part in parts if part.size]
    # A log of millions of rows is not copied where nothing stands beside it.
    rows = parts[0] if len(parts) == 1 else np.concatenate(parts)
    rows /= scales
    return rows
