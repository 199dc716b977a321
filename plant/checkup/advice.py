"""Advice is tried before it is given: what a finding suggests is applied, and the checks run again.

A correction is kept where fewer checks find something and the motion explains no less of the torque.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.signals import Signals

_WORSE, _CHANCE = 1.02, 1e-3
"""Factor, and share, by which what is unexplained of the torque may rise: chance, and counts rounded again."""

_TRIALS = 6
"""Corrections that are tried of one log; a log with more to correct is wrong throughout."""

_IN_VAIN = "; correcting that was tried and does not make the log explain more, so leave it: look for another cause."


def tried(record: Any, examined: Callable[[Any], list[Finding]]) -> tuple[tuple[Finding, ...], Any]:
    """Findings about a record, each with what its correction does, and the record with all corrections that help.

    `examined`: the findings about a record.
    """
    findings = examined(record)
    odd, left, trials = sum(not each.ok for each in findings), unexplained(record), 0
    for k, finding in enumerate(findings):
        options = [] if finding.ok else list(_corrections(record, finding))[: max(0, _TRIALS - trials)]
        trials += len(options)
        for option in options:
            explains = unexplained(option)
            fewer = sum(not each.ok for each in examined(option)) if explains <= _WORSE * left + _CHANCE else odd
            if fewer >= odd:
                continue
            said = f"the motion explains {1 - explains:.2%} of the torque, before {1 - left:.2%}"
            said = f"{finding.advice} Corrected so, {said if left < 1 else 'fewer checks find something'}."
            findings[k] = dataclasses.replace(finding, advice=said)
            odd, left, record = fewer, explains, option
            break
        else:
            if options and finding.check in ("delay", "period"):
                findings[k] = dataclasses.replace(finding, advice=finding.advice.partition(";")[0] + _IN_VAIN)
    return tuple(findings), record


def unexplained(record: Any) -> float:
    """Share of the motor torques' variance that the motion does not explain, mean over joints; 1 where none can be."""
    signals = Signals(record)
    if not signals.long_enough or signals.motor_torque is None:
        return 1.0
    return float(np.mean([1.0 if each is None else each.unexplained for each in signals.regressions]))


def _corrections(record: Any, finding: Finding) -> Iterator[Any]:
    """What a finding suggests, as records; none where its law runs at one period alone."""
    i, rig, value = finding.joint, record.rig, finding.value or 0.0
    if finding.check == "rounding":
        encoder = dataclasses.replace(rig.encoder, rounding="floor" if rig.encoder.rounding == "fix" else "fix")
        yield dataclasses.replace(record, rig=dataclasses.replace(rig, encoder=encoder))
    elif finding.check == "delay":
        yield _counting(record, i, _read_later(record, i, value))
    elif finding.check == "period" and (power := 1e3 ** np.round(np.log10(value / 1e3 / rig.period) / 3)) != 1:
        yield dataclasses.replace(record, t=record.t / power)
    elif finding.check == "period" and getattr(record.law, "period", None) is None:
        yield dataclasses.replace(record, rig=dataclasses.replace(rig, period=value / 1e3))
    elif finding.check in ("gear sign", "drive sign"):
        turned = np.where(np.arange(record.n) == i, -1.0, 1.0)
        names = ("torque", "current") if finding.check == "drive sign" else ("error_pulses",)
        given = {name: getattr(record, name) for name in names}
        yield dataclasses.replace(record, **{name: turned * x for name, x in given.items() if x is not None})
        yield _counting(record, i, -record.counts[:, i])


def _counting(record, i, counts):
    """The record with other counts (N,) of joint i."""
    error = np.array(record.error_pulses)
    error[:, i] = record.reference_pulses[:, i] - counts
    return dataclasses.replace(record, error_pulses=error)


def _read_later(record, i, samples):
    """Counts (N,) of joint i that were so many samples late, as its encoder would count them in time."""
    encoder, rows = record.rig.encoder, np.arange(len(record))
    centres = encoder.position_in_pulses(encoder.cell_centre(record.counts))[:, i]
    return encoder.quantised(np.interp(rows + samples, rows, centres))
