"""The machine code of the lane loop: every way of losing vectorisation is silent, so it is read."""

import re
import types

import casadi as ca
import numpy as np
import pytest
from numba.core.registry import cpu_target

from identification.replay import squared_error
from plant import P, puma560
from plant.simulation import LANES, ClosedLoop, LoopKernel

FEATURES = cpu_target.target_context.codegen().magic_tuple()[2].split(",")
VECTOR = "zmm" if "+avx512f" in FEATURES else "ymm"

pytestmark = pytest.mark.skipif("+avx2" not in FEATURES, reason="no x86 processor with AVX2")


def assembly(loop):
    """Machine code of the population kernel, and its source, compiled here and now."""
    kernel = LoopKernel(loop, range(loop.dynamics.p))
    program = kernel.program("population")
    source = program.kernel.source.replace("cache=True, ", "")
    module = types.ModuleType("kernel")
    exec(source, module.__dict__)  # noqa: S102 - the generator's own text
    function = getattr(module, f"population_{program.kernel.hash}")
    table = empty = np.zeros((0, 0))
    memory = np.zeros((program.rows, LANES))
    uniform = np.ones(len(kernel.uniform) + 1)
    function(memory, uniform, table, table, table, table, empty, empty, 0)
    return (
        next(iter(function.inspect_asm().values())),
        source[source.index("def population_step_0") : source.rindex("@compiled")],
    )


def loops(code):
    """All loops of a function as lists of instructions: from a label to the last jump back to
    it.
    """
    lines = [line.strip() for line in code.splitlines() if line.strip()]
    labels = {
        line[:-1]: i
        for i, line in enumerate(lines)
        if line.startswith(".LBB") and line.endswith(":")
    }
    found = {}
    for i, line in enumerate(lines):
        jump = re.match(r"j\w+\s+(\.LBB\w+)", line)
        if jump and labels.get(jump[1], i) < i:
            found[labels[jump[1]]] = i
    return [(start, end, lines[start : end + 1]) for start, end in found.items()]


def judged(code):
    """What the time loop is made of: calls; scalar arithmetic in its inner loops; vector and
    fused instructions.
    """
    every = loops(code)
    start, end, time_loop = max(every, key=lambda loop: sum(VECTOR in line for line in loop[2]))
    inner = [line for s, e, lines in every if start < s and e < end for line in lines]
    return {
        "calls": [line for line in time_loop if re.match(r"call", line)],
        "scalar": [
            line for line in inner if re.match(r"v\w+sd\s", line) and "broadcast" not in line
        ],
        "vector": sum(VECTOR in line and bool(re.match(r"v\w+pd\s", line)) for line in time_loop),
        "fused": sum(
            VECTOR in line and bool(re.match(r"vfn?m\w+pd\s", line)) for line in time_loop
        ),
        "memory": len(re.findall(r"v(?:gather|scatter)", "\n".join(time_loop))),
    }


def paper_loop(law=None):
    return ClosedLoop(
        dynamics=puma560.dynamics(),
        rig=puma560.rig(),
        law=law or puma560.p_law(),
        steps_per_sample=4,
        score=squared_error(2),
    )


def test_lane_loop_is_made_of_vectors_and_fused_instructions_and_calls_nothing():
    code, source = assembly(paper_loop())
    found = judged(code)
    assert found["calls"] == []
    assert found["scalar"] == []
    assert found["memory"] == 0
    in_source = len(re.findall(r"e\.(?:fma|fms|fnma)\(", source)) + 14 * source.count("e.sincos(")
    assert in_source > 60
    assert found["fused"] >= in_source
    assert found["vector"] > 2 * in_source


def test_what_cannot_be_vectorised_is_found_out():
    class Power(P):
        def equations(self, rig, state, setpoint, pulses, torque, dt):
            asked, state = super().equations(rig, state, setpoint, pulses, torque, dt)
            return asked * ca.fabs(setpoint.pulses - pulses + 2) ** 0.3, state

    found = judged(assembly(paper_loop(Power(gain=(0.2, 0.15))))[0])
    assert found["calls"]
