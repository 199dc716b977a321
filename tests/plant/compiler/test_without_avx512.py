"""The kernels of a processor without AVX-512, forced in a child process, against those of the
processor that is there.

Without it the sine is another one, a limit is two choices, and vectors are half as long. Where
there is no AVX-512 both are the same, and so are the results.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from plant.compiler import AVX512_VARIABLE, CACHE_VARIABLE

ROOT = Path(__file__).resolve().parents[3]

RUN = """
import sys
import numpy as np
import pytest
from numba.core.registry import cpu_target
from identification import Objective
from plant import puma560, simulate

arm, random = puma560.arm(), np.random.default_rng(0)
record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.7)
candidates = arm.f * (1 + 0.1 * random.normal(size=(80, arm.dynamics.p)))
costs = Objective(arm.dynamics, record)(candidates)
wide = "+avx512f" in cpu_target.target_context.codegen().magic_tuple()[2].split(",")
np.savez(sys.argv[1], counts=record.counts, true=record.rig.position_in_pulses(record.true_q), costs=costs, wide=wide)
"""


def child(cache, without, *command):
    """Run Python without AVX-512, or as usual."""
    environment = os.environ | {
        AVX512_VARIABLE: str(int(without)),
        CACHE_VARIABLE: str(cache),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(  # noqa: S603 - the commands are those below
        [sys.executable, *command],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_counts_and_costs_are_the_same_and_true_positions_agree(tmp_path):
    """With one cache folder for both: other bits on another path show that neither runs the code
    of the other.
    """
    cache = tmp_path / "kernels"
    for without in (True, False):
        child(cache, without, "-c", RUN, tmp_path / f"{without}.npz")
    narrow, usual = (np.load(tmp_path / f"{without}.npz") for without in (True, False))
    assert not narrow["wide"]
    np.testing.assert_array_equal(narrow["counts"], usual["counts"])
    # A cost is a sum of squares of whole pulses: the same unless a count differs.
    assert np.isfinite(usual["costs"]).any()
    np.testing.assert_array_equal(narrow["costs"], usual["costs"])
    # Both sines err by less than 3e-15 (test_translate): so far a rounding of the position (4e-12
    # pulses); over all of (6) sticking and sliding make 3e-8 pulses of it.
    np.testing.assert_allclose(narrow["true"], usual["true"], rtol=0, atol=1e-7)
    assert np.array_equal(narrow["true"], usual["true"]) == (not usual["wide"])


@pytest.mark.slow
def test_translation_and_machine_code_pass_without_avx512(tmp_path):
    """Sine and cosine against mpmath, every operation against casadi, vectors and calls in the
    loop of a population.
    """
    tests = [Path(__file__).with_name(f"test_{name}.py") for name in ("translate", "assembly")]
    child(tmp_path / "kernels", True, "-m", "pytest", "-p", "no:cacheprovider", *tests)
