"""Identifiability of an arm's parameters, and of a load's, from the excitation of a motion."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from plant.mechanics import LOAD, Dynamics, independent_columns
from plant.motion.reference import Reference
from plant.parts import Floats, Piece, Shown, Verdict, instance, real


@dataclasses.dataclass(frozen=True, repr=False)
class Visibility(Shown):
    """Identifiable combinations of f, or of a load's parameters, under the excitation of a motion.

    Attributes
    ----------
    combinations : tuple of str
        The sums of parameters that the torque of this motion identifies; a name alone where that
        parameter is identifiable by itself.
    invisible : tuple of str
        The parameters without an effect on the torque of this motion above the tolerance, not even
        in a sum.
    condition : float
        Condition number of the regressor of the combinations, columns scaled to one length: some
        tens are good; above a thousand some combinations are badly separated, and their estimates
        correlate.
    """

    combinations: tuple[str, ...]
    invisible: tuple[str, ...]
    condition: float

    def _short(self) -> str:
        return (
            f"{len(self.combinations)} identifiable combinations, condition number"
            f" {self.condition:.0f}"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()} (some tens are good)")
        yield from self.combinations
        yield from (f"not identifiable from this motion: {name}" for name in self.invisible)


def visibility(
    dynamics: Dynamics,
    reference: Reference,
    *,
    load: int | str | None = None,
    start: float = 0.0,
    duration: float | None = None,
    tolerance: float | None = None,
) -> Visibility:
    """Identifiability of an arm's parameters, or of a load's, from the torque of a motion.

    Parameters
    ----------
    dynamics : Dynamics
        Of the arm, empty or not.
    reference : Reference
    load : int or str, optional
        Link that carries a load, such as -1, the last: its standard parameters (m, mx, ..., Izz),
        with all else known.
    start, duration : float
        A segment of the reference [s]; by default all of it.
    tolerance : float, optional
        Relative size below which a contribution to the torque counts as zero: of a column of the
        regressor outside the span of the others, of a parameter in a sum, and of a column beside
        the longest one. By default 1e-6; 1e-3 of a load, whose smaller contributions are below
        noise.

    Returns
    -------
    Visibility

    Raises
    ------
    ValueError
        A segment that is not in the reference, a link that the chain does not have.

    See Also
    --------
    identification.pulse_budget, identification.design_motion, ctc.PayloadEstimator

    Examples
    --------
    >>> from plant import puma560, visibility
    >>> seen = visibility(puma560.dynamics(), puma560.reference())
    >>> seen.combinations[:2], seen.invisible
    (('f1', 'f2'), ())
    >>> visibility(puma560.dynamics(), puma560.reference(), load=-1, duration=1.0).invisible
    ('mz', 'Ixx', 'Ixy', 'Ixz', 'Iyy', 'Iyz')
    """
    # The torque is linear in the parameters: their columns along the motion decide which of them,
    # or which sums, it determines.
    regressor = _along(dynamics, reference, start, duration)
    names = dynamics.names
    if load is not None:
        regressor = regressor @ dynamics.load_matrix(load)
        names = LOAD
    # Noise hides the smaller components of a load.
    if tolerance is None:
        tolerance = 1e-6 if load is None else 1e-3
    return _identifiable(regressor, names, tolerance)


def _along(
    dynamics: Dynamics, reference: Reference, start: float, duration: float | None
) -> Floats:
    """Regressor along a segment of a reference, stacked: (500 n, p)."""
    instance(
        "dynamics",
        dynamics,
        Dynamics,
        "The order is dynamics, reference; Dynamics.from_chain(chain) makes one.",
    )
    instance("reference", reference, Reference, "The order is dynamics, reference.")
    end = reference.duration
    start = real("start", start, "Give seconds.")
    if duration is None:
        duration = end - start
    else:
        duration = real("duration", duration, "Give seconds.", positive=True)
    if not (0 <= start < end and start + duration <= end * (1 + 1e-9)):
        raise ValueError(
            f"the segment must be in the reference, 0 to {end:g} s; got {start:g} to"
            f" {start + duration:g} s. Change start or duration."
        )
    # 500 instants: several times as many as any arm has parameters.
    motion = reference(np.linspace(start, start + duration, 500))
    return np.vstack([dynamics.Y(*state).full() for state in zip(*motion, strict=True)])


def _identifiable(regressor: Floats, parameters: Sequence[str], tolerance: float) -> Visibility:
    """Combinations of parameters that a regressor with a column for each identifies."""
    lengths = np.linalg.norm(regressor, axis=0)
    # The leading column of a sum stands for it; a row of the matrix has the factors of all columns
    # in that sum.
    independent, matrix = independent_columns(regressor, range(len(parameters)), tolerance)
    # Within a sum, a parameter that is a sum itself stands in brackets.
    summands = [f"({name})" if " " in name else name for name in parameters]
    combinations = []
    for row, column in zip(matrix, independent, strict=True):
        terms = [parameters[column]]
        for k in np.flatnonzero(np.abs(row) > tolerance):
            if k != column:
                terms.append(f"{'-' if row[k] < 0 else '+'} {abs(row[k]):.4g} {summands[k]}")
        combinations.append(" ".join(terms))
    # Columns that are short beside the longest one: no effect on the torque above the tolerance.
    invisible = np.flatnonzero(lengths <= tolerance * lengths.max())
    # Columns of one length: the units of the parameters must not count.
    scaled = regressor[:, independent] / lengths[independent]
    return Visibility(
        tuple(combinations),
        tuple(parameters[int(k)] for k in invisible),
        float(np.linalg.cond(scaled)),
    )
