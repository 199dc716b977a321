"""Oscillation of the loop itself: errors that oscillate at a frequency which the reference does not
contain, and go on.

A stable loop rings after each reversal of friction, and stays below its tracking error. One that is
unstable, by a lag of its currents or by elastic gears, oscillates ever wider, or until friction or
the amplifier limit it.
"""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.finding import Finding, unless
from plant.checkup.signals import Signals
from plant.parts.fields import Floats

# Share of the reference's power below the highest of its frequencies; and how many times that, and
# [Hz], is above.
_CONTAINED = 0.999
_BEYOND = 5.0
_SLOWEST = 3.0

_PARTS = 6  # of the log, in whose median the error oscillates

# How much wider, RMS, than the slow part of the error: stable P loops come to 0.55; and in counts.
_SWINGS = 0.8
_LEAST = 2.0

# Power there in that of the median of fast frequencies, averaged over so many neighbours; noise
# comes to 3.
_PEAK = 20.0
_AVERAGED = 9

_GROWN = 1.5  # ratio of the last third to the first from which on it grows

# the same ratio, below which it is what is left of the start: a loop of little damping, but stable
_DECAYED = 0.5

# How much wider, by the median over so many reversals of the loads at least, it is in so many of
# its periods after them than before, where a gear has backlash; without it comes to 1.3.
_FLARES = 1.6
_REVERSALS = 4
_AFTER = 4

_LIMITED = 0.01  # share of the log in which commands above the limit make it another loop

_NAME = "oscillation"


def spectrum(values: Floats, period: float) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and power of values (N,) or (N, n) about their mean, in a Hann window."""
    window = np.hanning(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    power = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)) ** 2
    return np.asarray(np.fft.rfftfreq(len(values), period), dtype=np.float64), np.asarray(
        power, dtype=np.float64
    )


def oscillation_findings(signals: Signals, share: float = 1.0) -> Iterator[Finding]:
    """Yield the findings about oscillations of the loop, joint by joint."""
    why = (
        ""
        if signals.long_enough and signals.tracks.all()
        else "too short, or counts that do not track"
    )
    why = "no reference" if signals.reference is None else why
    check = functools.partial(_oscillation, share=share)
    yield from unless(why, (_NAME,), signals.each(check))


def own_oscillations(record: Any, share: float = 1.0) -> list[float]:
    """Frequencies [Hz] at which joints of the loop of a `Record` oscillate, by more than this
    share of what is told.
    """
    found = oscillation_findings(Signals(record), share)
    return [each.value for each in found if not each.ok and each.value is not None]


class _Swings(NamedTuple):
    """Error (M,) of a joint [pulses] above the frequencies of its reference, its slow part and that
    of the torque.

    `own`: frequency of the highest peak above [Hz]. `clear`: whether that stands out.
    """

    fast: Floats
    slow: Floats
    load: Floats
    own: float
    clear: bool


def _swings(signals, i):
    """Swings of a joint; None where the reference is as fast as the samples show."""
    error = signals.even((signals.reference - signals.counts)[:, i])
    frequency, of_error = spectrum(error, signals.interval)
    contained = np.cumsum(spectrum(signals.even(signals.reference[:, i]), signals.interval)[1])
    highest = frequency[np.searchsorted(contained, _CONTAINED * contained[-1])]
    fast = frequency > max(_BEYOND * highest, _SLOWEST)
    if fast.sum() < 10 * _AVERAGED:
        return None
    around = np.convolve(of_error, np.ones(_AVERAGED) / _AVERAGED, mode="same")
    torque = error if signals.motor_torque is None else signals.even(signals.motor_torque[:, i])
    parts = (error - error.mean(), fast), (error - error.mean(), ~fast), (torque, ~fast)
    kept = (np.fft.irfft(np.fft.rfft(values) * some, len(error)) for values, some in parts)
    clear = around[fast].max() > _PEAK * np.median(around[fast])
    return _Swings(*kept, own=frequency[np.argmax(of_error * fast)], clear=bool(clear))


def _oscillation(signals, i, share):
    joint = _swings(signals, i)
    if joint is None:
        return Finding.unknown(_NAME, i, "the reference is as fast as the samples show")
    parts = np.array([_rms(part) for part in np.array_split(joint.fast, _PARTS)])
    size = np.median(parts)
    tracking = _rms(joint.slow)
    third = _PARTS // 3
    wide = size > share * _LEAST * signals.least_count[i] and size > share * _SWINGS * tracking
    grown = parts[-third:].mean() / max(parts[:third].mean(), 1e-300)
    flares = _flares(signals) if joint.clear and wide else 1.0
    if not (joint.clear and wide) or (grown < _DECAYED and flares < _FLARES):
        return Finding.of(_NAME, i, size, "pulses")
    if _driven_to_limit(signals, i, size):
        return Finding.unknown(
            _NAME, i, "the motion takes the amplifier to its limit", value=size, unit="pulses"
        )
    does = "grows" if grown > _GROWN else "goes on"
    seen = (
        f"The loop oscillates, {size:.3g} pulses rms beside {tracking:.3g} of tracking, and {does}"
    )
    why = (
        ": it is unstable, or nearly, by gains too high for its friction, lag of the currents,"
        " elastic gears or backlash (or driven by ripple)"
    )
    if flares >= _FLARES and grown <= _GROWN:  # what grows is wider after anything
        why = (
            f"; just after the load changes sign it is {flares:.2g} times as wide as before: a gear"
            " has backlash"
        )
    return Finding.of(_NAME, i, joint.own, "Hz", "look", f"{seen}{why}. Lower its gains.")


def _flares(signals):
    """How much wider the loop swings just after the load of a joint changes sign, but not its
    speed, than before.
    """
    ratios = list[float]()
    for i, joint in enumerate(_swings(signals, i) for i in range(signals.n)):
        if joint is None:
            continue
        around = round(_AFTER / joint.own / signals.interval)
        turns = np.flatnonzero(np.diff(np.sign(np.gradient(signals.even(signals.reference[:, i])))))
        for k in np.flatnonzero(np.diff(np.sign(joint.load))):
            if around < k < len(joint.fast) - around and not (np.abs(turns - k) < around).any():
                ratios.append(
                    _rms(joint.fast[k : k + around]) / max(_rms(joint.fast[k - around : k]), 1e-300)
                )
    return float(np.median(ratios)) if len(ratios) >= _REVERSALS else 1.0


def _driven_to_limit(signals, i, size):
    """Whether commands reach the amplifier's limit, which swings of this size [pulses] (RMS)
    alone would not.
    """
    if signals.commanded is None:
        return False
    drive = signals.rig.drive
    commanded = signals.commanded[:, i]
    limit = drive.current_limit[i] * drive.motor_gain[i]
    per_pulse = _rms(commanded) / max(_rms((signals.reference - signals.counts)[:, i]), 1e-300)
    return np.mean(np.abs(commanded) > limit) > _LIMITED and np.sqrt(2) * size * per_pulse < limit


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))
