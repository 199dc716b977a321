"""A load as physics: increments of f against eq. (3), against whole chains with the load joined,
and the way back.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from packaged_arms import puma560 as whole_puma560
from random_arms import random_body, random_chain

from plant import Body, Dynamics, puma560
from plant.mechanics import LOAD, inertia_matrix, prior_factor, pseudo_inertia


def test_the_increments_are_those_of_equation_3():
    """A body on link 3 by the paper's own formula, with and without it; eq. (3) takes Izz about
    the centre of mass.
    """
    a3, com, mass, izz = puma560.LINK_LENGTH, (0.03, -0.4, 0.1), 2.5, 0.02
    nothing = SimpleNamespace(m=0.0, x=0.0, y=0.0, Izz=0.0, J=0.0)
    load = SimpleNamespace(m=mass, x=com[0], y=com[1], Izz=izz, J=0.0)
    expected = np.array(list(puma560.equation_3(nothing, load, a3).values()))
    body = Body(mass=mass, com=com, inertia=(0.01, 0, 0, 0.01, 0, izz))
    got = puma560.dynamics().load_matrix() @ body.standard_parameters
    np.testing.assert_allclose(got, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("joints", "link", "frames"), [(2, -1, False), (4, 1, True), (6, -1, True), (6, "3", False)]
)
def test_any_chain_any_link(joints, link, frames):
    """The torque of the chain that has the body joined is that of the empty one with f + B phi."""
    chain, random = random_chain(joints, seed=joints, frames=frames), np.random.default_rng(joints)
    dynamics, body = Dynamics.from_chain(chain), dataclasses.replace(random_body(random), rotor=0.0)
    carrying = dynamics.f(chain.carrying(body, link).bodies)
    got = dynamics.f() + dynamics.load_matrix(link) @ body.standard_parameters
    np.testing.assert_allclose(got, carrying, rtol=1e-10, atol=1e-10 * np.abs(carrying).max())


def test_there_and_back():
    body = dataclasses.replace(random_body(np.random.default_rng(3)), rotor=0.0)
    back = Body.from_standard_parameters(body.standard_parameters)
    assert back.mass == body.mass
    np.testing.assert_allclose(back.com, body.com, rtol=1e-12)
    np.testing.assert_allclose(back.inertia, body.inertia, rtol=1e-9, atol=1e-12)
    assert Body.from_standard_parameters(np.zeros(10)).mass == 0


def test_the_prior_of_a_solid_body_is_the_body():
    """Nothing of it is widened, and no mass is added; a point mass keeps mass and moments."""
    solid = random_body(np.random.default_rng(3)).standard_parameters
    factor = prior_factor(solid)
    np.testing.assert_allclose(factor @ factor.T, pseudo_inertia(solid), rtol=1e-12, atol=1e-14)
    point = Body(mass=2.0, com=(0.1, -0.2, 0.3)).standard_parameters
    factor = prior_factor(point)
    np.testing.assert_allclose((factor @ factor.T)[3], pseudo_inertia(point)[3], rtol=1e-12)


@pytest.mark.parametrize(
    ("function", "wrong"),
    [
        (pseudo_inertia, [1.0, 0.0, 0.0, 0.0, 2.0]),
        (pseudo_inertia, np.ones(12)),
        (inertia_matrix, 0.1),
        (inertia_matrix, [0.1, 0.1, 0.1]),
    ],
)
def test_parameters_of_another_number_are_refused(function, wrong):
    """One moment would otherwise fill all entries of the matrix."""
    with pytest.raises(ValueError, match="must have shape"):
        function(wrong)


def test_what_cannot_be():
    with pytest.raises(ValueError, match="body must be of type Body; got a value of type float"):
        Body(mass=1.0, com=(0, 0, 0)).joined(2.0)
    with pytest.raises(ValueError, match="positive mass"):
        Body.from_standard_parameters([-1.0, *np.zeros(9)])
    with pytest.raises(ValueError, match="positive mass"):
        Body.from_standard_parameters([0.0, 0.1, *np.zeros(8)])
    with pytest.raises(ValueError, match="shape"):
        Body.from_standard_parameters(np.zeros(11))
    with pytest.raises(ValueError, match="link"):
        puma560.dynamics().load_matrix(7)


def test_the_whole_arm_weighs_what_it_carries():
    """Held level at its joints' zero, 3 kg at the flange change the torque of joint 2 by weight
    times distance.
    """
    chain = whole_puma560()
    dynamics = Dynamics.from_chain(chain)
    increment = dynamics.load_matrix() @ Body(mass=3.0, com=(0.0, 0.0, 0.2)).standard_parameters
    rest = np.zeros(6)
    torque = dynamics.Y(rest, rest, rest).full() @ increment
    assert len(LOAD) == 10
    # The flange is 0.0203 + 0.4318 m from axis 2, level; the forearm hangs down, so the 0.2 m of
    # the tool are plumb.
    assert torque[1] == pytest.approx(3.0 * 9.81 * (0.4318 + 0.0203), rel=1e-9)
