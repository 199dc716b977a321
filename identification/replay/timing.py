"""Delay of the counts of a log: read a fraction of a sample late, they look like friction and bias
everything else.

A delay of d samples shifts every count by d times the counts that pass in one. With f found and
friction known, the difference between measured and simulated errors is then proportional to the
speed, and its slope is the delay. Viscous friction or a gain that is unknown absorbs it.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from identification.replay.followed import speed_of
from identification.replay.gauss_newton import variance_inflation
from identification.replay.prediction import Prediction
from plant import Dynamics, Record
from plant.parts.arguments import instance, known_options, real
from plant.parts.fields import Floats
from plant.parts.sums import dot

# delay [samples] that matters, and from how many of its standard deviations on
_LATE = 0.02
_SURE = 3.0

_WINDOW = 5  # samples before and after, over which the speed of the counts is taken


def delay_of(
    dynamics: Dynamics,
    records: Iterable[Record],
    unknown: Iterable[str],
    values: Floats,
    **options: Any,
) -> tuple[float, float]:
    """How many samples late the counts of records are, against a simulation with these values; and
    its deviation.

    Returns delay, std: [samples]; a positive delay is a count that is read too late.
    """
    prediction = Prediction(dynamics, records, unknown, **options)
    # the search's loop, uncorrected
    difference = prediction.innovations(np.append(values, 0 * prediction.nuisances))
    if not np.isfinite(difference).all():
        return np.nan, np.inf
    speed = np.concatenate([speed_of(record.counts, _WINDOW).ravel() for record in records])
    weight = prediction.weights
    slope = dot(difference, weight * speed) / dot(weight * speed, weight * speed)
    left = difference - slope * weight * speed
    std = np.sqrt(np.mean(left**2) * variance_inflation(left) / dot(weight * speed, weight * speed))
    return float(-slope), float(std)


def is_late(delay: float, std: float) -> bool:
    """Whether a delay and its deviation [samples] say that counts are late, or early."""
    return abs(delay) > max(_LATE, _SURE * std)


@known_options
def without_delay(record: Record, samples: float) -> Record:
    """The same record with the delay of its counts taken out, by their speed.

    Parameters
    ----------
    record : Record
    samples : float
        By how much the counts are late, such as ``found.diagnostics.delay``; within one sample.

    Returns
    -------
    Record
        Errors are no longer whole pulses.

    Raises
    ------
    ValueError
        More than one sample: drop rows instead.

    See Also
    --------
    plant.Record

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import without_delay
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    >>> without_delay(record, 0.5).error_pulses.shape
    (715, 2)
    """
    instance("record", record, Record, "The order is record, samples.")
    samples = real("samples", samples, "Give found.diagnostics.delay.")
    if abs(samples) > 1:
        raise ValueError(
            f"samples must be within one; got {samples}. Shift the columns by whole rows first."
        )
    return dataclasses.replace(
        record, error_pulses=record.error_pulses - samples * speed_of(record.counts, _WINDOW)
    )
