"""Advice is tried before it is given: what a finding suggests is applied, and the checks run again.

A correction is kept where fewer checks find something and the motion explains no less of the torque.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.signals import Signals

_WORSE, _CHANCE = 1.02, 1e-3
"""Factor, and share, by which what is unexplained of the torque may rise: chance, and counts rounded again."""

_TRIALS = 8
"""Corrections that are tried of one log; a log with more to correct is wrong throughout."""

_IN_VAIN = "a correction was tried and does not make the log explain more, so leave it: another cause is likelier"

_WEIGHT = {"look": 1, "wrong": 2}

_EVEN_ODDS = 50.0
"""Probability of `fix` [%] above which it is likelier than `floor`."""

_FACTORS = (1e-3, 1e3)
"""Of torques in another unit."""


def tried(record: Any, examined: Callable[[Any], list[Finding]]) -> tuple[tuple[Finding, ...], Any]:
    """Findings about a record, each with what its correction does, and the record with all corrections that help.

    `examined`: the findings about a record.
    """
    findings = list(examined(record))
    now, left, trials, done = findings, unexplained(Signals(record)), 0, ""
    for k, finding in enumerate(findings):
        if finding.ok or not finding.advice:
            continue
        if not any(finding.check == each.check and finding.joint == each.joint and not each.ok for each in now):
            findings[k] = dataclasses.replace(finding, advice=f"Nothing of itself: gone with what {done} says.")
            continue
        options = list(_corrections(record, finding))[: max(0, _TRIALS - trials)]
        trials += len(options)
        for option in options:
            explains = unexplained(Signals(option))
            if explains > _WORSE * left + _CHANCE or _size(found := examined(option)) >= _size(now):
                continue
            said = (
                f"Corrected so, {_size(now) - _size(found)} points fewer"
                if left >= 1
                else (f"Corrected so, the motion explains {1 - explains:.2%} of the torque in place of {1 - left:.2%}")
            )
            findings[k] = dataclasses.replace(finding, advice=f"{finding.advice} {said}.")
            now, left, record, done = found, explains, option, finding.check
            break
        else:
            if options:
                seen = finding.advice.partition(";")[0].partition(": change")[0].rstrip(".")
                findings[k] = dataclasses.replace(finding, advice=f"{seen}; {_IN_VAIN}.")
    return tuple(findings), record


def unexplained(signals: Signals) -> float:
    """Share of the motor torques' variance that the motion does not explain, mean over joints; NaN without torques."""
    shares = [1.0 if each is None else each.unexplained for each in signals.regressions]
    return 1.0 if signals.motor_torque is None else float(np.mean(shares))


def _size(findings: Sequence[Finding]) -> int:
    return sum(_WEIGHT.get(finding.verdict, 0) for finding in findings)


def _corrections(record: Any, finding: Finding) -> Iterator[Any]:
    """What a finding suggests, as records, as far as its law can have run in them."""
    with contextlib.suppress(ValueError):
        yield from (option for option in _suggested(record, finding) if _runs(option))


def _runs(record):
    """Whether the law can be evaluated with the rig."""
    try:
        return record.law is None or bool(record.law.block(record.rig))
    except ValueError:
        return False


def _suggested(record, finding):
    i, encoder = finding.joint, record.rig.encoder
    if finding.check == "rounding":
        changed = dataclasses.replace(encoder, rounding="fix" if finding.value > _EVEN_ODDS else "floor")
        yield dataclasses.replace(record, rig=dataclasses.replace(record.rig, encoder=changed))
    elif finding.check == "delay" and finding.value is not None:
        yield _shifted(record, i, finding.value)
    elif finding.check == "period" and finding.value is not None:
        period = finding.value / 1e3
        power = 1e3 ** np.round(np.log10(period / record.rig.period) / 3)
        if power == 1:
            yield dataclasses.replace(record, rig=dataclasses.replace(record.rig, period=period))
        else:
            yield dataclasses.replace(record, t=record.t / power)
    elif finding.check in ("gear sign", "drive sign"):
        names = ("torque", "current", "error_pulses", "counts")
        yield from _scaled(record, names if finding.check == "drive sign" else names[::-1], i, -1.0)
    elif finding.check == "units of torque":
        gear = record.rig.drive.gear[i]
        for factor in (*_FACTORS, gear, 1 / gear):
            yield from _scaled(record, ("torque", "current"), i, factor)
    elif finding.check in ("swapped joints", "swapped torques"):
        for j in range(record.n):
            order = [*range(record.n)]
            order[i], order[j] = order[j], order[i]
            if j != i and finding.check == "swapped joints":
                yield _counting(record, record.counts[:, order])
            elif j != i:
                names = [name for name in ("torque", "current") if getattr(record, name) is not None]
                yield dataclasses.replace(record, **{name: getattr(record, name)[:, order] for name in names})


def _counting(record, counts):
    return dataclasses.replace(record, error_pulses=record.reference_pulses - counts)


def _scaled(record, names, i, factor):
    """The record with joint i of each of these columns, where it is logged, times a factor."""
    for name in names:
        if getattr(record, name) is not None:
            changed = np.array(getattr(record, name))
            changed[:, i] *= factor
            yield _counting(record, changed) if name == "counts" else dataclasses.replace(record, **{name: changed})


def _shifted(record, i, late):
    """The record with counts of joint i read so many rows later."""
    encoder, rows, counts = record.rig.encoder, np.arange(len(record)), np.array(record.counts)
    centres = encoder.position_in_pulses(encoder.cell_centre(counts))[:, i]
    counts[:, i] = encoder.quantised(np.interp(rows + late, rows, centres)[:, None] * np.ones(record.n))[:, i]
    return _counting(record, counts)
