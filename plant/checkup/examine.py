"""The examination of a record before anything is identified from it: a table with a verdict per line.

It knows no model of the arm. What the rig and the law of the record state is compared with what the columns show.
"""

from __future__ import annotations

from plant.checkup.counts import counts_findings
from plant.checkup.finding import Checkup, Finding
from plant.checkup.quantisation import quantisation_findings
from plant.checkup.signals import Signals
from plant.checkup.stamps import time_findings
from plant.checkup.torques import torque_findings
from plant.checkup.tracking import reference_findings
from plant.checkup.units import unit_findings
from plant.checkup.wiring import wiring_findings

__all__ = ["examine"]

_LEAST = 50
"""Samples with weight, below which only their times are looked at."""


def examine(record):
    """Examine a record; ``record.check()`` does.

    Parameters
    ----------
    record : Record

    Returns
    -------
    Checkup
    """
    signals = Signals(record)
    if len(signals.t) < _LEAST:
        few = Finding.unknown("counts, torque", None, f"only {len(signals.t)} samples have weight")
        return Checkup(findings=(*time_findings(signals), few))
    parts = (
        time_findings, counts_findings, quantisation_findings, reference_findings, wiring_findings, unit_findings,
        torque_findings,
    )  # fmt: skip
    return Checkup(findings=tuple(finding for part in parts for finding in part(signals)))
