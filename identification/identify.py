"""From records to an arm: the identification procedure of the paper."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from tqdm import tqdm

import plant
from identification.genetic import GeneticSettings, minimize_genetic
from identification.objective import Objective
from plant import Arm, Law, Rig
from plant.check import array, choice, known_options

__all__ = ["Identification", "identify"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """What was found, and how.

    Attributes
    ----------
    arm : Arm
        The arm with the best f; D-hat and h-hat of a computed-torque controller.
    rig, law : Rig, Law
        Those of the (first) record, with whatever else was unknown filled in.
    f : (p,) numpy.ndarray
    unknown : tuple of str
        Names of what was searched; `values` (k,) are what was found for them.
    objective, initial_objective : float
        Objective (4) of the best candidate, at the end and in the first generation [pulses^2].
    initial_population : (P, k) numpy.ndarray
    initial_costs : (P,) numpy.ndarray
        Objective (4) of each of them, inf where it cannot be an arm or diverges.
    history : (generations + 1, 3) numpy.ndarray
        Best, mean and worst finite objective of each generation.
    evaluations : int
    seconds : float
    seed : int
    settings : GeneticSettings
    version : str
        Of the library.
    message : str
        Why the search ended.
    """

    arm: Arm
    rig: Rig
    law: Law
    f: np.ndarray
    unknown: tuple
    values: np.ndarray
    objective: float
    initial_objective: float
    initial_population: np.ndarray
    initial_costs: np.ndarray
    history: np.ndarray
    evaluations: int
    seconds: float
    seed: int
    settings: GeneticSettings
    version: str
    message: str

    def __repr__(self):
        f = np.array2string(self.f, precision=3, suppress_small=True)
        return (
            f"Identification(f={f}, objective {self.initial_objective:.0f} -> {self.objective:.0f} pulses^2, "
            f"{self.evaluations} evaluations in {self.seconds:.1f} s)"
        )


@known_options
def identify(
    dynamics,
    records,
    *,
    seed=0,
    method="paper",
    progress=True,
    ranges=None,
    unknown=None,
    settings=None,
    steps_per_sample=4,
    sweeps=3,
    threads=None,
):
    """Find the parameters with which the model repeats the tracking errors of the robot.

    Steps 1-6 of 3.2: the robot has followed a trajectory under P control (1) and its errors are in the record (2); a
    population is drawn from the ranges (3), evaluated by objective (4), and evolved (5); the best ever seen is the
    result (6).

    Parameters
    ----------
    dynamics : Dynamics
        The equations with f open.
    records : Record or sequence of Record
        From `plant.simulate` or `Record.from_csv`; only pulses are read.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    method : {"paper"}
        The genetic algorithm of 3.7.
    progress : bool
        Show a progress bar.
    ranges : (k, 2) array_like, optional
        Where to search each unknown; by default ``dynamics.ranges``.
    unknown : sequence of str, optional
        Names of what to find: all of f by default; numbers of rig or law may be added (``drive.viscous[0]``).
    settings : GeneticSettings, optional
        By default `GeneticSettings.paper()`.
    steps_per_sample, sweeps : int
        Sub-steps of the model, and sweeps of its friction law.
    threads : int, optional
        By default one per core.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        Bad input, or no candidate that can be simulated.

    Source: paper 3.2, 3.7.
    """
    choice("method", method, ("paper",))
    started = time.perf_counter()
    objective = Objective(dynamics, records, unknown, steps_per_sample=steps_per_sample, sweeps=sweeps, threads=threads)
    if ranges is None:
        if dynamics.ranges is None or objective.unknown != dynamics.names:
            raise ValueError(
                f"ranges must be given for {', '.join(objective.unknown)}; got None. Pass (low, high) for each, "
                "or give the Dynamics its ranges."
            )
        ranges = dynamics.ranges
    ranges = array("ranges", ranges, (objective.p, 2), advice="Give (low, high) for each unknown.")
    settings = GeneticSettings.paper() if settings is None else settings
    if not isinstance(settings, GeneticSettings):
        given = type(settings).__name__
        raise ValueError(f"settings must be GeneticSettings; got {given}. Leave it out for those of the paper.")
    with tqdm(total=settings.generations, desc="identify", unit="generation", disable=not progress, leave=False) as bar:

        def show(state):
            bar.set_postfix_str(f"best {state.best_cost:.0f} pulses^2")
            bar.update()

        result = minimize_genetic(objective, ranges, settings, seed, callback=show)
    if not np.isfinite(result.cost):
        raise ValueError(
            f"some candidate must repeat the experiment; all {result.evaluations} diverged or had no sound inertia. "
            "Widen or correct the ranges, and check gains, gears and signs of the rig."
        )
    values = dict(zip(objective.unknown, result.x, strict=True))
    f = np.array([values[name] for name in dynamics.names])
    first = objective.records[0]
    return Identification(
        arm=dynamics.arm(f),
        rig=_filled(first.rig, values, ""),
        law=_filled(first.law, values, "law."),
        f=f,
        unknown=objective.unknown,
        values=result.x,
        objective=result.cost,
        initial_objective=result.initial_cost,
        initial_population=result.initial_population,
        initial_costs=result.initial_costs,
        history=result.history,
        evaluations=result.evaluations,
        seconds=time.perf_counter() - started,
        seed=result.seed,
        settings=settings,
        version=plant.__version__,
        message=result.message,
    )


def _filled(part, values, prefix):
    """A rig or law with the identified numbers in place."""
    names = part.number_names(prefix)
    numbers = [values.get(name, given) for name, given in zip(names, part.number_values(), strict=True)]
    return part.with_numbers(np.array(numbers))
