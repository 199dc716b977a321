"""Delay of the counts of a log, which looks like friction and biases all other values.

A delay of d samples shifts every count by d times the counts that pass in one. With f found and
friction known, the difference between measured and simulated errors is then proportional to the
speed, and its slope is the delay. Viscous friction or a gain that is unknown absorbs it.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from identification.replay.followed import speed_of
from identification.replay.gauss_newton import variance_inflation
from identification.replay.prediction import Prediction
from plant import Dynamics, Record
from plant.parts import Floats, dot, frozen_settings, instance, known_options, real


@frozen_settings
class TimingSettings:
    """When counts are called late; chosen by hand.

    Parameters
    ----------
    least : float
        Least delay that matters [samples].
    certain : float
        Standard deviations from which on a delay is certain.
    window : int
        Samples on either side over which the speed of the counts is taken.
    """

    least: float = 0.02
    certain: float = 3.0
    window: int = 5


SETTINGS = TimingSettings()


def delay_of(
    dynamics: Dynamics,
    records: Iterable[Record],
    unknown: Iterable[str],
    values: Floats,
    **options: Any,
) -> tuple[float, float]:
    """Delay of the counts of records against a simulation with these values, and its deviation.

    Returns delay, std: [samples]; a positive delay is a count that is read too late.
    """
    prediction = Prediction(dynamics, records, unknown, **options)
    # Without correction: an observer would take up a part of the delay. It is the loop of the
    # search with gains of zero, whose kernel is compiled already.
    difference = prediction.innovations(np.append(values, 0 * prediction.nuisances))
    if not np.isfinite(difference).all():
        return np.nan, np.inf
    speed = np.concatenate([speed_of(record.counts, SETTINGS.window).ravel() for record in records])
    # Weighted like the difference, of which they are a multiple if counts are late.
    speed = prediction.weights * speed
    square = dot(speed, speed)
    # Regression of the difference on the speed: late counts lag by their delay times the speed.
    slope = dot(difference, speed) / square
    residual = difference - slope * speed
    # Neighbouring residuals correlate: the variance is inflated for that.
    std = np.sqrt(np.mean(residual**2) * variance_inflation(residual) / square)
    # The model is ahead of late counts: its difference is measured less predicted.
    return float(-slope), float(std)


def is_late(delay: float, std: float) -> bool:
    """Whether a delay and its deviation [samples] say that counts are late, or early."""
    return abs(delay) > max(SETTINGS.least, SETTINGS.certain * std)


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
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.5)
    >>> without_delay(record, 0.5).error_pulses.shape
    (715, 2)
    """
    instance("record", record, Record, "The order is record, samples.")
    samples = real("samples", samples, "Give found.diagnostics.delay.")
    # Counts are moved along a straight line, which holds within a sample.
    if abs(samples) > 1:
        raise ValueError(
            f"samples must be within one; got {samples}. Shift the columns by whole rows first."
        )
    initial = record.initial
    # The start goes along: an arm beside its counts would swing for a second.
    if initial is not None:
        q, qd = np.asarray(initial)
        initial = np.array([q + samples * record.rig.period * qd, qd])
    return replace(
        record,
        error_pulses=record.error_pulses - samples * speed_of(record.counts, SETTINGS.window),
        initial=initial,
    )
