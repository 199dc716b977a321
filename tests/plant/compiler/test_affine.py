"""Affine arithmetic holds what a function gives anywhere in its ranges, and is exact where it is
linear.
"""

import casadi as ca
import numpy as np
import pytest

from plant.compiler.affine import Affine, Arithmetic

X = ca.SX.sym("x", 3)
A, B, C = ca.vertsplit(X)
FUNCTIONS = {
    "smooth": (
        ca.sin(A) * ca.exp(B) / (3 + C**2)
        + ca.cos(A + B) * ca.sqrt(3 + C)
        - ca.tanh(A) / (2 + ca.cos(B))
    ),
    "clip": ca.fmin(ca.fmax(A + B, -0.2), 0.2) + 2 * C,
    "clip of two": ca.fmin(ca.fmax(A, C - 0.5), C + 0.5),
    "larger": ca.fmax(A * B, C) - ca.fmin(A, 0.1),
    "steps": ca.floor(3 * A) + ca.copysign(ca.floor(ca.fabs(5 * B)), 5 * B) * C,
    "sign": ca.fabs(A) * ca.sign(B) + ca.sign(C),
    "choice": (
        ca.if_else(B > 0.1, A, C**2)
        + ca.logic_or(A > 0, C <= 0)
        - ca.logic_and(A < 0, ca.logic_not(B < 0))
    ),
    "equal": ca.if_else(A == 0.25, B, C) + (ca.SX(1) * (A != B)),
}


def ranges(seed, count):
    """Centres and sizes, some of them zero."""
    random = np.random.default_rng(seed)
    sizes = random.uniform(0, 0.6, (count, 3)) * (random.random((count, 3)) > 0.25)
    return random, random.normal(0, 0.8, (count, 3)), sizes


@pytest.mark.parametrize("name", FUNCTIONS)
def test_all_of_a_range_is_held(name):
    count, function = 200, ca.Function("f", [X], [FUNCTIONS[name]])
    random, centres, sizes = ranges(1, count)
    centres[:5, 0] = 0.25  # where a comparison is met exactly
    arithmetic = Arithmetic(sizes)
    inputs = [Affine(centres[:, i], np.tile(np.eye(3)[i], (count, 1))) for i in range(3)]
    (got,) = arithmetic(function, [inputs])
    slopes = np.zeros((count, arithmetic.sizes.shape[1]))
    slopes[:, : got.slopes.shape[1]] = got.slopes
    rest = np.abs(slopes[:, 3:]).sum(axis=1) + got.remainder
    largest = np.zeros(count)
    for trial in range(2000):
        moved = (
            random.uniform(-1, 1, (count, 3))
            if trial % 2
            else random.choice((-1.0, 0.0, 1.0), (count, 3))
        )
        moved = sizes * moved
        true = function.map(count)((centres + moved).T).full()[0]
        off = np.abs(true - got.value - (slopes[:, :3] * moved).sum(axis=1))
        assert (off <= rest + 1e-12).all()
        largest = np.maximum(largest, off)
    wide = rest > 1e-6
    assert np.median(largest[wide] / rest[wide]) > 0.3  # it is no bound of another size


def test_what_is_linear_is_exact():
    function = ca.Function(
        "f", [X], [2 * A - (B + C) / 4 + ca.fmax(A, A - 1) + ca.fmin(ca.fmax(B, -9), 9)]
    )
    _, centres, sizes = ranges(2, 50)
    (got,) = Arithmetic(sizes + 0.1)(
        function, [[Affine(centres[:, i], np.tile(np.eye(3)[i], (50, 1))) for i in range(3)]]
    )
    np.testing.assert_allclose(got.slopes[:, :3], np.tile((3, 0.75, -0.25), (50, 1)), atol=1e-14)
    assert np.abs(got.slopes[:, 3:]).sum() + np.abs(got.remainder).sum() < 1e-12


def test_an_operation_without_a_range_is_refused():
    function = ca.Function("f", [X], [ca.atan2(A, B)])
    with pytest.raises(ValueError, match="operation must have a range; got ATAN2"):
        Arithmetic(np.ones((1, 3)))(function, [[Affine(np.ones(1), np.eye(3)[:1])] * 3])
