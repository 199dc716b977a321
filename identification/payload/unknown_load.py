"""A load as what is unknown of it: mass, and where its centre is as far as that shows; inertia as stated."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from plant import Body, Dynamics
from plant.mechanics.base_parameters import independent_columns

_SAME = 1e-7
"""Share of its own below which what a direction does to f is a combination of what others do."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class UnknownLoad:
    """Numbers of a load, and the increments of f that they are.

    Attributes
    ----------
    matrix : (p, 10) numpy.ndarray
        Increments of f by the load's standard parameters.
    position : (3,) numpy.ndarray
        Centre of mass where it is known, or 0 where it is unknown or does not show [m].
    inertia : (6,) numpy.ndarray
        About the centre of mass [kg m^2].
    shown : tuple of int
        Axes of the link's frame along which the place of the centre is unknown.
    """

    matrix: NDArray[np.float64]
    position: NDArray[np.float64]
    inertia: NDArray[np.float64]
    shown: tuple[int, ...]

    @classmethod
    def of(
        cls, dynamics: Dynamics, link: int | str, position: NDArray[np.float64] | None, inertia: NDArray[np.float64]
    ) -> UnknownLoad:
        """Of a load on a link, whose place may be unknown."""
        matrix = dynamics.load_matrix(link)
        if position is not None:
            return cls(matrix=matrix, position=position, inertia=inertia, shown=())
        shown = tuple(axis for axis in range(3) if matrix[:, 1 + axis].any())
        moments = matrix[:, [*(1 + axis for axis in shown), 0]]
        if not moments.any() or len(independent_columns(moments, range(len(shown) + 1), _SAME)[0]) <= len(shown):
            raise ValueError(
                "mass and centre of the load must show separately; on this arm or link they do not. Give position."
            )
        return cls(matrix=matrix, position=np.zeros(3), inertia=inertia, shown=shown)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown numbers."""
        return ("mass", *(f"com[{axis}]" for axis in self.shown))

    def com(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Centre of mass (3,) [m]; 0 along axes that do not show."""
        com = self.position.copy()
        com[list(self.shown)] = values[1 : len(self.names)]
        return com

    def increments(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of f (p,), by mass and centre (k,)."""
        unit = Body(mass=1.0, com=self.com(values)).standard_parameters
        own = np.concatenate([np.zeros(4), self.inertia]) if values[0] else np.zeros(10)
        return np.asarray(self.matrix @ (values[0] * unit + own))
