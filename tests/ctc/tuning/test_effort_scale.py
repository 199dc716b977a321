"""The torque to which chatter is compared: of a joint at rest without gravity it is the limit."""

import dataclasses

import numpy as np

from ctc.tuning import effort_scale
from plant import Dynamics, PointToPoint, puma560

RIG = puma560.rig()


def test_a_joint_that_needs_no_torque_has_its_limit():
    """Its chatter is a share of something, so that loops and tunings have an order."""
    chain = dataclasses.replace(puma560.dynamics().chain, gravity=(0.0, 0.0, 0.0))
    dynamics = Dynamics.from_chain(chain)
    arm = dynamics.arm((4.0, 0.0, 0.0, 0.5, 2.0))
    rest = PointToPoint(start=(0.1, 0.2), goal=(0.1, 0.2), duration=1.0)
    scale = effort_scale(arm, RIG, {"rest": (rest, 1.0)})
    np.testing.assert_allclose(scale, RIG.drive.torque_limit())
    move = PointToPoint(start=(0.1, 0.2), goal=(0.5, 0.2), duration=1.0)
    assert (effort_scale(arm, RIG, {"move": (move, 1.0)}) < 0.5 * RIG.drive.torque_limit()).all()
