"""What a user should know before trusting what an identification found, one line each."""

from __future__ import annotations

import numpy as np

__all__ = ["warnings_of"]

_AT_END = 0.002
"""Share of a range within which a value lies at its end."""

_STRANGE = 0.4
"""Scatter [pulses] that rounding does not explain."""

_LATE = 0.02
"""Delay [samples] that matters."""

_FAR = 0.9
"""Difference [pulses] between simulated and measured errors that rounding does not explain."""

_WORSE = 1.5
"""How much worse a record kept aside may be repeated."""

_BIASED = 0.08
"""Share by which least squares may miss f in a band."""

_INSEPARABLE = 0.995
"""Correlation above which two unknowns are one."""

_TURNED = 0.49
"""Zero of a counter [rad] beyond which it is at the end of what is searched."""


def warnings_of(found):
    """Lines (list of str) about an `Identification`."""
    replayed = any(record.law.replays for record in found.records)
    return [
        *([] if found.trouble is None else [f"{found.trouble}."]),
        *_ends(found),
        *(_of_torques(found) if replayed else []),
        *_of_fit(found, replayed),
        *(_of_timing(found) if not replayed else []),
        *_of_repeats(found, replayed),
        *_of_pairs(found),
    ]


def _ends(found):
    if found.ranges is None:
        return
    for name, value, (low, high) in zip(found.unknown, found.values, found.ranges, strict=True):
        if low < high and min(value - low, high - value) < _AT_END * (high - low):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} end of its range; widen it."


def _of_torques(found):
    """Least squares in its bands, against what repeats the motion; zeros."""
    right = [band for band, share in found.bands.items() if abs(share - 1) < _BIASED]
    if found.bands and not right:
        yield (
            "least squares on these torques agrees in no band with what repeats the motion; ask record.check() for "
            "order, signs and units of torques and positions."
        )
    elif any(band > max(right) for band in found.bands):
        small = ", ".join(f"{share:.2f} at {band:.3g}" for band, share in found.bands.items() if band > max(right))
        yield (
            f"least squares on these torques is biased in bands above {max(right):.3g} Hz: it finds {small} Hz of what "
            "repeats the motion."
        )
    if found.zeros is not None and np.abs(found.zeros).max() > _TURNED:
        yield "a counter's zero ends half a radian away; was it set to zero at the start of the run?"


def _of_fit(found, replayed):
    if found.scatter is not None and found.scatter > _STRANGE:
        reason = "Was it made with this rig, law and reference?"
        if replayed:
            reason = "The rest is what it lacks (backlash, elasticity, changing friction), or a wrong rig."
        yield f"the model follows the log no closer than {found.scatter:.2f} pulses (rounding alone: 0.29). {reason}"


def _of_timing(found):
    if abs(found.delay) > max(_LATE, 3 * found.delay_std):
        yield (
            f"the counts are {abs(found.delay):.2f} samples {'late' if found.delay > 0 else 'early'}, which ruins f. "
            f"Identify without_delay(record, {found.delay:.3g}) and compare."
        )
    absorbing = [name for name in found.unknown if name.startswith(("drive.viscous", "law.gain"))]
    if absorbing:
        yield f"a delay of the log cannot be told from {', '.join(absorbing)}; be sure of the timing."


def _of_repeats(found, replayed):
    if not np.isfinite(found.difference):
        yield "the arm cannot repeat the record in a simulation: it diverges, or D(q) is no arm's."
    elif found.difference > _FAR and not replayed:
        yield (
            f"simulated and measured errors differ by {found.difference:.2f} pulses (rms); two roundings alone give "
            "0.58. Check signs (error = reference minus counted), friction, gains, gears, the order of joints."
        )
    if found.held_out_difference is not None and found.held_out_difference > _WORSE * found.difference:
        yield (
            f"a record kept aside differs by {found.held_out_difference:.2f} pulses, those searched by "
            f"{found.difference:.2f}: the values do not hold for both."
        )


def _of_pairs(found):
    if found.covariance is None:
        return
    for i, j in np.argwhere(np.triu(np.abs(found.correlation) > _INSEPARABLE, 1)):
        yield f"{found.unknown[i]} and {found.unknown[j]} show together only; fix one of them."
