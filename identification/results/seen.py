"""What the logs of an identification show, and where a path leaves it."""

import dataclasses
from typing import Any

import numpy as np

from plant import Record, Reference
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept

_BEYOND = 0.1  # share of a log's range, or of its largest speed, by which a path may leave it

_POINTS = 1000  # instants of a path at which it is looked at

APART = 20
"""Samples from one position to the next for a speed."""


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Seen(Frozen):
    """What the searched logs show, beside a path.

    Attributes
    ----------
    resonance : float or None
        Gears of any joint that resonate below this would have contradicted the log [Hz]; None where that was not
        tested, or gears are elastic already.
    beyond : tuple of str
        Where the path leaves angles and speeds of the logs, a joint each.
    """

    resonance: float | None
    beyond: tuple[str, ...]


def seen(found: Any, reference: Reference, duration: float) -> Seen:
    """What the logs of an `Identification` show, beside so many seconds of a path."""
    return Seen(resonance=_resonance(found), beyond=tuple(_beyond(found, reference, duration)))


def _resonance(found: Any) -> float | None:
    """Lowest of the joints' resonances below which compliance would have been seen."""
    detection = found.diagnostics.detection
    visible = [sign.visible for sign in detection.signs if sign.name == "compliance" and not sign.significant]
    if detection.reason is not None or not visible or not visible[0]:
        return None
    return float(min(value**-0.5 for value in visible[0].values()))


def _beyond(found: Any, reference: Reference, duration: float) -> list[str]:
    logged = [motion_of(record) for record in found.records]
    low = np.min([q.min(axis=0) for q, _ in logged], axis=0)
    high = np.max([q.max(axis=0) for q, _ in logged], axis=0)
    fastest = np.max([np.abs(qd).max(axis=0) for _, qd in logged], axis=0)
    path, lines = reference(np.linspace(0.0, duration, _POINTS)), []
    room = _BEYOND * (high - low)
    chain = found.arm.dynamics.chain
    for i, (link, label) in enumerate(zip(chain.links, chain.joint_labels, strict=True)):
        unit = "m" if link.prismatic else "rad"
        first, last, speed = path.q[:, i].min(), path.q[:, i].max(), np.abs(path.qd[:, i]).max()
        said = []
        if first < low[i] - room[i] or last > high[i] + room[i]:
            said.append(f"{first:z.2f} to {last:z.2f} {unit} (log: {low[i]:z.2f} to {high[i]:z.2f})")
        if speed > (1 + _BEYOND) * fastest[i]:
            said.append(f"{speed:.2g} {unit}/s (log: {fastest[i]:.2g})")
        if said:
            lines.append(f"{label} {' and '.join(said)}")
    return lines


def motion_of(record: Record) -> tuple[Floats, Floats]:
    """Positions (N, n) and speeds (M, n) of a log, from its counts."""
    q = record.rig.to_angle(record.counts)
    every = slice(None, None, min(APART, len(q) - 1))
    return q, np.diff(q[every], axis=0) / np.diff(record.t[every])[:, None]
