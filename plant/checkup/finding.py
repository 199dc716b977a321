"""What an examination of a record found: one finding per check and joint, and the table of all of them."""

from __future__ import annotations

import dataclasses

__all__ = ["Checkup", "Finding"]

_ROUNDING = 1e-9
"""Printed as 0."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of a checkup.

    Attributes
    ----------
    check : str
        What was looked at.
    joint : int or None
        Joint (or motor) from 0; None for the whole record.
    value : float or None
        What was measured, in `unit`; None where nothing could be.
    unit : str
    verdict : str
        "fine", "look", "wrong", or "cannot tell: " and why.
    advice : str
        What to do, one sentence; empty where there is nothing to do.
    """

    check: str
    joint: int | None
    value: float | None
    unit: str
    verdict: str
    advice: str = ""

    @classmethod
    def graded(cls, check, joint, value, unit, *, look, wrong=float("inf"), advice):
        """Judge the size of a value: fine up to `look`, wrong above `wrong`."""
        size = abs(value)
        verdict = "wrong" if size > wrong else "look" if size > look else "fine"
        return cls(check=check, joint=joint, value=float(value), unit=unit, verdict=verdict,
                   advice="" if verdict == "fine" else advice)  # fmt: skip

    @classmethod
    def unknown(cls, check, joint, why, *, value=None, unit=""):
        """A check that this record does not allow."""
        value = None if value is None else float(value)
        return cls(check=check, joint=joint, value=value, unit=unit, verdict=f"cannot tell: {why}")

    @property
    def ok(self):
        """Whether there is nothing to do: fine, or not to be told."""
        return self.verdict not in ("look", "wrong")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Checkup:
    """All findings about a record; printed, a table.

    Attributes
    ----------
    findings : tuple of Finding
    """

    findings: tuple

    @property
    def ok(self):
        """Whether no check says "look" or "wrong"."""
        return not self.troubles

    @property
    def troubles(self):
        """The findings that say "look" or "wrong"."""
        return tuple(finding for finding in self.findings if not finding.ok)

    def __repr__(self):
        words = [finding.verdict.partition(":")[0] for finding in self.findings]
        counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
        return f"Checkup({counts})"

    def __str__(self):
        """Name, joint, number, verdict and advice; joints about which the same is said share a line."""
        rows = [("check", "joint", "measured", "verdict", "what to do")]
        groups = {}
        for finding in self.findings:
            own = finding.joint if not finding.ok else None
            groups.setdefault((finding.check, finding.verdict, finding.unit, own), []).append(finding)
        for (name, verdict, unit, _), group in groups.items():
            joints = _joints([finding.joint for finding in group])
            values = [finding.value for finding in group if finding.value is not None]
            rows.append((name, joints, _measured(values, unit), verdict, group[0].advice))
        widths = [max(len(row[i]) for row in rows if i < 3 or len(row[i]) < 10) for i in range(4)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)) for row in rows]
        return "\n".join(
            (f"{line}  {row[4]}" if row[4] else line).rstrip() for line, row in zip(lines, rows, strict=True)
        )


def _joints(joints):
    if joints[0] is None:
        return "-"
    return str(joints[0]) if len(joints) == 1 else ", ".join(map(str, joints))


def _measured(values, unit):
    if not values:
        return ""
    low, high = (f"{0.0 if abs(value) < _ROUNDING else value:.4g}" for value in (min(values), max(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
