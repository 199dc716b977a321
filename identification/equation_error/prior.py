"""Prior of f, by bodies or f with a relative spread; and known values of unknowns.

A body with the pseudo-inertia P = L L' becomes L (1 + spread S) L', where the entries of S in an
orthonormal basis of the symmetric matrices are standard normal. Whatever the frame, its mass and
each second moment then have this relative standard deviation, and its centre one of spread /
sqrt(2) radii of gyration. A rotor has it too.

Source: T. Lee, P. M. Wensing, F. C. Park, Geometric robot dynamic identification: a convex
programming approach, IEEE Transactions on Robotics 36 (2020) (the metric).
"""

import contextlib
import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from identification.equation_error.least_squares import IDENTIFIABLE
from plant import Arm, Body, Dynamics, Rig
from plant.mechanics import STANDARD, prior_changes, prior_factor
from plant.parts import Floats, Frozen, array, dot, frozen, kept, real, triangle

_ADVICE = "Give a relative spread such as 0.3, or (bodies or f, 0.3)."

# Relative spread of a model's own bodies, where none is given; chosen by hand.
_OF_MODEL = 0.3


@kept
@frozen
class Prior(Frozen):
    """Gaussian prior of f.

    `names` (p), `mean` (p,), `covariance` (p, p), and the relative `spread` it was made of.
    """

    names: tuple[str, ...]
    mean: Floats
    covariance: Floats
    spread: float

    @functools.cached_property
    def whitening(self) -> Floats:
        """W (p, p) with W C W' = 1."""
        # Scaled to correlations first: parameters differ by orders of magnitude.
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(
            np.linalg.inv(np.linalg.cholesky(self.covariance / np.outer(std, std))) / std
        )

    def places(self, unknown: Sequence[str]) -> list[int]:
        """Where the parameters are among the unknowns, all of f among them."""
        return [unknown.index(name) for name in self.names]

    def rows(
        self, unknown: Sequence[str], known_values: Mapping[str, float]
    ) -> tuple[Floats, Floats]:
        """Equations rows x = target, of standard deviation 1, in the unknowns (k).

        `known_values`: of the parameters that are not among them.
        """
        rows = np.zeros((len(self.names), len(unknown)))
        # A known parameter moves the mean of the others by its own deviation.
        mean = self.mean.copy()
        for i, name in enumerate(self.names):
            if name in unknown:
                rows[:, unknown.index(name)] = self.whitening[:, i]
            else:
                mean[i] -= known_values[name]
        return rows, (self.whitening * mean).sum(axis=1)

    def deviations(self, f: Floats) -> Floats:
        """Whitened deviations (p,) of f from the mean: independent, of standard deviation 1."""
        return (self.whitening * (f - self.mean)).sum(axis=1)

    def squares(self, vectors: Floats) -> Floats:
        """Sum (P,) of the squares of these, of several f (P, p)."""
        return np.array([dot(row, row) for row in map(self.deviations, vectors)])

    @classmethod
    def of(cls, dynamics: Dynamics, rig: Rig, argument) -> Self:
        """Prior from the argument of a user.

        The argument is a spread of the chain's own bodies, or a pair: bodies, f or an arm, and a
        spread.

        Bodies without any rotor have those of the rig. A prior of these f is returned as it is.
        """
        if isinstance(argument, cls):
            if argument.names != dynamics.names:
                raise ValueError(
                    f"prior must be of the f of these dynamics, {', '.join(dynamics.names)}; got"
                    f" {', '.join(argument.names)}. {_ADVICE}"
                )
            return argument
        mean: Any
        paired = isinstance(argument, (tuple, list)) and len(argument) == 2
        mean, spread = argument if paired else (dynamics.chain.bodies, argument)
        spread = real("spread of the prior", spread, _ADVICE, positive=True)
        if isinstance(mean, (tuple, list)) and all(isinstance(body, Body) for body in mean):
            f, columns = _of_bodies(dynamics, rig, tuple(mean))
        else:
            mean = mean.f if isinstance(mean, Arm) else mean
            # Without bodies each parameter spreads by itself, relative to its size.
            f = array("f of the prior", mean, (dynamics.p,), advice=_ADVICE)
            columns = np.diag(f)
        # The independent share of each parameter's spread: the diagonal of the triangular factor.
        std = np.sqrt((columns**2).sum(axis=1))
        scaled = columns / np.where(std > 0, std, 1.0)[:, None]
        shares = np.abs(np.diag(triangle(scaled.T)))
        for name, share in zip(dynamics.names, shares.tolist(), strict=True):
            if not share > IDENTIFIABLE.certain:
                raise ValueError(
                    f"prior must spread every parameter; {name} has no spread of its own: it is"
                    " zero, or follows from others (a link without mass, no rotor). State"
                    " motor_inertia, or give bodies or f that have it."
                )
        # Columns are the changes of f by independent unit changes of the bodies.
        covariance = spread**2 * (columns @ columns.T)
        return cls(names=dynamics.names, mean=f, covariance=covariance, spread=spread)

    @classmethod
    def of_model(cls, dynamics: Dynamics, rig: Rig) -> Self | None:
        """Prior of the chain's own bodies.

        None where it has none, or where they do not spread every parameter.
        """
        with contextlib.suppress(ValueError):
            return cls.of(dynamics, rig, _OF_MODEL)
        return None


def _of_bodies(dynamics, rig, bodies):
    """The f (p,) of bodies, and its changes (p, m) with independent ones of the bodies."""
    if not bodies:
        raise ValueError("prior needs bodies; the chain has none. Give (bodies or f, 0.3).")
    chain = replace(dynamics.chain, bodies=bodies)
    if not any(body.rotor for body in bodies):
        chain = chain.with_rotors(rig.drive)
    # f is the lumping matrix times the standard parameters of all bodies.
    matrix = np.array(dynamics.lumping.matrix)
    width = len(STANDARD)
    columns = []
    for i, (body, link) in enumerate(zip(chain.bodies, chain.links, strict=True)):
        of_body = matrix[:, width * i :][:, :width]
        # The lumping matrix takes standard parameters in the frame of the link.
        placed = body.seen_from(link.frame)
        # A body without mass is a mere frame: its pseudo-inertia has no factor to vary.
        if body.mass or body.inertia.any():
            changes = prior_changes(prior_factor(placed.standard_parameters))
            columns.append(of_body[:, : width - 1] @ changes)
        columns.append(of_body[:, [STANDARD.index("J")]] * body.rotor)
    return dynamics.f(chain.bodies), np.hstack(columns)


class Known(dict[str, float]):
    """Values of unknowns that need no fit, by name, and the `prior` of f, or None."""

    def __init__(
        self, values: Mapping[str, float] | None = None, prior: Prior | None = None
    ) -> None:
        super().__init__(values or {})
        self.prior = prior if prior is not None else getattr(values, "prior", None)


# Noise [pulses] that is expected of an innovation until it is known: the RMS of rounding, 1 /
# sqrt(12).
ROUNDING = 0.289

# Relative change of the noise below which rows of a prior are not weighed again; chosen by hand.
_SETTLED = 0.05


class PriorRows:
    """Rows of a prior, or none: whitened deviations of f times the noise of an innovation.

    `noise`: in pulses.
    """

    def __init__(self, prior: Prior | None, unknown: Sequence[str]) -> None:
        self._prior = prior
        self.noise = ROUNDING
        self._places = [] if prior is None else prior.places(unknown)

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self._places)

    def own(self, usual: float) -> float:
        """Least independent share of a slope: the usual one, or with a prior a smaller one.

        A prior separates unknowns that the log cannot separate.
        """
        return usual if self._prior is None else IDENTIFIABLE.with_prior

    def of(self, values: Floats) -> Floats:
        """The rows of values (k,)."""
        if self._prior is None:
            return np.empty(0)
        return self.noise * self._prior.deviations(values[self._places])

    def settle(self, variance: float) -> bool:
        """Weigh the rows by the variance of an innovation; whether that changes much."""
        previous = self.noise
        # The rows must vary as much as an innovation does: least squares gives all rows one
        # variance.
        self.noise = float(np.sqrt(variance))
        return bool(self._places) and abs(self.noise - previous) > _SETTLED * previous
