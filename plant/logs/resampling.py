"""Resampling of a record at uniform times: interpolated counts, mean torques, weightless gaps."""

import dataclasses
from typing import Any

import numpy as np

from plant.checkup import SETTINGS as MOTION
from plant.checkup import longest_line
from plant.parts import Floats, frozen_settings


@frozen_settings
class ResamplingSettings:
    """Limits of resampling; all chosen by hand.

    Parameters
    ----------
    max_ratio : int
        Largest ratio of the new period and the nominal interval, in either direction.
    max_samples : int
        Largest number of new samples.
    """

    max_ratio: int = 20
    max_samples: int = 1 << 25


SETTINGS = ResamplingSettings()


def resampled_fields(record: Any, period: float) -> dict[str, Any]:
    """Fields of `Record.resampled`."""
    t = record.t
    # The median is the nominal interval of a log with gaps.
    nominal = float(np.median(np.diff(t))) if len(t) > 1 else period
    if not nominal / SETTINGS.max_ratio <= period <= nominal * SETTINGS.max_ratio:
        got = f"got {period:g} s, and the log's interval is {nominal:g} s"
        raise ValueError(
            f"period must be within {SETTINGS.max_ratio} times the log's; {got}. Give seconds."
        )
    if (t[-1] - t[0]) / period > SETTINGS.max_samples:
        raise ValueError(
            f"period must give at most {SETTINGS.max_samples} samples; got {period:g} s. Give"
            " seconds."
        )
    # The factor 1 + 1e-12 keeps the final sample of a duration of whole periods in spite of
    # rounding.
    times = t[0] + period * np.arange(int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1)
    # 1. The old samples around each new one, and its fraction of the interval between them.
    earlier = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)
    later = np.minimum(earlier + 1, len(t) - 1)
    step = np.diff(t, append=np.inf)[earlier]
    share = np.clip((times - t[earlier]) / step, 0, 1)
    # at a sample, within rounding
    share = np.where(share < 1e-9, 0.0, np.where(share > 1 - 1e-9, 1.0, share))

    steps = np.diff(t, append=t[-1])
    # A torque was held up to here; across longer steps it changes along a line.
    long = steps > MOTION.late * nominal
    # Late stamps lose nothing of a slow motion.
    gap = steps > longest_line(t, record.counts)

    def between(value: Floats) -> Floats:
        return value[earlier] + share[:, None] * (value[later] - value[earlier])

    # 2. Weights: at an old sample its own, between two the smaller one, in a gap 0, because nothing
    # was measured there.
    weight = np.where(
        share == 0, record.valid[earlier], np.where(share == 1, record.valid[later], 0.0)
    )
    inside = (share > 0) & (share < 1) & ~gap[earlier]
    weight[inside] = np.minimum(record.valid[earlier], record.valid[later])[inside]
    # 3. Signals. Reference and counts are rounded separately, so that the error is a whole number
    # of pulses, as in a controller.
    rounded = np.asarray if record.rig.encoder.smooth else np.round
    commanded = between(record.reference_pulses)
    if record.reference is not None and record.reference.held:
        # The goal of the row before, and whatever was sent since.
        sent, before = (
            record.rig.counts(record.reference(at - t[0]).q) for at in (times, t[earlier])
        )
        commanded = record.reference_pulses[earlier] + sent - before
    reference = rounded(commanded)
    fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    fields |= {"t": times, "valid": weight, "rig": dataclasses.replace(record.rig, period=period)}
    fields |= {
        "reference_pulses": reference,
        "error_pulses": reference - rounded(between(record.counts)),
    }
    fields |= {
        n: between(fields[n]) for n in ("link_counts", "true_q", "true_qd") if fields[n] is not None
    }
    # Torques act throughout a period: means preserve their impulse, samples would not.
    torques = [name for name in ("torque", "current", "injected") if fields[name] is not None]
    fields |= {name: _means(t, fields[name], long, times, period) for name in torques}
    return fields


def _means(t, value, long, times, period):
    """Means over each new period of a zero-order hold; across long steps, of a straight line."""
    # Between neighbouring instants, old or new, the torque is constant, or linear in a long step.
    edges = np.union1d(t, np.append(times, times[-1] + period))
    edges = edges[edges <= times[-1] + period]
    # The value at the middle times the length is the exact integral of such a piece.
    middle = (edges[1:] + edges[:-1]) / 2
    lengths = np.diff(edges)[:, None]
    row = np.searchsorted(t, middle, side="right") - 1
    following = np.minimum(row + 1, len(t) - 1)
    share = np.where(long[row], (middle - t[row]) / np.diff(t, append=np.inf)[row], 0.0)
    pieces = value[row] + share[:, None] * (value[following] - value[row])
    starts = np.searchsorted(edges, times)
    return np.add.reduceat(pieces * lengths, starts) / np.add.reduceat(lengths, starts)
