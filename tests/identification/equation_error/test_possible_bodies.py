"""Nearest bodies that can be: an arm from numbers that are none, friction that brakes."""

import dataclasses

import numpy as np
import pytest

from identification import fit_torque
from identification.equation_error import PointMasses, boxes_of, with_possible_bodies
from plant import Body, Dynamics, puma560, simulate
from plant.machine import least_inertia_margin
from tests.oracles.packaged_arms import planar

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
DYNAMICS = Dynamics.from_chain(ARM.dynamics.chain)
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(2))


@pytest.fixture(scope="module")
def fit():
    record = simulate(ARM, RIG, puma560.p_law(), puma560.reference())
    return fit_torque(DYNAMICS, record, unknown=(*DYNAMICS.names, *FRICTION))


def moved(fit, name, value):
    """The fit with one value that no arm has."""
    values = fit.values.copy()
    values[fit.names.index(name)] = value
    return dataclasses.replace(fit, values=values)


def test_what_can_be_stays_within_its_noise(fit):
    possible = with_possible_bodies(DYNAMICS, RIG, fit)
    # The rows hold far more than so many numbers: an arm that can be costs no residual.
    assert possible.relative_error < 1.01 * fit.relative_error


def test_inertia_below_zero_becomes_that_of_an_arm(fit):
    inertia = DYNAMICS.names[-1]
    wrong = moved(fit, inertia, -3 * abs(fit[inertia]))
    assert least_inertia_margin(DYNAMICS, RIG, wrong.f[None])[0] < 0
    possible = with_possible_bodies(DYNAMICS, RIG, wrong)
    assert least_inertia_margin(DYNAMICS, RIG, possible.f[None])[0] > 0
    assert possible.relative_error > wrong.relative_error


def test_friction_below_zero_is_none_and_the_others_follow(fit):
    possible = with_possible_bodies(DYNAMICS, RIG, moved(fit, FRICTION[2], -0.2 * fit[FRICTION[2]]))
    assert possible[FRICTION[2]] == 0
    assert (possible.values[-len(FRICTION) :] >= 0).all()


def test_partly_known_parameters_have_no_nearest(fit):
    assert with_possible_bodies(DYNAMICS, RIG, dataclasses.replace(
        fit, names=fit.names[1:], values=fit.values[1:], known={fit.names[0]: 1.0}
    )) is None  # fmt: skip


def test_columns_of_point_masses_are_those_of_bodies():
    """A rod between two points of the grid has the sum of their columns, whatever the frame."""
    dynamics = Dynamics.from_chain(planar(3))
    boxes = boxes_of(dynamics)
    grid = PointMasses.in_boxes(dynamics, boxes, 2)
    pairs = [np.flatnonzero(grid.links == i)[[0, -1]] for i in range(3)]
    bodies = [
        Body(mass=1.0, com=grid.places[a]).joined(Body(mass=1.0, com=grid.places[b]))
        for a, b in pairs
    ]
    expected = sum(grid.columns[:, pair].sum(axis=1) for pair in pairs)
    np.testing.assert_allclose(dynamics.f(tuple(bodies)), expected, rtol=1e-9, atol=1e-12)


def test_boxes_reach_from_each_joint_to_the_next():
    """The last one, whose tool nobody states, may be as long as the others."""
    for box in boxes_of(Dynamics.from_chain(planar(3))):
        assert box[0, 0] < 0 < 0.399 < box[0, 1]
