"""Pulse budget: what a motion can say of each parameter, before the experiment.

The closed loop, without rounding, is simulated with each number a little larger and a little smaller: by how many
pulses the tracking error changes is all that a log can hold of it. With readings that err by rounding alone, evenly
within a cell, it bounds how well any method can know the number (Cramer-Rao).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from identification.equation_error.least_squares import least_squares
from identification.replay.gauss_newton import slopes
from identification.replay.prediction import Prediction
from plant import simulate
from plant.parts.arguments import known_options

__all__ = ["Budget", "pulse_budget"]

_STEP = 1e-4
"""Of the derivatives, as a share of a number (or of the largest f, for one that is zero)."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Budget:
    """What a motion is worth.

    Attributes
    ----------
    names : tuple of str
    values : (k,) numpy.ndarray
    peak, rms : (k,) numpy.ndarray
        Change of the tracking error, largest and root mean square over samples and joints, for 1 % of each [pulses].
    bound : (k,) numpy.ndarray
        Smallest standard deviation of each with all of them unknown, from rounding alone.
    bound_alone : (k,) numpy.ndarray
        The same with all others known.
    """

    names: tuple
    values: np.ndarray
    peak: np.ndarray
    rms: np.ndarray
    bound: np.ndarray
    bound_alone: np.ndarray

    def __str__(self):
        width = max(map(len, self.names))
        lines = [f"{'':<{width}} {'value':>11} {'1 % is worth':>13} {'rms':>8} {'bound':>9} {'alone':>9}"]
        for row in zip(self.names, self.values, self.peak, self.rms, self.bound, self.bound_alone, strict=True):
            name, value, peak, rms, bound, alone = row
            lines.append(f"{name:<{width}} {value:11.4g} {peak:7.3f} pulses {rms:8.4f} {bound:9.2g} {alone:9.2g}")
        return "\n".join(lines)


@known_options
def pulse_budget(arm, rig, law, reference, *, unknown=None, duration=None):
    """How many pulses each number of an experiment is worth.

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
        Bad input, a number that has no effect, or numbers that this motion cannot tell apart.
    """
    record = simulate(arm, rig, law, reference, duration=duration)
    prediction = Prediction(arm.dynamics, record, unknown, free=True)
    known = dict(zip(arm.dynamics.names, arm.f, strict=True))
    for part, prefix in ((rig, ""), (law, "law.")):
        known |= dict(zip(part.number_names(prefix), part.number_values(), strict=True))
    values = np.array([known[name] for name in prediction.unknown])
    step = _STEP * np.where(values == 0, np.abs(arm.f).max(), np.abs(values))
    change = slopes(prediction, values, step.copy(), np.arange(len(values))) / step
    per_cent = np.abs(change * 0.01 * values)
    covariance = least_squares(prediction.unknown, change * np.abs(step), change[:, 0], dependent=1e-7)[1]
    cell = 1 / np.sqrt(12)
    return Budget(
        names=prediction.unknown,
        values=values,
        peak=per_cent.max(axis=0),
        rms=np.sqrt((per_cent**2).mean(axis=0)),
        bound=cell * np.sqrt(np.diag(covariance)) * step,
        bound_alone=cell / np.sqrt((change**2).sum(axis=0)),
    )
