"""Search of one family: the quietest tuning whose loops stay within the limit, by the genetic algorithm of 3.7."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.plants import Plants
from ctc.tuning.families import Family
from identification import GeneticSettings, minimize_genetic
from plant import Reference
from plant.simulation.population import Population, Runs

__all__ = ["SETTINGS", "Tunings", "searched"]

_LEFT, _BEYOND = 20.0, 5.0
"""Weight of the share of loops that leave, and of the peak error beyond the aim [pulses], against chatter."""

_FAR = 20.0
"""Peak error [pulses] beyond which one is as bad as another."""

_HOPE, _HOPELESS = 8, 0.5
"""Generation after which a search is given up whose best tuning still loses such a share of the loops."""

SETTINGS = GeneticSettings(individuals=20, subpopulations=2, generations=24, bits_per_variable=10)


class Tunings:
    """Tunings of a family on drawn plants, each with each.

    Parameters
    ----------
    family : Family
    plants : Plants
    reference : Reference
    options : dict
        Of `plant.simulation.population.Population`.
    scale : (n,) numpy.ndarray
        Torque [N m] of each joint to which its chatter is compared.
    """

    def __init__(
        self, family: Family, plants: Plants, reference: Reference, options: dict[str, Any],
        scale: NDArray[np.float64], threads: int,
    ) -> None:  # fmt: skip
        self.family, self.plants, self.reference = family, plants, reference
        self.options, self.scale, self.threads = options, scale, threads

    def runs(self, values: NDArray[np.float64]) -> tuple[Runs, tuple[int, int]]:
        """All plants under tunings (T, k); results tuning by tuning, and the shape (T, P)."""
        names, plants = self.plants.numbers()
        named = dict(zip(self.family.variables, values.T, strict=True))
        own = self.family.numbers(named)
        count, each = len(values), len(plants)
        lanes = np.hstack([np.repeat(np.column_stack(list(own.values())), each, axis=0), np.tile(plants, (count, 1))])
        population = Population(
            self.plants.arm, self.plants.rig, self.family.law, self.reference, (*own, *names), lanes, **self.options
        )
        return population.run(self.threads), (count, each)

    def costs(self, values: NDArray[np.float64], aim: float) -> NDArray[np.float64]:
        """What the search minimises, (T,): mean chatter, and what leaves."""
        runs, shape = self.runs(values)
        peak, chatter = runs.unrounded.max(axis=1).reshape(shape), runs.chatter.reshape(*shape, -1)
        beyond = np.clip(peak - aim, 0, _FAR)
        noise = np.minimum((chatter / self.scale).mean(axis=2), _FAR)
        return noise.mean(axis=1) + _LEFT * (beyond > 0).mean(axis=1) + _BEYOND * beyond.mean(axis=1)


def searched(
    tunings: Tunings, aim: float, seed: int, known: NDArray[np.float64], show: Any = None
) -> NDArray[np.float64]:
    """Tunings (T, k) of the last generation, best first; the search begins with the known ones (K, k).

    The variables are searched by their logarithms. It ends early where every tuning loses most of the loops.
    """
    bounds = np.log(np.array(list(tunings.family.variables.values())))

    def generation(state: Any) -> bool:
        if show is not None:
            show(state)
        return bool(state.generation >= _HOPE and state.best_cost > _HOPELESS * _LEFT)

    result = minimize_genetic(
        lambda population: tunings.costs(np.exp(population), aim), bounds, SETTINGS, seed,
        initial=np.clip(np.log(known), bounds[:, 0], bounds[:, 1]), callback=generation,
    )  # fmt: skip
    found, costs = np.vstack([result.x, result.final_population]), np.append(result.cost, result.final_costs)
    found, first = np.unique(found, axis=0, return_index=True)
    return np.exp(found[np.argsort(costs[first], kind="stable")])
