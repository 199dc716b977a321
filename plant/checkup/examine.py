"""The checkup of a record: what its rig and law state against what its columns show, without a model of the arm.

Advice is tried before it is given: what a finding suggests is applied, and the checks run again. A correction is kept
where fewer checks find something and the motion explains no less of the torque.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from plant.checkup.counts import counts_findings
from plant.checkup.finding import Checkup, Finding, unless
from plant.checkup.lost_rows import MOST, all_bridged, lost_rows, repeats_bridged
from plant.checkup.oscillation import oscillation_findings
from plant.checkup.quantisation import count_unit_findings, quantisation_findings
from plant.checkup.rounding import rounding_findings
from plant.checkup.signals import Signals
from plant.checkup.stamps import lost_findings, time_findings
from plant.checkup.tracking import reference_findings
from plant.checkup.units import unit_findings
from plant.checkup.wiring import wiring_findings

_AT_LIMIT, _BEYOND = 0.999, 1.05
"""Share of the amplifier's limit from which on it is saturated; and above which the limit is wrong."""

_SATURATED, _LOST = 1.0, 50.0
"""Share of saturated samples [%] to look at, and above which the log shows the limit alone."""

_ALIKE = 0.01
"""Share of its range by which a torque that is not clipped may differ from the commanded one."""

_PILED, _LEAST_PILE = 4.0, 0.5
"""An extreme value is clipped if it is so many times as frequent as the next ones, in so many % of the samples."""

_SURE = 5.0
"""Standard deviations from which on a sign is significant."""

_REVERSALS, _PLAY, _PLAY_SURE = 6, 0.5, 3.5
"""Reversals of the load that a log must hold; backlash [pulses], and in standard deviations, that is significant."""


def _of_torque(name: str, check: Callable[[Any, int], Finding]) -> Callable[[Signals], Iterator[Finding]]:
    """A check of torque or current, joint by joint."""
    return lambda signals: unless(signals.no_torque, (name,), signals.each(check))


def _saturated(signals, i):
    limit = signals.rig.drive.current_limit[i]
    if not np.isfinite(limit):
        return Finding.unknown("saturation", i, "no current limit stated")
    current = signals.motor_torque[:, i] / signals.rig.drive.motor_gain[i]
    share = 100 * np.mean(np.abs(current) >= _AT_LIMIT * limit)
    advice = f"The amplifier is at its limit of {limit:g} A: slow the motion down, or lower the gains."
    return Finding.graded("saturation", i, share, "%", look=_SATURATED, wrong=_LOST, advice=advice)


def _clipped(signals, i):
    """Share of samples that pile up at an extreme which is not the amplifier's limit [%]."""
    torque, limit = signals.motor_torque[:, i], signals.rig.drive.current_limit[i]
    levels, often = np.unique(torque, return_counts=True)
    piled = 0
    for k, inner in ((0, slice(1, 4)), (-1, slice(-4, -1))):
        if len(levels) < 10 or np.abs(levels[k]) / signals.rig.drive.motor_gain[i] >= _AT_LIMIT * limit:
            continue
        if signals.torque is not None and signals.commanded is not None:
            cut, commanded = torque == levels[k], signals.commanded[:, i]
            inside = (torque > levels[0]) & (torque < levels[-1])
            alike = np.quantile(np.abs(commanded - torque)[inside], 0.9) < _ALIKE * np.ptp(torque)
            piled += alike * np.sum(cut & (np.abs(commanded) > _BEYOND * np.abs(levels[k])))
        elif often[k] > _PILED * often[inner].mean():
            piled += often[k]
    # Against the commanded torque a cut one is plain to see.
    least = _LEAST_PILE if signals.commanded is None else _LEAST_PILE / 5
    cut_off = f"cut off at {np.abs(torque).max():.4g} N m (motor), not at the stated limit of the amplifier"
    advice = f"The torque is {cut_off}: it gives less, or the log's range is too small; leave these rows out."
    return Finding.graded("clipped torque", i, 100 * piled / len(torque), "%", look=least, wrong=_LOST, advice=advice)


def _backlash(signals, i):
    """Motion of the motor alone where the load torque changes sign [pulses]: a lower bound of the backlash."""
    name, unit = "backlash", "pulses"
    regression = signals.regressions[i]
    if regression is None or regression.inertia[i] < _SURE * regression.inertia_std[i]:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    if regression.reversals < _REVERSALS:
        return Finding.unknown(name, i, f"the load changes sign {regression.reversals} times")
    play, std = regression.backlash, regression.backlash_std
    if play > max(_PLAY * signals.least_count[i], _PLAY_SURE * std):
        why = "The motor runs ahead where the load changes sign: the gear has at least this backlash"
        return Finding.of(name, i, play, unit, "look", f"{why}; expect no better than that from the model there.")
    if std > _PLAY * signals.least_count[i] or (abs(play) > _PLAY_SURE * std and play < 0):
        return Finding.unknown(name, i, f"known to +-{std:.2g} pulses only", value=play, unit=unit)
    if signals.reference is not None:
        return Finding.unknown(name, i, "none seen, but a position loop hides it", value=play, unit=unit)
    return Finding.of(name, i, play, unit)


_LEAST = 50
"""Samples with weight, below which only their times are checked."""


_PARTS = (
    _of_torque("clipped torque", _clipped), oscillation_findings, quantisation_findings, rounding_findings,
    reference_findings, wiring_findings, unit_findings, _of_torque("saturation", _saturated),
    _of_torque("backlash", _backlash),
)  # fmt: skip
"""Checks of a log whose lost rows are bridged; first what shows as noise, saturation and delay, too."""


def examine(record: Any) -> Checkup:
    """Check a record for errors; ``record.check()`` does."""
    labels = tuple(Signals(record).joint_labels)
    if (record.valid > 0).sum() < _LEAST:
        return Checkup(findings=tuple(_findings(record)), joint_labels=labels, record=record)
    findings, corrected = tried(record, _findings)
    return Checkup(findings=findings, joint_labels=labels, record=corrected)


def _findings(record: Any) -> list[Finding]:
    signals = Signals(record)
    if len(signals.t) < _LEAST:
        few = Finding.unknown("counts, torque", None, f"only {len(signals.t)} samples have weight")
        return [*time_findings(signals), few]
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        return [*time_findings(signals), *lost_findings(signals, lost)]
    whole, bridged = Signals(repeats_bridged(record, lost)), Signals(all_bridged(record, lost))
    found = [
        *time_findings(signals),
        *count_unit_findings(signals),
        *lost_findings(signals, lost),
        *counts_findings(signals, whole),
    ]
    return [*found, *(finding for part in _PARTS for finding in part(bridged))]


_WORSE, _CHANCE = 1.02, 1e-3
"""Factor, and share, by which what is unexplained of the torque may rise: chance, and counts rounded again."""

_TRIALS = 6
"""Corrections that are tried of one log; a log with more to correct is wrong throughout."""

_IN_VAIN = "; correcting that was tried and does not make the log explain more, so leave it: look for another cause."


def tried(record: Any, examined: Callable[[Any], list[Finding]]) -> tuple[tuple[Finding, ...], Any]:
    """Findings about a record, each with what its correction does, and the record with all corrections that help.

    `examined`: the findings about a record.
    """
    findings, corrected = examined(record), set[int]()
    odd, left, trials = sum(not each.ok for each in findings), unexplained(record), 0
    for k, finding in enumerate(findings):
        skipped = finding.ok or k in corrected
        options = [] if skipped else list(_corrections(record, findings, k))[: max(0, _TRIALS - trials)]
        trials += len(options)
        for of, option in options:
            explains = unexplained(option)
            fewer = sum(not each.ok for each in examined(option)) if explains <= _WORSE * left + _CHANCE else odd
            if fewer >= odd:
                continue
            said = f"the motion explains {1 - explains:.2%} of the torque, before {1 - left:.2%}"
            for i in of:
                more = f" Corrected so, {said if left < 1 else 'fewer checks find something'}."
                findings[i] = dataclasses.replace(findings[i], advice=findings[i].advice + more)
            corrected |= set(of)
            if finding.check == "swapped joints":  # until they are exchanged, all else is told of other joints
                told = {(findings[i].check, findings[i].joint): findings[i] for i in sorted(corrected)}
                rest, record = tried(option, examined)
                return (*told.values(), *(each for each in rest if (each.check, each.joint) not in told)), record
            odd, left, record = fewer, explains, option
            break
        else:
            if options and finding.check in ("delay", "period"):
                findings[k] = dataclasses.replace(finding, advice=finding.advice.partition(";")[0] + _IN_VAIN)
    return tuple(findings), record


def unexplained(record: Any) -> float:
    """Share of the logged torques' variance that the motion does not explain, mean over joints; 1 where none can be."""
    signals = Signals(record)
    if not signals.long_enough or signals.torque is None:
        return 1.0
    return float(np.mean([1.0 if each is None else each.unexplained for each in signals.regressions]))


def _corrections(record: Any, findings: Sequence[Finding], k: int) -> Iterator[tuple[Sequence[int], Any]]:
    """What finding k suggests, as records, and which findings each corrects; none where its law runs at one period."""
    finding = findings[k]
    i, rig, value = finding.joint, record.rig, finding.value or 0.0
    if finding.check == "rounding":
        encoder = dataclasses.replace(rig.encoder, rounding="floor" if rig.encoder.rounding == "fix" else "fix")
        yield (k,), dataclasses.replace(record, rig=dataclasses.replace(rig, encoder=encoder))
    elif finding.check == "delay":  # of all joints, as a logger makes it, or of this one alone
        late = [each for each, other in enumerate(findings) if other.check == "delay" and not other.ok]
        for of in dict.fromkeys((tuple(late), (k,))):
            moved = record
            for each in of:
                moved = _counting(moved, findings[each].joint, _read_later(moved, findings[each]))
            yield of, moved
    elif finding.check == "period" and (power := 1e3 ** np.round(np.log10(value / 1e3 / rig.period) / 3)) != 1:
        yield (k,), dataclasses.replace(record, t=record.t / power)
    elif finding.check == "period" and getattr(record.law, "period", None) is None:
        yield (k,), dataclasses.replace(record, rig=dataclasses.replace(rig, period=value / 1e3))
    elif finding.check == "swapped joints":  # as counts, or as angles that were converted by each other's gears
        for each, other in enumerate(findings):
            if other.check == finding.check and not other.ok and each != k:
                order, pair = np.arange(record.n), np.array([i, other.joint], int)
                order[pair] = pair[::-1]
                exchanged = record.counts[:, order], rig.counts(rig.cell_centre(record.counts)[:, order])
                error = min((record.reference_pulses - counts for counts in exchanged), key=lambda x: np.abs(x).sum())
                yield (k, each), dataclasses.replace(record, error_pulses=error)
    elif finding.check in ("gear sign", "drive sign"):
        turned = np.where(np.arange(record.n) == i, -1.0, 1.0)
        names = ("torque", "current") if finding.check == "drive sign" else ("error_pulses",)
        given = {name: getattr(record, name) for name in names}
        yield (k,), dataclasses.replace(record, **{name: turned * x for name, x in given.items() if x is not None})
        yield (k,), _counting(record, i, -record.counts[:, i])


def _counting(record, i, counts):
    """The record with other counts (N,) of joint i."""
    error = np.array(record.error_pulses)
    error[:, i] = record.reference_pulses[:, i] - counts
    return dataclasses.replace(record, error_pulses=error)


def _read_later(record, finding):
    """Counts (N,) of the joint of a finding that were so many samples late, as its encoder would count them in time."""
    encoder, rows = record.rig.encoder, np.arange(len(record))
    centres = encoder.position_in_pulses(encoder.cell_centre(record.counts))[:, finding.joint]
    return encoder.quantised(np.interp(rows + finding.value, rows, centres))
