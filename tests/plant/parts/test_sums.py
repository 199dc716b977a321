"""Sums in a fixed order: right, and the same bits for any number of threads of the linear
algebra library.
"""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from plant.parts import dot, least, norm, one_thread, product, products, triangle

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
def test_products_of_columns_are_exact_where_sums_are_and_symmetric(shape):
    """Whole numbers have no rounding; of others both triangles have the same bits."""
    for rows in (RANDOM.integers(-99, 99, shape), RANDOM.integers(-99, 99, shape[::-1]).T):
        np.testing.assert_array_equal(products(rows.astype(float)), rows.T @ rows)
        uneven = products(rows / 7)
        np.testing.assert_array_equal(uneven, uneven.T)


def blas_threads():
    """Threads of each linear algebra library that is loaded."""
    pools = ThreadpoolController().info()
    return [pool["num_threads"] for pool in pools if pool["user_api"] == "blas"]


def test_the_linear_algebra_library_has_one_thread_inside_and_its_own_number_afterwards():
    """Also of contexts inside each other, after an error, and in the checkup of a log."""
    with ThreadpoolController().limit(limits=2, user_api="blas"):
        if 2 not in blas_threads():
            pytest.skip("a library with a single thread")
        with one_thread:
            with one_thread:
                assert set(blas_threads()) == {1}
            assert set(blas_threads()) == {1}
        assert 2 in blas_threads()
        with pytest.raises(ZeroDivisionError), one_thread:
            1 / 0  # noqa: B018 - it raises
        assert 2 in blas_threads()


@pytest.mark.parametrize("threads", [1, 4])
def test_threads_that_enter_in_turns_leave_the_number_as_it_was(threads):
    """The first to enter is not the last to leave."""
    with ThreadpoolController().limit(limits=2, user_api="blas"):
        before = blas_threads()
        barrier = threading.Barrier(threads)

        def work(i):
            for _ in range(20):
                barrier.wait()
                with one_thread:
                    time.sleep(1e-4 * i)
                    assert set(blas_threads()) == {1}
            return True

        with ThreadPoolExecutor(threads) as pool:
            assert all(pool.map(work, range(threads)))
        assert blas_threads() == before


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
