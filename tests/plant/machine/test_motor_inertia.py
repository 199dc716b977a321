"""The margin of D(q) over the motors' own inertia, against eigenvalues on a fine grid."""

import numpy as np
import pytest
from random_arms import random_arm

from plant import Coupling, puma560
from plant.machine import LEAST_MOTOR_INERTIA, least_inertia_margin, require_inertia

DYNAMICS, RIG = puma560.dynamics(), puma560.rig()
LEAST = LEAST_MOTOR_INERTIA * RIG.drive.motor_inertia * RIG.drive.gear**2


def smallest_eigenvalue(f):
    """Of D(q) - diag(Jm_min k^2) over 720 angles of joint 3 (D depends on no other), by numpy."""
    q3 = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    q = np.vstack([np.zeros_like(q3), q3])
    D = DYNAMICS.D.map(len(q3))(q, np.repeat(np.asarray(f)[:, None], len(q3), axis=1)).full()
    D = D.reshape(2, len(q3), 2).transpose(1, 0, 2)
    return np.linalg.eigvalsh(D - np.diag(LEAST)).min()


def test_sign_agrees_with_eigenvalues_for_random_candidates():
    random = np.random.default_rng(0)
    low, high = np.array(puma560.PRINTED_RANGES).T
    f = random.uniform(low, high, (200, 9))
    f[:50] = puma560.PUBLISHED * random.uniform(0.5, 1.5, (50, 9))
    margins = least_inertia_margin(DYNAMICS, RIG, f)
    eigenvalues = np.array([smallest_eigenvalue(row) for row in f])
    # The grids miss the worst angle by 0.25 and 0.5 deg, where D changes by less than 4e-5 of its
    # range.
    clear = np.abs(eigenvalues) > 1e-2
    assert clear.sum() > 185
    assert (np.sign(margins[clear]) == np.sign(eigenvalues[clear])).all()
    assert (margins[clear] > 0).sum() > 30
    assert (margins[clear] < 0).sum() > 30


def test_positive_margin_is_the_smallest_pivot():
    """Pivots of a positive definite (2, 2) matrix: M11, and det M / M11."""
    q3 = np.arange(360) * np.pi / 180
    f1, f2, f3, f4, f7 = puma560.PUBLISHED[[0, 1, 2, 3, 6]]
    c, s = np.cos(q3), np.sin(q3)
    M11, M12, M22 = f7 + 2 * f3 * c - 2 * f4 * s - LEAST[0], f2 + f3 * c - f4 * s, f1 - LEAST[1]
    expected = np.minimum(M11, M22 - M12**2 / M11).min()
    got = least_inertia_margin(DYNAMICS, RIG, puma560.PUBLISHED[None])
    # 1e-15 times a loss of three digits in the subtraction
    np.testing.assert_allclose(got, [expected], rtol=1e-12)


def test_published_and_literature_arms_pass():
    for arm in (puma560.arm(), puma560.literature_arm()):
        require_inertia(arm, RIG)  # raises where the margin is negative
        assert least_inertia_margin(arm.dynamics, RIG, arm.f[None])[0] > 0


@pytest.mark.parametrize(("index", "value"), [(0, 0.1), (6, 1.0), (1, 5.0), (0, np.nan)])
def test_impossible_arm_is_refused_in_one_line(index, value):
    f = puma560.PUBLISHED.copy()
    if np.isnan(value):
        f[index] = value
        assert not least_inertia_margin(DYNAMICS, RIG, f[None])[0] >= 0
        return
    f[index] = value
    assert smallest_eigenvalue(f) < 0
    with pytest.raises(
        ValueError,
        match=r"D\(q\) must exceed the motors' own inertia .* falls short by [\d.e+-]+ kg m\^2",
    ) as error:
        require_inertia(DYNAMICS.arm(f), RIG)
    assert "\n" not in str(error.value)


def test_no_candidates_give_no_margins():
    assert least_inertia_margin(DYNAMICS, RIG, np.empty((0, 9))).shape == (0,)


def test_three_joints_are_looked_at_all_over():
    """D of a longer chain depends on several joints: a Sobol sequence, not a grid."""
    _, bodies, dynamics = random_arm(3, 0)
    f = dynamics.f(bodies)

    class Unloaded:
        class drive:
            motor_inertia, coupling = np.zeros(3), Coupling()

            @staticmethod
            def reflected_inertia(jm):
                return np.zeros(3)

    random = np.random.default_rng(1)
    heavier = f.copy()
    heavier[dynamics.names.index("J1")] -= 1e3  # no link has such an inertia
    margins = least_inertia_margin(dynamics, Unloaded, np.array([f, heavier]))
    smallest = min(
        np.linalg.eigvalsh(dynamics.D(q, f).full()).min()
        for q in random.uniform(-np.pi, np.pi, (200, 3))
    )
    assert smallest > 0
    assert margins[0] > 0
    assert margins[1] < 0
