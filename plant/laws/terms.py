"""Terms of sampled controllers: rate of a signal (behind a low-pass, or over samples), integral
with anti-windup.

The encoder is all that a law has to take a speed from. The low-pass is sampled exactly. For a
sampling period that is long against the filter's time constant the rate is the plain backward
difference, for a short one the usual filtered derivative, pole s / (s + pole).
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray


def no_reading(n: int, samples: int = 1) -> NDArray[np.float64]:
    """Memory (samples n + 1,) before the first reading of n signals: their last values, and a
    flag that none was.
    """
    return np.zeros(samples * n + 1)


def filtered_difference(
    signal: ca.SX, memory: ca.SX, pole: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Filtered rate (n,) [signal / s] of a signal (n,) read now, and the memory (n + 1,) to be
    passed on.

    The memory is that of the last call, or `no_reading`: then the rate is zero, wherever the signal
    starts. The pole of the filter is in rad/s, dt the time since the last reading [s].
    """
    smoothed = ca.if_else(memory[-1] > 0, memory[:-1], signal)
    change = (1 - ca.exp(-pole * dt)) * (signal - smoothed)
    return change / dt, ca.vertcat(smoothed + change, 1)


def difference(signal: ca.SX, memory: ca.SX, samples: int, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rate (n,) of a signal (n,) over its last samples, and the memory (samples n + 1,); as
    `filtered_difference`.
    """
    before = ca.if_else(memory[-1] > 0, memory[:-1], ca.repmat(signal, samples, 1))
    n = signal.shape[0]
    return (signal - before[-n:, 0]) / (samples * dt), ca.vertcat(signal, before[:-n, 0], 1)


def integrated(integral: ca.SX, slope: ca.SX, missing: ca.SX, tracking: ca.SX, dt: ca.SX) -> ca.SX:
    """Integral one step later, with back-calculation against windup.

    What the amplifier cut off since the last step (`missing`: applied minus commanded) is fed back
    with the time constant 1 / `tracking` [s]. For a PI law that is gain / integral gain: in
    saturation the integral then settles at the limit. `slope` is what is integrated, times its
    gain.

    Source: back-calculation; Astrom and Hagglund, Advanced PID Control (2006), 3.5.
    """
    return integral + dt * slope + ca.fmin(tracking * dt, 1) * missing
