"""The closed loop as one symbolic step, the kernels made of it, `simulate` and `replay`.

Reading order: `layout` (state and numbers), `sub_step`, `closed_loop` (the step) -> `loop_source`,
`loop_kernel` (compiled), `logged_run` (by casadi, the reference) -> `clock`, `followed_path`,
`time_tables` (its inputs in time) -> `simulator` (with `cautions`), `population` (many loops at
once, on `executors`), `stepped_arm` (for scripts), `law_run` (a law along a log), `jacobians`.
"""

from plant.simulation.cautions import warn_of_missing_rotors
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import FAR, ClosedLoop, bounded, closed_loop
from plant.simulation.executors import Executor, finished, mapped, reason
from plant.simulation.followed_path import (
    Logged,
    Path,
    counts_along,
    in_motion,
    is_rounded,
    is_start_open,
    path_of,
    start_of,
    with_path,
)
from plant.simulation.jacobians import jacobians
from plant.simulation.law_run import LawRun, run_from, run_law
from plant.simulation.layout import Correction
from plant.simulation.logged_run import DivergenceError, logged_run
from plant.simulation.loop_kernel import (
    LANES,
    LOGGED,
    LoggedKernel,
    LoopKernel,
    Structure,
    logged_kernel,
    loop_kernel,
)
from plant.simulation.population import Population, Runs
from plant.simulation.simulator import Injected, injected_beside, run, simulate
from plant.simulation.stepped_arm import stepped_loop
from plant.simulation.time_tables import in_blocks, time_tables

__all__ = [
    "FAR",
    "LANES",
    "LOGGED",
    "Clock",
    "ClosedLoop",
    "Correction",
    "DivergenceError",
    "Executor",
    "Injected",
    "LawRun",
    "Logged",
    "LoggedKernel",
    "LoopKernel",
    "Path",
    "Population",
    "Runs",
    "Structure",
    "bounded",
    "closed_loop",
    "counts_along",
    "finished",
    "in_blocks",
    "in_motion",
    "injected_beside",
    "is_rounded",
    "is_start_open",
    "jacobians",
    "logged_kernel",
    "logged_run",
    "loop_kernel",
    "mapped",
    "path_of",
    "reason",
    "run",
    "run_from",
    "run_law",
    "simulate",
    "start_of",
    "stepped_loop",
    "time_tables",
    "warn_of_missing_rotors",
    "with_path",
]
