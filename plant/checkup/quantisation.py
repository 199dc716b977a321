"""Quantisation of the counts: whole numbers, the grid of the stated encoder, noise."""

from collections.abc import Iterator

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.signals import Signals
from plant.parts.fields import Floats

# amplitude (0 to 1) of a spectral line of the counts above which they are on a coarser grid
_COMB = 0.8

# Smallest step [pulses] that still leaves a comb after rounding; a smaller one is aliased to a
# coarser one.
_FINEST = 1.43

# largest amplitude, that of every second count, with a margin; more has another cause
_COMB_WHOLE = 1.7

# Gear from which on counts within a pulse of its multiples are no coincidence: three in five, at
# the most.
_GEARED = 4.0

_CHANCE = 5.0  # significance of a spectral line against random counts [standard deviations]

_DISTINCT = 50  # different counts needed to tell the step

_NOISY = 0.6  # noise [pulses] that rounding (0.29) does not explain


# Note of a record whose positions were clean multiples of such a step before they were counted.
STEP_NOTE = "step of counts [pulses], joint {}"

# Digits of scaled counts, beyond which they are rounding; and how far off a multiple of their step
# they may be.
_DIGITS = 6
_WHOLE = 0.01


def count_unit_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about the unit of the counts."""
    yield from signals.each(_units)


def quantisation_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about quantisation and noise of the counts."""
    yield from signals.each(_step, _noise)


def _units(signals, i):
    """Counts are whole; angles are not."""
    counts = signals.counts[:, i]
    if signals.rig.encoder.smooth:
        return Finding.unknown("units of counts", i, "the encoder is said not to round")
    broken = 100 * np.mean(counts != np.round(counts))
    if not broken:
        return Finding.of("units of counts", i, 0.0, "% not whole")
    verdict = "look"
    advice = "Counts are whole; these were shifted or scaled after counting."
    if (step := grid(counts)) > 1:
        degrees = (
            " = 180/pi, as of radians turned into degrees"
            if abs(np.deg2rad(step) - 1) < _WHOLE
            else ""
        )
        advice = (
            f"Counts are whole; these come in steps of {step:.6g}{degrees}: divide counts and"
            " reference by it."
        )
    if signals.angular[i]:
        unit = "radians" if np.ptp(counts) < 4 * np.pi else "degrees"
        verdict = "wrong"
        advice = (
            f"These look like {unit}, not counts; turn angles of the joints into rig.counts(q)."
        )
    return Finding.of("units of counts", i, broken, "% not whole", verdict, advice)


def _step(signals, i):
    """Step of the counts [pulses]; 1 is that of the stated encoder."""
    if signals.rig.encoder.smooth:
        return Finding.unknown("quantisation step", i, "the encoder is said not to round")
    if own := (signals.record.notes or {}).get(STEP_NOTE.format(i)):
        advice = (
            f"The positions come in steps of {own:.4g} pulses: gear times resolution appears to be"
            f" {1 / own:.4g} times as stated; correct the gear, or the resolution, and read the log"
            " again."
        )
        return Finding.of("quantisation step", i, own, "pulses", "wrong", advice)
    levels = np.unique(np.round(signals.counts[:, i]))
    if len(levels) < _DISTINCT:
        return Finding.unknown("quantisation step", i, f"only {len(levels)} different counts")
    gear = abs(signals.rig.drive.gear[i])
    turns = (levels - levels[0]) / gear
    if gear > _GEARED and (np.abs(levels - levels[0] - gear * np.round(turns)) <= 1).all():
        why = (
            f"Counts come in steps of {gear:g} like the gear: angles of the motor were given as"
            " those of the joint"
        )
        return Finding.of(
            "quantisation step", i, gear, "pulses", "wrong", f"{why}; map them to motor_position."
        )
    step, clear = comb(signals.counts[:, i])
    if not clear:
        return Finding.unknown(
            "quantisation step", i, f"always faster than {step:.0f} pulses per sample"
        )
    stated = signals.rig.encoder.resolution[i]
    why = (
        f"the encoder has {stated / step:.6g} pulses per turn, not {stated:g}, or was rounded to"
        " another step before"
    )
    advice = f"Counts come in steps of {step:.4g}: {why}."
    return Finding.graded("quantisation step", i, step, "pulses", look=1.02, advice=advice)


def grid(counts: Floats) -> float:
    """Step [pulses] of which all counts (N,) are multiples apart, where it is more than a pulse;
    otherwise 1.
    """
    levels = np.unique(np.round(counts - counts[0], _DIGITS))
    if len(levels) < _DISTINCT or (step := float(np.diff(levels).min())) <= 1:
        return 1.0
    return step if np.abs(levels / step - np.round(levels / step)).max() < _WHOLE else 1.0


def comb(counts: Floats) -> tuple[float, bool]:
    """Step of the grid of whole counts (N,), and whether the motion is ever slow enough to tell.

    Counts of a coarser encoder, whole or rounded again, leave a comb in the histogram. Its period
    is that of the strongest line in the spectrum of the visited counts; it cannot exceed the
    smallest steps of the motion by more than the rounding.
    """
    counts = np.round(counts)
    steps = np.abs(np.diff(counts))
    if not steps.any():
        return 1.0, False
    smallest = np.quantile(steps[steps > 0], 0.02)
    levels = np.unique(counts)
    levels = levels[: 1 << 16] - levels[0]
    if smallest > 50 or levels[-1] > 5e7:
        return smallest, False
    length = 1 << int(np.ceil(np.log2(4 * levels[-1] + 8)))
    visited = np.zeros(length)
    visited[levels.astype(int)] = 1
    power = np.abs(np.fft.rfft(visited)) / len(levels)
    frequency = np.arange(len(power)) / length
    # a step between 1 and 2 shows beyond half a cycle per count, folded
    for folded in (frequency, 1 - frequency):
        step = 1 / np.maximum(folded, 1e-9)
        allowed = (
            (step >= _FINEST) & (step <= smallest + 1) & (power > _CHANCE / np.sqrt(len(levels)))
        )
        # rounding again leaves that much of a comb
        share = power / np.sinc(np.minimum(1 / step, 1 / _FINEST))
        share = np.where(allowed & (share < _COMB_WHOLE), share, 0)
        peaks = np.flatnonzero(share > _COMB)
        if len(peaks):  # the widest step that fits: every fraction of it fits, too
            peak = peaks[np.abs(1 / step[peaks] - 1 / step[peaks].max()) < 16 / length]
            found = float(step[peak[np.argmax(power[peak])]])
            # else it is the other one of the pair
            if np.mean(np.diff(levels) < np.floor(found + 0.01)) < 0.01:
                return found, True
    return 1.0, True


def _noise(signals, i):
    """What is left of quartics, and of fourth differences: a motor that its loop shakes still
    moves smoothly.
    """
    noise = signals.noise[i]
    counts = signals.counts[:, i]
    if not np.isfinite(noise):
        return Finding.unknown("noise", i, "too few samples")
    moved = np.abs(counts[4:] - counts[:-4])
    rough = np.diff(counts, 4)[moved <= np.quantile(moved, 0.1)]
    noise = min(noise, np.sqrt(np.mean(rough**2) / 70))  # 1 + 16 + 36 + 16 + 1
    if signals.rig.encoder.smooth:
        return Finding.of("noise", i, noise, "pulses")
    grid = _step(signals, i).value or 1.0
    advice = (
        "The noise of the counts exceeds their rounding, even where the arm is slowest; look for"
        " interference."
    )
    return Finding.graded(
        "noise", i, noise, "pulses", look=_NOISY * grid, wrong=10 * grid, advice=advice
    )
