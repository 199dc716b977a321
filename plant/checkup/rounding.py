"""How counters round, seen where joints pass zero: `fix` has a cell two pulses wide there, `floor`
and `round` none.

A polynomial in time, what the torque adds to it, and a step of the counts at zero are fitted about
each crossing. The same at crossings of other counts, whose cells are one pulse wide, tells what no
step looks like in this log; with two neighbouring cells merged, a step of `fix`. So the log is its
own yardstick, whatever its motion and its noise.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.quantisation import STEP_NOTE
from plant.checkup.signals import Signals

# Rows to each side of a crossing, and degree of the polynomial in time: the pair that tells most is
# taken.
_WINDOWS = tuple((half, degree) for half in (10, 20, 40, 80) for degree in (3, 5, 7))

# crossings of other counts that are fitted, at most; fewer tell nothing
_MOST = 300
_FEW = 20

# Probability from which on a convention is seen; standard deviations from both at which it is
# neither.
_SURE = 0.95
_NEITHER = 4.0

_MOST_ODDS = 100.0  # logarithm of odds beyond which it makes no difference

# windows whose standard deviation is at most so many times that of the best one tell the same
_COMPARABLE = 3.0

# Factor within which other counts are passed at the speeds at which zero is; and counts per row
# that pass nothing.
_ALIKE = 2.0
_SLOW = 0.05


def rounding_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the finding about the convention of the counters, of all joints together."""
    stated = signals.rig.encoder.rounding
    scaled = any(STEP_NOTE.format(i) in (signals.record.notes or {}) for i in range(signals.n))
    seen = None if signals.rig.encoder.smooth or scaled else fix_seen(signals)
    if seen is None:
        why = (
            "the encoder is said not to round"
            if signals.rig.encoder.smooth
            else "no joint passes zero clearly"
        )
        why = "the positions are not in whole pulses" if scaled else why
        yield Finding.unknown("rounding", None, f"{why}; {stated} is stated")
        return
    share = 100 * seen
    if 1 - _SURE < seen < _SURE:
        yield Finding.unknown(
            "rounding", None, f"{stated} is stated, fix to {share:.0f} %", value=share, unit="% fix"
        )
    elif (seen > 0.5) == (stated == "fix"):
        yield Finding.of("rounding", None, share, "% fix")
    else:
        shown = (
            'a cell two pulses wide at zero: Encoder(rounding="fix") (probability'
            f" {min(seen, 0.999):.1%})"
        )
        if seen < 0.5:
            shown = (
                'no wide cell at zero: Encoder(rounding="floor"), or "round" (probability'
                f" {min(1 - seen, 0.999):.1%})"
            )
        advice = f"The counts show {shown}, not {stated!r} as stated."
        yield Finding.of("rounding", None, share, "% fix", "wrong", advice)


def rounding_doubts(record: Any) -> list[str]:
    """A line if the counts of a record contradict the stated convention, or none."""
    return [finding.advice for finding in rounding_findings(Signals(record)) if not finding.ok]


def fix_seen(signals: Signals) -> float | None:
    """Probability (0 to 1) that the counts are rounded towards zero; None where the log does not
    tell.
    """
    if not signals.long_enough:
        return None
    torque = signals.motor_torque
    if torque is None and signals.reference is not None:
        torque = signals.reference - signals.counts
    torque = np.zeros((len(signals.t), 1)) if torque is None else torque
    rows = np.flatnonzero(signals.record.valid > 0)
    # rows without weight on straight lines: the windows are of rows in turn
    every = np.arange(rows[0], rows[-1] + 1)
    counts, torques = (
        [np.interp(every, rows, x) for x in table.T] for table in (signals.counts, torque)
    )
    counts = [np.where(np.isin(every, rows), x, np.round(x)) for x in counts]
    forces = np.column_stack([x / max(np.std(x), 1e-300) for x in torques])
    odds = [odds for x in counts if (odds := _odds(x, forces)) is not None]
    return float(1 / (1 + np.exp(-np.clip(sum(odds), -_MOST_ODDS, _MOST_ODDS)))) if odds else None


def _odds(counts, forces):
    """Logarithm of the odds of `fix`, of counts (M,) of a joint under forces (M, k); None: not
    to be told.
    """
    tried = [each for window in _WINDOWS if (each := _step(counts, forces, *window)) is not None]
    if (counts != np.round(counts)).any() or not tried:
        return None
    value, none, wide, std = np.array(tried).T
    width = np.maximum(wide - none, 1e-9)
    # of a wide cell's step
    share = (value - none) / width
    std = std / width
    best = np.argmin(std)
    near = share[std < _COMPARABLE * std[best]]
    spread = np.hypot(
        std[best], np.sqrt(np.mean((near - share[best]) ** 2))
    )  # what windows of other lengths make of it
    off = np.abs(share[best] - np.array([0, 1])) / spread
    return None if off.min() > _NEITHER else float(off[0] ** 2 - off[1] ** 2) / 2


def _step(counts, forces, half, degree):
    """Mean step at zero; what it is without a wide cell, and with one; standard deviation of it.
    None: no crossings.
    """
    if len(counts) < 4 * half:
        return None
    speed = np.pad(np.abs(counts[2 * half :] - counts[: -2 * half]) / (2 * half), half)
    at_zero = np.flatnonzero(np.diff(counts >= 0) & (speed[1:] > _SLOW))
    at_zero = at_zero[np.diff(at_zero, prepend=-half) >= half]
    if not len(at_zero):
        return None
    alike = (
        (speed >= speed[at_zero].min() / _ALIKE)
        & (speed <= speed[at_zero].max() * _ALIKE)
        & (speed > _SLOW)
    )
    away = np.abs(counts) > 2 * half * np.maximum(speed, 1)  # a wide cell would spoil it
    others = np.flatnonzero((alike & away)[:-1] & (np.diff(counts) != 0))
    others = others[:: max(1, len(others) // _MOST)]
    if len(others) < _FEW:
        return None
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, 2 * half), degree + 1))
    levels = np.maximum(counts[others], counts[others + 1])
    off = np.arange(1 - half, half + 1)
    windows = counts[others[:, None] + off] - levels[:, None]
    passed = counts[at_zero[:, None] + off]
    moved = [
        np.cumsum(np.cumsum(forces[rows[:, None] + off], axis=1), axis=1)
        for rows in (others, at_zero)
    ]
    apart = moved[0].swapaxes(1, 2)
    apart = (apart - apart @ basis @ basis.T).swapaxes(1, 2).reshape(-1, forces.shape[1])
    gain = np.linalg.lstsq(apart, (windows - windows @ basis @ basis.T).ravel(), rcond=None)[0]
    found, weight = _fitted(passed - moved[1] @ gain, basis, passed)
    means = []
    scale = 0.0
    # as they are; the cell at the level merged with the one below
    for window in (windows, windows + (windows < 0)):
        sizes, weights = _fitted(window - moved[0] @ gain, basis, window)
        means.append(float(np.average(sizes, weights=weights)))
        scale = max(scale, 1.4826 * float(np.median(np.abs(sizes - means[-1]) * np.sqrt(weights))))
    return float(np.average(found, weights=weight)), *means, scale / np.sqrt(weight.sum())


def _fitted(windows, basis, counts):
    """Steps where counts pass zero (K,) in windows (K, 2 half) beside a polynomial, in that of
    `fix`; their weights.
    """
    step = -0.5 * np.sign(counts)
    apart = step - (step @ basis) @ basis.T
    weight = np.maximum((apart**2).sum(axis=1), 1e-9)
    return (apart * windows).sum(axis=1) / weight, weight
