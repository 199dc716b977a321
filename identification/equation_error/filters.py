"""Filters without phase: forwards and backwards, and central differences of what they pass."""

import functools

import numpy as np
from numpy.typing import ArrayLike

from plant.motion import Motion
from plant.parts import Floats, real

# Order of the Butterworth low-pass, chosen by hand. Run forwards and backwards it has no phase, and
# the attenuation of twice the order.
_ORDER = 4

# Cutoff of the low-pass before differentiation, in pass bands: its slope must not reach into them.
CUTOFF = 2.5

# Highest pass band, in sample rates: the cutoff stays below half of the sample rate.
BAND_MOST = 0.4 / CUTOFF


def low_pass(x: ArrayLike, period: float, cutoff: float) -> Floats:
    """Zero-phase low-pass of the columns of x (N, ...).

    `period` [s]: between samples. `cutoff` [Hz].
    """
    # Imported here: it takes a third of a second, which the genetic algorithm does not need.
    from scipy.signal import sosfiltfilt

    x = np.asarray(x)
    cutoff = real("cutoff", cutoff, "Give Hz.", positive=True)
    if not 2 * cutoff * period < 1:
        raise ValueError(
            f"cutoff must be below half of the sample rate, {0.5 / period:.4g} Hz; got {cutoff:g}."
            " Lower it."
        )
    # The filter starts from reflected ends of the log, which needs as many samples.
    if len(x) <= 6 * _ORDER:
        raise ValueError(
            f"a log must have more than {6 * _ORDER} samples to be filtered; got {len(x)}. Log"
            " longer."
        )
    return sosfiltfilt(_butterworth(2 * cutoff * period), x, axis=0)


@functools.lru_cache(maxsize=256)
def _butterworth(cutoff):
    from scipy.signal import butter

    return np.asarray(butter(_ORDER, cutoff, output="sos"))


def derivatives(q: ArrayLike, period: float, cutoff: float) -> Motion:
    """Motion from positions (N, n) [rad]: low-passed, then differentiated by central differences.

    `period` [s]: between samples. `cutoff` [Hz].

    Returns q, qd, qdd, each (N, n).
    """
    return by_differences(low_pass(q, period, cutoff), period)


def by_differences(x: Floats, period: float) -> Motion:
    """Samples (N, n), and their first and second derivatives by central differences."""
    # Symmetric, like the filter: no signal is later than another.
    rate = np.gradient(x, period, axis=0)
    return Motion(x, rate, np.gradient(rate, period, axis=0))
