"""What the motion of a reference shows of an arm's parameters."""

from __future__ import annotations

import dataclasses

import numpy as np

from plant.mechanics.dynamics import Dynamics
from plant.mechanics.independent_columns import independent_columns
from plant.motion.reference import Reference
from plant.parts.arguments import instance

__all__ = ["Visibility", "visibility"]


@dataclasses.dataclass(frozen=True)
class Visibility:
    """What a motion shows of f.

    Attributes
    ----------
    combinations : tuple of str
        The sums of f that the torque of this motion depends on; a name alone where f is visible by itself.
    invisible : tuple of str
        Those of f that do not show at all, not even in a sum.
    condition : float
        Condition number of the regressor of the combinations, columns scaled to one length: some tens are good, and
        above a thousand some of them are told apart badly.
    """

    combinations: tuple
    invisible: tuple
    condition: float

    def __str__(self):
        lines = [f"{len(self.combinations)} combinations, condition number {self.condition:.0f} (some tens are good)"]
        lines += [f"  {name}" for name in self.combinations]
        return "\n".join(lines + [f"  not visible in this motion: {name}" for name in self.invisible])


def visibility(dynamics, reference, *, tolerance=1e-6):
    """What the motion of a reference shows of an arm's parameters.

    Parameters
    ----------
    dynamics : Dynamics
    reference : Reference
    tolerance : float
        How much of a column, in length, has to be new for its parameter to count as visible by itself.

    Returns
    -------
    Visibility
    """
    instance("dynamics", dynamics, Dynamics, "The order is dynamics, reference; Dynamics.from_chain(chain) makes one.")
    instance("reference", reference, Reference, "The order is dynamics, reference.")
    motion = reference(np.linspace(0, reference.duration, 500))
    regressor = np.vstack([dynamics.Y(*state).full() for state in zip(*motion, strict=True)])
    lengths = np.linalg.norm(regressor, axis=0)
    kept, matrix = independent_columns(regressor, range(dynamics.p), tolerance)
    names = []
    for row, own in zip(matrix, kept, strict=True):
        others = [k for k in np.flatnonzero(np.abs(row) > tolerance) if k != own]
        terms = [f"{'-' if row[k] < 0 else '+'} {abs(row[k]):.4g} {dynamics.names[k]}" for k in others]
        names.append(" ".join([dynamics.names[own], *terms]))
    scaled = regressor[:, kept] / lengths[kept]
    hidden = np.flatnonzero(lengths <= tolerance * lengths.max())
    return Visibility(tuple(names), tuple(dynamics.names[k] for k in hidden), float(np.linalg.cond(scaled)))
