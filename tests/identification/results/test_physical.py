"""The nearest arm that bodies can have: better where the robot is one, far away where it is
none.
"""

import dataclasses

import numpy as np
import pytest

from identification import identify, nearest_physical
from plant import Dynamics, puma560, simulate
from plant.mechanics import STANDARD

DYNAMICS, RIG = puma560.dynamics(), puma560.rig()
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()
BOXES = [[(-0.1, 0.5), (-0.15, 0.15), (0, 0)], [(-0.15, 0.15), (-0.7, 0.15), (0, 0)]]


def found_on(arm, dynamics=DYNAMICS):
    record = simulate(arm, RIG, puma560.p_law(), puma560.reference(), steps_per_sample=16)
    return identify(dynamics, record, method="prediction_error", progress=False)


@pytest.fixture(scope="module")
def physical():
    return found_on(puma560.literature_arm(1.5))


def test_physical_arm_is_found_better_with_what_bodies_can_have(physical):
    """f3 by itself is off by several per cent of its range; as a f5 of a body it is within 1.5."""
    nearest, true = nearest_physical(physical, BOXES), puma560.literature_arm(1.5).f
    off = [100 * np.abs(f - true) / WIDTH for f in (physical.f, nearest.arm.f)]
    assert off[0].max() > 3.0
    assert off[1].max() < 2.0
    assert nearest.distance < 4.0  # within the noise of nine numbers
    a = puma560.LINK_LENGTH
    np.testing.assert_allclose(nearest.arm.f[[2, 3]], a * nearest.arm.f[[4, 5]], rtol=1e-9)


def test_bodies_are_bodies_within_their_boxes_and_have_these_f(physical):
    nearest = nearest_physical(physical, BOXES)
    np.testing.assert_allclose(DYNAMICS.f(nearest.bodies), nearest.arm.f, rtol=1e-12)
    for body, box, least in zip(nearest.bodies, BOXES, RIG.drive.reflected_inertia(), strict=True):
        body.require_physical("one")
        assert all(
            low - 1e-9 <= x <= high + 1e-9 for x, (low, high) in zip(body.com, box, strict=True)
        )
        assert body.rotor >= 0.5 * least - 1e-12


def test_published_vector_is_no_set_of_bodies_and_the_distance_says_so():
    """ERRATA: f3 / f5 = 3.6 m, f4 / f6 = 0.72 m, where a link is 0.4318 m."""
    assert nearest_physical(found_on(puma560.arm()), BOXES).distance > 20


def test_seven_base_parameters_are_projected_too():
    found = found_on(puma560.literature_arm(1.5), Dynamics.from_chain(DYNAMICS.chain))
    nearest = nearest_physical(found, BOXES)
    assert nearest.distance < 4.0
    np.testing.assert_allclose(nearest.arm.f, found.f, atol=4 * found.fit.std.max())


def test_a_heap_on_a_finer_grid_comes_no_further(physical):
    coarse, fine = (nearest_physical(physical, BOXES, points=points).distance for points in (3, 9))
    assert fine <= coarse + 1e-6


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"boxes": BOXES[:1]}, "boxes must have shape"),
        ({"boxes": [[(1, 0), (0, 0), (0, 0)]] * 2}, "low <= high"),
        ({"points": 1}, "points must be a whole number of at least 2"),
        ({"found": puma560.arm()}, "found must be of type Estimate"),
        ({"boxs": BOXES}, "Did you mean 'boxes'"),
    ],
)
def test_bad_input_is_refused(physical, change, says):
    with pytest.raises(ValueError, match=says):
        nearest_physical(**({"found": physical, "boxes": BOXES} | change))


def test_result_without_covariance_is_refused(physical):
    without = dataclasses.replace(physical, fit=dataclasses.replace(physical.fit, covariance=None))
    with pytest.raises(ValueError, match="this fit provides none"):
        nearest_physical(without, BOXES)


def test_standard_parameters_end_with_the_rotor():
    assert STANDARD[-1] == "J"
