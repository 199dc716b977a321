"""The paper's closed loop by every engine, side by side.

    python -m pytest -o addopts="" tests/benchmarks/bench_engine.py

Times are per call; `per_simulation_ms` in the extra information is per individual. What is asserted is that all give
the same answers; what it means for a reader is the table that speed.py makes.
"""

import numpy as np
import pytest
from opponents import Experiment, all_engines

EXPERIMENT = Experiment()
ENGINES = all_engines(EXPERIMENT)
POPULATION = EXPERIMENT.candidates(80)
EXPECTED = ENGINES["scalar numba loop"][0](POPULATION)


@pytest.mark.parametrize("name", ENGINES)
def test_population(benchmark, name):
    engine, count = ENGINES[name]
    benchmark.group = "trajectory (6), 5215 samples, 4 sub-steps, 3 friction sweeps"
    costs = benchmark(engine, POPULATION[:count])
    benchmark.extra_info["per_simulation_ms"] = benchmark.stats["median"] / count * 1e3
    # Engines round differently, and through the encoder a rounding moves a cost by some 0.3 % (median), at most 5 %.
    off = np.abs(costs / EXPECTED[:count] - 1)
    assert np.median(off) < 0.02
    assert off.max() < 0.1
    if name.startswith(("engine", "kernel", "scalar numba")):
        np.testing.assert_array_equal(costs, EXPECTED[:count])
