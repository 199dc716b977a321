"""Gains in another unit, and a reference that was not mapped, are named."""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import P, puma560, simulate

RIG = puma560.rig()
GAIN = RIG.drive.motor_gain


@pytest.fixture(scope="module")
def record():
    return simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference(), duration=3.65)


def said(record, check):
    return [finding.advice for finding in record.check().problems if finding.check == check]


def test_gains_in_amperes_are_named_by_the_logged_torque(record):
    law = puma560.p_law()
    assert not said(record, "units of torque")
    lines = said(dataclasses.replace(record, law=P(gain=law.gain / GAIN)), "units of torque")
    assert len(lines) == 2
    assert all("may be in A per pulse: multiply them by motor_gain" in line for line in lines)
    lines = said(dataclasses.replace(record, law=P(gain=law.gain * 10)), "units of torque")
    assert lines
    assert not any("A per pulse" in line for line in lines)


def test_they_are_named_by_friction_where_no_torque_is_logged(record):
    alone = dataclasses.replace(record, torque=None, current=None, law=P(gain=puma560.p_law().gain / GAIN))
    lines = said(alone, "units of torque")
    assert lines
    assert all("in A per pulse" in line for line in lines)


def test_a_reference_that_was_not_mapped_is_named(record):
    without = dataclasses.replace(
        record, reference=None, reference_pulses=np.zeros_like(record.counts), error_pulses=-record.counts, torque=None,
        current=None,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"no reference came with it, so its law is taken to hold 0\. Map ref"):
        identify(puma560.dynamics(), without, progress=False)


def test_a_turned_current_may_be_a_turned_gear(record):
    turned = dataclasses.replace(record, torque=None, current=record.current * (1, -1))
    (line,) = said(turned, "drive sign")
    assert line.endswith("change the sign of the current, or of the gear.")
