"""CMA-ES beside the genetic algorithm: the same objective, box, evaluations and result, by the package `cma`.

N. Hansen, A. Ostermeier, Completely derandomized self-adaptation in evolution strategies, Evolutionary Computation 9,
2001. Its generations are smaller, and more, than those of the genetic algorithm.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.search.genetic import GeneticResult, GeneticSettings

_POPULATION = 20
"""Individuals of a generation."""

_STEP = 0.3
"""Standard deviation of the first, as a share of each range."""


def minimize_cma(
    objective: Callable[[NDArray[np.float64]], ArrayLike],
    bounds: NDArray[np.float64],
    settings: GeneticSettings,
    seed: int,
    callback: Callable[[float], object] | None = None,
) -> GeneticResult:
    """Minimise an objective inside a box, with at most the evaluations of the genetic algorithm with these settings.

    Parameters
    ----------
    objective : callable
        Population (P, p) -> costs (P,), inf for a bad candidate.
    bounds : (p, 2) numpy.ndarray
        Equal bounds fix a variable.
    settings : GeneticSettings
        Of which individuals, sub-populations, generations and target count.
    seed : int
        Same seed, same bits, on one machine: its eigenvectors are the linear algebra library's.
    callback : callable, optional
        Called with the best cost whenever as much is done as in a generation of the genetic algorithm.

    Raises
    ------
    ValueError
        The package is not installed, or a box with one variable or without width.
    """
    try:
        from cma import CMAEvolutionStrategy
    except ImportError:
        raise ValueError('method "cma" needs the package cma; it is not there. pip install "onepulse[cma]".') from None
    low, width = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
    free = np.flatnonzero(width > 0)
    if len(free) < 2:
        raise ValueError(f'method "cma" must have two unknowns or more; got {len(free)}. Use "paper".')
    first = settings.individuals * settings.subpopulations
    each = settings.offspring * settings.subpopulations
    budget = first + settings.generations * each
    rng = np.random.default_rng(seed)
    options = {
        "bounds": [0, 1], "popsize": min(_POPULATION, budget), "maxfevals": budget, "verbose": -9, "seed": np.nan,
        "randn": lambda *shape: rng.standard_normal(shape), "tolx": 0, "tolfun": 0, "tolfunhist": 0,
        "tolflatfitness": budget,
    }  # fmt: skip
    search: Any = CMAEvolutionStrategy(np.full(len(free), 0.5), _STEP, options)
    best_x, best, history, populations, done, shown = low.copy(), np.inf, [], [], 0, 0
    while done < budget and not search.stop() and not (settings.target is not None and best <= settings.target):
        asked = np.array(search.ask())
        x = np.repeat(low[None], len(asked), axis=0)
        x[:, free] += width[free] * asked
        costs = np.asarray(objective(x), float)
        finite = costs[np.isfinite(costs)]
        worst = finite.max() if finite.size else 0.0
        search.tell(list(asked), np.where(np.isfinite(costs), costs, worst + abs(worst) + 1.0))  # ranks are what counts
        done += len(asked)
        if np.nanmin(costs, initial=np.inf) < best:
            best_x, best = x[int(np.nanargmin(costs))].copy(), float(np.nanmin(costs))
        history.append((best, *((finite.mean(), finite.max()) if finite.size else (np.inf, np.inf))))
        populations.append((x, costs))
        while callback is not None and shown < (done - first) // each:
            callback(best)
            shown += 1
    (start, costs_of_start), (end, costs_of_end) = populations[0], populations[-1]
    return GeneticResult(
        x=best_x, cost=best, initial_cost=float(np.nanmin(costs_of_start)), initial_population=start,
        initial_costs=costs_of_start, final_population=end, final_costs=costs_of_end, history=np.array(history),
        evaluations=done, seed=seed, settings=settings,
        message=f"CMA-ES ended after {len(history)} generations of {len(end)}. Best cost {best:.6g}.",
    )  # fmt: skip
