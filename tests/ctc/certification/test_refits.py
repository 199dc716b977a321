"""What a log of an elastic arm says of f, on gears of stated resonances."""

import dataclasses

import numpy as np
import pytest

from ctc.certification.gears import Gears
from ctc.certification.refits import refits
from ctc.certification.uncertainty import Uncertainty
from identification import identify
from plant import Elasticity, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH(np.zeros(1)).q[0]
HZ, RATIO = 60.0, 0.02


@pytest.fixture(scope="module")
def found():
    """An elastic arm, taken for rigid."""
    gears = Elasticity.from_resonance(ARM, HZ, RATIO, drive=RIG.drive, q=START)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    log = simulate(ARM, rig, puma560.p_law(), PATH, steps_per_sample=16)
    return identify(ARM.dynamics, dataclasses.replace(log, rig=RIG), seed=1, progress=False)


@pytest.fixture(scope="module")
def again(found):
    return refits(found, ((0.9 * HZ, 1.1 * HZ),), (RATIO, RATIO), START)


def test_the_fit_at_the_resonance_of_the_robot_is_nearest_to_it(found, again):
    deviation = np.sqrt(np.diag(again.covariances[again.nearest(np.array([0.5]))[0]]))
    rigid, true = (np.abs(f - ARM.f) / deviation for f in (found.arm.f, again.centres(np.array([0.5]))[0]))
    assert rigid.max() > 8
    assert true.max() < 4

    away = [np.abs(row - ARM.f).sum() for row in again.values]
    assert np.argmin(away) == len(again.places) // 2


def test_plants_have_the_f_of_their_resonance_and_laws_that_of_the_middle(found, again):
    stated = Uncertainty(gears=Gears(resonance=(0.9 * HZ, 1.1 * HZ), damping_ratio=RATIO))
    plants = stated.draw(found, RIG, 400, 0, START)
    np.testing.assert_allclose(plants.arm.f, again.centres(np.array([0.5]))[0], rtol=1e-9)

    hz = plants.values[:, plants.names.index("resonance")]
    low, high = np.quantile(hz, (0.2, 0.8))
    ends = again.centres(np.array([0.0, 1.0]))
    moved = plants.f[hz > high].mean(axis=0) - plants.f[hz < low].mean(axis=0)
    most = np.argmax(np.abs(ends[1] - ends[0]) / np.sqrt(np.diag(again.covariances[1])))
    assert moved[most] / (ends[1] - ends[0])[most] == pytest.approx(0.8, abs=0.25)


def test_where_no_resonance_can_be_fitted_there_are_none(found):
    assert refits(found, ((0.3, 0.3),), (RATIO, RATIO), START) is None
