"""Subset simulation: a rare failure as a product of conditional probabilities.

None of the conditional probabilities is small.

Failures lie within ever higher levels of the response g(u) of independent standard normal numbers
u, and P(failure) = P(g > b_1) P(g > b_2 | g > b_1) ... Each level b_i is a quantile of the
population. From the part of the population above it, Markov chains u' = rho u + sqrt(1 - rho^2) xi
with the condition g(u') > b_i give the next population.

Source: S. K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset
simulation, Probabilistic Engineering Mechanics 16 (2001), eqs. (15), (28) to (30); the chains and
the adaptation of rho to the acceptance rate, I. Papaioannou et al., MCMC algorithms for subset
simulation, same journal 41 (2015).
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ctc.certification.uncertainty import Uncertainty
from plant import Law, Reference
from plant.parts import Floats, Frozen, frozen, frozen_settings, kept


@frozen_settings
class SubsetSettings:
    """Numbers of the subset simulation.

    ``tests/benchmarks/campaign.py --rare`` shows that the stated coefficient of variation is that
    over 60 seeds. The other numbers were chosen by hand.

    Parameters
    ----------
    population : int
        Samples of each level.
    level_share : float
        Share of a population that exceeds the next level.
    moves : float
        Accepted steps of a chain between two states that are kept. With half of it the spread over
        seeds exceeds the coefficient of variation that is stated.
    trial_steps : int
        Steps after which the chains are tested for being stuck.
    stuck_rate : float
        Mean acceptance rate over these steps below which they are.
    acceptance : float
        Acceptance rate to which the width of the steps is adapted (Papaioannou et al.).
    initial_width, narrowest, widest : float
        Width of a step sqrt(1 - rho^2): the first, and its limits.
    """

    # Levels
    population: int = 1000
    level_share: float = 0.1
    # Chains
    moves: float = 0.88
    trial_steps: int = 10
    stuck_rate: float = 0.02
    # Width of their steps
    acceptance: float = 0.44
    initial_width: float = 0.6
    narrowest: float = 0.25
    widest: float = 0.999


SETTINGS = SubsetSettings()


@kept
@frozen
class Rare(Frozen):
    """Probability that the largest error before rounding exceeds the limit, by subset simulation.

    Where the counts exceed the limit, this error does so, too. So its probability bounds that of a
    `Certificate` from above. The bound is loose: rounding of reference and counts can hide almost
    one pulse, so an error of one count may be almost two pulses before rounding.

    `asked`: probability that was to be shown. `probability`: the estimate. Where the simulation
    ended before it reached the limit (`below`, `stuck`), it is that of the highest level.
    `variation`: coefficient of variation of the estimate. `upper`: one-sided upper bound at the
    confidence, for a log-normal estimate. `below`: whether the upper bound of a level fell below
    `asked` before a level reached the limit. `stuck`: whether the simulation ended before either,
    because its chains no longer moved or all errors were equal. Beyond that level no uncertain
    number changes the error; rounding, for example, decides it.
    `levels` (k,): of the largest error before rounding [pulses]. `evaluations`: simulated samples.
    """

    asked: float
    probability: float
    variation: float
    upper: float
    below: bool
    stuck: bool
    levels: Floats
    evaluations: int

    @property
    def met(self) -> bool:
        """Whether the upper bound is at most the probability that was to be shown."""
        return self.upper <= self.asked

    def __str__(self) -> str:
        result = f"probability {self.probability:.2g}, at most {self.upper:.2g}"
        if self.below:
            result = f"rarer than {self.asked:g}: at most {self.upper:.2g}"
        elif self.stuck:
            result = (
                f"at most {self.upper:.2g}, no further: rounding decides beyond"
                f" {self.levels[-1]:.2f} pulses"
            )
        missed = "" if self.met else f"; not shown to be as rare as {self.asked:g}"
        method = (
            f"subset simulation of {self.evaluations:,} samples, coefficient of variation"
            f" {self.variation:.2f}"
        )
        return f"error before rounding beyond the limit: {result}{missed} ({method})"


def subset_simulation(
    response: Callable[[Floats], Floats],
    limit: float,
    numbers: int,
    rare: float,
    seed: int,
    confidence: float = 0.95,
) -> Rare:
    """Probability that a response exceeds a limit, from levels that end where it is below `rare`.

    The response: standard normal u (P, numbers) -> g (P,). Rows with g = -inf stand for no arm and
    are left out.
    """
    from scipy.special import ndtri

    # A stream of its own: plain samples of this seed use others.
    random = np.random.default_rng((seed, 4))
    population = SETTINGS.population
    quantile = ndtri(confidence)
    width = SETTINGS.initial_width

    # 1. The first population is an ordinary Monte Carlo sample.
    u = random.standard_normal((population, numbers))
    g = _errors(response, u)
    evaluations = population
    steps = 1
    u = u[g > -np.inf]
    # Chains cannot begin at a state that is no arm.
    g = g[g > -np.inf]
    if len(g) < population / 2:
        raise ValueError(
            f"samples must be arms; {population - len(g)} of them are not. Give less covariance."
        )
    probability = 1.0
    squares = 0.0  # squared coefficient of variation of the probability
    levels = list[float]()
    stuck = False
    while True:
        failed = g > limit
        # 2. Where the limit is no rarer than a level, the share beyond it is the last factor.
        reached = failed.mean() >= SETTINGS.level_share
        below = probability * _bound(squares, quantile) < rare
        if reached and not stuck:
            probability = probability * failed.mean()
            squares = squares + _square(failed, steps)
        if reached or below or stuck:
            upper = min(probability * _bound(squares, quantile), 1.0)
            return Rare(
                asked=rare,
                probability=float(probability),
                variation=float(np.sqrt(squares)),
                upper=float(upper),
                below=bool(below and not reached),
                stuck=stuck and not below,
                levels=np.array(levels),
                evaluations=evaluations,
            )
        # 3. The level is the midpoint between two distinct responses, so that about `level_share`
        # of the population exceeds it; equal responses are never split.
        order = np.argsort(-g, kind="stable")
        above = int(SETTINGS.level_share * len(g))
        distinct = np.unique(g)
        place = max(np.searchsorted(distinct, g[order[above - 1]]), 1)
        # No number changes responses that are all equal.
        stuck = len(distinct) == 1
        if stuck:
            levels.append(float(distinct[0]))
            continue
        low, high = distinct[place - 1 : place + 1]
        level = (low + high) / 2
        # Between neighbouring numbers, or below infinity, the midpoint may be the upper response.
        if not level < high:
            level = low
        above = min(above, int((g > level).sum()))
        probability = probability * (g > level).mean()
        squares = squares + _square(g > level, steps)
        levels.append(float(level))
        # 4. Chains from the states above the level restore the size of the population.
        steps = round(1 / SETTINGS.level_share)
        u, g, width, responses = _population(
            response, u[order[:above]], g[order[:above]], level, steps, width, random
        )
        evaluations = evaluations + responses
        stuck = not len(g)
        if stuck:
            # Without states the last level is all that is known, and the loop ends.
            g = np.full(1, -np.inf)


def _population(
    response: Callable[[Floats], Floats],
    u: Floats,
    g: Floats,
    level: float,
    steps: int,
    width: float,
    random: Any,
) -> tuple[Floats, Floats, float, int]:
    """States (P, numbers) and responses (P,) of Markov chains beyond a level.

    The states of the chains follow each other; chains that are stuck give none. Also returns the
    final width of their steps and the number of responses.
    """
    states = list[Floats]()
    responses = list[Floats]()
    count = 0
    moved = 0.0
    # Until the chains have as many states as the population needs.
    while len(states) < steps:
        # The proposal keeps the standard normal distribution, so only the level rejects.
        proposed = np.sqrt(1 - width**2) * u + width * random.standard_normal(u.shape)
        proposed_g = _errors(response, proposed)
        accepted = proposed_g > level
        u = np.where(accepted[:, None], proposed, u)
        g = np.where(accepted, proposed_g, g)
        count = count + 1
        moved = moved + accepted.mean()
        # Adaptation on the odds keeps the width between 0 and 1; its gain falls with the steps.
        surplus = accepted.mean() - SETTINGS.acceptance
        odds = width / (1 - width) * np.exp(2 * surplus / np.sqrt(count))
        width = float(np.clip(odds / (1 + odds), SETTINGS.narrowest, SETTINGS.widest))
        trials = SETTINGS.trial_steps
        # Chains that do not move would repeat their first states as if they were new samples.
        if count == trials and moved < SETTINGS.stuck_rate * trials:
            return u[:0], g[:0], width, count * len(g)
        # A state is kept only after enough accepted steps: neighbours of a chain are correlated.
        if moved >= SETTINGS.moves * (len(states) + 1):
            states.append(u)
            responses.append(g)
    return np.concatenate(states), np.concatenate(responses), width, count * len(g)


def _errors(response: Callable[[Floats], Floats], u: Floats) -> Floats:
    """Responses (P,); one that is NaN would pass for an error below every level."""
    g = response(u)
    if np.isnan(g).any():
        raise ValueError(
            f"the response must be a number for each sample; got NaN for {np.isnan(g).sum()} of"
            f" {len(g)}. Return inf where the error has no limit."
        )
    return g


def _square(beyond: Any, steps: int) -> float:
    """Squared coefficient of variation of a share estimated by Markov chains (eq. (29)).

    It includes the correlation along chains of so many steps.
    """
    # Rows are steps of the chains, columns the chains.
    chains = beyond.reshape(steps, -1).astype(float)
    share = beyond.mean()
    covariances = sum(
        (1 - k / steps) * ((chains[:-k] * chains[k:]).mean() - share**2) for k in range(1, steps)
    )
    # A share of 0 or 1 has no variance to divide by. Anticorrelation by chance counts as none.
    gamma = 2 * covariances / (share * (1 - share) or 1)
    return float((1 - share) / (share * len(beyond)) * (1 + max(gamma, 0.0)))


def _bound(squares: float, quantile: float) -> float:
    """Ratio of the upper bound to a log-normal estimate.

    The estimate has this squared coefficient of variation.
    """
    return float(np.exp(quantile * np.sqrt(np.log1p(squares))))


# Uncertainties that are drawn at every instant, or taken in turn: no number stands for them.
_NOT_NUMBERS = ("jitter", "dropped", "plants")


class Normals:
    """Stands for a random generator: the columns of u (P, d) are its draws, one after the other.

    With `random` it appends new columns to u and returns those. `sound` (P,): whether each row
    gives an arm whose inertia matrix is positive; whoever uses the draws writes it.
    """

    def __init__(self, u: Floats, random: Any = None) -> None:
        self.u = u
        self._random = random
        self._read = 0  # columns that were given out
        self.sound = np.ones(len(u), bool)

    def standard_normal(self, shape: Any) -> Floats:
        """The next columns."""
        # The first dimension of a shape counts the samples, which are the rows of u.
        count = int(np.prod(np.atleast_1d(shape)[1:]))
        if self._random is not None:
            self.u = np.hstack([self.u, self._random.standard_normal((len(self.u), count))])
        self._read += count
        return self.u[:, self._read - count : self._read].reshape(shape)

    def uniform(self, low: Any, high: Any, shape: Any) -> Floats:
        """The next columns as uniform numbers between two ends."""
        from scipy.special import ndtr

        return np.asarray(low + (high - low) * ndtr(self.standard_normal(shape)))


def require_numbers(uncertainty: Uncertainty) -> None:
    """Refuse uncertainties that no number of a sample stands for."""
    # A response must be a function of u alone, else a chain could not return to a state.
    for name in _NOT_NUMBERS:
        value = getattr(uncertainty, name)
        if value is not None and np.any(np.asarray(value) != 0):
            raise ValueError(
                f"rare needs uncertainties with one number for each sample; {name} has none. Leave"
                f" out {name} or rare."
            )


def rare_failure(
    task: Any,
    law: Law,
    motions: Mapping[str, tuple[Reference, dict[str, Any]]],
    rare: float,
    confidence: float,
) -> Rare:
    """Probability that the error before rounding exceeds the limit in any motion.

    The probability is over the samples of a task.
    """

    def response(u: Floats) -> Floats:
        normals = Normals(u)
        plants = task.sampled(len(u), normals=normals)
        worst = np.full(len(u), -np.inf)
        # Failure is to exceed the limit in any motion, so the worst motion counts.
        for path, settings in motions.values():
            runs = plants.under(law, path, within=task.within, **settings).run(task.threads)
            worst = np.maximum(worst, runs.unrounded.max(axis=1))
        # A row that is no arm must never be a state of a chain.
        return np.where(normals.sound, worst, -np.inf)

    # A trial draw of two samples counts the numbers that one sample needs.
    trial = Normals(np.empty((2, 0)), np.random.default_rng(0))
    task.sampled(2, normals=trial)
    return subset_simulation(response, task.within, trial.u.shape[1], rare, task.seed, confidence)
