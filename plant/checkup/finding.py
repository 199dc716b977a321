"""Findings of a checkup: one per check and joint, and the table of all of them."""

from __future__ import annotations

import dataclasses
from typing import Any

from plant.parts.labels import joint_label

__all__ = ["Checkup", "Finding"]

_ROUNDING = 1e-9
"""Printed as 0."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of a checkup.

    Attributes
    ----------
    check : str
        What was checked.
    joint : int or None
        Place of the joint (or motor) in q, from 0; None for the whole record.
    value : float or None
        What was measured, in `unit`; None where nothing could be.
    unit : str
    verdict : str
        "fine", "look", "wrong", or "cannot tell: " and why.
    advice : str
        What to do, one sentence; empty where there is nothing to do.

    See Also
    --------
    plant.Checkup

    Examples
    --------
    >>> from plant import Finding
    >>> Finding.graded("peak error", 0, 3.0, "pulses", look=2.0, wrong=10.0, advice="Lower the gain.").verdict
    'look'
    """

    check: str
    joint: int | None
    value: float | None
    unit: str
    verdict: str
    advice: str = ""

    @classmethod
    def graded(
        cls,
        check: str,
        joint: int | None,
        value: float,
        unit: str,
        *,
        look: float,
        wrong: float = float("inf"),
        advice: str,
    ) -> Finding:
        """Judge the size of a value: fine up to `look`, wrong above `wrong`."""
        size = abs(value)
        verdict = "wrong" if size > wrong else "look" if size > look else "fine"
        return cls(check=check, joint=joint, value=float(value), unit=unit, verdict=verdict,
                   advice="" if verdict == "fine" else advice)  # fmt: skip

    @classmethod
    def unknown(cls, check: str, joint: int | None, why: str, *, value: Any = None, unit: str = "") -> Finding:
        """A check that this record does not allow."""
        value = None if value is None else float(value)
        return cls(check=check, joint=joint, value=value, unit=unit, verdict=f"cannot tell: {why}")

    @property
    def ok(self) -> bool:
        """Whether there is nothing to do: fine, or cannot tell."""
        return self.verdict not in ("look", "wrong")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Checkup:
    """All findings about a record; printed, a table.

    Attributes
    ----------
    findings : tuple of Finding
    joint_labels : tuple of str
        What the table calls each joint.

    See Also
    --------
    plant.Finding, plant.Record, identification.Identification

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    >>> checkup = record.check()
    >>> checkup.ok, len(checkup.problems)
    (True, 0)
    """

    findings: tuple[Finding, ...]
    joint_labels: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether no check says "look" or "wrong"."""
        return not self.problems

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The findings that say "look" or "wrong"."""
        return tuple(finding for finding in self.findings if not finding.ok)

    def __repr__(self) -> str:
        words = [finding.verdict.partition(":")[0] for finding in self.findings]
        counts = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
        return f"Checkup({counts})"

    def __str__(self) -> str:
        """Check, joint, number, verdict and advice; joints with one verdict share the line of a check."""
        rows = [("check", "joint", "measured", "verdict", "what to do")]
        groups: dict[tuple[Any, ...], list[Finding]] = {}
        for finding in self.findings:
            own = finding.joint if not finding.ok else None
            groups.setdefault((finding.check, finding.verdict, finding.unit, own), []).append(finding)
        for (name, verdict, unit, _), group in groups.items():
            label, *more = self._labels([finding.joint for finding in group])
            values = [finding.value for finding in group if finding.value is not None]
            rows.append((name, label, _measured(values, unit), verdict, group[0].advice))
            rows += [("", label, "", "", "") for label in more]
        widths = [max(len(row[i]) for row in rows if i < 3 or len(row[i]) < 10) for i in range(4)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)) for row in rows]
        return "\n".join(
            (f"{line}  {row[4]}" if row[4] else line).rstrip() for line, row in zip(lines, rows, strict=True)
        )

    def _labels(self, joints: list[int | None]) -> list[str]:
        """What the table calls these joints, a line each; "all" for all of several."""
        if 1 < len(joints) == len(self.joint_labels):
            return ["all"]
        known = [joint for joint in joints if joint is not None]
        return [self.joint_labels[j] if self.joint_labels else joint_label((), j) for j in known] or ["-"]


def _measured(values: list[float], unit: str) -> str:
    if not values:
        return ""
    low, high = (f"{0.0 if abs(value) < _ROUNDING else value:.4g}" for value in (min(values), max(values)))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
