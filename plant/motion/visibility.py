"""Identifiability of an arm's parameters from the excitation of a motion."""

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
    """Identifiable combinations of f under the excitation of a motion.

    Attributes
    ----------
    combinations : tuple of str
        The sums of f that the torque of this motion identifies; a name alone where that f is identifiable by itself.
    invisible : tuple of str
        Those of f without any effect on the torque of this motion, not even in a sum.
    condition : float
        Condition number of the regressor of the combinations, columns scaled to one length: some tens are good; above a
        thousand some combinations are badly separated, and their estimates correlate.
    """

    combinations: tuple[str, ...]
    invisible: tuple[str, ...]
    condition: float

    def __str__(self) -> str:
        count = f"{len(self.combinations)} identifiable combinations"
        lines = [f"{count}, condition number {self.condition:.0f} (some tens are good)"]
        lines += [f"  {name}" for name in self.combinations]
        return "\n".join(lines + [f"  not identifiable from this motion: {name}" for name in self.invisible])


def visibility(dynamics: Dynamics, reference: Reference, *, tolerance: float = 1e-6) -> Visibility:
    """Identifiability of an arm's parameters from the torque of a reference's motion.

    Parameters
    ----------
    dynamics : Dynamics
    reference : Reference
    tolerance : float
        Component of a regressor's column outside the span of the others, relative to its length, above which its
        parameter counts as identifiable by itself.

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
    sums = [f"({name})" if " " in name else name for name in dynamics.names]
    names = []
    for row, own in zip(matrix, kept, strict=True):
        others = [k for k in np.flatnonzero(np.abs(row) > tolerance) if k != own]
        terms = [f"{'-' if row[k] < 0 else '+'} {abs(row[k]):.4g} {sums[k]}" for k in others]
        names.append(" ".join([dynamics.names[own], *terms]))
    scaled = regressor[:, kept] / lengths[kept]
    unexcited = np.flatnonzero(lengths <= tolerance * lengths.max())
    return Visibility(tuple(names), tuple(dynamics.names[k] for k in unexcited), float(np.linalg.cond(scaled)))
