"""How fast the engine is, and what its settings cost: every number of docs/background/speed.md,
measured in one go.

    python tests/benchmarks/speed.py [--write] [--quick]

With --write the tables replace those in docs/background/speed.md. Engines take turns, round after
round, so that a noisy machine disturbs all of them alike; ratios are medians over the rounds.
"""

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import any_arm
import c_loops
import numpy as np
import six_joints
from opponents import Engine, Experiment, Kernel, all_engines

from identification import Objective, identify
from plant import puma560, simulate
from plant.compiler import AVX512_VARIABLE

ROOT = Path(__file__).parent.parent.parent
PAGE = ROOT / "docs" / "background" / "speed.md"

FIRST_VALUE = """
import time
started = time.perf_counter()
import numpy as np
from identification import Objective
from plant import Record, puma560
from plant.simulation.followed_path import Path
rig, path = puma560.rig(), puma560.reference()
t = np.arange(5215) * rig.period
record = Record(t=t, reference_pulses=Path(path, rig)(t)[1], error_pulses=np.zeros((5215, 2)), rig=rig,
                law=puma560.p_law(), reference=path)
assert np.isfinite(Objective(puma560.dynamics(), record)(puma560.PUBLISHED[None])).all()
print(time.perf_counter() - started)
"""

MEMORY = """
import re
import numpy as np
from pathlib import Path
from identification import Objective
from plant import puma560, simulate
arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
record = simulate(arm, rig, law, puma560.reference(), duration=10.0)
Objective(puma560.dynamics(), simulate(arm, rig, law, puma560.reference(), duration=0.1))(arm.f[None])
def of_process(name):
    return int(re.search(name + r":\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
Path("/proc/self/clear_refs").write_text("5")  # forget the peak
before = of_process("VmRSS")
costs = Objective(puma560.dynamics(), record)(np.repeat(arm.f[None], 1000, axis=0))
assert np.isfinite(costs).all()
print(of_process("VmHWM") - before)
"""


def seconds(call):
    """Time of one call."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def machine():
    """Processor, compilers and commit."""
    model = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(
            (line.split(":")[1].strip() for line in lines if line.startswith("model name")), model
        )
        flags = next((line for line in lines if line.startswith("flags")), "")
        model += " with AVX-512" if "avx512f" in flags else " with AVX2" if "avx2" in flags else ""
    parts = [f"{model}, {os.cpu_count()} cores", f"Python {platform.python_version()}"]
    parts += [f"{name} {__import__(name).__version__}" for name in ("numba", "casadi", "numpy")]
    if c_loops.available():
        version = subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True)  # noqa: S607
        parts.append(version.stdout.splitlines()[0])
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],  # noqa: S607
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    ).stdout.strip()
    return f"{'; '.join(parts)}; commit {commit or 'unknown'}."


def engines(rounds):
    """Table of all engines on the paper's experiment, and lines on threads and the genetic
    algorithm.
    """
    experiment = Experiment()
    population, names = experiment.candidates(80), all_engines(experiment)
    per = {name: [] for name in names}
    for engine, count in names.values():
        engine(population[:count])
    for _ in range(rounds):
        for name, (engine, count) in names.items():
            engine(population[:count])  # in its stride: what came before has emptied the caches
            # called at once
            per[name].append(seconds(lambda: engine(population[:count])) / count)  # noqa: B023
    yield (
        f"Population 80, trajectory (6), 5,215 samples, 4 sub-steps, 3 friction sweeps; {rounds}"
        " rounds, in which"
    )
    yield "each engine is called twice and timed the second time.\n"
    yield (
        "| engine | ms per simulation | time, with this engine on one thread as 1 | middle half of"
        " the rounds |"
    )
    yield "|---|---|---|---|"
    ours = np.array(per["engine, 1 thread"])
    for name, times in per.items():
        ratios = np.array(times) / ours
        low, high = np.quantile(ratios, (0.25, 0.75))
        yield (
            f"| {name} | {statistics.median(times) * 1e3:.3g} | {np.median(ratios):.3g} | {low:.3g}"
            f" to {high:.3g} |"
        )
    many = experiment.candidates(3200, seed=1)
    one, two = Engine(experiment, 1), Engine(experiment, 2)
    pairs = np.array(
        [
            (seconds(lambda: one(many)), seconds(lambda: two(many)))
            for _ in range(max(3, rounds // 3))
        ]
    )
    yield ""
    yield (
        f"3,200 evaluations: {np.median(pairs[:, 0]):.3f} s on one thread,"
        f" {np.median(pairs[:, 1]):.3f} s on two, {np.median(pairs[:, 0] / pairs[:, 1]):.2f} times"
        " faster. The paper: half an hour."
    )
    options = {"method": "paper", "progress": False}
    runs = [
        seconds(lambda: identify(puma560.dynamics(), experiment.record, **options))
        for _ in range(6)
    ]
    yield f"The whole genetic algorithm of 3.7, warm: {statistics.median(runs[1:]):.2f} s."


def without_avx512(rounds):
    """The table of engines of a process for which the processor has no AVX-512, nor has gcc."""
    environment = {**os.environ, AVX512_VARIABLE: "1"}
    command = [sys.executable, __file__, "--engines", str(rounds)]
    # this file
    answer = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)  # noqa: S603
    yield from (
        line for line in answer.stdout.splitlines() if line.startswith("|") and "casadi" not in line
    )


def widths(rounds):
    """Individuals side by side against time."""
    experiment = Experiment()
    population = experiment.candidates(240)
    kernels = {width: Kernel(experiment, width) for width in (8, 16, 24, 32, 40, 48, 64, 80)}
    per = {width: [] for width in kernels}
    for kernel in kernels.values():
        kernel(population)
    for _ in range(rounds):
        for width, kernel in kernels.items():
            # called at once
            per[width].append(seconds(lambda: kernel(population)) / len(population))  # noqa: B023
    yield "| individuals side by side | " + " | ".join(map(str, kernels)) + " |"
    yield "|---|" + "---|" * len(kernels)
    yield (
        "| ms per simulation | "
        + " | ".join(f"{statistics.median(t) * 1e3:.3f}" for t in per.values())
        + " |"
    )


def scaling():
    """Time per individual, per sample and per sub-step."""
    arm, rig, law, path = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
    random = np.random.default_rng(0)

    def per_sub_step(duration, count, steps=4):
        record = simulate(arm, rig, law, path, duration=duration)
        objective = Objective(puma560.dynamics(), record, steps_per_sample=steps, threads=1)
        population = arm.f * (1 + 0.05 * random.normal(size=(count, 9)))
        objective(population[:1])
        best = statistics.median(seconds(lambda: objective(population)) for _ in range(3))
        return best / count / len(record) / steps * 1e9

    rows = {
        "individuals (500 samples)": {
            n: per_sub_step(0.35, n) for n in (40, 400, 4000, 40000, 100000)
        },
        "samples (80 individuals)": {
            n: per_sub_step(n * 0.7e-3, 80) for n in (250, 500, 1000, 2000, 5000, 10000)
        },
        "sub-steps (80 individuals, 1000 samples)": {
            n: per_sub_step(0.7, 80, n) for n in (1, 2, 4, 8, 16, 32)
        },
    }
    for name, row in rows.items():
        yield f"| {name} | " + " | ".join(f"{n:,}" for n in row) + " |"
        yield "|---|" + "---|" * len(row)
        yield (
            "| ns per individual and sub-step | "
            + " | ".join(f"{t:.2f}" for t in row.values())
            + " |"
        )
        yield ""


def starts(rounds):
    """From import to the first value, with an empty cache and with a filled one; and memory."""

    def child(code, cache):
        environment = {**os.environ, "ONEPULSE_CACHE": cache, "PYTHONPATH": str(ROOT)}
        said = subprocess.run(  # noqa: S603
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return float(said.stdout)

    cold, warm = [], []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as cache:
            Path(cache).chmod(0o700)
            cold.append(child(FIRST_VALUE, cache))
            warm.append(child(FIRST_VALUE, cache))
            memory = child(MEMORY, cache)
    yield (
        f"From `import` to the first value of the objective: {statistics.median(cold):.2f} s with"
        f" an empty cache, {statistics.median(warm):.2f} s with a filled one (medians of {rounds}"
        " processes each)."
    )
    imports = {code: [] for code in ("pass", "import plant", "import ctc")}
    for _ in range(2 * rounds):
        for code, spent in imports.items():
            spent.append(
                seconds(lambda: subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True))  # noqa: B023, S603
            )
    said = ", ".join(
        f"`{code}` {statistics.median(spent):.2f} s" for code, spent in imports.items()
    )
    yield f"Whole processes (medians of {2 * rounds}): {said}."
    yield (
        f"1,000 individuals over 10 s of samples every 0.7 ms: {memory / 1024:.0f} MB more than"
        " before, at the peak."
    )


def accuracy():
    """What sub-steps and sweeps change, in pulses of the motor shaft, against 256 sub-steps and
    30 sweeps.
    """
    arm, rig, law, path = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
    exact = simulate(arm, rig, law, path, steps_per_sample=256, sweeps=30)

    def off(record, other):
        pulses = rig.position_in_pulses(record.true_q - other.true_q)
        rms = np.sqrt((pulses**2).mean(axis=0))
        floor = np.sum((record.error_pulses - other.error_pulses) ** 2)
        return f"{rms[0]:.2f}, {rms[1]:.2f} | {np.abs(pulses).max():.2f} | {floor:,.0f}"

    yield (
        "| sub-steps | sweeps | true position error, RMS of joints 2, 3 [pulses] | largest [pulses]"
        " | objective (4) |"
    )
    yield "|---|---|---|---|---|"
    for steps in (1, 2, 4, 8, 16, 32, 64):
        yield (
            f"| {steps} | 3 | {off(simulate(arm, rig, law, path, steps_per_sample=steps), exact)} |"
        )
    for sweeps in (1, 2, 5, 10):
        yield f"| 4 | {sweeps} | {off(simulate(arm, rig, law, path, sweeps=sweeps), exact)} |"


def more_joints(*, cpp):
    """The kernel of a six-joint arm beside pinocchio."""
    chain, bodies = six_joints.arm(np.random.default_rng(0))
    first, step, instructions = six_joints.without_cache(
        lambda: six_joints.kernel_time(chain, bodies)
    )
    yield (
        f"{instructions:,} instructions per sub-step; from the description of the arm to the first"
        f" run {first:.1f} s."
    )
    yield "\n| engine | what | microseconds | times this engine |\n|---|---|---|---|"
    yield f"| this engine, 1 thread | a whole sub-step of the closed loop | {step * 1e6:.3f} | 1 |"
    for name, spent in six_joints.aba_times(chain, bodies, cpp=cpp).items():
        yield (
            f"| {name} | forward dynamics alone (`aba`) | {spent * 1e6:.3g} | {spent / step:.3g} |"
        )


def main():
    """Measure, print, and replace the tables of the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help="put the tables into docs/background/speed.md"
    )
    parser.add_argument("--quick", action="store_true", help="few rounds, no C++")
    parser.add_argument("--engines", type=int, metavar="ROUNDS", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.engines:
        print(*engines(options.engines), sep="\n")
        return
    rounds = 3 if options.quick else 15
    parts = {
        "machine": [machine()],
        "engines": engines(rounds),
        "without AVX-512": without_avx512(rounds),
        "widths": widths(rounds),
        "scaling": scaling(),
        "starts": starts(1 if options.quick else 5),
        "accuracy": accuracy(),
        "any arm": any_arm.table(),
        "six joints": more_joints(cpp=not options.quick),
    }
    page = PAGE.read_text(encoding="utf-8") if options.write else ""
    for name, lines in parts.items():
        print(f"\n## {name}\n", flush=True)
        text = []
        for line in lines:
            print(line, flush=True)
            text.append(line)
        if options.write:
            begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
            before, rest = page.split(begin)
            page = before + begin + "\n" + "\n".join(text).strip() + "\n" + end + rest.split(end)[1]
    if options.write:
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
