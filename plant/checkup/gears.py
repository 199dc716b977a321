"""Elastic gears and lagging torques: what the counts show of them without a model of the arm, which is little.

The inertia matrix of an arm on rigid gears exceeds that of its motors alone, so under a law that is proportional to the
error no mode of the loop is faster than a motor without an arm: sqrt(gain / Jm). An oscillation above that is a gear's.
"""

from collections.abc import Iterator

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.signals import Signals

_AVERAGED = 9
"""Neighbouring frequencies whose power is averaged."""

_ABOVE, _PEAK = 8.0, 4.0
"""Power of an oscillation, in that of the rounding; and in that of the valley on either side."""

_VALLEY = 40
"""Frequencies on either side, in which that valley is."""

_MARGIN = 1.25
"""By how much an oscillation must be faster than any of rigid gears."""

_UNTOLD = "identify() tests it, with a model"


def gear_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about compliance and lag, joint by joint."""
    fastest = _fastest(signals)
    if fastest is None:
        yield Finding.unknown("compliance", None, f"no fast proportional law and motor inertia; {_UNTOLD}")
    else:
        for i in range(signals.n):
            yield _compliance(signals, i, fastest)
    yield Finding.unknown("lag", None, _UNTOLD)


def _fastest(signals):
    """Frequency [Hz] that no mode of a loop with rigid gears exceeds; None where law or rig do not tell."""
    inertia = signals.rig.drive.motor_inertia
    if signals.commanded is None or not signals.long_enough or not (inertia > 0).all():
        return None
    error = signals.reference - signals.counts
    per_pulse = (error * signals.commanded).sum(axis=0) / np.maximum((error**2).sum(axis=0), 1e-300)
    stiffness = per_pulse * signals.rig.encoder.position_in_pulses(np.ones(signals.n))
    return float(np.sqrt(max(0.0, (stiffness / inertia).max())) / (2 * np.pi))


def _compliance(signals, i, fastest):
    name, unit = "compliance", "Hz"
    frequency, power = _spectrum(signals, i)
    above = np.flatnonzero(frequency > _MARGIN * fastest)
    above = above[above > _VALLEY]
    if len(above) < 4 * _VALLEY:
        return Finding.unknown(name, i, f"sampled too slowly; {_UNTOLD}")
    floor = np.median(power[above[len(above) // 2] :])
    for k in above[np.argsort(-power[above])]:
        if power[k] < _ABOVE * floor:
            break
        highest = power[k - _AVERAGED : k + _AVERAGED + 1].max()
        valley = max(power[k - _VALLEY : k].min(), power[k : k + _VALLEY].min())
        if power[k] == highest and power[k] > _PEAK * valley:
            return Finding(
                check=name, joint=i, value=float(frequency[k]), unit=unit, verdict="look",
                advice=f"On rigid gears nothing in this loop oscillates faster than {fastest:.0f} Hz: the gear gives, "
                "or the motor's inertia is below the stated one. identify() tests it.",
            )  # fmt: skip
    return Finding.unknown(name, i, f"no oscillation above the {fastest:.0f} Hz of rigid gears; {_UNTOLD}")


def _spectrum(signals, i):
    """Frequencies [Hz], and power of the error there, averaged over neighbours."""
    grid = np.arange(signals.t[0], signals.t[-1], signals.interval)
    error = np.interp(grid, signals.t, (signals.reference - signals.counts)[:, i])
    power = np.abs(np.fft.rfft((error - error.mean()) * np.hanning(len(error)))) ** 2
    averaged = np.convolve(power, np.ones(_AVERAGED) / _AVERAGED, mode="same")
    return np.fft.rfftfreq(len(error), signals.interval), averaged
