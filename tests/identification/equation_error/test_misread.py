"""Mistakes of a log that an identification repeats from its checkup."""

from types import SimpleNamespace

import pytest

from identification.equation_error import misread
from plant.checkup import Cause, Check, Checkup


@pytest.mark.parametrize(("samples", "lines"), [(1.0, 1), (0.4, 0)])
def test_torques_late_by_whole_rows_are_a_mistake_of_the_export(samples, lines):
    """A drive may lag by a part of a row, and then its current_lag is identified."""
    late = Cause(
        name="late torques",
        joints=(),
        size=samples,
        unit="samples",
        log_odds=200.0,
        sentence=f"The torques of all joints are {samples} samples late",
        remedy="Shift them.",
        check="delay",
    )
    findings = tuple(Check("delay", i, "samples").look(samples, late.line) for i in range(2))
    checkup = Checkup(findings=findings, joint_labels=("1", "2"), causes=(late,))
    record = SimpleNamespace(check=lambda: checkup)
    assert misread(record) == (late.line,) * lines
