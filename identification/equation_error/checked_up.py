"""Checkups of records, each made once, and what they call wrong in the columns.

Signs that a record alone does not tell apart are told by an arm.
"""

import functools
from dataclasses import replace

import numpy as np

from identification.equation_error.stated_equation import TorqueEquation
from plant import Dynamics, Record
from plant.checkup import (
    TABLE,
    Checkup,
    Experiment,
    SelectionSettings,
    Trials,
    bridged,
    ranking,
)

# These checks ask whether the columns are right, and whether the rig and the law describe them
# correctly. A wrong column makes everything else look wrong, so the findings of these checks come
# before all others.
_MISREAD = (
    "law",
    "rows left out",
    "copied columns",
    "units of counts",
    "quantisation step",
    "swapped joints",
    "gear sign",
    "drive sign",
    "swapped torques",
    "units of torque",
)

# Causes of this check keep the sizes of all columns, so that an arm can judge between them.
_SIGNS = "drive sign"


def checkup_of(record: Record, dynamics: Dynamics | None = None) -> Checkup:
    """`record.check()`, made once for each record, since it takes seconds of a wrong one.

    With `dynamics`, an arm with any f decides between signs that explain the record alike.
    """
    # Records are equal whatever their columns are called, but advice names the columns.
    return _checkup_of(record, repr(record.columns), dynamics)


@functools.lru_cache(maxsize=8)
def _checkup_of(record: Record, columns: str, dynamics: Dynamics | None) -> Checkup:
    if dynamics is None:
        return record.check()
    checkup = checkup_of(record)
    if not checkup.causes or checkup.causes[0].check != _SIGNS:
        return checkup
    first = checkup.causes[0]
    others = checkup.causes[1:]

    # 1. The record with either sign corrected, and the evidence for it: its own, and that of the
    # equation of motion.
    trials = [(first, checkup.first_corrected)]
    # The runner-up may be likelier by the arm, though not by the record alone.
    names = {rival.name for rival in (*first.rivals, first.runner_up) if rival is not None}
    for row in TABLE:
        if row.name in names and row.check == _SIGNS:
            experiment, settings = Experiment(bridged(record)), SelectionSettings(causes=1)
            ranked = ranking(experiment, Trials([row]), checkup.joint_labels, settings)
            trials += [
                (cause, row.undo(record, cause.joints, cause.size)) for cause in ranked.causes
            ]
    equations = [TorqueEquation.of(dynamics, trial) for _, trial in trials]
    evidence = [
        -np.inf if equation is None else cause.log_odds + equation.evidence
        for (cause, _), equation in zip(trials, equations, strict=True)
    ]

    # 2. The first of those that the arm does not exclude.
    least = max(evidence) - SelectionSettings().undecided
    excluded = {cause.name for (cause, _), of in zip(trials, evidence, strict=True) if of < least}
    likeliest, corrected = next(trial for trial in trials if trial[0].name not in excluded)
    excluded.add(likeliest.name)
    told = replace(
        likeliest, rivals=tuple(rival for rival in first.rivals if rival.name not in excluded)
    )
    findings = [
        replace(finding, advice=told.line) if finding.advice == first.line else finding
        for finding in checkup.findings
    ]
    if likeliest is first:
        return replace(checkup, findings=tuple(findings), causes=(told, *others))
    # What else is wrong shows in the record as the arm has it.
    further = checkup_of(corrected)
    findings = [finding for finding in findings if finding.advice == told.line]
    return replace(
        checkup,
        findings=(*findings, *further.findings),
        causes=(told, *further.causes),
        records=(record, *further.records),
    )


def misread(
    record: Record, dynamics: Dynamics | None = None, *, limited: bool = False
) -> tuple[str, ...]:
    """What `checkup_of` a record calls wrong in its columns, the likeliest first.

    With `limited`, units of torque are left out: an amplifier at its limit looks like a wrong unit.
    """
    checkup = checkup_of(record, dynamics)
    causes = {cause.line for cause in checkup.causes}
    # An export whose torques are late is late by whole rows; a drive may lag by less.
    late = {
        cause.line
        for cause in checkup.causes
        if cause.name == "late torques" and cause.size == round(cause.size)
    }
    lines = []
    for finding in checkup.problems:
        wrong = finding.verdict == "wrong" and finding.check in _MISREAD
        if not wrong and finding.advice not in late:
            continue
        if limited and finding.check == "units of torque":
            continue
        # A cause names its joints itself.
        joint = "" if finding.joint is None else f" of {checkup.joint_labels[finding.joint]}"
        prefix = "" if finding.advice in causes else f"{finding.check}{joint}: "
        lines.append(f"{prefix}{finding.advice}")
    return tuple(dict.fromkeys(lines))
