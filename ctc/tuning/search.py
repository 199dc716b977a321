"""Search of one family: the tuning with the least chatter that keeps the limit, by the genetic
algorithm of 3.7.

Few samples are simulated in the search, many in the check of its best. Those that exceed the limit
there join the search, until none does: what a tuning fails on is not left to chance.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ctc.certification.certified import clopper_pearson
from ctc.certification.plants import Plants
from ctc.tuning.tuning import Family, Trial
from identification import GeneticSettings, minimize_genetic
from plant import Reference
from plant.parts.checkpoint import Checkpoint
from plant.parts.fields import Floats
from plant.simulation.population import Runs

# Generations of one search after another, and the share of the limit within which errors before
# rounding are to stay; with an infinite one the counts decide, as in the verdict: those of a pulse
# are errors of up to two before rounding.
ROUNDS = (24, np.inf), (12, np.inf), (12, 1.1), (12, 1.0), (12, 0.95), (12, 0.85)

# Searches at most that go on from the first tuning under which none exceeds the limit; the share of
# chatter to which each must bring it for another to follow; how far from it they search, in the
# logarithm of each variable; and the share of the limit that they aim at.
_QUIETER = 4
_GAIN = 0.9
_NEAR = 0.5
_SPARE = 1.05

# Tunings with less chatter under which the fewest fail, and so many on the way to each from the
# best that holds.
_BETWEEN = 2, 5

_STEPS = 4, 8  # integration steps per sample in a search, and in a check

# Tunings of a search that are checked at most, and samples that exceed the limit under each which
# join the next.
_CHECKED = 2
_JOINING = 6

_FIRST = 200  # samples of a check after which it ends if more exceed the limit than may

_HARDEST = 2  # motions of a set on which a search begins

# Of a family whose searches have all of their generations; how much more chatter all known tunings
# of a family have than what holds in another where it is not searched.
_VARIABLES = 5
_LOUDER = 2.0

# Weight of the share of loops that exceed the limit, and of the peak error beyond it [pulses],
# against chatter.
_LEFT = 20.0
_BEYOND = 5.0

_RANK = operator.attrgetter("rank")

_FAR = 20.0  # peak error [pulses] beyond which one is as bad as another

# Generation after which a search is given up under whose best tuning such a share still exceeds the
# limit.
_HOPE = 8
_HOPELESS = 0.5


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Tunings:
    """Tunings of a family on samples of the arm, each with each.

    `plants` are those on which tunings are checked; the search has its own. A sample exceeds the
    limit that does in any of the motions, each with its duration [s]; if some may, as a share
    `allowed`, none joins a search. `scale` (n,) is the torque [N m] to which a joint's chatter is
    compared; `options` and `by` are of `Population` and its `run`.
    """

    family: Family
    plants: Plants
    motions: tuple[tuple[Reference, float], ...]
    options: dict[str, Any]
    scale: Floats
    by: dict[str, Any]
    allowed: float = 0.0
    checkpoint: Checkpoint = dataclasses.field(default_factory=lambda: Checkpoint(None, ""))

    def runs(self, values: Floats, plants: Floats, steps: int) -> tuple[Runs, tuple[int, int]]:
        """Samples (P, L) under tunings (T, k), tuning by tuning, and the shape (T, P)."""
        named = dict(zip(self.family.variables, values.T, strict=True))
        own = self.family.numbers(named)
        names = self.plants.numbers()[0]
        count = len(values)
        each = len(plants)
        lanes = np.hstack(
            [
                np.repeat(np.column_stack(list(own.values())), each, axis=0),
                np.tile(plants, (count, 1)),
            ]
        )
        options = self.options | {"steps_per_sample": steps}
        numbers = ((*own, *names), lanes)
        runs = []
        for path, lasts in self.motions:
            population = self.plants.under(
                self.family.law, path, numbers, duration=lasts, **options
            )
            runs.append(population.run(**self.by))
        return Runs.joined(runs), (count, each)

    def costs(self, values: Floats, plants: Floats, aim: float) -> Floats:
        """What the search minimises, (T,): mean chatter, and what exceeds the limit, or a share
        of it.
        """
        runs, shape = self.runs(values, plants, _STEPS[0])
        peak = runs.unrounded.max(axis=1)
        within = self.options["within"]
        left = ((runs.outside > 0) | (peak > aim * within)).reshape(shape)
        beyond = np.clip(peak - min(aim, 1.0) * within, 0, _FAR).reshape(shape)
        noise = np.minimum((runs.chatter / self.scale).mean(axis=1).reshape(shape), _FAR)
        must = shape[1] - int(self.allowed * shape[1])
        left = np.sort(left, axis=1)[:, :must]
        beyond = np.sort(beyond, axis=1)[:, :must]
        return noise.mean(axis=1) + _LEFT * left.mean(axis=1) + _BEYOND * beyond.mean(axis=1)

    def best(
        self, plants: Floats, seed: int, show: Callable[[], Any], beat: float = np.inf
    ) -> Trial:
        """The tuning with the least chatter under which no more exceed the limit than may, or the
        fewest.

        The search begins with plants (P, L), and calls `show` once per generation. `beat` is the
        noise of the best of another family: one under which some still exceed the limit, and
        noisier, is given up.
        """
        known, tried = np.array([list(each.values()) for each in self.family.known]), list[Trial]()
        hard = self.checkpoint.stage("hardest", lambda: self._hardest(known, plants))

        def checked(values: Floats) -> Trial:
            """The best of a check; what exceeds the limit joins the search, and so does the
            motion where it does.
            """
            nonlocal plants, hard
            check = functools.partial(self._checked, values)
            trials, leaving, where = self.checkpoint.stage(f"check {len(tried)}", check)
            tried.extend(trials)
            plants, hard = np.vstack([plants, *leaving]), sorted({*hard, *where})
            return min(trials, key=_RANK)

        def following(generations: int, aim: float, near: float = np.inf) -> Trial:
            nonlocal known
            some = dataclasses.replace(self, motions=tuple(self.motions[i] for i in hard))
            known = some._searched(plants, known, generations, aim, near, seed + len(tried), show)
            return checked(known[:_CHECKED])

        if np.isfinite(beat) and self._quietest(known, plants, hard[0]) > _LOUDER * beat:
            return checked(known[:1])
        for generations, aim in ROUNDS:
            best = following(generations, aim)
            if best.holds or best.left > _HOPELESS * len(self.plants) or best.noise > beat:
                break
        for _ in range(_QUIETER if best.holds else 0):
            before = min(tried, key=_RANK)
            known = np.vstack([list(before.numbers.values()), known])
            following(generations, _SPARE, _NEAR)
            for rows in self._between(tried):
                checked(rows)
            if min(tried, key=_RANK).noise > _GAIN * before.noise:
                break
        return min(tried, key=_RANK)

    def _hardest(self, known: Floats, plants: Floats) -> list[int]:
        """The motions of a set in which most samples exceed the limit under the known tunings,
        the farthest first.
        """
        hardness = list[tuple[float, float]]()
        for motion in self.motions if len(self.motions) > _HARDEST else ():
            runs, _ = dataclasses.replace(self, motions=(motion,)).runs(known, plants, _STEPS[0])
            hardness.append(((runs.outside > 0).mean(), np.minimum(runs.unrounded, _FAR).mean()))
        ranked = sorted(
            range(len(self.motions)), key=lambda i: hardness[i] if hardness else 0, reverse=True
        )
        return ranked[:_HARDEST]

    def _quietest(self, known: Floats, plants: Floats, hard: int) -> float:
        """Noise of the quietest of the known tunings in one motion."""
        runs, shape = dataclasses.replace(self, motions=(self.motions[hard],)).runs(
            known, plants, _STEPS[0]
        )
        return float((runs.chatter / self.scale).mean(axis=1).reshape(shape).mean(axis=1).min())

    def _searched(
        self,
        plants: Floats,
        known: Floats,
        generations: int,
        aim: float,
        near: float,
        seed: int,
        show: Callable[[], Any],
    ) -> Floats:
        """Tunings (T, k) of the last generation, best first.

        Variables are searched by their logarithms, at most `near` from the first that is known.
        """
        bounds = np.log(np.array(list(self.family.variables.values())))
        bounds = np.clip(bounds.T, np.log(known[0]) - near, np.log(known[0]) + near).T
        generations = -(-generations * min(len(bounds), _VARIABLES) // _VARIABLES)
        settings = GeneticSettings(
            individuals=20, subpopulations=2, generations=generations, bits_per_variable=10
        )

        def generation(state: Any) -> bool:
            show()
            return bool(state.generation >= _HOPE and state.best_cost > _HOPELESS * _LEFT)

        initial = np.clip(np.log(known), bounds[:, 0], bounds[:, 1])[: settings.individuals]
        kept = self.checkpoint.part(f"search {seed}")
        result = minimize_genetic(
            kept.remembered(
                "costs", lambda population: self.costs(np.exp(population), plants, aim)
            ),
            bounds,
            settings,
            seed,
            initial=initial,
            callback=generation,
        )
        found = np.vstack([result.x, result.final_population])
        costs = np.append(result.cost, result.final_costs)
        found, first = np.unique(found, axis=0, return_index=True)
        return np.exp(found[np.argsort(costs[first], kind="stable")])

    def _between(self, tried: list[Trial]) -> Iterator[Floats]:
        """On the way from the best tuning that holds to those with less chatter under which the
        fewest fail.

        Each way from its quiet end.
        """
        best = min(tried, key=_RANK)
        quieter = sorted((trial for trial in tried if trial.noise < best.noise), key=_RANK)
        start = np.log([*best.numbers.values()])
        ways = np.linspace(1, 0, _BETWEEN[1] + 2)[1:-1]
        for trial in quieter[: _BETWEEN[0]]:
            yield np.exp(start + ways[:, None] * (np.log([*trial.numbers.values()]) - start))

    def _checked(self, values: Floats) -> tuple[list[Trial], list[Floats], set[int]]:
        """Trials of tunings (T, k) until one holds, the farthest samples beyond the limit under
        each, and in which motions they are.
        """
        plants, trials, leaving, where = (
            self.plants.numbers()[1],
            list[Trial](),
            list[Floats](),
            set[int](),
        )
        for row in values:
            for block in (plants[:_FIRST], plants):
                alone = (dataclasses.replace(self, motions=(motion,)) for motion in self.motions)
                each = [one.runs(row[None], block, _STEPS[1])[0] for one in alone]
                runs = Runs.joined(each)
                if (runs.outside > 0).mean() > 2 * self.allowed or len(plants) <= _FIRST:
                    break
            lost = runs.outside > 0
            chatter = runs.chatter.mean(axis=0)
            trials.append(
                Trial(
                    family=self.family.name,
                    law=self.family.tuned(row),
                    numbers=dict(zip(self.family.variables, row.tolist(), strict=True)),
                    left=int(lost.sum()),
                    of=len(lost),
                    allowed=self._most(len(lost)),
                    peak=float(runs.peak.max()),
                    chatter=chatter,
                    noise=float((chatter / self.scale).mean()),
                )
            )
            far = np.argsort(-np.where(lost, runs.unrounded.max(axis=1), -1.0), kind="stable")
            leaving.append(plants[far[: 0 if self.allowed else min(_JOINING, lost.sum())]])
            where |= {i for i, alone in enumerate(each) if (alone.outside > 0).any()}
            if trials[-1].holds:
                break
        return trials, leaving, where

    def _most(self, plants: int) -> int:
        """How many of the samples may fail: a controller given beforehand would then keep the
        share, at 95 %.
        """
        counts = range(1, int(self.allowed * plants) + 1)
        return sum(clopper_pearson(count, plants, 0.9)[1] <= self.allowed for count in counts)
