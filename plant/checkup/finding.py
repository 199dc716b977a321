"""Findings of a checkup: one line per check and joint, and the table of all of them."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from plant.checkup.hypothesis import Cause
from plant.parts import Piece, Shown, Table, Verdict, joint_label


@dataclass(frozen=True, kw_only=True, repr=False)
class Finding(Shown):
    """One line of a checkup: a check, its joint, the measured value and the verdict.

    Parameters
    ----------
    check : str
        Name of the check, "delay".
    joint : int, optional
        Index of the joint in q; None for the whole record.
    value : float, optional
        The measured value in `unit`.
    unit : str
    verdict : str
        "fine", "look", "wrong", or "cannot tell: " and the reason.
    advice : str
        One sentence that says what to do; empty where there is nothing to do.
    """

    check: str
    joint: int | None
    value: float | None
    unit: str
    verdict: str
    advice: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is nothing to do: fine, or cannot tell."""
        return self.verdict not in ("look", "wrong")

    def _short(self) -> str:
        measured = "" if self.value is None else f", {_range_text([self.value], self.unit)}"
        joint = "" if self.joint is None else f", joint {self.joint}"
        return f"{self.check}{joint}{measured}: {self.verdict:.40}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.ok)
        # A finding on its own shows its advice below the verdict.
        if self.advice:
            yield self.advice


class Check(NamedTuple):
    """A check of a joint, or of the whole record, which makes its findings.

    `joint`: index in q, or None. `unit`: that of the measured values.
    """

    name: str
    joint: int | None = None
    unit: str = ""

    def finding(self, value: Any, verdict: str, advice: str = "") -> Finding:
        """A finding of this check; the value becomes a plain float."""
        # numpy numbers would print their type in a list of findings.
        value = None if value is None else float(value)
        return Finding(
            check=self.name,
            joint=self.joint,
            value=value,
            unit=self.unit,
            verdict=verdict,
            advice=advice,
        )

    def fine(self, value: Any = None) -> Finding:
        """There is nothing to do."""
        return self.finding(value, "fine")

    def look(self, value: Any, advice: str) -> Finding:
        """There may be a fault, which a user has to look at."""
        return self.finding(value, "look", advice)

    def wrong(self, value: Any, advice: str) -> Finding:
        """There is a fault."""
        return self.finding(value, "wrong", advice)

    def unknown(self, reason: str, value: Any = None) -> Finding:
        """This record does not allow the check."""
        # Without a value the table shows no unit, and findings with one reason share a line.
        check = self._replace(unit="") if value is None else self
        return check.finding(value, f"cannot tell: {reason}")

    def graded(self, value: Any, advice: str, look: float, wrong: float = math.inf) -> Finding:
        """Judge the size of a value: fine up to `look`, wrong above `wrong`."""
        if abs(value) > wrong:
            return self.wrong(value, advice)
        return self.look(value, advice) if abs(value) > look else self.fine(value)


def unless(reason: str, names: Iterable[str], findings: Iterable[Finding]) -> Iterator[Finding]:
    """Findings of the checks of these names; "cannot tell" of each where there is a reason."""
    # The findings are a generator: with a reason no check runs.
    if not reason:
        yield from findings
        return
    for name in names:
        yield Check(name).unknown(reason)


@dataclass(frozen=True, kw_only=True, repr=False)
class Checkup(Shown):
    """All findings about a record; it prints as a table with the labels of the joints.

    Parameters
    ----------
    findings : tuple of Finding
    joint_labels : tuple of str
    causes : tuple of Cause
        What explains the log better than what it states, the likeliest first.
    records : tuple of Record
        The log as it is, without the first cause, without the first two, ...: columns, rig and law.
    failed : tuple of str
        Hypotheses of the user's that could not be tried, with the reason, a line each.
    """

    findings: tuple[Finding, ...]
    joint_labels: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    records: tuple[Any, ...] = ()
    failed: tuple[str, ...] = ()

    @property
    def corrected(self) -> Any:
        """The log without all its causes: columns, rig and law put right."""
        return self.records[-1] if self.records else None

    @property
    def first_corrected(self) -> Any:
        """The log without its first cause; the log itself where nothing is wrong."""
        return self.records[min(1, len(self.records) - 1)] if self.records else None

    @property
    def record(self) -> Any:
        """The log without all its causes, as `corrected`."""
        return self.corrected

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
        """Advice first, then check, joint, value and verdict; joints with one verdict share it."""
        # A joint with a problem has a line of its own: its advice names its columns.
        groups: dict[tuple[Any, ...], list[Finding]] = {}
        for finding in self.findings:
            joint = None if finding.ok else finding.joint
            key = finding.check, finding.verdict, finding.unit, joint
            groups.setdefault(key, []).append(finding)
        yield Verdict(
            # The counts of all verdicts follow the colon.
            f"{len(self.problems)} of {len(self.findings)} checks need attention: {self._short()}",
            self.ok,
        )
        rows = []
        # Joints with the same advice, or reason, share its line.
        advised: dict[tuple[str, str], list[str]] = {}
        reasons: dict[tuple[str, str], list[str]] = {}
        for (check, verdict, unit, _), group in groups.items():
            # Joints of one group are listed below each other; the first has the numbers of all.
            label, *further_labels = self._labels([finding.joint for finding in group])
            values = [finding.value for finding in group if finding.value is not None]
            # The reason of "cannot tell" is too long for the table, so it goes below.
            word, _, reason = verdict.partition(": ")
            rows.append((check, label, _range_text(values, unit), word))
            rows += [("", label, "", "") for label in further_labels]
            # All findings of a group have the same verdict, and those with advice are alone in
            # theirs.
            labels = [name for name in (label, *further_labels) if name not in ("-", "all")]
            if group[0].advice:
                advised.setdefault((check, group[0].advice), []).extend(labels)
            if reason:
                reasons.setdefault((check, verdict), []).extend(labels)
        yield from _by_joints(advised)
        yield Table(("check", "joint", "measured", "verdict"), rows, words=(1, 2, 3))
        yield from _by_joints(reasons)
        yield from self.failed
        if self.ok:
            yield "gears, lengths and torque constants are tested by identify, which knows the arm"

    def _labels(self, joints: list[int | None]) -> list[str]:
        """Labels of these joints in the table, a line each; "all" for all of several."""
        # A robot with a single joint keeps its label.
        if 1 < len(joints) == len(self.joint_labels):
            return ["all"]
        # A checkup made by hand may have no labels.
        labels = self.joint_labels
        named = [labels[j] if labels else joint_label((), j) for j in joints if j is not None]
        return named or ["-"]


def _by_joints(lines: dict[tuple[str, str], list[str]]) -> Iterator[str]:
    """Lines of checks, each with its joints."""
    for (check, line), labels in lines.items():
        yield f"{', '.join((check, *labels))}: {line}"


def _range_text(values: list[float], unit: str) -> str:
    if not values:
        return ""
    # What is zero but for rounding prints as 0, so that equal numbers share one text.
    low, high = (
        f"{0.0 if abs(value) < 1e-9 else value:.4g}" for value in (min(values), max(values))
    )
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
