"""Identification of a load, from logs of its own or from a short window while the arm works.

From logs, with unknown friction: `load_search` (the residual in mass, centre and friction, and its
fit), `logged_load` (`find_load`), `load` (its result, with warnings).

From a window: `posterior` (prior of a load, and its distribution), `kernel_estimate` (smooth
kernels on the torque equation), `genetic_estimate` (3.7 on the load parameters) and `worker` (both
in a separate process).
"""

from identification.payload.genetic_estimate import GeneticEstimator
from identification.payload.kernel_estimate import (
    KERNEL,
    KernelEstimator,
    Smoothing,
    Window,
    uncertainty,
)
from identification.payload.load import Load
from identification.payload.load_search import LoadSearch
from identification.payload.posterior import (
    LoadShape,
    PayloadEstimate,
    information,
    judged,
    posterior,
    uninformed,
)
from identification.payload.worker import Specification, Worker, shared_worker

__all__ = [
    "KERNEL",
    "GeneticEstimator",
    "KernelEstimator",
    "Load",
    "LoadSearch",
    "LoadShape",
    "PayloadEstimate",
    "Smoothing",
    "Specification",
    "Window",
    "Worker",
    "information",
    "judged",
    "posterior",
    "shared_worker",
    "uncertainty",
    "uninformed",
]
