"""Rate of a sampled or counted signal: backward difference behind a first-order low-pass, or over several samples.

The encoder is all that a law has to take a speed from. The low-pass is sampled exactly. For a sampling period that is
long against the filter's time constant the rate is the plain backward difference, for a short one the usual filtered
derivative, pole s / (s + pole).
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray


def no_reading(n: int, samples: int = 1) -> NDArray[np.float64]:
    """Memory (samples n + 1,) before the first reading of n signals: their last values, and a flag that none was."""
    return np.zeros(samples * n + 1)


def filtered_difference(signal: ca.SX, memory: ca.SX, pole: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Filtered rate of a signal, and the memory to be passed on.

    Parameters
    ----------
    signal : (n,) casadi SX
        Read now.
    memory : (n + 1,) casadi SX
        From the last call, or `no_reading`: then the rate is zero, wherever the signal starts.

    pole : casadi SX
        Of the filter [rad/s].
    dt : casadi SX
        Time since the last reading [s].

    Returns
    -------
    rate : (n,) casadi SX
        [signal / s]
    memory : (n + 1,) casadi SX
    """
    smoothed = ca.if_else(memory[-1] > 0, memory[:-1], signal)
    change = (1 - ca.exp(-pole * dt)) * (signal - smoothed)
    return change / dt, ca.vertcat(smoothed + change, 1)


def difference(signal: ca.SX, memory: ca.SX, samples: int, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rate of a signal over its last samples, and the memory to be passed on.

    Parameters
    ----------
    signal : (n,) casadi SX
        Read now.
    memory : (samples n + 1,) casadi SX
        From the last call, or ``no_reading(n, samples)``: then the rate is zero, wherever the signal starts.
    samples : int
        Over so many the difference is taken.
    dt : casadi SX
        Time since the last reading [s].

    Returns
    -------
    rate : (n,) casadi SX
        [signal / s]
    memory : (samples n + 1,) casadi SX
    """
    before = ca.if_else(memory[-1] > 0, memory[:-1], ca.repmat(signal, samples, 1))
    n = signal.shape[0]
    return (signal - before[-n:, 0]) / (samples * dt), ca.vertcat(signal, before[:-n, 0], 1)
