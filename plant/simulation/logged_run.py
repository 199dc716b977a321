"""One run of a closed loop with its log, by the compiled kernel or by casadi, which is the referee."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.arm import Arm
from plant.simulation.casadi_loop import by_casadi
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.divergence import refuse_divergence
from plant.simulation.loop_kernel import loop_kernel
from plant.simulation.time_tables import time_tables


def logged_run(
    loop: ClosedLoop, arm: Arm, driven: tuple[Any, ...], start: Any, backend: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log and true errors of a run from a start, or a refusal where it diverges.

    It is driven by a path, a clock, what is replayed and what is injected, as for `time_tables`.
    """
    numbers = loop.number_values(arm.f)
    state = loop.initial_state(start[0], start[1], numbers)
    if backend == "numba":
        final, log, true_error = _by_kernel(loop, driven, state, numbers)
    else:
        final, _, log, true_error = by_casadi(loop, time_tables(loop, *driven), driven[1], state, numbers)
    if not (final[-1] > 0 and bounded(final[: 2 * loop.n])):
        refuse_divergence(loop, arm, log, final)
    return log, true_error


def _by_kernel(
    loop: ClosedLoop,
    driven: tuple[Any, ...],
    state: NDArray[np.float64],
    numbers: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    path, clock, replayed, injected = driven
    samples, steps = len(clock), len(clock) * loop.steps_per_sample
    log, true_error = np.full((samples, loop.n_log), np.nan), np.full((steps, loop.n), np.nan)
    kernel = loop_kernel(loop, uneven=clock.even is None)
    nothing = np.empty((samples, 0))
    tables = kernel.along(loop, path, clock, nothing, logged=True, replayed=replayed, injected=injected)
    final, _ = kernel.run(tables, state[:, None], np.empty((0, 1)), numbers, (log, true_error))
    return final[:, 0], log, true_error
