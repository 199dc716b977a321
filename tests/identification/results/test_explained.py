"""A fit says how much of each joint's torque its values explain."""

import dataclasses

import numpy as np
import pytest
from random_rigs import drawn

from identification import identify
from identification.equation_error import torque_error
from plant import puma560, simulate


@pytest.fixture(scope="module")
def found():
    record = simulate(
        puma560.literature_arm(1.5), puma560.rig(), puma560.p_law(), puma560.reference()
    )
    return identify(puma560.dynamics(), record, progress=False)


def test_a_right_fit_explains_the_torque(found):
    """Independent truth: the torques of the arm itself, along the motion that was simulated."""
    # At 10 Hz the hunting by counts, which no motion explains, is 2 % of the torque.
    assert (found.explained > 97).all()
    assert (found.explained <= 100).all()
    assert "fit of the torque: 97." in str(found)


def test_values_that_are_off_explain_less(found):
    arm = found.arm.dynamics.arm(1.2 * found.f)
    wrong = dataclasses.replace(found, arm=arm)
    # A fifth more torque, less the part that friction takes.
    assert (wrong.explained < 95).all()
    error = torque_error(arm, found.rig, found.records[0])
    np.testing.assert_allclose(wrong.explained, 100 * (1 - error.relative), atol=1e-9)


@pytest.mark.slow
def test_a_law_with_a_memory_gives_its_torque():
    """It is run along its log, which holds no torque, from where it was at the first sample."""
    case = drawn(1, torque=False)
    found = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert (found.explained > 98).all()
