"""The step of logged angles that are whole counts of another gear or encoder than stated."""

import numpy as np
from numpy.typing import NDArray

from plant.checkup.quantisation import STEP_NOTE
from plant.logs.units import Unit, factors
from plant.machine.rig import Rig
from plant.parts.fields import Floats

_LEVELS, _CLEAN = 50, 0.05  # different angles that tell; and share of a step by which each may be off its multiple

# Pulses about a whole one that tell no other gear; factor of it, at most; and distance of the logarithm of a step to a
# power of ten, of radians or degrees, at which decimals were cut.
_NEAR, _FACTOR, _DECIMAL = 0.02, 5.0, 1e-3


def own_steps(field: str, value: Floats, unit: Unit, rig: Rig) -> dict[str, float]:
    """Notes of joints whose positions (N, n) are clean multiples of one step that is no whole pulse [pulses]."""
    place = rig.encoder.position_in_pulses if "motor" in field else rig.position_in_pulses
    notes, pulses = dict[str, float](), np.abs(np.diagonal(place(np.eye(rig.n) * factors(unit))))
    for i in range(0 if rig.encoder.smooth else rig.n):
        step = _clean_step(value[:, i])
        share = step * pulses[i]
        decimals = np.log10(max(step, 1e-300) * np.array((1, np.pi / 180, 180 / np.pi)))
        off = np.abs(share - np.round(share)) > _NEAR and 1 / _FACTOR < share < _FACTOR
        if off and np.abs(decimals - np.round(decimals)).min() > _DECIMAL:
            notes[STEP_NOTE.format(i)] = float(share)
    return notes


def _clean_step(value: NDArray[np.float64]) -> float:
    """The step of which all values (N,) are multiples apart, or 0."""
    levels = np.unique(value[np.isfinite(value)])
    if len(levels) < _LEVELS:
        return 0.0
    apart = np.diff(levels)
    apart = apart[apart > _CLEAN * np.median(apart)]  # the rest is one level, written in other last digits
    # The cell at zero of `fix` is two wide: its neighbours' centres are half a step further.
    halves = np.round(2 * apart / apart.min())
    step, off = float(2 * apart.sum() / halves.sum()), 2 * (levels - levels[0])
    return step if np.abs(off / step - np.round(off / step)).max() < _CLEAN else 0.0
