"""How the unknowns were searched: what of an identification is for its repetition and for figures of its course."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from identification.search.genetic import GeneticSettings
from identification.search.outcome import Outcome
from identification.search.problem import Problem
from identification.search.tolerances import Tolerances
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown
from plant.parts.tables import Table


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Search(Shown, Frozen):
    """How the unknowns were searched.

    Attributes
    ----------
    method : str
    seed : int
    settings : GeneticSettings
    tolerances : Tolerances
        Within which the rigs are right, as the intervals count them.
    ranges : (k, 2) numpy.ndarray or None
        Those that were given.
    stages : dict
        What each stage before the last found: name -> (k,) values.
    initial_objective : float
        Objective (4) of the best candidate of the first generation [pulses^2]; of a method without generations, that
        of the result.
    initial_population : (P, k) numpy.ndarray
    initial_costs : (P,) numpy.ndarray
        Objective (4) of each of them, inf for one that is no arm or diverges.
    history : (generations + 1, 3) numpy.ndarray
        Best, mean and worst finite objective of each generation.
    evaluations : int
        Simulated experiments.
    seconds : float
        Of the whole identification.
    message : str
        Why the search ended.
    """

    method: str
    seed: int
    settings: GeneticSettings
    tolerances: Tolerances
    ranges: NDArray[np.float64] | None
    stages: dict[str, NDArray[np.float64]]
    initial_objective: float
    initial_population: NDArray[np.float64]
    initial_costs: NDArray[np.float64]
    history: NDArray[np.float64]
    evaluations: int
    seconds: float = dataclasses.field(compare=False)
    message: str

    def _short(self) -> str:
        return f"{self.method}, seed {self.seed}, {self.evaluations} evaluations in {self.seconds:.1f} s"

    def _shown(self) -> Iterator[Piece]:
        yield f"{self.message}"
        rows = [("method", self.method), ("seed", f"{self.seed}"), ("evaluations", f"{self.evaluations}")]
        rows += [("generations", f"{max(len(self.history) - 1, 0)}"), ("time [s]", f"{self.seconds:.1f}")]
        yield Table((), rows)

    @classmethod
    def of(cls, problem: Problem, outcome: Outcome, objective: float, seconds: float) -> Search:
        """The search of a problem that had this outcome, with the result's objective (4)."""
        genetic = outcome.genetic
        return cls(
            method=problem.method,
            seed=problem.seed,
            settings=problem.settings,
            tolerances=problem.tolerances,
            ranges=problem.ranges,
            stages=outcome.stages,
            initial_objective=objective if genetic is None else genetic.initial_cost,
            initial_population=np.empty((0, len(problem.unknown))) if genetic is None else genetic.initial_population,
            initial_costs=np.empty(0) if genetic is None else genetic.initial_costs,
            history=np.empty((0, 3)) if genetic is None else genetic.history,
            evaluations=outcome.evaluations,
            seconds=seconds,
            message=outcome.message,
        )
