"""The Robotics Toolbox as a second engine: its PUMA 560, and random arms of six and seven joints
in both tables.
"""

import dataclasses

import numpy as np
import pytest
from packaged_arms import puma560

from plant import Body, Chain, Dynamics, Link

toolbox = pytest.importorskip(
    "roboticstoolbox", reason="the Robotics Toolbox is not installed (Linux only)"
)


def random_links(n, seed):
    """Rows of a table with bodies, gears and motor inertias."""
    random = np.random.default_rng(seed)
    links = []
    for _ in range(n):
        # a body of twelve points has an inertia that a body can have
        points = random.uniform(-0.2, 0.2, (12, 3))
        com = points.mean(axis=0)
        mass, centred = random.uniform(1, 5), points - com
        inertia = mass * (np.sum(centred**2) / 12 * np.eye(3) - centred.T @ centred / 12)
        alpha, a, d, offset = random.uniform((-2, 0, -0.3, -2), (2, 0.5, 0.3, 2))
        links.append(
            {
                "alpha": alpha,
                "a": a,
                "d": d,
                "offset": offset,
                "m": mass,
                "r": com,
                "I": inertia,
                "Jm": 1e-4,
                "G": -80.0,
            }
        )
    return links


def theirs(links, modified):
    joint = toolbox.RevoluteMDH if modified else toolbox.RevoluteDH
    return toolbox.DHRobot([joint(**link, B=0.0, Tc=[0.0, 0.0]) for link in links])


def ours(links, modified):
    upper = np.triu_indices(3)
    bodies = tuple(
        Body(mass=k["m"], com=k["r"], inertia=k["I"][upper], rotor=k["Jm"] * k["G"] ** 2)
        for k in links
    )
    rows = [{"alpha": k["alpha"], "a": k["a"], "d": k["d"], "theta": k["offset"]} for k in links]
    if modified:
        return Chain(
            links=tuple(Link(name=str(i + 1), **row) for i, row in enumerate(rows)), bodies=bodies
        )
    return Chain.standard(rows, bodies=bodies)


def agree(chain, robot, states=5):
    """Inverse and forward dynamics, D and gravity at random states, to 1e-10 of the largest."""
    dynamics = Dynamics.from_chain(chain)
    arm, random = dynamics.arm(dynamics.f()), np.random.default_rng(0)
    for q, qd, qdd in random.uniform(-2, 2, (states, 3, chain.n)):
        pairs = [
            (arm.inverse(q, qd, qdd), robot.rne(q, qd, qdd)),
            (arm.D(q), robot.inertia(q)),
            (arm.h(q, 0 * q), robot.gravload(q)),
        ]
        torque = arm.inverse(q, qd, qdd)
        pairs.append((arm.forward(q, qd, torque), robot.accel(q, qd, torque)))
        for got, expected in pairs:
            expected = np.asarray(expected).reshape(got.shape)
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("n", [6, 7])
@pytest.mark.parametrize("modified", [True, False])
def test_random_arms_move_as_the_toolbox_says(n, modified):
    links = random_links(n, n)
    agree(ours(links, modified), theirs(links, modified))


def test_puma_560_moves_as_the_toolbox_s():
    """Its own table and bodies, friction left out. It stands on a post of 0.67 m, which no
    torque shows.
    """
    robot = toolbox.models.DH.Puma560().nofriction(coulomb=True, viscous=True)
    chain = puma560()
    agree(chain, robot)
    heavier = dataclasses.replace(chain.bodies[-1], mass=chain.bodies[-1].mass + 1e-3)
    chain = dataclasses.replace(chain, bodies=(*chain.bodies[:-1], heavier))
    with pytest.raises(AssertionError):  # one gram more on the last link is seen
        agree(chain, robot)
