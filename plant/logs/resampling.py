"""A record resampled at uniform times: interpolated counts, mean torques, no weight where
nothing was logged.
"""

import dataclasses
from typing import Any

import numpy as np

from plant.parts.fields import Floats

_GAP = 1.5  # nominal intervals
_FACTOR = 20  # between the new period and the nominal interval
_MOST = 1 << 25  # samples


def resampled_fields(record: Any, period: float) -> dict[str, Any]:
    """Fields of `Record.resampled`."""
    t = record.t
    nominal = float(np.median(np.diff(t))) if len(t) > 1 else period
    if not nominal / _FACTOR <= period <= nominal * _FACTOR:
        got = f"got {period:g} s, and the log's interval is {nominal:g} s"
        raise ValueError(f"period must be within {_FACTOR} times the log's; {got}. Give seconds.")
    if (t[-1] - t[0]) / period > _MOST:
        raise ValueError(
            f"period must give at most {_MOST} samples; got {period:g} s. Give seconds."
        )
    new = t[0] + period * np.arange(int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1)
    left = np.clip(np.searchsorted(t, new, side="right") - 1, 0, len(t) - 1)
    right = np.minimum(left + 1, len(t) - 1)
    step = np.diff(t, append=np.inf)[left]
    share = np.clip((new - t[left]) / step, 0, 1)
    # at a sample, within rounding
    share = np.where(share < 1e-9, 0.0, np.where(share > 1 - 1e-9, 1.0, share))

    gap = np.diff(t, append=t[-1]) > _GAP * nominal

    def between(value: Floats) -> Floats:
        return value[left] + share[:, None] * (value[right] - value[left])

    weight = np.where(
        share == 0, record.valid[left], np.where(share == 1, record.valid[right], 0.0)
    )
    inside = (share > 0) & (share < 1) & ~gap[left]
    weight[inside] = np.minimum(record.valid[left], record.valid[right])[inside]
    reference = np.round(between(record.reference_pulses))
    fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    fields |= {"t": new, "valid": weight, "rig": dataclasses.replace(record.rig, period=period)}
    fields |= {
        "reference_pulses": reference,
        "error_pulses": reference - np.round(between(record.counts)),
    }
    fields |= {
        n: between(fields[n]) for n in ("link_counts", "true_q", "true_qd") if fields[n] is not None
    }
    torques = [name for name in ("torque", "current", "injected") if fields[name] is not None]
    fields |= {name: _means(t, fields[name], gap, new, period) for name in torques}
    return fields


def _means(t, value, gap, new, period):
    """Means over each new period of a zero-order hold; across gaps, of a straight line."""
    edges = np.union1d(t, np.append(new, new[-1] + period))
    edges = edges[edges <= new[-1] + period]
    middle = (edges[1:] + edges[:-1]) / 2
    lengths = np.diff(edges)[:, None]
    row = np.searchsorted(t, middle, side="right") - 1
    following = np.minimum(row + 1, len(t) - 1)
    share = np.where(gap[row], (middle - t[row]) / np.diff(t, append=np.inf)[row], 0.0)
    pieces = value[row] + share[:, None] * (value[following] - value[row])
    first = np.searchsorted(edges, new)
    return np.add.reduceat(pieces * lengths, first) / np.add.reduceat(lengths, first)
