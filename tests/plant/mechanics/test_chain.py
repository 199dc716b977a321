"""Geometry against pinocchio: prismatic joints, the standard table, free frames, tilt and loads;
then bad input.
"""

import casadi as ca
import numpy as np
import pytest
from packaged_arms import planar
from random_arms import random_body, random_chain, random_placement

from plant import Body, Chain, Dynamics, Link, Lumping, Placement
from plant.mechanics import inverse, turn

pin = pytest.importorskip("pinocchio")

from pinocchio_arm import pinocchio_model  # noqa: E402


def compared(chain, other, rotors):
    """This project's torque, D, gravity and acceleration beside pinocchio's, at random states."""
    other.armature = np.asarray(rotors, float)
    dynamics, data = Dynamics(chain=chain, lumping=Lumping.standard(chain)), other.createData()
    f = dynamics.f()
    for q, qd, qdd in np.random.default_rng(0).uniform(-3, 3, (5, 3, chain.n)):
        tau = pin.rnea(other, data, q, qd, qdd)
        got = dynamics.arm(f).inverse(q, qd, qdd)
        np.testing.assert_allclose(got, tau, rtol=0, atol=1e-10 * np.abs(tau).max())
        D = pin.crba(other, data, q)
        D = np.triu(D) + np.triu(D, 1).T
        np.testing.assert_allclose(dynamics.D(q, f).full(), D, rtol=0, atol=1e-10 * np.abs(D).max())
        gravity = pin.computeGeneralizedGravity(other, data, q)
        got = dynamics.gravity(q, f).full().ravel()
        np.testing.assert_allclose(got, gravity, rtol=0, atol=1e-10 * np.abs(tau).max())
        acceleration = pin.aba(other, data, q, qd, tau)  # articulated bodies, no D at all
        by_factor = inverse(ca.SX(dynamics.D(q, f))).solve(
            tau - dynamics.h(q, qd, f).full().ravel()
        )
        for got in (dynamics.arm(f).forward(q, qd, tau), ca.DM(by_factor).full().ravel()):
            np.testing.assert_allclose(
                got, acceleration, rtol=0, atol=1e-10 * np.abs(acceleration).max()
            )


@pytest.mark.parametrize("frames", [False, True])
@pytest.mark.parametrize(("n", "seed"), [(1, 0), (2, 1), (2, 2), (3, 3), (5, 4), (7, 5)])
def test_revolute_and_prismatic_joints_agree_with_pinocchio(n, seed, frames):
    chain = random_chain(n, seed, frames=frames)
    compared(
        chain, pinocchio_model(chain, chain.bodies), np.array([body.rotor for body in chain.bodies])
    )


def test_standard_table_agrees_with_pinocchio():
    """The joint turns about z of the previous frame; the body is given in the frame at the far
    end of the link.
    """
    random = np.random.default_rng(7)
    rows = [
        dict(zip(("alpha", "a", "d", "theta"), random.uniform(-1, 1, 4), strict=True))
        for _ in range(5)
    ]
    rows[2]["prismatic"] = True
    bodies = tuple(random_body(random) for _ in rows)
    chain = Chain.standard(rows, bodies=bodies)

    model, parent, before = pin.Model(), 0, pin.SE3.Identity()
    for i, (row, body) in enumerate(zip(rows, bodies, strict=True)):
        joint = pin.JointModelPZ() if row.get("prismatic") else pin.JointModelRZ()
        start = pin.SE3(pin.utils.rotate("z", row["theta"]), np.array([0.0, 0.0, row["d"]]))
        parent = model.addJoint(parent, joint, before * start, str(i))
        before = pin.SE3(pin.utils.rotate("x", row["alpha"]), np.array([row["a"], 0.0, 0.0]))
        inertia = np.zeros((3, 3))
        inertia[np.triu_indices(3)] = body.inertia
        inertia += np.triu(inertia, 1).T
        model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, inertia), before)
    compared(chain, model, np.array([body.rotor for body in bodies]))


def test_tilted_base_is_gravity_from_another_side():
    """A pendulum about a vertical axis feels gravity only once its base is tilted."""
    body = Body(mass=2.0, com=(0.5, 0, 0), inertia=(0, 0, 0, 0, 0, 0))
    chain = Chain(links=(Link(name="1"),), bodies=(body,))
    for angle in (0.0, 0.3, np.pi / 2):
        tilted = chain.tilted(turn((1, 0, 0), angle))
        dynamics = Dynamics(chain=tilted, lumping=Lumping.standard(tilted))
        # Seen from the base, gravity points to -y by sin(angle): it pulls on the arm at q = 0,
        # which lies along x.
        expected = 2.0 * 9.81 * 0.5 * np.sin(angle)
        np.testing.assert_allclose(
            float(dynamics.gravity([0.0], dynamics.f())), expected, atol=1e-14
        )


def test_a_load_is_one_body_with_its_link():
    chain = random_chain(3, 11, frames=True)
    load = Body(mass=1.5, com=(0.1, 0.2, -0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.01))
    loaded = chain.carrying(load, link=1)
    model = pinocchio_model(chain, chain.bodies)
    from pinocchio_arm import frame, inertia_matrix

    inertia = pin.Inertia(load.mass, load.com, inertia_matrix(load))
    model.appendBodyToJoint(2, inertia, frame(chain.links[1].frame))
    compared(loaded, model, np.array([body.rotor for body in chain.bodies]))


def test_placements_compose_and_invert():
    random = np.random.default_rng(2)
    a, b = random_placement(random), random_placement(random)
    x = random.normal(size=3)

    def seen(p, x):
        return np.array(p.position) + np.array(p.rotation) @ x

    np.testing.assert_allclose(seen(a @ b, x), seen(a, seen(b, x)), atol=1e-14)
    np.testing.assert_allclose(seen(a.inverse(), seen(a, x)), x, atol=1e-14)
    body = random_body(random)
    there_and_back = body.seen_from(a).seen_from(a.inverse())
    np.testing.assert_allclose(there_and_back.inertia, body.inertia, atol=1e-13)
    np.testing.assert_allclose(there_and_back.com, body.com, atol=1e-13)


ROW = {"alpha": 0, "a": 1, "d": 0}


def test_a_chain_of_one_row_takes_its_body_alone():
    body = planar(1).bodies[0]
    assert Chain.standard([ROW], bodies=body) == Chain.standard([ROW], bodies=(body,))


BALL = (0.1, 0, 0, 0.1, 0, 0.1)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Body(mass=0.0, com=(0, 0, 0), inertia=BALL).require_physical("3"), "body 3 must have a positive mass"),
        (lambda: Body(mass=1, com=(0, 0, 0), inertia=(0.1, 0, 0, 0.1, 0, -0.1)).require_physical("a"),
         "body a must have a positive semidefinite inertia"),
        (lambda: Body(mass=1, com=(0, 0, 0), inertia=(0.1, 0, 0, 0.1, 0, 0.3)).require_physical("b"),
         r"body b must have an inertia that a body can have \(triangle inequality\)"),
        (lambda: Chain(links=(Link(name="1"), Link(name="1"))), "'1' comes twice"),
        (lambda: Link(name="1", a=431.8), r"a of link 1 must be a length in metres, at most 50; got 431\.8\. Divide"),
        (lambda: Chain(links=(Link(name="1"),), bodies=(1, 2)), "bodies must be 1, one Body per link; got 2"),
        (lambda: Chain(links=(Link(name="1"),)).carrying(Body(mass=1, com=(0, 0, 0), inertia=BALL)), "has none"),
        (lambda: Chain.standard([{"alpha": 0, "a": 1}]), "row 0 must have d; it has alpha, a"),
        (lambda: Chain.standard([{"alpha": 0, "a": 1, "d": 0, "alpha_before": 1}]), "Did you mean 'alpha'"),
        (lambda: Chain.standard([(0, 1, 2)]), "row 0 must be of type dict"),
        (lambda: Chain.standard([{"alpha": 0, "a": ".4", "d": 0}]), "a of row 0 must be a finite number"),
        (lambda: Link(name="1", alpha=90), "must be an angle in radians"),
        (lambda: planar(2).carrying(1.5), "body must be of type Body"),
        (lambda: planar(2).carrying(Body(mass=1, com=(0, 0, 0)), link=7), "a name or a place from -2 to 1; got 7"),
        (lambda: planar(2).carrying(Body(mass=1, com=(0, 0, 0)), link=-5), "a name or a place from -2 to 1; got -5"),
        (lambda: planar(2).carrying(Body(mass=1, com=(0, 0, 0)), link=True), "a name or a place .*; got True"),
        (lambda: Chain.standard([ROW, ROW], bodies=planar(1).bodies[0]), "bodies must be 2, one Body per link; got 1"),
        (lambda: Chain.standard([ROW, ROW], bodies=(planar(1).bodies[0], None)), "bodies must be 2, .*; got one of type NoneType"),
        (lambda: planar(2).carrying(Body(mass=1, com=(0, 0, 0)), link="3"), "link must be one of '1', '2'"),
        (lambda: Chain(links=(Link(name="1"), Link(name="2")), bodies=planar(1).bodies[0]), "bodies must be 2"),
        (lambda: Placement(rotation=((1, 0, 0), (0, 1, 0), (0, 0, -1))), "must be a right-handed rotation"),
        (lambda: Placement(position=(0, 0)), r"position must have shape \(3,\)"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)
