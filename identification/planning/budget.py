"""Pulse budget: how much a motion excites each parameter, and the Cramer-Rao bound, before the
experiment.

The closed loop, without rounding, is simulated with each number a little larger and a little
smaller: by how many pulses the tracking error changes is all that a log can hold of it. With
readings that err by rounding alone, uniformly within a quantisation cell, it gives the Cramer-Rao
bound on the standard deviation by any method.
"""

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from identification.equation_error.least_squares import least_squares
from identification.equation_error.naming import short_names
from identification.replay.gauss_newton import slopes
from identification.replay.prediction import Prediction
from plant import Arm, Dynamics, Law, Reference, Rig, simulate
from plant.parts.arguments import known_options
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Aside, Piece, Shown
from plant.parts.tables import Table

# of the central differences, as a share of a number (or of the largest f, for one that is zero)
_STEP = 1e-4


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Budget(Shown, Frozen):
    """How much a motion excites each parameter.

    Attributes
    ----------
    dynamics : Dynamics
        What its names of f mean.
    names : tuple of str
    values : (k,) numpy.ndarray
    peak, rms : (k,) numpy.ndarray
        Change of the tracking error, largest and root mean square over samples and joints, for 1 %
        of each [pulses].
    bound : (k,) numpy.ndarray
        Smallest standard deviation of each with all of them unknown, from rounding alone.
    bound_alone : (k,) numpy.ndarray
        The same with all others known.
    """

    dynamics: Dynamics
    names: tuple[str, ...]
    values: Floats
    peak: Floats
    rms: Floats
    bound: Floats
    bound_alone: Floats

    def _short(self) -> str:
        least = int(self.peak.argmin())
        name = short_names(self.dynamics, self.names)[least]
        return (
            f"{len(self.names)} numbers; {name} is excited least, {self.peak[least]:.2g} pulses"
            " for 1 %"
        )

    def _shown(self) -> Iterator[Piece]:
        columns = (self.values, self.peak, self.rms, self.bound, self.bound_alone)
        rows = [
            (name, f"{value:.4g}", f"{peak:.3f}", f"{rms:.4f}", f"{bound:.2g}", f"{alone:.2g}")
            for name, value, peak, rms, bound, alone in zip(
                short_names(self.dynamics, self.names), *columns, strict=True
            )
        ]
        yield Table(
            (
                "",
                "value",
                "sensitivity to 1 % [pulses]",
                "rms [pulses]",
                "Cramér-Rao bound",
                "conditional std",
            ),
            rows,
        )
        yield Aside("What the parameters mean", self.dynamics.legend.splitlines())


@known_options
def pulse_budget(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    *,
    unknown: Iterable[str] | None = None,
    duration: float | None = None,
) -> Budget:
    """By how many pulses each number of an experiment changes the tracking error, and its
    Cramer-Rao bound.

    Parameters
    ----------
    arm : Arm
        Known roughly, as from a data sheet.
    rig : Rig
    law : Law
    reference : Reference
    unknown : sequence of str, optional
        By default f; friction and gains may be added, as for `identify`.
    duration : float, optional
        [s]; by default one period of the reference.

    Returns
    -------
    Budget
        Print it for a table.

    Raises
    ------
    ValueError
        Bad input, a number that has no effect, or numbers that are not separately identifiable in
        this motion.

    See Also
    --------
    identification.design_motion

    Examples
    --------
    >>> from plant import puma560
    >>> from identification import pulse_budget
    >>> budget = pulse_budget(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=1.0)
    >>> print((budget.peak > 0).all())
    True
    """
    record = simulate(arm, rig, law, reference, duration=duration)
    prediction = Prediction(arm.dynamics, record, unknown, simulated=True)
    known = dict(zip(arm.dynamics.names, arm.f, strict=True))
    known |= dict(zip(rig.number_names(), rig.number_values(), strict=True))
    known |= dict(zip(law.number_names("law."), law.number_values(), strict=True))
    values = np.array([known[name] for name in prediction.unknown])
    step = _STEP * np.where(values == 0, np.abs(arm.f).max(), np.abs(values))
    change = slopes(prediction, values, step.copy(), np.arange(len(values))) / step
    per_cent = np.abs(change * 0.01 * values)
    covariance = least_squares(
        prediction.unknown, change * np.abs(step), change[:, 0], dependent=1e-7
    )[1]
    cell = 1 / np.sqrt(12)
    return Budget(
        dynamics=arm.dynamics,
        names=prediction.unknown,
        values=values,
        peak=per_cent.max(axis=0),
        rms=np.sqrt((per_cent**2).mean(axis=0)),
        bound=cell * np.sqrt(np.diag(covariance)) * step,
        bound_alone=cell / np.sqrt((change**2).sum(axis=0)),
    )
