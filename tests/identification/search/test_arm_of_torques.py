"""Logged torques that no prediction follows still give an arm; wrong ones give none."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import fit_torque, identify
from identification.search import methods
from plant import FrictionCurve, LoggedTorque, puma560, simulate

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
OFFSET = np.array([0.05, 0.0])
"""Of the friction of each motor [N m]."""


def replayed(offset, viscous_offset=(0.0, 0.0)):
    """A log of computed torque, held from sample to sample, as a logger has it; open friction."""
    curve = FrictionCurve(offset=offset, viscous_offset=viscous_offset)
    real = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve))
    record = simulate(ARM, real, ComputedTorque(ARM, RIG), puma560.reference())
    drive = dataclasses.replace(RIG.drive, viscous=None, coulomb=None)
    return dataclasses.replace(
        record, rig=dataclasses.replace(RIG, drive=drive), law=LoggedTorque(), true_q=None, true_qd=None
    )  # fmt: skip


@pytest.fixture(scope="module")
def record():
    return replayed(OFFSET)


def refused(*arguments, **options):
    raise ValueError("the search must start from an arm that follows the log; it diverges. Hint.")


@pytest.mark.slow
def test_torques_give_the_arm_where_prediction_fails(record, monkeypatch):
    monkeypatch.setattr(methods, "polished", refused)
    found = identify(ARM.dynamics, record, progress=False)
    assert "it diverges" in found.fit.fallback_reason
    assert found.error_on(record).total < 0.05
    assert np.linalg.eigvalsh(found.arm.D([0.3, 0.4])).min() > 0
    assert (found.fit.std > 0).all()


def test_turned_torques_give_none(record, monkeypatch):
    monkeypatch.setattr(methods, "polished", refused)
    turned = dataclasses.replace(record, torque=-record.torque)
    with pytest.raises(ValueError, match=r"diverges|no band"):
        identify(ARM.dynamics, turned, progress=False)


@pytest.mark.slow
def test_prediction_that_leaves_the_torques_gives_way(record, monkeypatch):
    """An arm of twice the gravity may follow the counts by its observer, not the torques."""
    polished = methods.polished

    def heavier(problem, values, *arguments, **options):
        outcome = polished(problem, values, *arguments, **options)
        return dataclasses.replace(
            outcome, fit=dataclasses.replace(outcome.fit, values=2 * outcome.fit.values)
        )

    monkeypatch.setattr(methods, "polished", heavier)
    found = identify(ARM.dynamics, record, progress=False)
    assert "times as much of the torques unexplained" in found.fit.fallback_reason
    assert found.error_on(record).total < 0.05


def test_an_offset_with_evidence_is_found(record):
    found = identify(ARM.dynamics, record, method="equation_error", progress=False)
    offsets = [name for name in found.fit.unknown if "offset" in name]
    assert offsets == ["drive.curve.offset[0]"]
    assert found.rig.drive.curve.offset[0] == pytest.approx(OFFSET[0], rel=0.3)


def test_no_offset_is_found_where_none_is():
    found = identify(ARM.dynamics, replayed((0.0, 0.0)), method="equation_error", progress=False)
    assert not [name for name in found.fit.unknown if "offset" in name]


@pytest.mark.slow
def test_slopes_that_differ_by_direction_are_no_offset():
    """Viscous friction of joint 2 is half as large again forwards as backwards."""
    slopes = np.array([0.2, 0.0]) * RIG.drive.viscous
    record = replayed((0.0, 0.0), slopes)
    fit = fit_torque(ARM.dynamics, record)
    assert [name for name in fit.names if "curve" in name] == ["drive.curve.viscous_offset[0]"]
    assert fit.rig.drive.curve.viscous_offset == pytest.approx(slopes, abs=0.3 * slopes[0])
    found = identify(ARM.dynamics, record, method="equation_error", progress=False)
    assert "drive.curve.viscous_offset[0]" in found.fit.unknown
