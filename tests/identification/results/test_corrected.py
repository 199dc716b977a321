"""Records that an identification corrects: the rig has what was found, and nothing else is wrong."""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import PID, FrictionCurve, puma560, simulate

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
ARM = puma560.literature_arm(1.5)
PID_LAW = PID(
    gain=(0.1, 0.08),
    derivative=(4e-4, 3e-4),
    integral=(0.5, 0.4),
    filter=2000.0,
    period=RIG.period,
)


def log(law=None, duration=None, **drive):
    """A robot whose drive has what is said; its record's rig states nothing of it."""
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **drive))
    made = simulate(
        ARM, rig, law or puma560.p_law((0.1, 0.08)), PATH, duration=duration, steps_per_sample=16
    )
    return dataclasses.replace(made, rig=RIG, true_q=None, true_qd=None)


def quick(record):
    return identify(DYNAMICS, record, method="prediction_error", progress=False)


@pytest.mark.slow
def test_friction_is_that_of_the_robot_afterwards():
    viscous, coulomb = RIG.drive.viscous * (0.7, 1.4), RIG.drive.coulomb * (1.3, 0.7)
    found = quick(log(viscous=viscous, coulomb=coulomb))
    (record,) = found.corrected
    np.testing.assert_allclose(record.rig.drive.viscous, viscous, rtol=0.15)
    np.testing.assert_allclose(record.rig.drive.coulomb, coulomb, rtol=0.1)
    assert quick(record).causes == ()


@pytest.mark.slow
def test_an_offset_becomes_one_of_the_curve():
    offset = 0.4 * RIG.drive.coulomb * np.sign(RIG.drive.gear)
    (record,) = quick(log(law=PID_LAW, curve=FrictionCurve(offset=offset))).corrected
    np.testing.assert_allclose(record.rig.drive.curve.offset, offset, rtol=0.2)


def test_a_lag_and_a_right_record():
    (record,) = quick(log(current_lag=5e-5, duration=2.0)).corrected
    assert record.rig.drive.current_lag.time == pytest.approx(5e-5, rel=0.3)
    right = log(duration=2.0)
    assert quick(right).corrected == (right,)
