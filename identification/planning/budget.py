"""`pulse_budget`: excitation of each parameter by a motion, and its Cramer-Rao bound.

The closed loop, without rounding, is simulated with each number a little larger and a little
smaller: the change of the tracking error in pulses is all that a log tells about the number. If
readings err by rounding alone, uniformly within a quantisation cell, this change gives the
Cramer-Rao bound: no method has a smaller standard deviation. Samples in one cell share one rounding
error, so all changes are weighted by the root of the independent readings per sample, as in
`Prediction`: 1 where every sample is in a new cell, 0 where a motor stands still.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from identification.equation_error import IDENTIFIABLE, least_squares, short_names
from identification.replay import Prediction, slopes
from plant import Arm, Dynamics, Law, Reference, Rig, simulate
from plant.parts import Aside, Floats, Frozen, Piece, Shown, Table, frozen, known_options

# Step of the central differences, relative to a number, or to the largest f where that is zero.
# Chosen by hand: without rounding the loop is smooth, and simulated to some 1e-16.
_STEP = 1e-4


@frozen
class Budget(Shown, Frozen):
    """Sensitivity of the tracking error to each parameter, and its Cramer-Rao bound.

    Attributes
    ----------
    dynamics : Dynamics
        Explains the names of f.
    names : tuple of str
    values : (k,) numpy.ndarray
    peak, rms : (k,) numpy.ndarray
        Weighted change of the tracking error for 1 % of each number, largest and root mean square
        over samples and joints [pulses].
    bound : (k,) numpy.ndarray
        Smallest standard deviation of each number from rounding alone, if all are unknown.
    bound_alone : (k,) numpy.ndarray
        The same if all other numbers are known.
    """

    dynamics: Dynamics
    names: tuple[str, ...]
    values: Floats
    peak: Floats
    rms: Floats
    bound: Floats
    bound_alone: Floats

    def _short(self) -> str:
        # One per cent of a zero changes nothing, however much the motion excites it.
        weakest = int(np.where(self.values == 0, np.inf, self.peak).argmin())
        name = short_names(self.dynamics, self.names)[weakest]
        return (
            f"{len(self.names)} numbers; {name} is excited least, {self.peak[weakest]:.2g} pulses"
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
    """Change of the tracking error by each number of an experiment, and its Cramer-Rao bound.

    Parameters
    ----------
    arm : Arm
        Roughly known, as from a data sheet.
    rig : Rig
    law : Law
    reference : Reference
    unknown : sequence of str, optional
        By default f; friction and gains may be added, as for `identify`.
    duration : float, optional
        [s]; by default that of the reference.

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
    >>> rig, law, path = puma560.rig(), puma560.p_law(), puma560.reference()
    >>> budget = pulse_budget(puma560.arm(), rig, law, path, duration=1.0)
    >>> print((budget.peak > 0).all())
    True
    """
    # 1. Values of the unknowns, by name, of arm, rig and law.
    # The model of a prediction does not round; the counts of this record only weight its samples.
    record = simulate(arm, rig, law, reference, duration=duration)
    prediction = Prediction(arm.dynamics, record, unknown, simulated=True)
    numbers = dict(zip(arm.dynamics.names, arm.f, strict=True))
    # The names that `identify` takes, so that a budget and an identification compare.
    numbers |= rig.numbers() | law.numbers("law.")
    values = np.array([numbers[name] for name in prediction.unknown])

    # 2. Sensitivities of all readings (M, k) by differences. `slopes` shortens steps that lose the
    # log, in place, and gives changes per shortened step.
    step = _STEP * np.where(values == 0, np.abs(arm.f).max(), np.abs(values))
    # Dry friction opposes the motion whatever its sign: about zero only one side shows a change.
    dry = [name.startswith("drive.coulomb") for name in prediction.unknown]
    bounds = np.column_stack([np.where(dry, 0.0, -np.inf), np.full(len(values), np.inf)])
    change = slopes(prediction, values, step, np.arange(len(values)), bounds=bounds) / step
    # Pulses for one per cent: a user knows that counts show no change far below one pulse.
    per_cent = np.abs(change * 0.01 * values)

    # 3. The bound: the inverse of the products of sensitivities, times the variance of rounding.
    # Columns per step keep the matrix well scaled. The covariance does not depend on the target:
    # any column serves for it.
    covariance = least_squares(
        prediction.unknown, change * step, change[:, 0], dependent=IDENTIFIABLE.smooth
    )[1]
    # Standard deviation of rounding, uniform within a cell [pulses].
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
