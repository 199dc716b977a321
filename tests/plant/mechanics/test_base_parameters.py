"""Base parameters: their number against the literature and against numpy's rank, and the same
motion as before.
"""

import numpy as np
import pytest
from packaged_arms import planar, tx40
from packaged_arms import puma560 as whole_puma560
from random_arms import random_body, random_chain

from plant import Chain, Dynamics, Harmonics, Link, Lumping, puma560, visibility
from plant.mechanics import STANDARD, base_lumping, standard_parameters


def links_2_and_3():
    return puma560.dynamics().chain


@pytest.mark.parametrize(
    ("chain", "rotors", "count"),
    [
        # Gautier and Khalil 1990: 36 for the whole PUMA 560 without motor inertias. Four of these
        # join no other parameter's column: those of joints 3 to 6; the first two are one with Izz1
        # and Izz2.
        (whole_puma560, False, 36),
        (whole_puma560, True, 40),
        (links_2_and_3, False, 6),
        # the paper has 9 because it does not take the length of the link for known
        (links_2_and_3, True, 7),
        (lambda: planar(1), False, 3),
        (lambda: planar(3), False, 9),
        (lambda: planar(3), True, 11),
        (tx40, True, 40),
    ],
)
def test_number_of_base_parameters_is_the_literature_s(chain, rotors, count):
    assert len(base_lumping(chain(), rotors=rotors).names) == count


@pytest.mark.parametrize(
    ("n", "seed"),
    [(1, 0), (2, 1), (3, 2), (4, 3), (6, 4), pytest.param(7, 5, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("frames", [False, True])
def test_base_parameters_move_the_arm_as_the_standard_ones_do(n, seed, frames):
    chain = random_chain(n, seed, frames=frames)
    base, standard = (
        Dynamics.from_chain(chain),
        Dynamics(chain=chain, lumping=Lumping.standard(chain)),
    )
    random = np.random.default_rng(0)
    stacked = []
    for q, qd, qdd in random.uniform(-2, 2, (4 * len(STANDARD), 3, n)):
        expected = standard.arm(standard.f()).inverse(q, qd, qdd)
        got = base.arm(base.f()).inverse(q, qd, qdd)
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(
            base.Y(q, qd, qdd).full() @ base.f(), got, atol=1e-12 * np.abs(got).max()
        )
        stacked.append(standard.Y(q, qd, qdd).full())
    # as few as numpy finds, by singular values
    assert base.p == np.linalg.matrix_rank(np.vstack(stacked), tol=1e-6)


def test_paper_s_lumping_and_the_base_parameters_are_one_motion():
    """Nine named parameters or seven: on a physical arm f3 = a3 f5 and f4 = a3 f6, and both give
    one torque.
    """
    paper, base = puma560.dynamics(), Dynamics.from_chain(links_2_and_3())
    random = np.random.default_rng(3)
    bodies = tuple(random_body(random) for _ in range(2))
    for q, qd, qdd in random.uniform(-2, 2, (20, 3, 2)):
        one = paper.arm(paper.f(bodies)).inverse(q, qd, qdd)
        other = base.arm(base.f(bodies)).inverse(q, qd, qdd)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10 * np.abs(one).max())


def test_names_say_what_joins_what():
    names = base_lumping(links_2_and_3()).names
    assert names == (
        "mx2 + a3 m3", "my2", "J2 + Izz2 + a3^2 m3", "mx3", "my3", "Izz3", "J3",
    )  # fmt: skip
    whole = base_lumping(whole_puma560(), rotors=False).names
    assert "Ixz2 - a3 d3 m3 - a3 mz3 - a3 d3 m4 - a3 d3 m5 - a3 d3 m6" in whole
    assert whole[0].startswith("Izz1 + Iyy2 + (a3^2 + d3^2) m3 + 2 d3 mz3 + Iyy3")
    assert whole[-7:] == ("mx6", "my6", "Ixx6 - Iyy6", "Ixy6", "Ixz6", "Iyz6", "Izz6")


def test_names_and_matrix_say_the_same():
    """Each name, read as a formula, is its row of B."""
    chain = Chain(
        links=(
            Link(name="1"),
            Link(name="2", alpha=np.pi / 2, a=0.3, d=0.2),
            Link(name="3", a=0.7, d=0.1),
        )
    )
    lumping = base_lumping(chain)
    random = np.random.default_rng(0)
    pi = random.normal(size=len(STANDARD) * 3)
    known = {
        f"{name}{link + 1}": pi[len(STANDARD) * link + i]
        for link in range(3)
        for i, name in enumerate(STANDARD)
    }
    known |= {"a2": 0.3, "d2": 0.2, "a3": 0.7, "d3": 0.1}
    for name, row in zip(lumping.names, lumping.matrix, strict=True):
        formula = name.replace("^", "**").replace(" - ", "-").replace(" + ", "+").replace(" ", "*")
        # our own names
        np.testing.assert_allclose(eval(formula, {}, known), row @ pi, rtol=1e-3)  # noqa: S307


def test_bodies_without_known_masses_are_asked_for():
    with pytest.raises(ValueError, match=r"this chain has none"):
        Dynamics.from_chain(tx40()).f()


def test_whole_puma_560_is_the_one_of_the_literature():
    """Inertia and gravity at the nominal pose, as printed in the manual of the Robotics Toolbox
    for its puma560.
    """
    dynamics = Dynamics.from_chain(whole_puma560())
    arm, pose = dynamics.arm(dynamics.f()), [0, np.pi / 4, np.pi, 0, np.pi / 4, 0]
    expected = np.diag([3.6594, 4.4137, 0.9378, 0.1925, 0.1713, 0.1941])
    for i, j, value in (
        (0, 1, -0.4044),
        (0, 2, 0.1006),
        (0, 3, -0.0025),
        (1, 2, 0.3509),
        (1, 4, 0.0024),
        (2, 4, 0.0015),
    ):
        expected[i, j] = expected[j, i] = value
    np.testing.assert_allclose(arm.D(pose), expected, atol=6e-5)
    np.testing.assert_allclose(
        arm.h(pose, np.zeros(6)), [0, 31.6399, 6.0351, 0, 0.0283, 0], atol=6e-5
    )


def test_planar_chain_of_two_links_is_the_textbook_s():
    """Two rods: D11 = (4/3 + 1) m l^2 + m l^2 cos q2 + ..., at q2 = 0 and a right angle."""
    chain = planar(2, length=0.5, mass=3.0, rotor=0.0)
    dynamics = Dynamics.from_chain(chain)
    arm, unit = dynamics.arm(dynamics.f()), 3.0 * 0.5**2
    for q2 in (0.0, np.pi / 2):
        one, coupled = 1 / 3, np.cos(q2) / 2
        expected = unit * np.array(
            [[2 * one + 1 + 2 * coupled, one + coupled], [one + coupled, one]]
        )
        np.testing.assert_allclose(arm.D([0.3, q2]), expected, atol=1e-12)
    level = 3.0 * 9.81 * 0.5
    np.testing.assert_allclose(arm.h([0, 0], [0, 0]), [level * 2, level / 2], atol=1e-12)


def test_bodies_are_moved_from_their_frames_to_their_links():
    chain = random_chain(3, 8, frames=True)
    dynamics = Dynamics(chain=chain, lumping=Lumping.standard(chain))
    in_place = [
        body.seen_from(link.frame) for body, link in zip(chain.bodies, chain.links, strict=True)
    ]
    np.testing.assert_array_equal(dynamics.f(), standard_parameters(in_place))


def test_paper_s_motion_shows_all_nine():
    seen = visibility(puma560.dynamics(), puma560.reference())
    assert seen.combinations == puma560.dynamics().names
    assert seen.invisible == ()
    assert 10 < seen.condition < 1000


def test_a_joint_that_stands_still_hides_and_joins_parameters():
    """Joint 3 at rest, joint 2 turning: what only moves with joint 3 stays hidden, the rest
    joins.
    """
    still = Harmonics(
        period=2.0, offset=(0.0, 0.3), cosine=((1.0, 0.5), (0, 0)), sine=((0.3, 0.1), (0, 0))
    )
    dynamics = puma560.dynamics()
    seen = visibility(dynamics, still)
    f = puma560.PUBLISHED.copy()
    assert "f1" not in seen.combinations
    # What is said not to show does not: changing it leaves every torque of this motion as it was.
    motion = still(np.linspace(0, 2, 50))
    for name in seen.invisible:
        changed = f.copy()
        changed[dynamics.names.index(name)] += 1
        for state in zip(*motion, strict=True):
            np.testing.assert_allclose(dynamics.Y(*state).full() @ (changed - f), 0, atol=1e-12)
    joined = [name for name in seen.combinations if " " in name]
    assert joined
    assert "not identifiable" in str(seen) or not seen.invisible
    assert str(len(seen.combinations)) in str(seen)


def test_combinations_are_what_the_torque_depends_on():
    """The torque of the motion from the combinations alone."""
    still = Harmonics(
        period=2.0, offset=(0.1, 0.3), cosine=((1.0, 0.5), (0, 0)), sine=((0.3, 0.1), (0, 0))
    )
    dynamics, random = puma560.dynamics(), np.random.default_rng(0)
    seen = visibility(dynamics, still)
    rows = []
    for name in seen.combinations:
        own, *rest = name.split(" ")
        row = np.zeros(9)
        row[dynamics.names.index(own)] = 1.0
        for sign, factor, other in zip(rest[::3], rest[1::3], rest[2::3], strict=True):
            row[dynamics.names.index(other)] = float(sign + factor)
        rows.append(row)
    rows = np.array(rows)
    hidden = np.linalg.svd(rows)[2][len(rows) :]  # changes of f that leave all combinations alone
    assert len(hidden) == 9 - len(rows)
    for state in zip(*still(random.uniform(0, 2, 20)), strict=True):
        # four digits are printed
        np.testing.assert_allclose(dynamics.Y(*state).full() @ hidden.T, 0, atol=5e-3)
