"""Sums in a fixed order: right, and the same bits for any number of threads of the linear
algebra library.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from plant.parts.sums import dot, least, norm, product, products, triangle

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("shape", [(5000, 7), (7, 7), (3, 7), (50, 1)])
def test_triangle_is_that_of_a_qr_decomposition(shape):
    """R^T R = A^T A, to a few roundings."""
    rows = RANDOM.normal(size=shape)
    R = triangle(rows)
    assert R.shape == (shape[1], shape[1])
    assert (np.tril(R, -1) == 0).all()
    np.testing.assert_allclose(R.T @ R, rows.T @ rows, atol=1e-13 * np.abs(rows.T @ rows).max())


def test_least_squares_are_numpy_s_also_where_columns_are_dependent():
    rows, target = RANDOM.normal(size=(400, 6)), RANDOM.normal(size=400)
    np.testing.assert_allclose(
        least(rows, target), np.linalg.lstsq(rows, target, rcond=None)[0], rtol=1e-11
    )
    rows[:, 4] = rows[:, 0] + rows[:, 1]
    rows[:, 5] = 0
    np.testing.assert_allclose(
        least(rows, target), np.linalg.lstsq(rows, target, rcond=None)[0], atol=1e-11
    )
    assert least(rows[:, :0], target).shape == (0,)
    # several targets at once, and fewer equations than unknowns
    targets = RANDOM.normal(size=(4, 3))
    np.testing.assert_allclose(
        least(rows[:4], targets), np.linalg.lstsq(rows[:4], targets, rcond=None)[0], atol=1e-11
    )
    np.testing.assert_array_equal(least(rows[:0], target[:0]), np.zeros(6))


def test_products_and_lengths():
    a, b = RANDOM.normal(size=(2, 1000))
    rows, columns = RANDOM.normal(size=(30, 4)), RANDOM.normal(size=(4, 3))
    assert dot(a, b) == pytest.approx(a @ b, rel=1e-12)
    assert norm(rows) == pytest.approx(np.linalg.norm(rows), rel=1e-14)
    np.testing.assert_allclose(product(rows, columns), rows @ columns, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        product(rows, columns[:, 0]), rows @ columns[:, 0], rtol=1e-12, atol=1e-14
    )


@pytest.mark.parametrize("shape", [(3000, 21), (50, 8), (5, 1), (4, 0)])
def test_products_of_columns_are_summed_once_in_the_order_of_all(shape):
    for rows in (RANDOM.normal(size=shape), RANDOM.normal(size=shape[::-1]).T):
        np.testing.assert_array_equal(products(rows), np.einsum("mi,mj->ij", rows, rows))


SCRIPT = """
from identification import identify
from plant import puma560, simulate
from plant.parts.saved import fingerprint
rig = puma560.rig()
record = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), steps_per_sample=4)
found = identify(puma560.dynamics(), record, seed=1, method="prediction_error", progress=False)
print(fingerprint(found), found.covariance.tobytes().hex()[:400])
"""


def test_an_identification_has_the_same_bits_for_any_number_of_threads():
    """5,215 samples: long enough for the library to share its products out."""
    said = []
    for threads in ("1", "2"):
        done = subprocess.run(  # noqa: S603 - the script above
            [sys.executable, "-c", SCRIPT],
            env={
                **os.environ,
                "OPENBLAS_NUM_THREADS": threads,
                "PYTHONPATH": str(Path(__file__).parents[3]),
            },
            capture_output=True,
            text=True,
            check=True,
        )
        said.append(done.stdout)
    assert said[0] == said[1]
