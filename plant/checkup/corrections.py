"""Corrections are tried before they are advised: each is applied, and all checks run again.

A correction stays if fewer checks find a problem afterwards and the motion explains no less of the
torque. The findings that remain are those of the corrected record: a fault, not its consequences.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.finding import Finding, sign_advice
from plant.checkup.signals import Signals
from plant.checkup.wiring import error_column, torque_column


@dataclass(frozen=True, kw_only=True)
class CorrectionSettings:
    """Limits of the trials of corrections, chosen by hand.

    ``tests/benchmarks/second_reading.py`` measures them: does a log suffer from a correction?

    Parameters
    ----------
    worse : float
        Factor by which the unexplained share of the torque may rise.
    chance : float
        Rise of the unexplained share (0 to 1) that chance and rounding the counts again may cause.
    gravity : float
        The same for a change of sign. The regression has sines of sums of joint angles for gravity,
        and these sums change with the sign of one angle.
    trials : int
        Corrections that are tried of one log. A log with more of them is wrong throughout.
    """

    worse: float = 1.02
    chance: float = 1e-3
    gravity: float = 1e-2
    trials: int = 12


SETTINGS = CorrectionSettings()


@dataclass(frozen=True)
class Correction:
    """A change of a log, or of its rig, that a finding suggests.

    Parameters
    ----------
    mended : tuple of int
        Indices of the findings that it corrects.
    record : Record
        The record after the change.
    column : str
        The column whose sign it changes, as messages call it; empty for other changes.
    """

    mended: tuple[int, ...]
    record: Any
    column: str = ""


class _Trial(NamedTuple):
    """A correction, the findings about the record after it, and its unexplained share of torque."""

    correction: Correction
    findings: list[Finding]
    unexplained: float


def tried(record, examined: Callable[[Any], list[Finding]]) -> tuple[tuple[Finding, ...], Any]:
    """Findings about a record with the effect of their corrections; the record with all that help.

    `examined` gives the findings about a record.
    """
    mended = dict[Any, Finding]()
    in_vain = set[Any]()
    budget = SETTINGS.trials
    findings = examined(record)
    unexplained = unexplained_share(record)
    while (index := _next_problem(findings, {*mended, *in_vain})) is not None:
        # 1. Try what the finding suggests.
        corrections = list(_corrections(record, findings, index))[:budget]
        budget -= len(corrections)
        trials = [_trial(correction, findings, unexplained, examined) for correction in corrections]

        # 2. Without an improvement the advice stays, or says that the correction is in vain.
        problems = _problem_count(findings)
        fewest = min((_problem_count(trial.findings) for trial in trials), default=problems)
        if fewest == problems:
            finding = findings[index]
            in_vain.add(_key(finding))
            if trials and finding.check in ("delay", "period"):
                advice = (
                    f"{finding.cause}; correcting that was tried and does not make the log explain"
                    " more, so leave it: look for another cause."
                )
                findings[index] = replace(finding, advice=advice)
            continue

        # 3. Keep the first of the best; the columns of all the best are equally likely.
        best = [trial for trial in trials if _problem_count(trial.findings) == fewest]
        column = ", or of ".join(trial.correction.column for trial in best)
        effect = "fewer checks find something"
        if unexplained - best[0].unexplained > SETTINGS.chance:
            effect = (
                f"the motion explains {1 - best[0].unexplained:.2%} of the torque, before"
                f" {1 - unexplained:.2%}"
            )
        for k in best[0].correction.mended:
            finding = findings[k]
            advice = finding.advice
            if column and finding.cause:
                advice = sign_advice(finding.cause, column)
            advice = f"{advice} Corrected so, {effect}."
            mended[_key(finding)] = replace(finding, advice=advice)

        # 4. Go on with the corrected record: what failed before may help now.
        record = best[0].correction.record
        findings = best[0].findings
        unexplained = best[0].unexplained
        in_vain = set()
    remaining = (finding for finding in findings if _key(finding) not in mended)
    return (*mended.values(), *remaining), record


def _next_problem(findings, settled):
    """Index of the first finding with a problem that is not settled; None without any."""
    for k, finding in enumerate(findings):
        # Checks come in the order of causes, so the first problem is tried first.
        if not finding.ok and _key(finding) not in settled:
            return k
    return None


def _key(finding):
    return finding.check, finding.joint


def _problem_count(findings):
    return sum(not finding.ok for finding in findings)


def _trial(correction, findings, unexplained, examined):
    """Findings after a correction; those before it where the motion then explains less torque."""
    # A correction that makes the torque less plausible is no correction, whatever the checks say.
    share = unexplained_share(correction.record)
    rise = SETTINGS.gravity if correction.column else SETTINGS.chance
    if share > SETTINGS.worse * unexplained + rise:
        return _Trial(correction, findings, share)
    return _Trial(correction, examined(correction.record), share)


def unexplained_share(record) -> float:
    """Share of the torque's variance that the motion does not explain, mean over the joints.

    It is 1 for a joint, or a record, whose torque is unknown.
    """
    signals = Signals(record)
    # Without a logged torque nothing can become less plausible.
    if not signals.long_enough or signals.torque is None:
        return 1.0
    return float(np.mean([1.0 if fit is None else fit.unexplained for fit in signals.regressions]))


def _corrections(record, findings, index):
    """Corrections that the finding of this index suggests; none for most checks."""
    finding = findings[index]
    for other_finding in findings:
        # No correction of a column mends the column of another motor.
        if (
            other_finding.check == "copied columns"
            and other_finding.joint == finding.joint
            and not other_finding.ok
        ):
            return
    # Most findings need a new log, or a decision of the user.
    if finding.check in _BY_CHECK:
        yield from _BY_CHECK[finding.check](record, findings, index)


def _other_rounding(record, _, index):
    """The other convention of rounding the counts."""
    # "round" and "floor" differ by a shift of the zero alone, so "floor" stands for both.
    rounding = "floor" if record.rig.encoder.rounding == "fix" else "fix"
    encoder = replace(record.rig.encoder, rounding=rounding)
    yield Correction((index,), _with_rig(record, encoder=encoder))


def _counts_in_time(record, findings, index):
    """Late counts moved back: of all late joints, as a logger delays them, or of this one alone."""
    # The delays of all joints are usually one delay of the logger.
    late = [k for k, finding in enumerate(findings) if finding.check == "delay" and not finding.ok]
    for joints in dict.fromkeys((tuple(late), (index,))):
        moved = record
        for k in joints:
            counts = _read_later(moved, findings[k])
            moved = _with_counts(moved, findings[k].joint, counts)
        yield Correction(joints, moved)


def _other_time(record, findings, index):
    """Times in another unit; or the rig's period, where no law runs at a period of its own."""
    period = (findings[index].value or 0.0) / 1e3
    # Milliseconds and microseconds are powers of a thousand.
    factor = 1e3 ** np.round(np.log10(period / record.rig.period) / 3)
    if factor != 1:
        yield Correction((index,), replace(record, t=record.t / factor))
    elif getattr(record.law, "period", None) is None:
        yield Correction((index,), _with_rig(record, period=period))


def _exchanged_counts(record, findings, index):
    """Counts of two joints exchanged, as counts or as angles that the wrong gears converted."""
    rig = record.rig
    joint = findings[index].joint
    for k, partner in enumerate(findings):
        # The other joint of the pair has the same finding.
        if partner.check != "swapped joints" or partner.ok or k == index:
            continue
        order = np.arange(record.n)
        order[joint], order[partner.joint] = partner.joint, joint
        as_counts = record.reference_pulses - record.counts[:, order]
        as_angles = record.reference_pulses - rig.counts(rig.cell_centre(record.counts)[:, order])
        # The right one of the two leaves the smaller error.
        error = min((as_counts, as_angles), key=lambda pulses: np.abs(pulses).sum())
        yield Correction((index, k), replace(record, error_pulses=error))


def _turned_counts(record, findings, index):
    """The sign of the counts, the reference or the gear changed, where counts oppose reference."""
    joint = findings[index].joint
    signals = Signals(record)
    rig = record.rig
    columns = record.columns or {}
    turned = np.where(np.arange(record.n) == joint, -1.0, 1.0)
    # Columns that the reader of the file converted from angles to pulses.
    counts_are_angles = "position" in columns
    reference_is_angles = "reference_position" in columns
    counts = _reversed(rig, record.counts, counts_are_angles)[:, joint]
    with_counts = _with_counts(record, joint, counts)
    reference = np.where(
        turned < 0,
        _reversed(rig, record.reference_pulses, reference_is_angles),
        record.reference_pulses,
    )
    # A stated `reference` would contradict the turned column.
    with_reference = replace(
        record, reference=None, reference_pulses=reference, error_pulses=reference - record.counts
    )
    counts_column = signals.column("counts", joint)
    # Where the gear converted only one of the two columns to pulses, its sign is a correction of
    # its own; otherwise a wrong gear looks like wrong counts.
    if counts_are_angles != reference_is_angles:
        drive = replace(rig.drive, gear=turned * rig.drive.gear)
        converted = with_counts if counts_are_angles else with_reference
        yield Correction((index,), _with_rig(converted, drive=drive), "the gear")
        yield Correction((index,), with_counts, counts_column)
    else:
        yield Correction((index,), with_counts, f"{counts_column}, or of the gear")
    yield Correction((index,), with_reference, signals.column("reference", joint))


def _reversed(rig, pulses, angles):
    """Pulses (N, n) with the other sign; of angles, as the encoder would count those."""
    return rig.counts(-rig.cell_centre(pulses)) if angles else -pulses


def _turned_torque(record, findings, index):
    """The sign of the torque or of the error changed, where torque and counts disagree."""
    joint = findings[index].joint
    signals = Signals(record)
    turned = np.where(np.arange(record.n) == joint, -1.0, 1.0)
    # Torque and current of a record are one signal: their signs change together.
    columns = {}
    for name in ("torque", "current"):
        logged = getattr(record, name)
        if logged is not None:
            columns[name] = turned * logged
    if columns:
        # Without a reference the sign of the counts, or of the gear, is as likely: name no column.
        column = "" if signals.reference is None else torque_column(signals, joint)
        yield Correction((index,), replace(record, **columns), column)
    if column := error_column(signals, joint):
        error = turned * record.error_pulses
        yield Correction((index,), replace(record, error_pulses=error), column)


_BY_CHECK: dict[str, Callable[[Any, Sequence[Finding], int], Iterator[Correction]]] = {
    "rounding": _other_rounding,
    "delay": _counts_in_time,
    "period": _other_time,
    "swapped joints": _exchanged_counts,
    "gear sign": _turned_counts,
    "drive sign": _turned_torque,
}


def _with_rig(record, **changes):
    return replace(record, rig=replace(record.rig, **changes))


def _with_counts(record, joint, counts):
    """The record with other counts (N,) of a joint."""
    # A record holds reference and error; the counts are their difference.
    error = np.array(record.error_pulses)
    error[:, joint] = record.reference_pulses[:, joint] - counts
    return replace(record, error_pulses=error)


def _read_later(record, finding):
    """Counts (N,) of the finding's joint as its encoder would count them without the delay."""
    encoder = record.rig.encoder
    rows = np.arange(len(record))
    # Interpolate the middles of the cells, then round as the encoder does.
    centres = encoder.position_in_pulses(encoder.cell_centre(record.counts))[:, finding.joint]
    return encoder.quantised(np.interp(rows + finding.value, rows, centres))
