"""Torque that a law without memory commanded in the course of a log."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["commanded_torque"]


def commanded_torque(record: Any) -> NDArray[np.float64] | None:
    """Commanded torques (N, n) [N m] of a record under a law without memory, before the limit; None for other laws."""
    law, rig = record.law, record.rig
    if law is None or law.replays or law.has_memory(record.n):
        return None
    N, zero = len(record), np.zeros((record.n, len(record)))
    block = law.block(rig)
    asked, _ = block.step.map(N)(
        np.empty((0, N)), zero, zero, zero, record.reference_pulses.T, record.counts.T, zero,
        np.full((1, N), rig.period), np.repeat(block.values[:, None], N, axis=1),
    )  # fmt: skip
    return asked.full().T
