"""The paper's closed loop by every engine, side by side.

    python -m pytest -o addopts="" tests/benchmarks/bench_engine.py

Times are per call, for the number of individuals that stands in the name; per individual they are
in the extra information `per_simulation_ms` (``--benchmark-json=...``). What is asserted is that
all give the same answers; what it means for a reader is the table that speed.py makes.
"""

import numpy as np
import pytest
from opponents import Experiment, all_engines

EXPERIMENT = Experiment()
ENGINES = all_engines(EXPERIMENT)
POPULATION = EXPERIMENT.candidates(80)
EXPECTED = ENGINES["scalar numba loop"][0](POPULATION)


@pytest.mark.parametrize(("name", "count"), [(name, count) for name, (_, count) in ENGINES.items()])
def test_individuals(benchmark, name, count):
    engine, _ = ENGINES[name]
    benchmark.group = "trajectory (6), 5215 samples, 4 sub-steps, 3 friction sweeps"
    costs = benchmark(engine, POPULATION[:count])
    benchmark.extra_info["per_simulation_ms"] = benchmark.stats["median"] / count * 1e3
    # Engines round differently; where that tips a count over, a cost moves by some 0.2 %. Most do
    # not move at all.
    off = np.abs(costs / EXPECTED[:count] - 1)
    assert np.median(off) == 0
    assert off.max() < 0.02
    if name.startswith(("engine", "kernel", "scalar numba")):
        np.testing.assert_array_equal(costs, EXPECTED[:count])
