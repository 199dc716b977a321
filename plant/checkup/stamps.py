"""Sampling of a log: period, jitter, missing and repeated samples, length."""

from collections.abc import Iterator

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.lost_rows import MOST, LostRows
from plant.checkup.signals import Signals

# median intervals above which a sample is missing, and below which one is repeated
_GAP = 1.5
_CROWD = 0.5

_LOST = 5.0  # missing samples [%] above which the log is broken rather than patchy

# Jitter of the intervals [%] to look at, and above which time stamps are not sample times.
_JITTER = 1.0
_UNTIMED = 20.0

# relative error of the period: a thousandth is one sample in a thousand by the end
_OFF = 1e-3
_OTHER = 2e-2

# Regression coefficient (`Signals.row_shift`) above which stamps and counts belong together; and
# below which the counts were taken evenly.
_MATCH = 0.7
_EVEN = 0.3

_SHORT = 200  # fewer samples are too few for a fit


def time_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about time."""
    record = signals.record
    N = len(record)
    advice = f"{N} samples hold little; log at least {_SHORT}, and a few periods of the motion."
    short = "wrong" if N < _SHORT else "fine"
    yield Finding.of("samples", None, N, "", short, advice * (N < _SHORT))
    left_out = 100 * (1 - np.mean(record.valid > 0))
    advice = "Many samples have weight 0; see why they were dropped."
    yield Finding.graded(
        "samples left out", None, left_out, "%", look=_LOST, wrong=50, advice=advice
    )
    if N < 3:
        for name in (
            "period",
            "missing samples",
            "crowded samples",
            "time jitter",
            "rows and stamps",
        ):
            yield Finding.unknown(name, None, "fewer than three samples")
        return
    steps = np.diff(record.t) / signals.interval
    yield _period(signals)
    gaps = steps[steps > _GAP]
    lost = np.round(gaps).sum() - len(gaps)
    missing = (
        f"{lost:.0f} rows are missing in {len(gaps)} gaps of up to {steps.max():.1f} intervals"
    )
    advice = f"{missing}; use the time stamps, do not count rows."
    yield Finding.graded(
        "missing samples", None, 100 * lost / (lost + N), "%", look=0, wrong=_LOST, advice=advice
    )
    crowded = int((steps < _CROWD).sum())
    advice = "Samples follow each other within half an interval; drop the second of each pair."
    yield Finding.graded(
        "crowded samples", None, crowded, "", look=0, wrong=0.05 * N, advice=advice
    )
    even = (steps < _GAP) & (steps > _CROWD)
    jitter = 100 * np.std(steps[even] if even.any() else steps)
    advice = (
        "Intervals jitter; use the logged times, or let the controller's clock stamp the samples."
    )
    yield Finding.graded(
        "time jitter", None, jitter, "%", look=_JITTER, wrong=_UNTIMED, advice=advice
    )
    yield _stamps(signals)


def _period(signals):
    """Median interval against the rig's period [ms]."""
    ratio = signals.interval / signals.rig.period
    thousand = np.log10(ratio) / 3
    if abs(thousand) > 0.5 and abs(thousand - round(thousand)) < 0.03:
        factor = 1e3 ** round(thousand)
        advice = (
            f"Times are {factor:g} times what the rig's period says: give seconds (divide t by"
            f" {factor:g})."
        )
    else:
        advice = (
            f"The rig says {signals.rig.period * 1e3:.6g} ms; correct rig.period, or resample the"
            " log."
        )
    finding = Finding.graded(
        "period", None, ratio - 1, "ms", look=_OFF, wrong=_OTHER, advice=advice
    )
    return Finding(**{**vars(finding), "value": signals.interval * 1e3})


def _stamps(signals):
    """Whether the counts were taken when their time stamps say."""
    name = "rows and stamps"
    unit = "rows"
    shift, share = (np.nan, 0.0) if len(signals.t) < 20 else signals.row_shift
    if np.isnan(shift):
        return Finding.unknown(name, None, "intervals are too alike")
    if shift == 0 and share > _MATCH:
        return Finding.of(name, None, 0.0, unit)
    if share < _EVEN:
        advice = (
            "The stamps jitter, the samples do not: the counts come evenly; put t = row times"
            " interval."
        )
        return Finding.of(name, None, None, unit, "look", advice)
    when = (
        f"{abs(shift)} row(s) {'after' if shift > 0 else 'before'} the stamps"
        if shift
        else "partly in other rows"
    )
    reading = f"the counts come {when}: clock and counter are not read together"
    advice = f"At odd intervals {reading}; leave out the rows at gaps (valid = 0)."
    return Finding.of(name, None, shift, unit, "look", advice)


def lost_findings(signals: Signals, lost: LostRows) -> Iterator[Finding]:
    """Yield the findings about rows that are no measurement, by cause."""
    N = len(signals.record)
    fits = "Fits bridge them without weight"
    if lost.any.mean() > MOST:
        fits = (
            f"They are {lost.any.mean():.0%} of all, too many for any fit; log every sample, and"
            " anew"
        )
    causes = {
        "lost packets": (
            lost.packets,
            "Rows, or their reference, repeat the one before although the arm moves",
        ),
        "stuck samples": (lost.stuck, "Counts of a joint repeat although it moves, and catch up"),
        "late stamps": (lost.late, "Stamps are late or early whose counts were taken in time"),
    }
    for name, (rows, why) in causes.items():
        yield Finding.graded(
            name, None, int(rows.sum()), "", look=0, wrong=0.05 * N, advice=f"{why}. {fits}."
        )
