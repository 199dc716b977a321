"""The examination of a record before anything is identified from it: a table with a verdict per line.

It knows no model of the arm. What the rig and the law of the record state is compared with what the columns show.
"""

from __future__ import annotations

from plant.doctor_counts import counts_findings
from plant.doctor_quantisation import quantisation_findings
from plant.doctor_reference import reference_findings
from plant.doctor_time import time_findings
from plant.doctor_torque import torque_findings
from plant.finding import Checkup
from plant.signals import Signals

__all__ = ["examine"]


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
    parts = (time_findings, counts_findings, quantisation_findings, reference_findings, torque_findings)
    return Checkup(findings=tuple(finding for part in parts for finding in part(signals)))
