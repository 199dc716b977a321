"""Oscillation of the loop itself: lasting errors at a frequency that the reference lacks.

The ringing of a stable loop after each reversal of friction stays below its tracking error. A loop
that is unstable, by a lag of its currents or by elastic gears, oscillates ever wider, or until
friction or the amplifier limits the oscillation.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plant.checkup.apparent_inertia import shows_soft_gears
from plant.checkup.finding import Check, Finding, unless
from plant.checkup.signals import Signals
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class OscillationSettings:
    """Limits that separate an oscillation of the loop from ringing and noise.

    Where a measurement is given it is that of ``docs/guides/check.md``; the others are chosen by
    hand.

    Parameters
    ----------
    contained : float
        Share of the reference's power below the highest of its frequencies.
    faster : float
        Multiple of that frequency from which on the error is the loop's.
    slowest : float
        Least frequency [Hz] of an oscillation.
    segments : int
        Number of segments of the log. The size of an oscillation is the median of their RMS.
    share_of_slow : float
        Least RMS of an oscillation, relative to the RMS of the slow error. In 40 logs of stable P
        loops this ratio is at most 0.55.
    counts : float
        Least RMS of an oscillation [counts].
    peak : float
        Least power of the peak, relative to the median power of the fast frequencies. The ratio of
        noise reaches 3.
    averaged : int
        Lines of the spectrum over which that power is averaged.
    grown : float
        RMS in the last third of the log, relative to that in the first, above which the oscillation
        grows.
    decayed : float
        The same ratio, below which the start of the log excited the oscillation: such a loop has
        little damping, and is stable.
    flares : float
        RMS after reversals of the load [that before them] from which on a gear has backlash; logs
        without backlash have 0.9 to 1.3.
    reversals : int
        Reversals that such a median needs.
    periods : int
        Periods of the oscillation before and after a reversal that are compared.
    limited : float
        Share of the log with commands above the limit, from which on the loop is not analysed.
    """

    contained: float = 0.999
    faster: float = 5.0
    slowest: float = 3.0
    segments: int = 6
    share_of_slow: float = 0.8
    counts: float = 2.0
    peak: float = 20.0
    averaged: int = 9
    grown: float = 1.5
    decayed: float = 0.5
    flares: float = 1.6
    reversals: int = 4
    periods: int = 4
    limited: float = 0.01


SETTINGS = OscillationSettings()

_NAME = "oscillation"


def spectrum(values: Floats, period: float) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and power of values (N,) or (N, n) about their mean, in a Hann window."""
    # The window suppresses the leakage of the slow motion into fast lines.
    window = np.hanning(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    power = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(values), period)
    return np.asarray(frequency, dtype=np.float64), np.asarray(power, dtype=np.float64)


def oscillation_findings(signals: Signals, share: float = 1.0) -> Iterator[Finding]:
    """Yield the findings about oscillations of the loop from this share of the limits on."""
    reason = ""
    if signals.reference is None:
        reason = "no reference"
    # Where counts do not track, the error is that of a wrong column.
    elif not (signals.long_enough and signals.tracks.all()):
        reason = "too short, or counts that do not track"
    check = functools.partial(_oscillation, share=share)
    yield from unless(reason, (_NAME,), signals.per_joint(check))


def own_oscillations(record, share: float = 1.0) -> list[float]:
    """Frequencies [Hz] at which joints of the loop of a `Record` oscillate.

    Each oscillation has at least this share of the size from which on a finding reports it.
    """
    findings = oscillation_findings(Signals(record), share)
    return [finding.value for finding in findings if not finding.ok and finding.value is not None]


class _Swings(NamedTuple):
    """Error of a joint, split at a frequency above those of its reference.

    `fast`, `slow`: parts (M,) of the error above and below that frequency [pulses]. `load`: slow
    part (M,) of the torque, or of the error without a torque. `frequency`: that of the highest line
    of the fast error [Hz]. `clear`: whether the averaged spectrum has a peak that stands out.
    """

    fast: Floats
    slow: Floats
    load: Floats
    frequency: float
    clear: bool


def _swings(signals, i):
    """Swings of a joint; None where its spectrum has too few fast lines."""
    reference = signals.even(signals.reference[:, i])
    error = signals.even((signals.reference - signals.counts)[:, i])
    frequency, power = spectrum(error, signals.interval)

    # 1. The frequencies above those of the reference.
    contained = np.cumsum(spectrum(reference, signals.interval)[1])
    # The highest frequency that the reference contains.
    highest = frequency[np.searchsorted(contained, SETTINGS.contained * contained[-1])]
    fast = frequency > max(SETTINGS.faster * highest, SETTINGS.slowest)
    if fast.sum() < 10 * SETTINGS.averaged:
        return None

    # 2. A peak among them, averaged so that a single noisy line is none.
    kernel = np.ones(SETTINGS.averaged) / SETTINGS.averaged
    # Of the fast lines alone: a mean across the limit would contain slow ones.
    averaged = np.convolve(power[fast], kernel, mode="same")
    peak = np.argmax(averaged)
    clear = averaged[peak] > SETTINGS.peak * np.median(averaged)

    def part(values, lines):
        return np.fft.irfft(np.fft.rfft(values) * lines, len(error))

    torque = signals.motor_torque
    load = error if torque is None else signals.even(torque[:, i])
    deviation = error - error.mean()
    return _Swings(
        fast=part(deviation, fast),
        slow=part(deviation, ~fast),
        load=part(load, ~fast),
        # The highest line of that peak.
        frequency=frequency[fast][_highest_near(power[fast], peak)],
        clear=bool(clear),
    )


def _highest_near(power, peak):
    """Place of the highest line within the mean at a peak."""
    begin = max(peak - SETTINGS.averaged // 2, 0)
    return begin + np.argmax(power[begin : peak + SETTINGS.averaged // 2 + 1])


def _oscillation(signals, i, share):
    # 1. A wide error with a clear peak, ...
    check = Check(_NAME, i, "pulses")
    swings = _swings(signals, i)
    if swings is None:
        return check.unknown("the log is too short, or its reference too fast, to show one")
    # The median over segments leaves out an event in one part of the log.
    segments = np.array([_rms(part) for part in np.array_split(swings.fast, SETTINGS.segments)])
    size = np.median(segments)
    tracking = _rms(swings.slow)
    # Wider than the quantisation, and than a share of the tracking error.
    wide = size > share * SETTINGS.counts * signals.least_count[i]
    wide &= size > share * SETTINGS.share_of_slow * tracking
    if not (swings.clear and wide):
        return check.fine(size)

    # 2. ... which is not what remains of the start, unless backlash restarts it, ...
    third = SETTINGS.segments // 3
    # RMS at the end of the log relative to that at its start.
    growth = segments[-third:].mean() / max(segments[:third].mean(), 1e-300)
    flares = _flares(signals)
    if growth < SETTINGS.decayed and flares < SETTINGS.flares:
        return check.fine(size)

    # 3. ... in a loop that its limit does not change.
    if _driven_to_limit(signals, i, size):
        return check.unknown("the motion takes the amplifier to its limit", size)
    lasts = "grows" if growth > SETTINGS.grown else "goes on"
    cause = (
        ": it is unstable, or nearly, by gains too high for its friction, lag of the currents,"
        " elastic gears or backlash (or driven by ripple)"
    )
    if not signals.rig.drive.elasticity and shows_soft_gears(signals, swings.frequency):
        cause = (
            ": there the motors move as if they had less inertia than their rotors, so the joints"
            " are elastic, or one has backlash. Log with lower gains, which tells them apart: a"
            " joint with backlash still swings where its load changes sign"
        )
    # An oscillation that grows is wider after any event, so it shows no backlash.
    elif flares >= SETTINGS.flares and growth <= SETTINGS.grown:
        cause = (
            f"; just after the load changes sign it is {flares:.2g} times as wide as before: a gear"
            " has backlash"
        )
    advice = (
        f"The loop oscillates, {size:.3g} pulses rms beside {tracking:.3g} of tracking, and"
        f" {lasts}{cause}. Lower its gains."
    )
    # An oscillation is named by its frequency; other findings by their size.
    return Check(_NAME, i, "Hz").look(swings.frequency, advice)


def _flares(signals):
    """RMS of the fast error after the load of a joint changes sign, relative to that before.

    The result is the median over the reversals of the load of all joints. A reversal of the load
    near a reversal of the speed is left out, since friction changes sign there, too. With too few
    reversals the result is 1.
    """
    ratios = []
    for i in range(signals.n):
        swings = _swings(signals, i)
        # Skip a joint with too few fast lines, and one of frequency 0, which has no fast error.
        if swings is None or not swings.frequency:
            continue
        fast = swings.fast
        span = round(SETTINGS.periods / swings.frequency / signals.interval)
        speed = np.gradient(signals.even(signals.reference[:, i]))
        # Rows in which the reference turns back.
        turns = np.flatnonzero(np.diff(np.sign(speed)))
        for k in np.flatnonzero(np.diff(np.sign(swings.load))):
            # Whole spans within the log, and no reversal of the speed in them.
            if span < k < len(fast) - span and not (np.abs(turns - k) < span).any():
                ratios.append(_rms(fast[k : k + span]) / max(_rms(fast[k - span : k]), 1e-300))
    return float(np.median(ratios)) if len(ratios) >= SETTINGS.reversals else 1.0


def _driven_to_limit(signals, i, size):
    """Whether the motion takes commands to the limit, not the oscillation of this RMS [pulses]."""
    if signals.commanded is None:
        return False
    drive = signals.rig.drive
    commanded = signals.commanded[:, i]
    limit = drive.current_limit[i] * drive.motor_gain[i]
    error = (signals.reference - signals.counts)[:, i]
    # Commanded torque per pulse of error [N m], from their RMS values.
    per_pulse = _rms(commanded) / max(_rms(error), 1e-300)
    saturates = np.mean(np.abs(commanded) > limit) > SETTINGS.limited
    # The amplitude of a sine is sqrt(2) times its RMS.
    return bool(saturates and np.sqrt(2) * size * per_pulse < limit)


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))
