"""Torque that a law without memory commanded in the course of a log."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_AT_ONCE = 1 << 14
"""Samples that are worked out at once."""


def commanded_torque(record: Any) -> NDArray[np.float64] | None:
    """Commanded torques (N, n) [N m] of a record under a law without memory, before the limit; None for other laws."""
    law, rig = record.law, record.rig
    if law is None or law.replays or law.has_memory(record.n):
        return None
    block, counts, found = law.block(rig), record.counts, np.empty((len(record), record.n))
    for start in range(0, len(record), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        count = len(found[rows])
        zero = np.zeros((record.n, count))
        asked, _ = block.step.map(count)(
            np.empty((0, count)), zero, zero, zero, record.reference_pulses[rows].T, counts[rows].T, zero,
            np.full((1, count), rig.period), np.repeat(block.values[:, None], count, axis=1),
        )  # fmt: skip
        found[rows] = asked.full().T
    return found
