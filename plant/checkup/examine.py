"""The checkup of a record: what its rig and law state against what its columns show, without a model of the arm."""

from typing import Any

from plant.checkup.counts import counts_findings
from plant.checkup.finding import Checkup, Finding
from plant.checkup.gears import gear_findings
from plant.checkup.oscillation import oscillation_findings
from plant.checkup.quantisation import quantisation_findings
from plant.checkup.signals import Signals
from plant.checkup.stamps import time_findings
from plant.checkup.torques import torque_findings
from plant.checkup.tracking import reference_findings
from plant.checkup.units import unit_findings
from plant.checkup.wiring import wiring_findings

_LEAST = 50
"""Samples with weight, below which only their times are checked."""


def examine(record: Any) -> Checkup:
    """Check a record for errors; ``record.check()`` does.

    Parameters
    ----------
    record : Record

    Returns
    -------
    Checkup
    """
    signals = Signals(record)
    labels = tuple(signals.joint_labels)
    if len(signals.t) < _LEAST:
        few = Finding.unknown("counts, torque", None, f"only {len(signals.t)} samples have weight")
        return Checkup(findings=(*time_findings(signals), few), joint_labels=labels)
    parts = (
        time_findings, counts_findings, quantisation_findings, reference_findings, wiring_findings, unit_findings,
        torque_findings, gear_findings, oscillation_findings,
    )  # fmt: skip
    findings = tuple(finding for part in parts for finding in part(signals))
    return Checkup(findings=findings, joint_labels=labels)
