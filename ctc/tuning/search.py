"""Search of one family for the tuning with the least chatter that keeps the limit.

The genetic algorithm `minimize_genetic` searches the family.

A search simulates few samples; the check of its best tunings simulates many. Unless some samples
may fail, the worst failing samples of each check join the next search.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ctc.certification import Plants, clopper_pearson
from ctc.tuning.tuning import Family, Trial
from identification import GeneticSettings, minimize_genetic
from plant import Reference
from plant.parts import Checkpoint, Floats, frozen, frozen_settings
from plant.simulation import Population, Runs


@frozen_settings
class SearchSettings:
    """Numbers that shape the search of `tune`.

    tests/benchmarks/tuning.py shows the effect of all of them together. A number without stated
    evidence was chosen by hand.

    Parameters
    ----------
    initial_samples, initial_samples_allowed : int
        Samples of the first search; the second where a share of them may exceed the limit, since a
        share of few samples is coarse.
    validation_samples : int
        Samples of a check on one motion; 2000 without a failure bound the probability to 0.15 %.
    shared_motions : int
        Number of motions up to which the validation samples are shared out among them.
    rounds : tuple of (int, float)
        Generations of each search in turn, and its aim: the share of the limit that the errors
        before rounding may reach. Under an infinite aim only the counts decide, as in a check:
        an error of up to two pulses before rounding can count as one pulse.
    quieter_searches : int
        Largest number of searches for a quieter tuning after a tuning holds.
    quieter_gain : float
        Such a search is repeated if it cut the chatter to at most this share of its former value.
    quieter_radius : float
        Their largest distance from the best tuning, in the logarithm of each variable.
    quieter_aim : float
        Share of the limit at which they aim, as in `rounds`.
    between_trials, between_points : int
        Quieter tunings that fail, and the number of tunings that are checked on the line from each
        to the best tuning that holds.
    search_steps, check_steps : int
        Integration steps per sample in a search, and in a check.
    checked_tunings : int
        Tunings of a search that are checked, at most.
    interrupted_samples : int
        Samples of the certificate after Ctrl-C, at most: without a failure they bound the
        probability to 0.3 %.
    joining_samples : int
        Failing samples of each check that join the next search, at most.
    inner_samples : int
        Samples on which each inner loop is judged.
    screening_samples : int
        Samples after which a check ends if more than twice the allowed share exceed the limit.
    initial_motions : int
        Motions of a set with which a search begins.
    reference_variables : int
        Number of variables with which a family gets all generations of `rounds`; fewer variables
        get proportionally fewer generations.
    louder : float
        A family is not searched if all its initial tunings have more than this many times the
        chatter of a tuning that holds in another family. A search takes three minutes for nine
        motions (tests/benchmarks/tuning.py --time).
    failure_weight : float
        Cost of the share of loops that exceed the limit; mean chatter, in shares of each joint's
        torque, has the weight 1.
    excess_weight : float
        Cost of the mean peak error beyond the limit [1/pulse].
    cap : float
        Peak error beyond the limit [pulses], and chatter, above which one value is as bad as
        another.
    hope_generation : int
        Generation from which on a search without success may end.
    hopeless_share : float
        Share of failing samples of the best tuning above which it ends.
    individuals, subpopulations, bits_per_variable : int
        Of the genetic algorithm: `GeneticSettings`.
    """

    # Samples and motions
    initial_samples: int = 16
    initial_samples_allowed: int = 80
    validation_samples: int = 2000
    shared_motions: int = 4
    # Searches until a tuning holds
    rounds: tuple[tuple[int, float], ...] = (
        (24, np.inf),
        (12, np.inf),
        (12, 1.1),
        (12, 1.0),
        (12, 0.95),
        (12, 0.85),
    )
    # Searches for a quieter tuning
    quieter_searches: int = 4
    quieter_gain: float = 0.9
    quieter_radius: float = 0.5
    quieter_aim: float = 1.05
    between_trials: int = 2
    between_points: int = 5
    # Simulation and checks
    search_steps: int = 4
    check_steps: int = 8
    checked_tunings: int = 2
    interrupted_samples: int = 1000
    joining_samples: int = 6
    inner_samples: int = 64
    screening_samples: int = 200
    initial_motions: int = 2
    reference_variables: int = 5
    # Families that are given up
    louder: float = 2.0
    # Cost of a tuning
    failure_weight: float = 20.0
    excess_weight: float = 5.0
    cap: float = 20.0
    # Searches that are given up
    hope_generation: int = 8
    hopeless_share: float = 0.5
    # Genetic algorithm
    individuals: int = 20
    subpopulations: int = 2
    bits_per_variable: int = 10

    @property
    def generations(self) -> int:
        """Generations of all rounds."""
        return sum(generations for generations, _ in self.rounds)


SETTINGS = SearchSettings()

_RANK = operator.attrgetter("rank")


@frozen
class Tunings:
    """Tunings of a family on samples of the arm, each with each.

    `plants`: samples of the checks; the search has samples of its own. `motions`: each with its
    duration [s]; a sample fails if it exceeds the limit in any of them. `options`: of `Population`.
    `scale` (n,): torque [N m] to which a joint's chatter is compared. `run_options`: of
    `Population.run`. `allowed`: share of the samples that may exceed the limit; where it is not
    zero, no failing sample joins a search. `show`: called with the work of each simulation: loops
    times seconds times steps per sample. `populations`: the first population of each motion, which
    later runs use again with other values.
    """

    family: Family
    plants: Plants
    motions: tuple[tuple[Reference, float], ...]
    options: dict[str, Any]
    scale: Floats
    run_options: dict[str, Any]
    allowed: float = 0.0
    checkpoint: Checkpoint = dataclasses.field(default_factory=lambda: Checkpoint(None, ""))
    settings: SearchSettings = SETTINGS
    show: Callable[[float], Any] = float
    populations: dict[Any, Population] = dataclasses.field(default_factory=dict)

    def runs(self, values: Floats, plants: Floats, steps: int) -> tuple[Runs, tuple[int, int]]:
        """Samples (P, L) under tunings (T, k), tuning by tuning, and the shape (T, P)."""
        shape = len(values), len(plants)
        # The family converts variables of all tunings at once to numbers of the law.
        variables = dict(zip(self.family.variables, values.T, strict=True))
        law_numbers = self.family.numbers(variables)
        # One lane of the kernel for each pair of tuning and sample; samples vary fastest, so a
        # result (T P,) reshapes to (T, P).
        of_law = np.repeat(np.column_stack(list(law_numbers.values())), shape[1], axis=0)
        lanes = np.hstack([of_law, np.tile(plants, (shape[0], 1))])
        numbers = ((*law_numbers, *self.plants.numbers()[0]), lanes)
        # More steps where a verdict is to come out of them.
        options = self.options | {"steps_per_sample": steps}
        # A sample makes all motions, one after the other; their runs are joined into one.
        runs = []
        for path, duration in self.motions:
            key = id(path), duration, *sorted(options.items())
            if key not in self.populations:
                self.populations[key] = self.plants.under(
                    self.family.law, path, numbers, duration=duration, **options
                )
            population = self.populations[key].with_values(lanes)
            runs.append(population.run(**self.run_options))
            self.show(len(lanes) * duration * steps)
        return Runs.joined(runs), shape

    def work(self, samples: int) -> float:
        """Work of a search with so many samples, if it needs all rounds; most need fewer."""
        settings = self.settings
        seconds = sorted((duration for _, duration in self.motions), reverse=True)
        individuals = settings.individuals * settings.subpopulations
        generations = self._generations(settings.generations)
        searched = sum(seconds[: settings.initial_motions]) * settings.search_steps
        checked = sum(seconds) * settings.check_steps * len(self.plants)
        return generations * individuals * samples * searched + len(settings.rounds) * checked

    def _generations(self, generations: int) -> int:
        """Generations for the number of variables: fewer variables need fewer, rounded up."""
        reference = self.settings.reference_variables
        return -(-generations * min(len(self.family.variables), reference) // reference)

    def costs(self, values: Floats, plants: Floats, aim: float) -> Floats:
        """Cost (T,) of tunings from chatter, failing samples and peak error.

        The terms are the mean chatter, the share of failing samples, and the mean peak error
        beyond the limit, or beyond the share `aim` of it if that is less.
        """
        settings = self.settings
        runs, shape = self.runs(values, plants, settings.search_steps)
        peak = runs.unrounded.max(axis=1)
        within = self.options["within"]
        failed = ((runs.outside > 0) | (peak > aim * within)).reshape(shape)
        # Under an infinite aim the excess still begins at the limit, else it would be zero and
        # give the search no direction.
        excess = np.clip(peak - min(aim, 1.0) * within, 0, settings.cap).reshape(shape)
        # Both are capped: one loop that diverges must not hide the mean of all others.
        noise = np.minimum(self._noise(runs).reshape(shape), settings.cap)
        # The worst samples, as many as may fail, do not count.
        counted = shape[1] - int(self.allowed * shape[1])
        failed = np.sort(failed, axis=1)[:, :counted]
        excess = np.sort(excess, axis=1)[:, :counted]
        return (
            noise.mean(axis=1)
            + settings.failure_weight * failed.mean(axis=1)
            + settings.excess_weight * excess.mean(axis=1)
        )

    def initial(self) -> Floats:
        """Initial tunings (T, k) of the family."""
        return np.array([list(tuning.values()) for tuning in self.family.initial])

    def best(self, plants: Floats, seed: int, trials: list[Trial], beat: float = np.inf) -> Trial:
        """The tuning with the least chatter among those with few enough failures.

        If no tuning holds, the result is the tuning with the fewest failing samples.

        The search begins with plants (P, L) and adds each check to `trials`, which the caller keeps
        after an interruption. `beat` is the noise of the best tuning of another family; a noisier
        tuning that fails ends the search.
        """
        settings = self.settings
        population = self.initial()
        # Stages of the checkpoint are found again by name, in the order of the search.
        initial = functools.partial(self._hardest, population, plants)
        hard = self.checkpoint.stage("hardest", initial)

        def best_of(values: Floats) -> Trial:
            """The best tuning of a check.

            Its failing samples join the search, and so do the motions in which they fail.
            """
            nonlocal plants, hard
            check = functools.partial(self.checked, values)
            checks, joining, failing = self.checkpoint.stage(f"check {len(trials)}", check)
            trials.extend(checks)
            plants = np.vstack([plants, *joining])
            hard = sorted({*hard, *failing})
            return min(checks, key=_RANK)

        def search(generations: int, aim: float, radius: float = np.inf) -> Trial:
            nonlocal population
            # Only motions that were hard so far: an easy one costs as much time and decides
            # nothing.
            on_hard = dataclasses.replace(self, motions=tuple(self.motions[i] for i in hard))
            # Trials grow with each search, so each has another seed and another part of the file.
            population = on_hard._searched(
                plants, population, generations, aim, radius, seed + len(trials)
            )
            return best_of(population[: settings.checked_tunings])

        # If even the quietest initial tuning is much louder than `beat`, only a check follows.
        if np.isfinite(beat) and self._quietest(population, plants, hard[0]) > (
            settings.louder * beat
        ):
            return best_of(population[:1])

        # 1. Search for a tuning that holds, with ever more to spare before rounding.
        for generations, aim in settings.rounds:
            best = search(generations, aim)
            # Give up a family under which most samples fail, or which fails and is louder than
            # `beat`.
            hopeless = best.left > settings.hopeless_share * len(self.plants)
            if best.holds or hopeless or best.noise > beat:
                break

        # 2. From there, search nearby for less chatter as long as it pays.
        for _ in range(settings.quieter_searches if best.holds else 0):
            reached = min(trials, key=_RANK)
            population = np.vstack([list(reached.numbers.values()), population])
            search(generations, settings.quieter_aim, settings.quieter_radius)
            for values in self._between(trials):
                best_of(values)
            # The last search must have paid for another one.
            if min(trials, key=_RANK).noise > settings.quieter_gain * reached.noise:
                break
        return min(trials, key=_RANK)

    def _noise(self, runs: Runs) -> Floats:
        """Chatter of each run in shares of the joints' torques, mean of the joints."""
        return np.asarray((runs.chatter / self.scale).mean(axis=1))

    def _hardest(self, values: Floats, plants: Floats) -> list[int]:
        """The motions in which most samples fail under initial tunings (T, k).

        The hardest motion is first.
        """
        settings = self.settings
        order = list(range(len(self.motions)))
        # With so few motions the order does not matter: the search has them all.
        if len(order) <= settings.initial_motions:
            return order
        hardness = list[tuple[float, float]]()
        for motion in self.motions:
            alone = dataclasses.replace(self, motions=(motion,))
            runs, _ = alone.runs(values, plants, settings.search_steps)
            # Capped, so that one loop that diverges does not rank its motion.
            peak = np.minimum(runs.unrounded, settings.cap)
            hardness.append(((runs.outside > 0).mean(), peak.mean()))
        order.sort(key=hardness.__getitem__, reverse=True)
        return order[: settings.initial_motions]

    def _quietest(self, values: Floats, plants: Floats, motion: int) -> float:
        """Noise of the quietest of tunings (T, k) in one motion."""
        alone = dataclasses.replace(self, motions=(self.motions[motion],))
        runs, shape = alone.runs(values, plants, self.settings.search_steps)
        return float(self._noise(runs).reshape(shape).mean(axis=1).min())

    def _searched(
        self,
        plants: Floats,
        values: Floats,
        generations: int,
        aim: float,
        radius: float,
        seed: int,
    ) -> Floats:
        """Tunings (T, k) of the final generation, best first, from initial tunings `values`.

        The logarithms of the variables are searched, at most `radius` from the first tuning.
        """
        settings = self.settings
        # Bandwidths and damping ratios act by their ratios, so the search is in logarithms.
        bounds = np.log(np.array(list(self.family.variables.values())))
        centre = np.log(values[0])
        bounds = np.clip(bounds.T, centre - radius, centre + radius).T
        genetic = GeneticSettings(
            individuals=settings.individuals,
            subpopulations=settings.subpopulations,
            generations=self._generations(generations),
            bits_per_variable=settings.bits_per_variable,
        )

        def generation(state: Any) -> bool:
            hopeless = settings.hopeless_share * settings.failure_weight
            return bool(state.generation >= settings.hope_generation and state.best_cost > hopeless)

        initial = np.clip(np.log(values), bounds[:, 0], bounds[:, 1])[: genetic.individuals]
        objective = self.checkpoint.part(f"search {seed}").remembered(
            "costs", lambda population: self.costs(np.exp(population), plants, aim)
        )
        result = minimize_genetic(
            objective, bounds, genetic, seed, initial=initial, callback=generation
        )
        # The best individual of the whole run may have left the final population.
        population = np.vstack([result.x, result.final_population])
        costs = np.append(result.cost, result.final_costs)
        # Binary coding repeats individuals; a check of a copy would be wasted.
        population, index = np.unique(population, axis=0, return_index=True)
        return np.exp(population[np.argsort(costs[index], kind="stable")])

    def _between(self, trials: list[Trial]) -> Iterator[Floats]:
        """Tunings on the line from the best that holds to quieter ones that fail least.

        Each line begins at its quiet end: a check stops at the first tuning that holds.
        """
        # Between both lies often a tuning that still holds and is quieter.
        best = min(trials, key=_RANK)
        quieter = sorted((trial for trial in trials if trial.noise < best.noise), key=_RANK)
        start = np.log([*best.numbers.values()])
        # Without the ends: both have been checked.
        shares = np.linspace(1, 0, self.settings.between_points + 2)[1:-1]
        for trial in quieter[: self.settings.between_trials]:
            end = np.log([*trial.numbers.values()])
            yield np.exp(start + shares[:, None] * (end - start))

    def checked(self, values: Floats) -> tuple[list[Trial], list[Floats], list[int]]:
        """Check tunings (T, k) in turn until one holds.

        Returns the trials, the failing samples with the largest errors under each, and the motions
        in which samples fail.
        """
        plants = self.plants.numbers()[1]
        screening = self.settings.screening_samples
        trials = list[Trial]()
        joining = list[Floats]()
        # A motion joins the search when any sample fails in it.
        failing = set[int]()
        for row in values:
            # Few samples first: most tunings fail on them already.
            for block in (plants[:screening], plants):
                by_motion = [
                    dataclasses.replace(self, motions=(motion,)).runs(
                        row[None], block, self.settings.check_steps
                    )[0]
                    for motion in self.motions
                ]
                runs = Runs.joined(by_motion)
                failed = runs.outside > 0
                # Twice the allowed share: by chance alone few samples may show more than the share
                # itself.
                if failed.mean() > 2 * self.allowed or len(plants) <= screening:
                    break
            trials.append(self._trial(row, runs))
            # Samples that hold come last.
            errors = np.where(failed, runs.unrounded.max(axis=1), -1.0)
            worst = np.argsort(-errors, kind="stable")
            count = 0 if self.allowed else min(self.settings.joining_samples, failed.sum())
            # Where some may fail, those that do are no mistake of the search.
            joining.append(plants[worst[:count]])
            failing |= {i for i, alone in enumerate(by_motion) if (alone.outside > 0).any()}
            if trials[-1].holds:
                break
        return trials, joining, sorted(failing)  # a checkpoint holds lists, no sets

    def _trial(self, values: Floats, runs: Runs) -> Trial:
        """The trial of a tuning (k,) by its runs."""
        failed = runs.outside > 0
        # Joint by joint, mean of the samples.
        chatter = runs.chatter.mean(axis=0)
        return Trial(
            family=self.family.name,
            law=self.family.tuned(values),
            numbers=dict(zip(self.family.variables, values.tolist(), strict=True)),
            left=int(failed.sum()),
            of=len(failed),
            allowed=self._allowed(len(failed)),
            peak=float(runs.peak.max()),
            chatter=chatter,
            noise=float((chatter / self.scale).mean()),
        )

    def _allowed(self, samples: int) -> int:
        """Number of samples that may fail.

        With at most so many failures, a controller that was chosen beforehand keeps the allowed
        share with 95 % confidence.
        """
        counts = range(1, int(self.allowed * samples) + 1)
        # A two-sided interval of 90 % has the one-sided upper bound of 95 %.
        return sum(clopper_pearson(count, samples, 0.9)[1] <= self.allowed for count in counts)
