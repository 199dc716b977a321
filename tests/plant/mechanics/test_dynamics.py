"""Equations of motion: against closed forms, Lagrange's equations, equation (2), invariants and
another engine.

Tolerances. Two ways to write the same few hundred additions and multiplications differ by some ten
roundings, 1e-15 of the largest term; 1e-12 leaves room for three digits of cancellation and none
for an error in a formula. `close` measures differences against the largest *term* where a test
knows it, else against the largest value.
"""

import re
from functools import cache

import casadi as ca
import equation2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lagrange import lagrange
from random_arms import random_arm, random_body

from plant import Body, Chain, Dynamics, Link, Lumping, puma560

ROUNDING = 1e-12


def close(got, expected, scale=None, tolerance=ROUNDING):
    got, expected = np.asarray(got, float), np.asarray(expected, float)
    assert got.shape == expected.shape
    scale = np.abs(expected).max() if scale is None else scale
    # Of the smallest numbers a product of the tolerance has no digits.
    np.testing.assert_allclose(got, expected, rtol=0, atol=max(tolerance * scale, 1e-250))


@cache
def puma():
    return puma560.dynamics()


def by_lagrange(chain, bodies):
    rows = [(link.alpha, link.a, link.d, link.theta) for link in chain.links]
    return lagrange(rows, [(b.mass, b.com, b.inertia, b.rotor) for b in bodies], chain.gravity)


def column(dm):
    return dm.full().ravel()


# -- closed forms --------------------------------------------------------------------------------
def test_pendulum():
    """One link, axis horizontal, x level at q = 0 and upwards for q > 0: m r^2 + I + J, and m g
    r cos q.
    """
    m, r, izz, rotor, q, qd = 3.0, 0.4, 0.2, 0.7, 0.6, -1.3
    chain = Chain(links=(Link(name="1", alpha=np.pi / 2, a=0.0, d=0.0),))
    model = Dynamics(chain=chain, lumping=Lumping.standard(chain))
    f = model.f(
        [Body(mass=m, com=(r, 0.0, 0.0), inertia=(0.0, 0.0, 0.0, 0.0, 0.0, izz), rotor=rotor)]
    )
    close(model.D([q], f), [[m * r**2 + izz + rotor]])
    close(column(model.h([q], [qd], f)), [m * 9.81 * r * np.cos(q)])


def test_horizontal_axis_points_such_that_positive_q2_lowers_the_arm():
    """ERRATA: G2(0) = -g (f5 + f9)."""
    f = puma560.PUBLISHED
    gravity = column(puma().h([0, 0], [0, 0], f))
    close(gravity, [-9.81 * (f[4] + f[8]), -9.81 * f[4]])


# -- Lagrange ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("n", "seed"), [(n, seed) for n in (1, 2, 3) for seed in range(4)] + [(6, 0)]
)
def test_random_chain_agrees_with_lagranges_equations(n, seed):
    chain, bodies, model = random_arm(n, seed)
    exact, f = by_lagrange(chain, bodies), model.f(bodies)
    random = np.random.default_rng(100 + seed)
    for _ in range(3):
        q, qd, qdd = random.uniform(-3, 3, (3, n))
        close(model.D(q, f), exact.D(q))
        close(column(model.h(q, qd, f)), exact.h(q, qd))
        # Column by column: `exact.Y` takes differences of torques of a unit body, so its own
        # rounding is 1e-15 of the largest column.
        close(model.Y(q, qd, qdd), exact.Y(q, qd, qdd))
        close(model.Y(q, qd, qdd) @ f, exact.tau(q, qd, qdd)[:, None])


def test_puma_with_the_literatures_links_agrees_with_lagranges_equations():
    """Equation (3) corrected, (3) in the model, and the same bodies in Lagrange's equations:
    three ways, one arm.
    """
    m, x, y, izz = (17.4, 4.8), (0.068, 0.0), (0.006, -0.070), (0.539, 0.086)
    wrist = np.array([(0.82, -0.0203, -0.414), (0.34, -0.0203, -0.4331), (0.09, -0.0203, -0.465)])
    jm, k, a = (2e-4, 2e-4), (107.8, -53.7), 0.4318
    # Lump the wrist into link 3 with the parallel-axis theorem.
    parts = np.vstack([(m[1], x[1], y[1]), wrist])
    m3 = parts[:, 0].sum()
    x3, y3 = parts[:, 0] @ parts[:, 1:] / m3
    izz3 = izz[1] + parts[:, 0] @ ((parts[:, 1] - x3) ** 2 + (parts[:, 2] - y3) ** 2)
    f = equation2.equation3((m[0], m3), (x[0], x3), (y[0], y3), (izz[0], izz3), jm, k, a)
    close(puma560.literature_arm().f, f)
    close(f[2:4], a * f[4:6])  # f3 = a f5, f4 = a f6: only physical links obey this

    # z and the other inertias have no say in a planar arm; give them any values.
    link2 = (m[0], (x[0], y[0], 0.3), (1.0, 0.2, -0.1, 2.0, 0.3, izz[0]), jm[0] * k[0] ** 2)
    link3 = (m3, (x3, y3, -0.2), (0.7, -0.1, 0.1, 0.5, 0.2, izz3), jm[1] * k[1] ** 2)
    exact = lagrange([(-np.pi / 2, 0, 0), (0, a, 0)], [link2, link3], (0, 0, -9.81))
    bodies = [Body(mass=b[0], com=b[1], inertia=b[2], rotor=b[3]) for b in (link2, link3)]
    close(puma().f(bodies), f)
    random = np.random.default_rng(0)
    for q, qd, qdd in random.uniform(-3, 3, (5, 3, 2)):
        close(puma().D(q, f), exact.D(q))
        close(column(puma().h(q, qd, f)), exact.h(q, qd))
        close(puma().Y(q, qd, qdd) @ f, exact.tau(q, qd, qdd)[:, None])


def test_two_bodies_joined_weigh_what_both_do():
    """A tool fixed to a link: energies add, so the standard parameters of the joined body are
    the sum.
    """
    random, (_, _, model) = np.random.default_rng(5), random_arm(1, 0)
    link, tool = random_body(random), random_body(random)
    close(model.f([link.joined(tool)]), model.f([link]) + model.f([tool]))


def test_equation_3_as_printed_swaps_the_motors():
    """With unequal motors only the corrected (3) gives the inertia that Lagrange's equations
    give.
    """
    jm, k, a = (1e-3, 1e-4), (107.8, -53.7), 0.4318
    bodies = [(10.0, (0.1, 0.05, 0.0), (0, 0, 0, 0, 0, 0.5), jm[0] * k[0] ** 2)]
    bodies += [(5.0, (0.02, -0.1, 0.0), (0, 0, 0, 0, 0, 0.2), jm[1] * k[1] ** 2)]
    exact = lagrange([(-np.pi / 2, 0, 0), (0, a, 0)], bodies, (0, 0, -9.81)).D((0.3, 0.4))
    physical = ((10.0, 5.0), (0.1, 0.02), (0.05, -0.1), (0.5, 0.2), jm, k, a)
    close(puma().D((0.3, 0.4), equation2.equation3(*physical)), exact)
    wrong = puma().D((0.3, 0.4), equation2.equation3(*physical, printed=True)).full()
    # [kg m^2]; the swapped motors differ by 9e-4 k^2 = 2.6 and 10.5
    assert abs(wrong - exact).max() > 1.0


# -- equation (2) --------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(10))
def test_puma_is_equation_2_corrected_for_any_f(seed):
    """All nine f independent, as the paper searches them; they need not be those of physical
    links.
    """
    random = np.random.default_rng(seed)
    f, (q, qd, qdd) = random.normal(size=9) * 3, random.uniform(-3, 3, (3, 2))
    D, h = equation2.D(q, f), equation2.C(q, qd, f) + equation2.G(q, f)
    close(puma().D(q, f), D)
    close(column(puma().h(q, qd, f)), h)
    close(puma().Y(q, qd, qdd) @ f, (D @ qdd + h)[:, None])


def equation_2_power(q, qd, f, printed):
    """qd' (Ddot qd - 2 c), zero for every matrix C with C qd = c that makes Ddot - 2 C skew."""
    # d/dq3 of 2 f3 c3 - 2 f4 s3, printed or not
    rate = -2 * f[2] * np.sin(q[1]) - 2 * f[3] * np.cos(q[1])
    Ddot = np.array([[rate, rate / 2], [rate / 2, 0.0]]) * qd[1]
    return qd @ (Ddot @ qd - 2 * equation2.C(q, qd, f, printed))


def test_equation_2_as_printed_breaks_skew_symmetry_and_forgets_f7():
    f, random = puma560.PUBLISHED, np.random.default_rng(0)
    more = f + 10 * (np.arange(9) == 6)
    for q, qd in random.uniform(-3, 3, (5, 2, 2)):
        # Corrected: sums of terms up to 2 f4 |qd|^3 = 100 W.
        assert abs(equation_2_power(q, qd, f, printed=False)) < 100 * 1e-14
        gap = 2 * f[3] * qd[1] * qd[0] ** 2 * (np.sin(q[1]) - np.cos(q[1]))
        assert equation_2_power(q, qd, f, printed=True) == pytest.approx(-gap, rel=1e-9)
        close(
            equation2.D(q, more, printed=True) - equation2.D(q, f, printed=True),
            np.zeros((2, 2)),
            scale=1,
        )
        close(puma().D(q, more) - puma().D(q, f), [[10, 0], [0, 0]])
    # [W], where the terms are of the order of 2 f4 qd2^2 qd3 = 4 W: no rounding.
    assert abs(equation_2_power((0.3, -0.8), (1.0, 1.5), f, printed=True)) > 1


def test_published_f_keeps_the_inertia_positive_definite():
    """ERRATA: smallest eigenvalue 0.77 over all q3 (0.7721 at q3 = 1.775)."""
    inertias = [
        puma().D([0, q3], puma560.PUBLISHED).full() for q3 in np.linspace(-np.pi, np.pi, 721)
    ]
    smallest = np.linalg.eigvalsh(inertias)[:, 0]
    # On a grid of half a degree the minimum is missed by less than 1e-4.
    assert min(smallest) == pytest.approx(0.7721, abs=1e-4)


# -- invariants ----------------------------------------------------------------------------------
@cache
def numeric_arm(name):
    """Dynamics, f and a function (q, qd, f) -> Ddot by casadi's directional derivative."""
    if name == "puma":
        model, f = puma(), puma560.PUBLISHED
    else:
        _, bodies, model = random_arm(int(name[0]), 7)
        f = model.f(bodies)
    q, qd, symbol = ca.SX.sym("q", model.n), ca.SX.sym("qd", model.n), ca.SX.sym("f", model.p)
    rate = ca.reshape(ca.jtimes(ca.vec(model.D(q, symbol)), q, qd), model.n, model.n)
    return model, f, ca.Function("Ddot", [q, qd, symbol], [rate])


@st.composite
def motions(draw, count):
    """An arm and `count` vectors per joint: q over more than a turn, rates and accelerations up
    to 5 in SI units.
    """
    model, f, rate = numeric_arm(draw(st.sampled_from(["puma", "1 link", "3 links"])))
    numbers = st.floats(-5, 5, allow_subnormal=False)
    vectors = [
        np.array(draw(st.lists(numbers, min_size=model.n, max_size=model.n))) for _ in range(count)
    ]
    return model, f, rate, *vectors


# Seeded: the same examples in every run.
invariant = settings(derandomize=True, deadline=None, max_examples=60, database=None)


@invariant
@given(motions(1))
def test_inertia_is_symmetric_and_positive_definite(motion):
    model, f, _, q = motion
    D = model.D(q, f).full()
    close(D, D.T)
    assert np.linalg.eigvalsh(D)[0] > 0.01  # the smallest motor inertia drawn; puma: 0.77


@invariant
@given(motions(2))
def test_rate_of_the_inertia_minus_twice_coriolis_is_skew(motion):
    model, f, rate, q, qd = motion
    C, Ddot = model.C(q, qd, f).full(), rate(q, qd, f).full()
    N = Ddot - 2 * C
    close(N, -N.T, scale=1e-9 + np.abs(C).max())


@invariant
@given(motions(2))
def test_bias_is_coriolis_plus_gravity(motion):
    model, f, _, q, qd = motion
    h, rest = column(model.h(q, qd, f)), column(model.h(q, 0 * qd, f))
    close(model.C(q, qd, f).full() @ qd + rest, h, scale=np.abs(h).max() + np.abs(rest).max())


@invariant
@given(motions(3))
def test_torque_is_regressor_times_f(motion):
    model, f, _, q, qd, qdd = motion
    Y, D, h = model.Y(q, qd, qdd).full(), model.D(q, f).full(), column(model.h(q, qd, f))
    close(Y @ f, D @ qdd + h, scale=(np.abs(Y) @ np.abs(f)).max())


@invariant
@given(motions(4))
def test_four_argument_regressor_is_the_torque_of_passivity_based_laws(motion):
    model, f, _, q, qd, qd_r, qdd_r = motion
    Y = model.Y(q, qd, qd_r, qdd_r).full()
    D, C, gravity = model.D(q, f).full(), model.C(q, qd, f).full(), column(model.h(q, 0 * qd, f))
    scale = (np.abs(Y) @ np.abs(f)).max()
    close(Y @ f, D @ qdd_r + C @ qd_r + gravity, scale)
    # Column by column: with qd_r = qd and qdd_r = qdd it is the ordinary regressor.
    ordinary = model.Y(q, qd, qdd_r).full()
    close(model.Y(q, qd, qd, qdd_r), ordinary, scale=1 + np.abs(ordinary).max())


@invariant
@given(motions(3))
def test_forward_of_inverse_is_the_identity(motion):
    model, f, _, q, qd, qdd = motion
    arm = model.arm(f)
    D, tau = arm.D(q), arm.inverse(q, qd, qdd)
    # Solving with D loses its condition number (below 1e4 here) of the torque's rounding, 1e-16 of
    # its terms.
    terms = (
        np.abs(D).max() * (1 + np.abs(qdd).max()) + np.abs(tau).max() + np.abs(arm.h(q, qd)).max()
    )
    close(
        arm.forward(q, qd, tau),
        qdd,
        scale=1,
        tolerance=1e-14 * terms * np.linalg.norm(np.linalg.inv(D)),
    )


@invariant
@given(motions(3))
def test_power_of_the_torque_beyond_gravity_is_the_rate_of_kinetic_energy(motion):
    model, f, rate, q, qd, qdd = motion
    D, h, gravity = model.D(q, f).full(), column(model.h(q, qd, f)), column(model.h(q, 0 * qd, f))
    terms = [qd @ D @ qdd, qd @ h, qd @ gravity, qd @ rate(q, qd, f).full() @ qd / 2]
    power, kinetic = terms[0] + terms[1] - terms[2], terms[0] + terms[3]
    # Products of three vectors: the terms may cancel inside as well, so measure them by norms.
    scale = np.linalg.norm(qd) * (
        np.linalg.norm(D) * np.linalg.norm(qdd) + np.linalg.norm(h) + np.linalg.norm(gravity)
    )
    close(power, kinetic, scale=scale)


# -- another engine ------------------------------------------------------------------------------
def test_six_joint_chain_agrees_with_pinocchio():
    pin = pytest.importorskip("pinocchio")
    from pinocchio_arm import pinocchio_model

    chain, bodies, model = random_arm(6, 3)
    other = pinocchio_model(chain, bodies)
    data, f, rotors = other.createData(), model.f(bodies), np.array([body.rotor for body in bodies])
    random = np.random.default_rng(0)
    # pinocchio works with rotations, not with sines and cosines of q: 1e-10 is generous for six
    # joints.
    for q, qd, qdd in random.uniform(-3, 3, (5, 3, 6)):
        D = pin.crba(other, data, q)
        D = np.triu(D) + np.triu(D, 1).T + np.diag(rotors)
        tau = pin.rnea(other, data, q, qd, qdd) + rotors * qdd
        close(model.D(q, f), D, tolerance=1e-10)
        close(column(model.h(q, qd, f)), tau - D @ qdd, scale=np.abs(tau).max(), tolerance=1e-10)
        close(model.arm(f).inverse(q, qd, qdd), tau, tolerance=1e-10)
        close(model.arm(f).forward(q, qd, tau), qdd, tolerance=1e-10)


# -- bad input -----------------------------------------------------------------------------------
Q = (0.1, 0.2)
F = tuple(puma560.PUBLISHED)


@pytest.mark.parametrize(
    ("call", "expected", "given_"),
    [
        pytest.param(lambda: puma().D(Q, F[:8]), r"\(9,\)", r"\(8,\)", id="f too short"),
        pytest.param(lambda: puma().h(Q, Q, (*F, 0.0)), r"\(9,\)", r"\(10,\)", id="f too long"),
        pytest.param(lambda: puma().D(np.array([Q]), F), r"\(2,\)", r"\(1, 2\)", id="q transposed"),
        pytest.param(lambda: puma().D(0.1, F), r"\(2,\)", r"\(\)", id="q scalar"),
        pytest.param(lambda: puma().C(Q, 0.1, F), r"\(2,\)", r"\(\)", id="qd scalar"),
        pytest.param(
            lambda: puma().Y(Q, Q, (0.1, 0.2, 0.3)), r"\(2,\)", r"\(3,\)", id="qdd too long"
        ),
        pytest.param(lambda: puma().Y(Q, Q, Q, 0.1), r"\(2,\)", r"\(\)", id="qdd_r scalar"),
        pytest.param(lambda: puma().D((0.1, np.nan), F), "finite", "nan at index 1", id="q NaN"),
        pytest.param(lambda: puma().D(Q, (*F[:8], np.nan)), "finite", "nan at index 8", id="f NaN"),
        pytest.param(
            lambda: puma().h(Q, (np.inf, 0.0), F), "finite", "inf at index 0", id="qd infinite"
        ),
        pytest.param(lambda: puma().D(("a", "b"), F), r"numbers", "'a'", id="q text"),
        pytest.param(lambda: puma().arm(F[:8]), "9", "8", id="arm with f too short"),
        pytest.param(
            lambda: puma().arm((*F[:8], np.nan)), "must be", "(?i)nan", id="arm with f NaN"
        ),
        pytest.param(lambda: puma560.arm().D(0.1), r"\(2,\)", r"\(\)", id="arm, q scalar"),
        pytest.param(
            lambda: puma560.arm().h(Q, np.array([Q])),
            r"\(2,\)",
            r"\(1, 2\)",
            id="arm, qd transposed",
        ),
        pytest.param(
            lambda: puma560.arm().inverse(Q, Q, 0.1), r"\(2,\)", r"\(\)", id="arm, qdd scalar"
        ),
        pytest.param(
            lambda: puma560.arm().forward(Q, Q, (1.0, np.nan)),
            "finite",
            "nan at index 1",
            id="arm, tau NaN",
        ),
        pytest.param(
            lambda: puma560.arm().forward(Q, Q, 1.0), r"\(2,\)", r"\(\)", id="arm, tau scalar"
        ),
        pytest.param(lambda: puma().D(Q), r"q, f", "1", id="argument missing"),
        pytest.param(lambda: puma().Y(Q, Q), r"q, qd, qdd", "2", id="accelerations missing"),
    ],
)
def test_bad_input_is_refused_in_one_line_that_says_what_was_expected_and_given(
    call, expected, given_
):
    with pytest.raises(ValueError, match=expected) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert re.search(given_, message), message
    assert message.rstrip().endswith(".")  # the third part, what to do, is a sentence


def test_numpy_goes_in_and_casadi_comes_out():
    assert isinstance(puma().D(np.array(Q), np.array(F)), ca.DM)
    assert isinstance(puma().D(ca.SX.sym("q", 2), ca.SX.sym("f", 9)), ca.SX)
    arm = puma560.arm()
    assert [
        type(x) for x in (arm.D(Q), arm.h(Q, Q), arm.inverse(Q, Q, Q), arm.forward(Q, Q, Q))
    ] == [np.ndarray] * 4
