"""The time stamps of a log: period, gaps, jitter, and whether the counts were read at them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from plant.checkup.finding import Check, Finding
from plant.checkup.innovation import SETTINGS as MOTION
from plant.checkup.lost_rows import MOST, LostRows
from plant.checkup.signals import Signals


@dataclass(frozen=True, kw_only=True)
class StampSettings:
    """Limits of the checks of time, chosen by hand.

    Parameters
    ----------
    samples : int
        Samples below which a log is too short for a fit.
    patchy : float
        Samples without weight [%] to look at; samples that are missing [%], repeated or late, from
        which on the log is broken.
    jitter : float
        Jitter of the intervals [%] to look at.
    period, other_period : float
        Relative error of the period to look at, and above which it is wrong: a thousandth is one
        sample in a thousand by the end.
    certain : float
        Standard deviations of the median interval from which on another period is no chance.
    shifts : int
        Rows to each side by which stamps may be shifted against counts.
    shift_evidence : float
        Sum of squared deviations [noise^2] of the intervals, from which on a shift is significant.
    """

    samples: int = 200
    patchy: float = 5.0
    jitter: float = 1.0
    period: float = 1e-3
    other_period: float = 2e-2
    certain: float = 3.0
    shifts: int = 2
    shift_evidence: float = 400.0


TIME = StampSettings()


def time_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about time."""
    record = signals.record
    N = len(record)
    # Even a short log is checked further, as far as each check allows.
    short = TIME.samples > N
    advice = (
        f"{N} samples hold little; log at least {TIME.samples}, and a few periods of the motion."
    )
    yield Check("samples").finding(N, "wrong" if short else "fine", advice if short else "")
    yield Check("samples left out", None, "%").graded(
        100 * (1 - np.mean(record.valid > 0)),
        "Many samples have weight 0; see why they were dropped.",
        look=TIME.patchy,
        wrong=50,
    )
    # Two intervals at least, to compare them.
    if N < 3:
        names = "period", "missing samples", "crowded samples", "time jitter", "rows and stamps"
        for name in names:
            yield Check(name).unknown("fewer than three samples")
        return
    steps = np.diff(record.t) / signals.interval
    yield _period(signals)
    yield from _intervals(signals, steps)
    yield _rows_and_stamps(signals)


def _period(signals):
    """Median interval against the rig's period [ms]."""
    # The median is that of regular rows, however many are missing.
    ratio = signals.interval / signals.rig.period
    factor = unit_of_time(ratio)
    if factor != 1:
        advice = (
            f"Times are {factor:g} times what the rig's period says: give seconds (divide t by"
            f" {factor:g})."
        )
    else:
        stated = signals.rig.period * 1e3
        advice = f"The rig says {stated:.6g} ms; correct rig.period, or resample the log."
    chance = chance_of_period(signals)
    # The ratio is judged, and the interval is shown.
    finding = Check("period", None, "ms").graded(
        ratio - 1, advice, look=TIME.period + chance, wrong=TIME.other_period + chance
    )
    return replace(finding, value=signals.interval * 1e3)


def unit_of_time(ratio: float) -> float:
    """The power of a thousand that a ratio of intervals is; 1 where it is near no other."""
    thousands = np.log10(ratio) / 3
    # Milliseconds or microseconds are a power of a thousand, but for 0.03 * 3 decades.
    near = abs(thousands - round(thousands)) < 0.03
    return float(1e3 ** round(thousands)) if near else 1.0


def another_period(signals: Signals, ratio: float) -> bool:
    """Whether intervals are so many times a period by more than chance, and than a thousandth."""
    return bool(abs(np.log(ratio)) > 1e-3 + chance_of_period(signals))


def chance_of_period(signals: Signals) -> float:
    """Relative error of the median interval that scattered stamps cause."""
    steps = np.diff(signals.record.t) / signals.interval
    # Standard deviation of a median, from the quartiles of the intervals.
    return float(TIME.certain * 1.25 * _spread(steps) / 1.35 / np.sqrt(len(steps)))


def _spread(steps):
    """Distance of the quartiles of the intervals (N - 1,) [median intervals]."""
    lower, upper = np.quantile(steps, (0.25, 0.75))
    return upper - lower


def _intervals(signals, steps):
    """Yield the findings about intervals (N - 1,) [median intervals]."""
    N = len(steps) + 1
    even = _spread(steps) < MOTION.mistimed
    # Of an even clock a late row is lost; of an uneven one the motion says what is too late.
    late = MOTION.late if even else signals.longest_line / signals.interval
    gaps = steps[steps > late]
    missing = np.round(gaps).sum() - len(gaps)
    advice = (
        f"{missing:.0f} rows are missing in {len(gaps)} gaps of up to {steps.max():.1f} intervals;"
        " use the time stamps, do not count rows."
    )
    # Of the rows that a complete log would have.
    share = 100 * missing / (missing + N)
    if not even:
        advice = (
            f"In {len(gaps)} steps of up to {steps.max() * signals.interval:.3g} s the motion is"
            " not known; fits leave them out."
        )
    wrong = TIME.patchy if even else np.inf
    yield Check("missing samples", None, "%").graded(share, advice, look=0, wrong=wrong)
    # Stamps of an even clock that round to no interval.
    crowded = (np.round(steps) == 0) & even
    yield Check("crowded samples").graded(
        int(crowded.sum()),
        "Samples follow each other within half an interval; drop the second of each pair.",
        look=0,
        wrong=TIME.patchy / 100 * N,
    )
    # Gaps and repeated samples have findings of their own.
    # The standard deviation is that of the stamps, not of the rows that are lost.
    regular = (steps < late) & ~crowded
    jitter = 100 * np.std(steps[regular] if regular.any() else steps)
    advice = (
        "Intervals jitter; use the logged times, unless rows and stamps says that the counts come"
        " evenly. Let the controller's clock stamp the samples."
    )
    # Whether such stamps are the times of the counts, `_rows_and_stamps` says.
    yield Check("time jitter", None, "%").graded(jitter, advice, look=TIME.jitter)


def _rows_and_stamps(signals):
    """Whether the counts were read when their time stamps say."""
    check = Check("rows and stamps", None, "rows")
    shifted = _row_shift(signals) if len(signals.t) >= 20 else None
    if shifted is None:
        return check.unknown("intervals are too alike")
    shift, coefficient = shifted
    # The counts move more in a longer interval: stamps and counts belong together.
    if shift == 0 and coefficient > 1 - MOTION.in_time:
        return check.fine(0.0)
    # They move alike in all intervals: the stamps are late, not the counts.
    if coefficient < MOTION.in_time:
        advice = (
            "The stamps jitter, the samples do not: the counts come evenly; put t = row times"
            " interval."
        )
        return check.look(None, advice)
    # Between both: stamps and counts belong together in some rows only.
    rows = "partly in other rows"
    if shift:
        rows = f"{abs(shift)} row(s) {'after' if shift > 0 else 'before'} the stamps"
    advice = (
        f"At odd intervals the counts come {rows}: clock and counter are not read together; leave"
        " out the rows at gaps (valid = 0)."
    )
    return check.look(shift, advice)


def _row_shift(signals):
    """Rows by which counts lag behind their stamps, and the regression coefficient there.

    The steps of the counts, beyond those of an even clock, are regressed on the steps that
    intervals of odd length predict. None where the intervals are too alike.
    """
    excess = np.diff(signals.counts, axis=0) - signals.local_speed * signals.interval
    # At least the noise of rounding, so that a perfect log does not divide by zero.
    noise = np.maximum(np.quantile(np.abs(excess), 0.9, axis=0), 0.3 * signals.least_count)
    longer = (np.diff(signals.t) - signals.interval)[:, None]
    predicted = longer * signals.local_speed / noise
    # np.roll below carries rows from one end to the other; zeros there have no weight.
    predicted[: TIME.shifts] = 0
    predicted[-TIME.shifts :] = 0
    power = np.sum(predicted**2)
    if power < TIME.shift_evidence:
        return None
    # Outliers are clipped to what the timing and the usual noise explain.
    limit = np.abs(predicted).max() + MOTION.spike
    excess = np.clip(excess / noise, -limit, limit)
    shifts = range(-TIME.shifts, TIME.shifts + 1)
    slopes = [np.sum(excess * np.roll(predicted, shift, axis=0)) / power for shift in shifts]
    best = int(np.argmax(slopes))
    return shifts[best], float(np.clip(slopes[best], 0.0, 1.0))


def lost_findings(signals: Signals, lost: LostRows) -> Iterator[Finding]:
    """Yield the findings about rows that are no measurement, by cause."""
    remedy = "Fits bridge them without weight"
    # Then the checkup ends here, and no fit accepts the log.
    if lost.any.mean() > MOST:
        remedy = (
            f"They are {lost.any.mean():.0%} of all, too many for any fit; log every sample, and"
            " anew"
        )
    causes = {
        "lost packets": "Rows, or their reference, repeat the one before although the arm moves",
        "stuck samples": "Counts of a joint repeat although it moves, and catch up",
        "late stamps": "Stamps are late or early whose counts were taken in time",
    }
    limit = TIME.patchy / 100 * len(signals.record)
    rows_by_cause = lost.packets, lost.stuck, lost.late
    for (name, cause), rows in zip(causes.items(), rows_by_cause, strict=True):
        yield Check(name).graded(int(rows.sum()), f"{cause}. {remedy}.", look=0, wrong=limit)
