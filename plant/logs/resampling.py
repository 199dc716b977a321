"""A record at uniform times: interpolated counts, and no weight where nothing was logged."""

from __future__ import annotations

import dataclasses

import numpy as np

__all__ = ["resampled_fields"]

_GAP = 1.5  # nominal intervals
_MOST = 1 << 25  # samples


def resampled_fields(record, period):
    """Fields of `Record.resampled`.

    Raises
    ------
    ValueError
        A period so short that it must be in another unit.
    """
    t = record.t
    if (t[-1] - t[0]) / period > _MOST:
        raise ValueError(f"period must give at most {_MOST} samples; got {period:g} s. Give seconds.")
    new = t[0] + period * np.arange(int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1)
    left = np.clip(np.searchsorted(t, new, side="right") - 1, 0, len(t) - 1)
    right = np.minimum(left + 1, len(t) - 1)
    step = np.diff(t, append=np.inf)[left]
    share = np.clip((new - t[left]) / step, 0, 1)
    share = np.where(share < 1e-9, 0.0, np.where(share > 1 - 1e-9, 1.0, share))  # at a sample, within rounding

    def between(value):
        return value[left] + share[:, None] * (value[right] - value[left])

    weight = np.where(share == 0, record.valid[left], np.where(share == 1, record.valid[right], 0.0))
    inside = (share > 0) & (share < 1) & (step <= _GAP * (np.median(np.diff(t)) if len(t) > 1 else 0.0))
    weight[inside] = np.minimum(record.valid[left], record.valid[right])[inside]
    reference = np.round(between(record.reference_pulses))
    fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    fields |= {"t": new, "valid": weight, "rig": dataclasses.replace(record.rig, period=period)}
    fields |= {"reference_pulses": reference, "error_pulses": reference - np.round(between(record.counts))}
    fields |= {n: between(fields[n]) for n in ("torque", "current", "true_q", "true_qd") if fields[n] is not None}
    return fields
