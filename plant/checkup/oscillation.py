"""Oscillation of the loop itself: errors that oscillate at a frequency which the reference does not contain, and go on.

A stable loop rings after each reversal of friction, and stays below its tracking error. One that is unstable, by a lag
of its currents or by elastic gears, oscillates ever wider, or until friction or the amplifier limit it.
"""

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.finding import Finding, unless
from plant.checkup.signals import Signals
from plant.parts.fields import Floats

_CONTAINED, _BEYOND, _SLOWEST = 0.999, 5.0, 3.0
"""Share of the reference's power below the highest of its frequencies; and how many times that, and [Hz], is above."""

_PARTS = 6
"""Of the log, in whose median the error oscillates."""

_SWINGS, _LEAST = 0.8, 2.0
"""How much wider, RMS, than the slow part of the error: stable P loops come to 0.55; and in counts."""

_PEAK, _AVERAGED = 20.0, 9
"""Power there in that of the median of fast frequencies, averaged over so many neighbours; noise comes to 3."""

_GROWN = 1.5
"""Ratio of the last third to the first from which on it grows."""

_LIMITED = 0.01
"""Share of the log in which commands above the limit make it another loop."""

_NAME = "oscillation"


def spectrum(values: Floats, period: float) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and power of values (N,) or (N, n) about their mean, in a Hann window."""
    window = np.hanning(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    power = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)) ** 2
    return np.asarray(np.fft.rfftfreq(len(values), period), dtype=np.float64), np.asarray(power, dtype=np.float64)


def oscillation_findings(signals: Signals, share: float = 1.0) -> Iterator[Finding]:
    """Yield the findings about oscillations of the loop, joint by joint."""
    why = "" if signals.long_enough and signals.tracks.all() else "too short, or counts that do not track"
    why, check = "no reference" if signals.reference is None else why, functools.partial(_oscillation, share=share)
    yield from unless(why, (_NAME,), signals.each(check))


def own_oscillations(record: Any, share: float = 1.0) -> list[float]:
    """Frequencies [Hz] at which joints of the loop of a `Record` oscillate, by more than this share of what is told."""
    found = oscillation_findings(Signals(record), share)
    return [each.value for each in found if not each.ok and each.value is not None]


def _oscillation(signals, i, share):
    error = signals.even((signals.reference - signals.counts)[:, i])
    frequency, of_error = spectrum(error, signals.interval)
    contained = np.cumsum(spectrum(signals.even(signals.reference[:, i]), signals.interval)[1])
    highest = frequency[np.searchsorted(contained, _CONTAINED * contained[-1])]
    fast = frequency > max(_BEYOND * highest, _SLOWEST)
    if fast.sum() < 10 * _AVERAGED:
        return Finding.unknown(_NAME, i, "the reference is as fast as the samples show")
    around = np.convolve(of_error, np.ones(_AVERAGED) / _AVERAGED, mode="same")
    own = frequency[np.argmax(of_error * fast)]
    transform = np.fft.rfft(error - error.mean())
    swinging, slow = (np.fft.irfft(transform * kept, len(error)) for kept in (fast, ~fast))
    parts = np.array([_rms(part) for part in np.array_split(swinging, _PARTS)])
    size, tracking = np.median(parts), _rms(slow)
    clear = around[fast].max() > _PEAK * np.median(around[fast])
    if not (clear and size > share * _LEAST * signals.least_count[i] and size > share * _SWINGS * tracking):
        return Finding.of(_NAME, i, size, "pulses")
    if _driven_to_limit(signals, i, size):
        return Finding.unknown(_NAME, i, "the motion takes the amplifier to its limit", value=size, unit="pulses")
    third = _PARTS // 3
    does = "grows" if parts[-third:].mean() > _GROWN * parts[:third].mean() else "goes on"
    seen = f"The loop oscillates, {size:.3g} pulses rms beside {tracking:.3g} of tracking, and {does}"
    why = (
        "it is unstable, or nearly, by gains too high for its friction, lag of the currents, elastic gears or backlash"
    )
    return Finding.of(_NAME, i, own, "Hz", "look", f"{seen}: {why} (or driven by ripple). Lower its gains.")


def _driven_to_limit(signals, i, size):
    """Whether commands reach the amplifier's limit, which swings of this size [pulses] (RMS) alone would not."""
    if signals.commanded is None:
        return False
    drive, commanded = signals.rig.drive, signals.commanded[:, i]
    limit = drive.current_limit[i] * drive.motor_gain[i]
    per_pulse = _rms(commanded) / max(_rms((signals.reference - signals.counts)[:, i]), 1e-300)
    return np.mean(np.abs(commanded) > limit) > _LIMITED and np.sqrt(2) * size * per_pulse < limit


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))
