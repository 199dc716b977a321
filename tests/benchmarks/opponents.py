"""The closed loop of the paper's experiment by several engines: costs (P,) of candidates (P, 9),
all by the same step.

Used by bench_engine.py (pytest-benchmark) and speed.py (the table of docs/background/speed.md).
"""

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

import c_loops
import casadi as ca
import numpy as np

from identification import Objective
from identification.replay import squared_error
from plant import puma560, simulate
from plant.simulation import Clock, ClosedLoop, LoopKernel, path_of, start_of, time_tables

STEPS_PER_SAMPLE = 4


class Experiment:
    """Trajectory (6) under the P law, logged by a robot of 16 sub-steps, to be replayed with 4."""

    def __init__(self, samples=None):
        self.record = simulate(
            puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), steps_per_sample=16
        )
        self.samples = samples or len(self.record)
        self.dynamics = puma560.dynamics()
        self.loop = ClosedLoop(
            dynamics=self.dynamics,
            rig=self.record.rig,
            law=self.record.law,
            steps_per_sample=STEPS_PER_SAMPLE,
            score=squared_error(2),
        )
        path = path_of(self.record)
        data = np.column_stack([self.record.error_pulses, self.record.valid])[: self.samples]
        clock = Clock.regular(self.samples, self.record.rig.period)
        self.tables = (*time_tables(self.loop, path, clock), np.ascontiguousarray(data))
        self.state = self.loop.initial_state(*start_of(self.record, path))
        self.fixed = self.loop.number_values(puma560.PUBLISHED)[9:]

    def candidates(self, count, seed=0):
        """Sound candidates (count, 9) near the published f."""
        return puma560.PUBLISHED * (1 + 0.05 * np.random.default_rng(seed).normal(size=(count, 9)))


class Engine:
    """This project's objective on so many threads."""

    def __init__(self, experiment, threads):
        self._objective = Objective(experiment.dynamics, experiment.record, threads=threads)

    def __call__(self, population):
        return self._objective(population)


class Kernel:
    """The population's kernel alone, so many individuals side by side; with one it is the scalar
    numba loop.
    """

    def __init__(self, experiment, width):
        self.experiment, self.width = experiment, width
        self.kernel = LoopKernel(experiment.loop, range(9), width)
        self._tables = self.kernel.prepared(experiment.tables)

    def __call__(self, population):
        state = np.repeat(self.experiment.state[:, None], self.width, axis=1)
        costs = np.empty(len(population))
        for start in range(0, len(population), self.width):
            rows = np.arange(start, start + self.width).clip(max=len(population) - 1)
            lanes = np.ascontiguousarray(population[rows].T)
            final, _ = self.kernel.run(self._tables, state, lanes, self.experiment.fixed)
            costs[rows] = np.where(final[-1] > 0, final[-2], np.inf)
        return costs


def sample_function(loop):
    """One sample of the loop as one casadi Function of scalars: log, score and all its
    sub-steps.
    """
    state, numbers = (
        ca.MX.sym("state", len(loop.state_names)),
        ca.MX.sym("numbers", len(loop.number_names)),
    )
    sample_time, data = (
        ca.MX.sym("sample_time", len(loop.time_names)),
        ca.MX.sym("data", loop.n_data),
    )
    step_time = ca.MX.sym("step_time", len(loop.time_names), loop.steps_per_sample)
    following, _ = loop.sample(state, sample_time, numbers, data)
    for i in range(loop.steps_per_sample):
        following, _ = loop.substep(following, step_time[:, i], numbers)
    return ca.Function(
        "sample_of_loop", [state, sample_time, data, step_time, numbers], [following]
    ).expand()


class Mapaccum:
    """casadi's virtual machine: the sample accumulated over all samples, once per candidate."""

    def __init__(self, experiment):
        self.experiment = experiment
        self._loop = sample_function(experiment.loop).mapaccum(
            "loop", experiment.samples, {"base": 2}
        )
        _, sample_time, step_time, data = experiment.tables
        self._rows = [np.ascontiguousarray(table.T) for table in (sample_time, data, step_time)]

    def __call__(self, population):
        costs = []
        for f in population:
            numbers = np.repeat(
                np.append(f, self.experiment.fixed)[:, None], self.experiment.samples, axis=1
            )
            final = self._loop(self.experiment.state, *self._rows, numbers).full()[:, -1]
            costs.append(final[-2] if final[-1] > 0 else np.inf)
        return np.array(costs)


_DRIVER = """
void run(long samples, long states, long times, long data_count, long steps, double *state, const double *sample_time,
         const double *data, const double *step_time, const double *numbers) {
  double following[64], w[SIZE_W + 1];
  const double *arg[SIZE_ARG + 8];
  double *res[SIZE_RES + 8];
  casadi_int iw[SIZE_IW + 1];
  for (long k = 0; k < samples; k++) {
    arg[0] = state; arg[1] = sample_time + k * times; arg[2] = data + k * data_count;
    arg[3] = step_time + k * steps * times; arg[4] = numbers; res[0] = following;
    sample_of_loop(arg, res, iw, w, 0);
    for (long i = 0; i < states; i++) state[i] = following[i];
  }
}
"""


class CasadiC:
    """The C that casadi generates of the sample, in a loop over the samples, compiled for this
    machine.
    """

    def __init__(self, experiment):
        self.experiment = experiment
        function = sample_function(experiment.loop)
        generator = ca.CodeGenerator("sample.c", {"with_header": False})
        generator.add(function)
        text = generator.dump()
        sizes = {
            "ARG": function.sz_arg(),
            "RES": function.sz_res(),
            "IW": function.sz_iw(),
            "W": function.sz_w(),
        }
        defines = "".join(f"#define SIZE_{name} {size}\n" for name, size in sizes.items())
        with tempfile.TemporaryDirectory() as folder:
            source, library = Path(folder, "loop.c"), Path(folder, "loop.so")
            source.write_text(text + defines + _DRIVER)
            command = [
                "gcc",
                "-O3",
                "-march=native",
                "-shared",
                "-fPIC",
                "-o",
                library,
                source,
                "-lm",
            ]
            subprocess.run(command, check=True)  # noqa: S603 - what casadi generated
            self._run = ctypes.CDLL(str(library)).run

    def __call__(self, population):
        experiment, costs = self.experiment, []
        _, sample_time, step_time, data = experiment.tables
        counts = (
            experiment.samples,
            len(experiment.state),
            sample_time.shape[1],
            data.shape[1],
            STEPS_PER_SAMPLE,
        )
        for f in population:
            state, numbers = experiment.state.copy(), np.append(f, experiment.fixed)
            arrays = (state, sample_time, data, step_time, numbers)
            self._run(
                *map(ctypes.c_long, counts),
                *(array.ctypes.data_as(ctypes.c_void_p) for array in arrays),
            )
            costs.append(state[-2] if state[-1] > 0 else np.inf)
        return np.array(costs)


def all_engines(experiment):
    """Name -> (callable, individuals that it is given): the slow ones get fewer, all are told
    per individual.
    """
    engines = {
        "engine, 1 thread": (Engine(experiment, 1), 80),
        "engine, 2 threads": (Engine(experiment, 2), 80),
        "kernel alone": (Kernel(experiment, 40), 80),
        "scalar numba loop": (Kernel(experiment, 1), 10),
        "casadi mapaccum": (Mapaccum(experiment), 1),
    }
    if c_loops.available():
        by_hand = c_loops.Experiment(experiment.dynamics, experiment.record)
        engines |= {
            "C, scalar, libm": (functools.partial(c_loops.scalar_costs, by_hand), 10),
            "C, vectors by hand": (functools.partial(c_loops.vector_costs, by_hand), 80),
            "C, vectors by hand, sines turned": (
                functools.partial(c_loops.turned_costs, by_hand),
                80,
            ),
            "C generated by casadi": (CasadiC(experiment), 5),
        }
    return engines
