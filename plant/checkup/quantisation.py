"""Quantisation of the counts: whole numbers, the grid of the stated encoder, noise."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from plant.checkup.finding import Check, Finding
from plant.checkup.innovation import stopped
from plant.checkup.signals import Signals
from plant.parts import Floats

STEP_NOTE = "step of counts [pulses], joint {}"
"""Note of a record whose positions were clean multiples of such a step before they were counted."""


@dataclass(frozen=True, kw_only=True)
class QuantisationSettings:
    """Limits of the search for the grid of the counts.

    They are chosen by hand where no other reason is given.

    Parameters
    ----------
    line : float
        Amplitude (0 to 1) of a line in the spectrum of the visited counts above which they are on a
        coarser grid.
    line_noise : float
        Significance of a line against random counts [standard deviations].
    largest_line : float
        Amplitude above which a line has another cause; every second count gives the largest, and
        this is with a margin.
    finest : float
        Smallest step [pulses] that leaves a comb after rounding: a smaller one is aliased to a
        coarser one.
    levels : int
        Different counts that show a step.
    range : int
        Range [pulses] whose spectrum is computed, at most: its transform takes 50 ms.
    geared : float
        Gear from which on counts within a pulse of its multiples are no coincidence: at most three
        in five of random counts are.
    noise : float
        Noise [pulses] that rounding (0.29) does not explain.
    digits : int
        Digits of scaled counts; further digits are rounding.
    whole : float
        Deviation of a count from a multiple of the step [steps].
    one_scale : float
        Ratio of the largest to the smallest step up to which one wrong number scales all joints.
    """

    line: float = 0.8
    line_noise: float = 5.0
    largest_line: float = 1.7
    finest: float = 1.43
    levels: int = 50
    range: int = 500_000
    geared: float = 4.0
    noise: float = 0.6
    digits: int = 6
    whole: float = 0.01
    one_scale: float = 1.02


SETTINGS = QuantisationSettings()


def count_unit_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about the unit of the counts."""
    yield from signals.per_joint(_units)


def quantisation_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about quantisation and noise of the counts."""
    yield from signals.per_joint(_step, _noise)


def _units(signals, i):
    """Share of counts that are not whole: angles, or counts that were scaled afterwards."""
    check = Check("units of counts", i, "% not whole")
    counts = signals.counts[:, i]
    if signals.rig.encoder.smooth:
        return check.unknown("the encoder is said not to round")
    # Counters give whole numbers; whatever else was done to them leaves broken ones.
    broken = 100 * np.mean(counts != np.round(counts))
    if not broken:
        return check.fine(0.0)
    # Angles have a small range, which scaled counts do not have.
    if signals.angular[i]:
        angle = "radians" if np.ptp(counts) < 4 * np.pi else "degrees"
        advice = (
            f"These look like {angle}, not counts; turn angles of the joints into rig.counts(q)."
        )
        return check.wrong(broken, advice)
    step = grid(counts)
    advice = "Counts are whole; these were shifted or scaled after counting."
    if step > 1:
        degrees = ""
        if abs(np.deg2rad(step) - 1) < SETTINGS.whole:
            degrees = " = 180/pi, as of radians turned into degrees"
        advice = (
            f"Counts are whole; these come in steps of {step:.6g}{degrees}: divide counts and"
            " reference by it."
        )
    return check.look(broken, advice)


def _step(signals, i):
    """Step of the counts [pulses]; 1 is that of the stated encoder."""
    check = Check("quantisation step", i, "pulses")
    if signals.rig.encoder.smooth:
        return check.unknown("the encoder is said not to round")

    # 1. The file's positions came in steps, and were no whole counts. A wrong resolution scales all
    # joints alike; the ranges of normalised positions differ.
    noted = noted_steps(signals.record)
    if i in noted:
        factor = f"gear times resolution appears to be {1 / noted[i]:.4g} times as stated"
        advice = (
            f"The positions come in steps of {noted[i]:.4g} pulses: {factor}; correct the gear, or"
            " the resolution, and read the log again."
        )
        if max(noted.values()) > SETTINGS.one_scale * min(noted.values()):
            advice = (
                f"The positions come in steps of {noted[i]:.4g} pulses, and the joints differ:"
                " either they are normalised to the range of each joint, as LeRobot's are by"
                ' default (state {"-100 to 100 of pulses": ranges of the joints}, and read the log'
                f" again), or {factor} (correct the gear, or the resolution)."
            )
        return check.wrong(noted[i], advice)

    # 2. Steps of the gear: whole counts of the motor were multiplied by it.
    # Few counts fit many grids.
    levels = np.unique(np.round(signals.counts[:, i]))
    if len(levels) < SETTINGS.levels:
        return check.unknown(f"only {len(levels)} different counts")
    gear = abs(signals.rig.drive.gear[i])
    distance = levels - levels[0]
    on_gear = np.abs(distance - gear * np.round(distance / gear)) <= 1
    if gear > SETTINGS.geared and on_gear.all():
        advice = (
            f"Counts come in steps of {gear:g} like the gear: angles of the motor were given as"
            " those of the joint; map them to motor_position."
        )
        return check.wrong(gear, advice)

    # 3. Steps of a coarser encoder.
    step, clear = comb(signals.counts[:, i])
    if not clear:
        return check.unknown(f"always faster than {step:.0f} pulses per sample")
    stated = signals.rig.encoder.resolution[i]
    advice = (
        f"Counts come in steps of {step:.4g}: the encoder has {stated / step:.6g} pulses per turn,"
        f" not {stated:g}, or was rounded to another step before."
    )
    return check.graded(step, advice, look=1.02)


def noted_steps(record) -> dict[int, float]:
    """Steps [pulses] of the file's positions, by joint, where they were no whole pulses."""
    notes = record.notes or {}
    labels = {i: STEP_NOTE.format(i) for i in range(record.n)}
    return {i: notes[label] for i, label in labels.items() if label in notes}


def grid(counts: Floats) -> float:
    """Step [pulses] of which all counts (N,) are multiples apart, if above a pulse; or 1."""
    # Differences, since the grid may begin anywhere.
    levels = np.unique(np.round(counts - counts[0], SETTINGS.digits))
    if len(levels) < SETTINGS.levels:
        return 1.0
    step = float(np.diff(levels).min())
    if step <= 1:
        return 1.0
    multiples = levels / step
    return step if np.abs(multiples - np.round(multiples)).max() < SETTINGS.whole else 1.0


def comb(counts: Floats) -> tuple[float, bool]:
    """Step of the grid of whole counts (N,), and whether the motion is ever slow enough to show it.

    Counts of a coarser encoder, whole or rounded again, leave a comb in the histogram. Its period
    is that of the strongest line in the spectrum of the visited counts; it cannot exceed the
    smallest steps of the motion by more than the rounding.
    """
    # 1. The visited counts, with zeros behind them for the resolution of the spectrum.
    counts = np.round(counts)
    steps = np.abs(np.diff(counts))
    if not steps.any():
        return 1.0, False
    # A quantile, since single small steps may be glitches.
    smallest = np.quantile(steps[steps > 0], 0.02)
    levels = _densest(np.unique(counts))
    # A fast motion shows no grid.
    if smallest > 50 or len(levels) < SETTINGS.levels:
        return smallest, False
    length = 1 << int(np.ceil(np.log2(4 * levels[-1] + 8)))
    visited = np.zeros(length)
    visited[levels.astype(int)] = 1
    power = np.abs(np.fft.rfft(visited)) / len(levels)
    lines = np.flatnonzero(power > SETTINGS.line_noise / np.sqrt(len(levels)))
    power = power[lines]
    frequency = lines / length

    # 2. Lines of a comb. One with a step between 1 and 2 pulses lies beyond half a cycle per count
    # and is folded back.
    for unfolded in (frequency, 1 - frequency):
        step = 1 / np.maximum(unfolded, 1e-9)
        allowed = (step >= SETTINGS.finest) & (step <= smallest + 1)
        # Rounding again attenuates the line of a fine step by this sinc.
        line = power / np.sinc(np.minimum(1 / step, 1 / SETTINGS.finest))
        line = np.where(allowed & (line < SETTINGS.largest_line), line, 0)
        peaks = np.flatnonzero(line > SETTINGS.line)
        if len(peaks):
            # The widest step that fits: every fraction of it fits, too.
            widest = np.abs(1 / step[peaks] - 1 / step[peaks].max()) < 16 / length
            peak = peaks[widest]
            period = float(step[peak[np.argmax(power[peak])]])
            # Visited counts closer than a step belong to the folded line of the pair.
            if np.mean(np.diff(levels) < np.floor(period + 0.01)) < 0.01:
                return period, True
    return 1.0, True


def _densest(levels):
    """The levels (L,) from zero on of the range `SETTINGS.range` that has most of them."""
    end = np.searchsorted(levels, levels + SETTINGS.range)
    begin = np.argmax(end - np.arange(len(levels)))
    return levels[begin : end[begin]] - levels[begin]


def noisy(signals: Signals) -> bool:
    """Whether the counts of any joint have more noise than their rounding and the arm explain."""
    return bool((signals.noise > np.maximum(signals.least_count, _shaken(signals))).any())


def _shaken(signals):
    """Amplitude (n,) with which an arm may move to and fro between two samples [pulses].

    Its acceleration changes sign from sample to sample: its fast loop stops and reverses it harder
    than the samples of the log show.
    """
    return 2 * stopped(signals.rig, signals.interval) / np.pi**2


def _noise(signals, i):
    """Noise of the counts [pulses]: the smaller of two estimates.

    Both the residual of quartics and fourth differences are small of a motor that its loop shakes:
    it still moves smoothly.
    """
    check = Check("noise", i, "pulses")
    noise = signals.noise[i]
    counts = signals.counts[:, i]
    if not np.isfinite(noise):
        return check.unknown("too few samples")
    moved = np.abs(counts[4:] - counts[:-4])
    differences = np.diff(counts, 4)[moved <= np.quantile(moved, 0.1)]
    # Fourth differences have 1 + 16 + 36 + 16 + 1 = 70 times the variance of the counts.
    noise = min(noise, np.sqrt(np.mean(differences**2) / 70))
    if signals.rig.encoder.smooth:
        return check.fine(noise)
    # On a coarser grid the rounding is as much larger.
    step = _step(signals, i).value or 1.0
    advice = (
        "The noise of the counts exceeds their rounding, even where the arm is slowest; look for"
        " interference."
    )
    look = SETTINGS.noise * step
    if look < noise < _shaken(signals)[i]:
        return check.unknown("the arm may move so between two samples", noise)
    return check.graded(noise, advice, look=look, wrong=10 * step)
