"""Sliding mode: the time to the boundary layer in closed form, staying there, and the layer's
own feedback.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import without_friction

from ctc import SlidingMode
from plant import puma560, simulate

ARM, W, LAYER = puma560.arm(), 30.0, 0.2


def surface(robot, reach, off):
    """Times and true s (N, n) of the published arm under sliding mode, started at rest off a
    moving reference.
    """
    drive = dataclasses.replace(puma560.rig().drive, current_limit=(np.inf, np.inf))
    rig = without_friction(
        dataclasses.replace(puma560.rig(), drive=drive), smooth=True, period=1e-4
    )
    law = SlidingMode(robot, rig, bandwidth=W, reach=reach, layer=LAYER, filter=4e5)
    path = puma560.reference()
    start = path([0.0])
    record = simulate(ARM, rig, law, path, duration=0.4, initial=(start.q[0] - off, start.qd[0]))
    motion = path(record.t)
    return record.t, motion.qd - record.true_qd + W * (motion.q - record.true_q)


@pytest.mark.parametrize("reach", [10.0, 30.0])
def test_the_layer_is_reached_in_the_time_of_the_closed_form(reach):
    """With the true f, sdot = -reach sign s outside the layer: at (abs(s_0) - layer) / reach,
    within three samples.

    Inside, sdot = -(reach / layer) s.
    """
    t, s = surface(ARM, reach, np.array([0.05, -0.03]))
    for joint in range(2):
        begin = abs(s[0, joint])
        arrival = (begin - LAYER) / reach
        inside = t[np.abs(s[:, joint]) <= LAYER]
        assert inside[0] == pytest.approx(arrival, abs=3e-4)
        assert len(inside) == (t >= inside[0]).sum()
        at = np.searchsorted(t, arrival + 2 * LAYER / reach)
        # First order in the period: reach / layer times it is 0.5 to 1.5 %, over two time
        # constants.
        assert abs(s[at, joint]) == pytest.approx(LAYER * np.exp(-2), rel=0.05)
        assert np.sign(s[at, joint]) == np.sign(s[0, joint])


def test_a_wrong_model_is_overruled_once_it_is_wrong_by_less_than_the_reach():
    """f 15 % off: the model is wrong by some rad/s^2 (its weight alone by 0.15 h / D = 3 rad/s^2).

    With a reach of 30 both joints come into the layer and stay there; with a reach of 1 they are
    driven out.
    """
    wrong, off = ARM.dynamics.arm(1.15 * puma560.PUBLISHED), np.array([0.02, -0.02])
    t, s = surface(wrong, 30.0, off)
    assert (np.abs(s[t > 0.02]) < LAYER).all()
    _, s = surface(wrong, 1.0, 0 * off)
    assert np.abs(s).max() > LAYER
