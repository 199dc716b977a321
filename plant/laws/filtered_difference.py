"""Rate of a sampled or counted signal: the difference of two readings, smoothed by one pole.

A law that needs a speed has nothing but the encoder to take it from. The signal passes a first-order low-pass, sampled
exactly; the rate is the difference of two values of that. For a step that is long against the pole it is the plain
backward difference, for a short one the usual filtered derivative, pole s / (s + pole).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

__all__ = ["filtered_difference", "no_reading"]


def no_reading(n):
    """Memory (n + 1,) before the first reading of n signals: their smoothed values, and that there was none."""
    return np.zeros(n + 1)


def filtered_difference(signal, memory, pole, dt):
    """Rate of a signal, and the memory to be passed on.

    Parameters
    ----------
    signal : (n,) casadi SX
        Read now.
    memory : (n + 1,) casadi SX
        From the last call, or `no_reading`: the first rate is zero, wherever the signal starts.
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
