"""Findings of a checkup: one per check and joint, and the table of all of them."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any, Self

from plant.parts.messages import joint_label
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_ROUNDING = 1e-9  # printed as 0


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Finding(Shown):
    """One line of a checkup: what was checked, of which joint (its place in q, or None for the
    whole record).

    `value` is what was measured, in `unit`, or None; the verdict "fine", "look", "wrong", or
    "cannot tell: " and why; `advice` what to do, one sentence, or empty.
    """

    check: str
    joint: int | None
    value: float | None
    unit: str
    verdict: str
    advice: str = ""

    @classmethod
    def of(
        cls,
        check: str,
        joint: int | None,
        value: Any,
        unit: str,
        verdict: str = "fine",
        advice: str = "",
    ) -> Self:
        """What a check measured, and its verdict."""
        value = None if value is None else float(value)
        return cls(check=check, joint=joint, value=value, unit=unit, verdict=verdict, advice=advice)

    @classmethod
    def graded(
        cls,
        name: str,
        joint: int | None,
        value: float,
        unit: str,
        *,
        look: float,
        wrong: float = math.inf,
        advice: str,
    ) -> Self:
        """Judge the size of a value: fine up to `look`, wrong above `wrong`."""
        size = abs(value)
        verdict = "wrong" if size > wrong else "look" if size > look else "fine"
        return cls.of(name, joint, value, unit, verdict, "" if verdict == "fine" else advice)

    @classmethod
    def unknown(
        cls, check: str, joint: int | None, why: str, *, value: Any = None, unit: str = ""
    ) -> Self:
        """A check that this record does not allow."""
        return cls.of(check, joint, value, unit, f"cannot tell: {why}")

    @property
    def ok(self) -> bool:
        """Whether there is nothing to do: fine, or cannot tell."""
        return self.verdict not in ("look", "wrong")

    def _short(self) -> str:
        measured = "" if self.value is None else f", {_measured([self.value], self.unit)}"
        where = "" if self.joint is None else f", joint {self.joint}"
        return f"{self.check}{where}{measured}: {self.verdict:.40}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.ok)
        if self.advice:
            yield self.advice


def unless(why: str, names: Iterable[str], findings: Iterable[Finding]) -> Iterator[Finding]:
    """What checks of these names find; where there is a reason why they cannot tell, that."""
    yield from (Finding.unknown(name, None, why) for name in names) if why else findings


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Checkup(Shown):
    """All findings about a record; printed, a table, which calls the joints by their labels.

    `record`: with every correction of the advice that was tried and helps; none, the same record.
    """

    findings: tuple[Finding, ...]
    joint_labels: tuple[str, ...] = ()
    record: Any = None

    @property
    def ok(self) -> bool:
        """Whether no check says "look" or "wrong"."""
        return not self.problems

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The findings that say "look" or "wrong"."""
        return tuple(finding for finding in self.findings if not finding.ok)

    def _short(self) -> str:
        words = [finding.verdict.partition(":")[0] for finding in self.findings]
        return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))

    def _shown(self) -> Iterator[Piece]:
        """Check, joint, number and verdict; joints with one verdict share the line of a check.
        Above, what to do.
        """
        groups: dict[tuple[Any, ...], list[Finding]] = {}
        for finding in self.findings:
            own = finding.joint if not finding.ok else None
            groups.setdefault((finding.check, finding.verdict, finding.unit, own), []).append(
                finding
            )
        yield Verdict(
            f"{len(self.problems)} of {len(self.findings)} checks need attention: {self._short()}",
            self.ok,
        )
        rows = []
        reasons = []
        for (name, verdict, unit, _), group in groups.items():
            label, *more = self._labels([finding.joint for finding in group])
            values = [finding.value for finding in group if finding.value is not None]
            said, _, why = verdict.partition(": ")
            rows.append((name, label, _measured(values, unit), said))
            rows += [("", label, "", "") for label in more]
            if group[0].advice:
                yield f"{name}{'' if label == '-' else f', {label}'}: {group[0].advice}"
            if why:
                reasons.append(f"{name}: {verdict}")
        yield Table(("check", "joint", "measured", "verdict"), rows, words=(1, 2, 3))
        yield from reasons

    def _labels(self, joints: list[int | None]) -> list[str]:
        """What the table calls these joints, a line each; "all" for all of several."""
        if 1 < len(joints) == len(self.joint_labels):
            return ["all"]
        known = [joint for joint in joints if joint is not None]
        return [
            self.joint_labels[j] if self.joint_labels else joint_label((), j) for j in known
        ] or ["-"]


def _measured(values: list[float], unit: str) -> str:
    if not values:
        return ""
    low, high = (
        f"{0.0 if abs(value) < _ROUNDING else value:.4g}" for value in (min(values), max(values))
    )
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
