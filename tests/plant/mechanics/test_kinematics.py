"""Forward kinematics against pinocchio, and against gravity of the dynamics, whose frames they
are.
"""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from packaged_arms import planar, tx40
from packaged_arms import puma560 as whole_puma560
from pinocchio_arm import pinocchio_model

from plant import Body, Chain, Dynamics, Link, Placement, puma560
from plant.mechanics import axis_frame, joint_positions

PLACED = Placement.of_angles(0.3, -0.5, 0.7, (0.1, -0.2, 0.3))
CHAINS = {
    "paper": puma560.dynamics().chain,
    "six joints": whole_puma560(),
    "tx40": tx40(),
    "slides": Chain(
        links=(
            Link(name="1", alpha=0.4, theta=0.2, before=PLACED),
            Link(name="2", a=0.3, prismatic=True),
        )
    ),
}


@pytest.mark.parametrize("name", CHAINS)
def test_joints_and_tip_are_where_pinocchio_has_them(name):
    """Ten random poses; six products of rotations round at 1e-15 of a metre."""
    chain, random, tip = CHAINS[name], np.random.default_rng(0), np.array([0.1, -0.4, 0.2])
    model = pinocchio_model(chain, [Body(mass=1.0, com=(0, 0, 0))] * chain.n)
    data, positions = model.createData(), joint_positions(chain, tip)
    for q in random.uniform(-np.pi, np.pi, (10, chain.n)):
        pin.forwardKinematics(model, data, q)
        expected = [
            np.zeros(3),
            *(data.oMi[i].translation for i in range(1, chain.n + 1)),
            data.oMi[chain.n].act(tip),
        ]
        np.testing.assert_allclose(positions(q).full().T, expected, rtol=0, atol=1e-13)


def test_gravity_of_a_point_mass_is_its_weight_on_the_slope_of_its_height():
    """Virtual work: tau = m g dz/dq, by central differences of steps 1e-6."""
    weightless = Body(mass=0.0, com=(0, 0, 0), inertia=(0,) * 6)
    chain = dataclasses.replace(
        planar(3), bodies=(weightless, weightless, Body(mass=2.0, com=(0.25, 0.1, 0)))
    )
    dynamics, height = Dynamics.from_chain(chain), joint_positions(chain, (0.25, 0.1, 0))
    q, step = np.array([0.3, -0.8, 1.1]), 1e-6
    slope = [
        float(height(q + e)[2, -1] - height(q - e)[2, -1]) / (2 * step) for e in step * np.eye(3)
    ]
    torque = dynamics.gravity(q, dynamics.f()).full().ravel()
    np.testing.assert_allclose(torque, 2.0 * 9.81 * np.array(slope), atol=1e-8)


def test_a_tip_is_three_numbers():
    with pytest.raises(ValueError, match=r"tip must have shape \(3,\)"):
        joint_positions(planar(2), (0.4, 0))


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -2), (1e-13, 0, -1), (1, -2, 3), (0, 1, 0)])
def test_the_frame_of_an_axis_is_a_rotation_that_turns_z_to_it(axis):
    frame = axis_frame(np.array(axis, float))
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1)
    np.testing.assert_allclose(frame[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-12)
