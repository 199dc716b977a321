"""The closed loop of the paper's arm written out by hand in C, to see what a generated kernel costs
beside it.

    from c_loops import Experiment, scalar_costs, vector_costs

Both give the sum of squared error differences of each candidate, as `identification.Objective`
does, but simulate every candidate: arms that no motor could drive are not sorted out beforehand.
`scalar_costs` is plain C, one individual after the other; `vector_costs` is as fast as it could be
made. One thread.
"""

import ctypes
import dataclasses
import functools
import os
import pathlib
import shutil
import subprocess
import tempfile

import numpy as np

from plant import Record
from plant.simulation import Clock, ClosedLoop, path_of, start_of, time_tables

SOURCES = pathlib.Path(__file__).with_name("c")

FLAGS = {
    "scalar": ("-O3", "-march=native"),
    "vector": ("-O3", "-march=native", "-ffp-contract=fast", "-DRENEW=1"),
    "turned": ("-O3", "-march=native", "-ffp-contract=fast"),
}
"""Options of gcc for each program; "turned" is vector.c with sines that 7 of 8 steps turn by the
angle moved.
"""

NARROW = ("-mno-avx512f",) if os.environ.get("ONEPULSE_NO_AVX512") == "1" else ()
"""Where the engine takes the processor for one without AVX-512, gcc does."""

_PAIR = ctypes.c_double * 2
_NUMBERS = (
    "gear",
    "viscous",
    "coulomb",
    "motor_gain",
    "current_limit",
    "resolution",
    "gain",
    "q",
    "qd",
)


class _Numbers(ctypes.Structure):
    """The C programs' struct experiment."""

    _fields_ = (
        ("h", ctypes.c_double),
        ("gravity", ctypes.c_double),
        *((name, _PAIR) for name in _NUMBERS),
    )


@dataclasses.dataclass
class Experiment:
    """A record under the P law, ready to be replayed by the C programs.

    Parameters
    ----------
    dynamics : Dynamics
        Of joints 2 and 3, with f1..f9 open.
    record : Record
    steps_per_sample : int
    """

    dynamics: object
    record: Record
    steps_per_sample: int = 4

    def __post_init__(self):
        rig, law, path = self.record.rig, self.record.law, path_of(self.record)
        loop = ClosedLoop(
            dynamics=self.dynamics, rig=rig, law=law, steps_per_sample=self.steps_per_sample
        )
        _, at_samples, at_steps = time_tables(loop, path, Clock.of(self.record))
        pulses = [loop.time_names.index(f"pulses_r[{i}]") for i in range(2)]
        self.tables = [
            np.ascontiguousarray(x) for x in (at_samples[:, pulses], at_steps[:, pulses])
        ]
        self.tables.append(np.ascontiguousarray(self.record.error_pulses))
        q, qd = start_of(self.record, path)
        values = {**vars(rig.drive), **vars(rig.encoder), **vars(law), "q": q, "qd": qd}
        gravity = -self.dynamics.chain.gravity[2]
        self.numbers = _Numbers(loop.h, gravity, *(_PAIR(*values[name]) for name in _NUMBERS))


def available():
    """Whether there is a gcc to compile with."""
    return shutil.which("gcc") is not None


def scalar_costs(experiment, population):
    """Costs (P,) [pulses^2] of candidates (P, 9), one after the other; inf for one that
    diverges.
    """
    return _costs("scalar", experiment, population)


def vector_costs(experiment, population):
    """Costs (P,) [pulses^2] of candidates (P, 9), several in the lanes of vectors; inf for one
    that diverges.
    """
    return _costs("vector", experiment, population)


def turned_costs(experiment, population):
    """The same with sine and cosine worked out in every eighth step only, and turned by the
    angle moved in between.
    """
    return _costs("turned", experiment, population)


def _costs(name, experiment, population):
    population = np.ascontiguousarray(population, dtype=float)
    if population.ndim != 2 or population.shape[1] != 9:
        raise ValueError(
            f"population must have shape (P, 9); got {population.shape}. Give f1..f9 per row."
        )
    costs, samples = np.empty(len(population)), len(experiment.record)
    pointers = [table.ctypes.data_as(ctypes.c_void_p) for table in (*experiment.tables, costs)]
    _function(name)(
        len(population),
        population.ctypes.data_as(ctypes.c_void_p),
        ctypes.byref(experiment.numbers),
        samples,
        experiment.steps_per_sample,
        *pointers,
    )
    return np.where(np.isfinite(population).all(axis=1), costs, np.inf)


@functools.cache
def _function(name):
    """The C function of a program, compiled now."""
    source = "vector" if name == "turned" else name
    with tempfile.TemporaryDirectory() as folder:
        library = pathlib.Path(folder) / f"{name}.so"
        command = [
            shutil.which("gcc"),
            *FLAGS[name],
            *NARROW,
            "-shared",
            "-fPIC",
            "-o",
            library,
            SOURCES / f"{source}.c",
            "-lm",
        ]
        subprocess.run(command, check=True)  # noqa: S603 - our own sources
        function = getattr(ctypes.CDLL(str(library)), f"{source}_costs")
    function.argtypes = (
        *(ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long, ctypes.c_long),
        *([ctypes.c_void_p] * 4),
    )
    function.restype = None
    return function
