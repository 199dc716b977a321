"""Coordinates of resonances: there and back, against `Elasticity.from_resonance`, derivatives,
what is known beside.
"""

import dataclasses
import re

import numpy as np
import pytest

from identification.replay import DAMPING, STIFFNESS, Prediction, Resonances, gauss_newton, on_gears
from plant import Elasticity, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
NAMES = (
    *ARM.dynamics.names,
    *(f"{field}[{i}]" for field in (STIFFNESS, DAMPING) for i in range(2)),
)
POSE = PATH(np.zeros(1)).q[0]


def elastic(hz, ratio=0.02):
    elasticity = Elasticity.from_resonance(ARM, hz, ratio, drive=RIG.drive, q=POSE)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))


@pytest.fixture(scope="module")
def record():
    rig = elastic((60, 90))
    return simulate(ARM, rig, puma560.p_law((0.1, 0.08)), PATH, duration=0.7, steps_per_sample=8)


def view_of(record, **options):
    prediction = Prediction(ARM.dynamics, record, NAMES)
    return Resonances(prediction, ARM.dynamics, record.rig, POSE, **options)


def start_of(view, hz, ratio):
    gears = elastic(hz, ratio).drive.elasticity
    values = np.concatenate([ARM.f, gears.stiffness, gears.damping, view.prediction.nuisances])
    bounds = np.tile([-np.inf, np.inf], (len(values), 1))
    return values, view.start(values, np.ones(len(values)), bounds)


def test_coordinates_are_resonances_and_lead_back(record):
    view = view_of(record)
    # the usual ratio, with which a search starts
    values, start = start_of(view, (60, 90), 0.0158113883)
    np.testing.assert_allclose(
        start.coordinates[9:11], 1 / (2 * np.pi * np.array([60, 90])) ** 2, rtol=1e-12
    )
    np.testing.assert_allclose(view.values(start.coordinates), values, rtol=1e-9)
    hz, ratio = view.resonances(start.coordinates)
    np.testing.assert_allclose(hz, [60, 90], rtol=1e-12)
    np.testing.assert_allclose(ratio, 0.0158113883, rtol=1e-9)


def test_slopes_of_values_are_those_of_their_definition(record):
    """k = m / u: by u -k / u, by f_j the derivative of m over u; damping grows with its
    logarithm.
    """
    view = view_of(record)
    values, start = start_of(view, (60, 90), 0.02)
    slopes, u = view.slopes(start.coordinates), start.coordinates[9:11]
    np.testing.assert_allclose(slopes[9, 9], -values[9] / u[0], rtol=1e-8)
    np.testing.assert_allclose(slopes[11, 11], view.values(start.coordinates)[11], rtol=1e-8)
    more = ARM.dynamics.arm(ARM.f + np.eye(9)[6]).D(POSE)[0, 0] - ARM.D(POSE)[0, 0]
    np.testing.assert_allclose(slopes[9, 6], more / u[0], rtol=1e-6)
    np.testing.assert_allclose(slopes[13:, 13:], np.eye(len(values) - 13), rtol=1e-8)


def test_what_cannot_be_is_infinite_not_a_number(record):
    view = view_of(record)
    _, start = start_of(view, 60, 0.02)
    # a negative compliance; link 3 lighter than its rotor
    for place, value in ((9, -1e-9), (0, 0.0)):
        wrong = start.coordinates.copy()
        wrong[place] = value
        assert np.isinf(view.innovations(wrong)).all()
        with pytest.raises(ValueError, match="the one that it was given diverges"):
            gauss_newton(view, wrong, start.steps, np.tile([-np.inf, np.inf], (len(wrong), 1)))


def test_expected_ratios_and_measured_compliances_weigh_as_readings(record):
    """At their middle nothing; one standard deviation off, the noise."""
    compliance = 1 / elastic((60, 90)).drive.elasticity.stiffness
    view = view_of(record, measured=(compliance, 0.01 * compliance))
    values, start = start_of(view, (60, 90), 0.02)
    assert view.innovations(start.coordinates)[-4:] == pytest.approx(0, abs=1e-9)
    moved = start.coordinates.copy()
    moved[11] += np.log(10) / 2 / 1.96  # of 0.5 to 5 %, 95 %
    moved[9] *= 1.02
    expected = np.array([1, 0, 2, 0]) * view.noise
    np.testing.assert_allclose(view.innovations(moved)[-4:], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(view.weights[:-4], view.prediction.weights)
    assert (view.weights[-4:] == 0).all()


def test_kept_names_and_known_gears_stay(record):
    names = (*ARM.dynamics.names, f"{STIFFNESS}[1]", f"{DAMPING}[0]")
    prediction = Prediction(ARM.dynamics, record, names)
    view = Resonances(prediction, ARM.dynamics, record.rig, POSE, fixed=(f"{DAMPING}[0]",))
    assert (list(view.stiffness), list(view.damping)) == ([1], [])
    values = np.concatenate([ARM.f, [1e5, 7.0], prediction.nuisances])
    start = view.start(values, np.ones(len(values)), np.tile([-np.inf, np.inf], (len(values), 1)))
    assert view.values(start.coordinates)[10] == 7.0
    assert view.resonances(start.coordinates)[0][0] == pytest.approx(60)  # the rig's


def test_a_search_stays_between_what_a_user_allows(record):
    view = view_of(record)
    values, _ = start_of(view, 60, 0.02)
    bounds = np.tile([-np.inf, np.inf], (len(values), 1))
    bounds[9] = values[9] / 2, values[9] * 3
    start = view.start(values, np.ones(len(values)), bounds)
    omega = 2 * np.pi * 60
    np.testing.assert_allclose(start.bounds[9], [1 / 3 / omega**2, 2 / omega**2], rtol=1e-9)
    np.testing.assert_allclose(
        start.bounds[10], 1 / (2 * np.pi * np.array([1000, 4])) ** 2, rtol=1e-9
    )


@pytest.mark.parametrize("ratios", [(0.005, 0.05), (0.001, 0.01)])
def test_a_rigid_start_keeps_a_range_of_damping(record, ratios):
    """Its resonance is searched from 1000 Hz on, where the same damping is a smaller ratio."""
    view = view_of(record)
    values, _ = start_of(view, 60, 0.02)
    bounds = np.tile([-np.inf, np.inf], (len(values), 1))
    bounds[11] = values[11] * np.array(ratios) / 0.02
    values[9] = 1e12
    start = view.start(values, np.ones(len(values)), bounds)
    expected = np.array(ratios) * 60 / 1000
    # Within 0.1 to 50 %, unless that leaves nothing.
    expected = np.clip(expected, 1e-3 if expected[1] > 1e-3 else 0, 0.5)
    np.testing.assert_allclose(start.bounds[11], np.log(expected), rtol=1e-9)
    assert start.steps[11] > 0


@pytest.mark.parametrize("stiffness", [(1e9, 1e10), (0, 1e-3)])
def test_a_range_of_stiffness_beyond_all_resonances_is_refused(record, stiffness):
    view = view_of(record)
    values, _ = start_of(view, 60, 0.02)
    bounds = np.tile([-np.inf, np.inf], (len(values), 1))
    bounds[10] = stiffness
    ends = re.escape(f"{stiffness[0]:g} to {stiffness[1]:g}")
    with pytest.raises(ValueError, match=rf"stiffness\[1\].* 4 to 1000 Hz.*{ends}"):
        view.start(values, np.ones(len(values)), bounds)


def test_rigid_rigs_get_gears_and_others_keep_theirs(record):
    rigid = dataclasses.replace(record, rig=RIG)
    assert on_gears(rigid).rig.drive.elasticity.stiffness.min() > 0
    assert on_gears(record) is record
    weightless = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, motor_inertia=(0, 2e-4))
    )
    with pytest.raises(ValueError, match="motors that weigh something"):
        on_gears(dataclasses.replace(record, rig=weightless))
