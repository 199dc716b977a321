"""What an identification shows: values, intervals, what contradicts the model, what was assumed."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from identification.results.doubts import doubts
from plant.parts.shown import Aside, Piece, Verdict, Warned, inside
from plant.parts.tables import Table


def said_of(found: Any) -> Iterator[Piece]:
    """Of an `Identification`: its verdict, each value with its interval, what was tested, what was assumed."""
    doubtful = len(doubts(found))
    count = f"{doubtful} warning{'s' * (doubtful > 1)}"
    clear = "Nothing in the log contradicts what was stated."
    yield Verdict(f"In doubt: {count}, below." if doubtful else clear, not doubtful)
    yield f"{found.search.method}, {len(found.records)} record(s): {found.message}"
    if found.held_out:
        named = ", ".join(record.name or f"a record of {len(record)} samples" for record in found.held_out)
        yield f"kept aside, and only repeated: {named}"
    yield _values(found)
    yield from inside(found.diagnostics)
    if found.fit.noise_covariance is not None:
        yield f"intervals count noise and {found.search.tolerances}"
    if found.covariance is not None and found.diagnostics.detection.assumed:
        yield from inside(found.assumed())
    if any(_torque_of_law(record) for record in found.records):
        yield (
            "the torque is the stated law's, none was logged: if all its gains are 1 % larger, f is 1 % larger, and "
            "friction that is unknown"
        )
    if found.fit.resonance is not None:
        yield from inside(found.fit.resonance)
    yield Warned(found.warnings)
    yield Aside("What the parameters mean", found.arm.dynamics.legend.splitlines())


def _torque_of_law(record: Any) -> bool:
    """Whether nothing but the law says with which torque an arm was moved, a law whose gains are not told apart."""
    logged = record.torque is not None or record.current is not None
    return not logged and record.law is not None and not record.law.replays and record.law.has_memory(record.n)


def _values(found: Any) -> Table:
    names, values = found.short_names, [f"{value:.5g}" for value in found.fit.values]
    if found.covariance is None:
        return Table(("", "value"), list(zip(names, values, strict=True)))
    try:
        bounds = np.full(len(values), np.nan) if found.fit.resumptions else found.bound()
    except ValueError:  # no reference, or numbers that are not separately identifiable
        bounds = np.full(len(values), np.nan)
    others, rows = found.fit.correlation - np.eye(len(values)), list[tuple[str, ...]]()
    for i, (value, std) in enumerate(zip(found.fit.values, found.fit.std, strict=True)):
        if not std > 0:
            said = "bounded" if found.fit.resonance is not None and found.fit.resonance.bounds(names[i]) else "known"
            rows.append((names[i], values[i], said, "", "", ""))
            continue
        most = int(np.argmax(np.abs(others[i])))
        interval = f"[{value - 1.96 * std:.5g}, {value + 1.96 * std:.5g}]"
        together = f"{names[most]} ({others[i, most]:+.2f})"
        rows.append((names[i], values[i], f"{std:.2g}", f"{bounds[i]:.2g}", interval, together))
    head: tuple[str, ...] = ("", "value", "std", "bound", "95 % interval", "largest correlation")
    if not np.isfinite(bounds).all():
        head, rows = head[:3] + head[4:], [row[:3] + row[4:] for row in rows]
    return Table(head, rows, words=(len(head) - 1,))
