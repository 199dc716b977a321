"""What a certificate says in words: its verdict, what was drawn, and what was not."""

from __future__ import annotations

import math
from typing import Any

from ctc.certification.identified import Identified
from ctc.certification.imperfections import IMPERFECTIONS
from plant import Rig

__all__ = ["percent", "statement", "verdict"]

_MOST = 0.5
"""Share of plants that leave beyond which nothing is said of the nominal one."""


def statement(uncertainty: Any, rig: Rig, known: Identified) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is drawn of an `Uncertainty` with these identified numbers, and what is not."""
    u, gears, drive = uncertainty, uncertainty.gears, rig.drive
    drawn, left = [], []
    identified = [name for name in known.names if name.startswith(("drive.viscous", "drive.coulomb"))]
    friction = "friction that was not identified" if identified else "friction"
    if u.plants is not None:
        drawn.append("f of given arms")
    elif known.refits is not None:
        drawn.append(f"what the log says on gears of {len(known.refits.places)} resonances of the range")
    elif known.names:
        drawn.append("what was identified")
    if gears.resonance is not None:
        alike = "all joints alike" if len(gears.resonance) == 1 else "of each joint"
        hz = ", ".join(f"{low:g} to {high:g}" for low, high in gears.resonance)
        drawn.append(f"resonance {hz} Hz ({alike}), damping ratio {_range(gears.damping_ratio)}")
    else:
        left.append("elasticity" if drive.elasticity is None else "resonance (as the rig has it)")
    for there, said, name in (
        (u.friction > 0, f"{friction} ±{100 * u.friction:g} % (standard deviation)", "friction"),
        (u.load[1] > 0, f"load {_range(u.load)} kg", "load"),
        (u.phase, "encoder zeros", "encoder zeros"),
        (u.delay[1] > 0, f"delay {_range(u.delay)} s", "delay"),
        (u.dropped > 0, f"lost counts {100 * u.dropped:g} %", "lost counts"),
    ):
        if name == "friction" and len(identified) == 2 * rig.n:
            continue  # drawn with all that was identified
        if there:
            drawn.append(said)
        else:
            left.append(name)
    for name, row in IMPERFECTIONS.items():
        ends = gears.imperfections.get(name, (0.0, 0.0))
        if any(ends):
            drawn.append(f"{row.words} {_range(ends)} {row.unit}")
        else:
            left.append(row.words if row.own(rig) is None else f"{row.words} (as the rig has it)")
    return tuple(drawn), tuple(left)


def _range(ends: Any) -> str:
    return f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g} to {ends[1]:g}"


def verdict(certificate: Any) -> str:
    """What a `Certificate` found, and on which gears it holds."""
    count, within = f"{len(certificate.plants):,} possible plants", certificate.within
    limit = f"±{within:g} pulse{'s' * (within != 1)}"
    sure, bound = f"with {100 * certificate.confidence:g} % confidence", percent(certificate.upper, up=True)
    cell, gears = certificate.worst_cell, certificate.on_gears
    of = "of all would" if cell is None else f"would at the worst resonance ({cell})"
    if certificate.failures:
        share = percent(certificate.probability)
        sentence = f"{share} of {count} leave {limit} at some sample; {sure}, at most {bound} {of}."
        if bound == percent(1.0):  # is no bound
            sentence = f"{share} of {count} leave {limit} at some sample{_worst(cell)}."
    elif bound == percent(1.0):
        sentence = f"None of {count} leaves {limit}{_worst(cell)}."
    else:
        sentence = f"None of {count} leaves {limit}; {sure}, fewer than {bound} {of}."
    if gears is None:
        return sentence
    if certificate.probability > _MOST:
        return f"{sentence} Rigid gears assumed."
    stated = certificate.plants.ranges.imperfections
    worst = {name: max(stated.get(name, (0.0,)), key=abs) for name in IMPERFECTIONS}
    rows = [(IMPERFECTIONS[name], value) for name, value in worst.items() if value]
    there = [f"{row.words} {value:g} {row.unit}" for row, value in rows]
    beside = f", with {', '.join(there)}," if there else ""
    return f"{sentence} Rigid gears assumed; the nominal arm{beside} {gears}."


def _worst(cell: Any) -> str:
    """What is said of the worst part of the resonances where there is no bound."""
    if cell is None:
        return ""
    do = f"{cell.failures} of {cell.count} do" if cell.count else "none was drawn, so nothing is said of it"
    return f"; at the worst resonance ({cell}) {do}"


def percent(share: float, up: bool = False) -> str:
    """A probability as text, with two digits that count, or three; a bound is rounded up."""
    percent = 100 * share
    if percent > 0:
        step = 10.0 ** min(math.floor(math.log10(percent)) - 1, -1)
        percent = step * (math.ceil(percent / step - 1e-9) if up else round(percent / step))
    return f"{percent:.3g} %"
