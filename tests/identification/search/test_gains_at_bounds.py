"""Observer gains at their bounds: the covariance comes from gains inside them."""

import dataclasses

import numpy as np
from driven_arm import CHAIN, DYNAMICS, LAW, PATH, RIG, TRUE
from random_rigs import log_of

from identification.replay import Prediction, gauss_newton
from identification.search import from_inside
from plant import LoggedTorque


def solved(gains):
    """Prediction, solution, steps and bounds of a fit with these observer gains (2,), kept."""
    record = log_of(CHAIN, RIG, None, LAW, PATH, 2.0)
    record = dataclasses.replace(record, law=LoggedTorque())
    prediction = Prediction(DYNAMICS, record)
    bounds = np.vstack([np.tile([-np.inf, np.inf], (3, 1)), prediction.nuisance_bounds])
    steps = np.append(1e-3 * np.ones(3), prediction.nuisance_steps)
    kept = np.append(steps[:3], [0, 0])
    start = np.append(TRUE, gains if gains is not None else prediction.nuisances)
    start = np.fmax(start, np.append(np.full(3, -np.inf), bounds[3:, 0]))
    solution = gauss_newton(prediction, start, kept, bounds)
    return prediction, solution, steps, bounds


def test_a_joint_in_open_loop_gives_no_narrow_interval():
    prediction, solution, steps, bounds = solved((0.0, 0.0))
    assert (solution.values[3:] == bounds[3:, 0]).all()
    inside = from_inside(prediction, solution, steps, bounds, slice(3, 5))
    np.testing.assert_array_equal(inside.values, solution.values)
    ratio = np.sqrt(np.diag(inside.covariance)[:3] / np.diag(solution.covariance)[:3])
    assert (ratio > 1.1).all(), ratio


def test_gains_inside_their_bounds_change_nothing():
    prediction, solution, steps, bounds = solved(None)
    assert from_inside(prediction, solution, steps, bounds, slice(3, 5)) is solution
