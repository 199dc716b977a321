"""Probability of a rare failure by subset simulation: a chain of conditional probabilities, each of
them common.

Failures lie within ever higher levels of the response g(u) of independent standard normal numbers
u, and P(failure) = P(g > b_1) P(g > b_2 | g > b_1) ... Each level b_i is the quantile that a share
of the population exceeds; from those above it Markov chains u' = rho u + sqrt(1 - rho^2) xi, kept
where g(u') > b_i, give the next population.

Source: S. K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset
simulation, Probabilistic Engineering Mechanics 16 (2001), eqs. (15), (28) to (30); the chains, and
how rho follows from the share that is accepted, I. Papaioannou et al., MCMC algorithms for subset
simulation, same journal 41 (2015).
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from plant import Law, Reference
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept

# of each level, and the share of it that exceeds the next level
_POPULATION = 1000
_SHARE = 0.1
# accepted steps between two that are kept: with half of it the spread over seeds exceeds what is
# stated
_MOVES = 0.88
# steps that tell how many are accepted; the share of them below which chains do not move
_TRIED = 10
_STUCK = 0.02
# share of the steps to be accepted; sqrt(1 - rho^2) to begin with
_ACCEPTED = 0.44
_BEGINNING = 0.6
# limits of sqrt(1 - rho^2)
_NARROW = 0.25
_WIDE = 0.999


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Rare(Frozen):
    """Probability that the largest error before rounding exceeds the limit, by subset simulation.

    Where the counts exceed the limit this error does, too, so it bounds what a `Certificate`
    counts; it is the larger of the two, since an error of up to two pulses may be one of the
    counts.

    `asked`: below which it is to be. `probability`: the estimate; with `below` or `stuck` that of
    the last level, beyond which the limit lies. `variation`: coefficient of variation of the
    estimate. `upper`: one-sided upper bound at the confidence, the estimate taken as log-normal.
    `below`: whether the levels went below `asked` before they reached the limit. `stuck`: whether
    they ended before either, since chains no longer move: what decides the error there, such as the
    chance of rounding, follows from none of the uncertain numbers. The bound is that of the last
    level. `levels` (k,): of the largest error before rounding [pulses]. `evaluations`: samples that
    were simulated.
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
        """Whether the probability is below what was asked, at the confidence."""
        return self.upper <= self.asked

    def __str__(self) -> str:
        how = (
            f"subset simulation of {self.evaluations:,} samples, coefficient of variation"
            f" {self.variation:.2f}"
        )
        some = f"probability {self.probability:.2g}, at most {self.upper:.2g}"
        if self.below:
            some = f"rarer than {self.asked:g}: at most {self.upper:.2g}"
        elif self.stuck:
            some = (
                f"at most {self.upper:.2g}, no further: rounding decides beyond"
                f" {self.levels[-1]:.2f} pulses"
            )
        missed = "" if self.met else f"; not shown to be as rare as {self.asked:g}"
        return f"error before rounding beyond the limit: {some}{missed} ({how})"


def subset_simulation(
    response: Callable[[Floats], Floats],
    limit: float,
    numbers: int,
    rare: float,
    seed: int,
    confidence: float = 0.95,
) -> Rare:
    """Probability that a response exceeds a limit; the levels end where it is below `rare`, at the
    confidence.

    The response: standard normal u (P, numbers) -> g (P,), -inf of what cannot be, which is left
    out.
    """
    from scipy.special import ndtri

    random = np.random.default_rng((seed, 4))
    width = _BEGINNING
    u = random.standard_normal((_POPULATION, numbers))
    g = response(u)
    evaluations = _POPULATION
    steps = 1
    u = u[g > -np.inf]
    g = g[g > -np.inf]
    if len(g) < _POPULATION / 2:
        raise ValueError(
            f"samples must be arms; {_POPULATION - len(g)} of them are not. Give less covariance."
        )
    probability = 1.0
    squares = 0.0
    levels = list[float]()
    stuck = False
    while True:
        failed = g > limit
        above = int(_SHARE * len(g))
        reached = failed.mean() >= _SHARE
        below = probability * _bound(squares, ndtri(confidence)) < rare
        if reached and not stuck:
            probability = probability * failed.mean()
            squares = squares + _square(failed, steps)
        if reached or below or stuck:
            upper = min(probability * _bound(squares, ndtri(confidence)), 1.0)
            return Rare(
                asked=rare,
                probability=float(probability),
                variation=float(np.sqrt(squares)),
                upper=float(upper),
                below=below and not reached,
                stuck=stuck,
                levels=np.array(levels),
                evaluations=evaluations,
            )
        order = np.argsort(-g, kind="stable")
        level = (g[order[above - 1]] + g[order[above]]) / 2
        probability = probability * (g > level).mean()
        squares = squares + _square(g > level, steps)
        levels.append(float(level))
        steps = round(1 / _SHARE)
        u, g, width, taken = _population(
            response, u[order[:above]], g[order[:above]], level, steps, width, random
        )
        evaluations = evaluations + taken
        stuck = not len(g)
        if stuck:
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
    """States of Markov chains beyond a level, step by step, none where they are stuck; the width of
    their steps at the end; the responses that it took.
    """
    us = list[Floats]()
    gs = list[Floats]()
    taken = 0
    moved = 0.0
    while len(us) < steps:
        proposed = np.sqrt(1 - width**2) * u + width * random.standard_normal(u.shape)
        there = response(proposed)
        accepted = there > level
        u, g = np.where(accepted[:, None], proposed, u), np.where(accepted, there, g)
        taken = taken + 1
        moved = moved + accepted.mean()
        odds = width / (1 - width) * np.exp(2 * (accepted.mean() - _ACCEPTED) / np.sqrt(taken))
        width = float(np.clip(odds / (1 + odds), _NARROW, _WIDE))
        if taken == _TRIED and moved < _STUCK * _TRIED:
            return u[:0], g[:0], width, taken * len(g)
        if moved >= _MOVES * (len(us) + 1):
            us.append(u)
            gs.append(g)
    return np.concatenate(us), np.concatenate(gs), width, taken * len(g)


def _square(beyond: Any, steps: int) -> float:
    """Squared coefficient of variation of a share, with the correlation along chains of so many
    steps (eq. (29)).
    """
    chains = beyond.reshape(steps, -1).astype(float)
    share = beyond.mean()
    lags = range(1, steps)
    products = [(chains[:-k] * chains[k:]).mean() - share**2 for k in lags]
    gamma = (
        2
        * sum((1 - k / steps) * each for k, each in zip(lags, products, strict=True))
        / (share * (1 - share) or 1)
    )
    return float((1 - share) / (share * len(beyond)) * (1 + max(gamma, 0.0)))


def _bound(squares: float, quantile: float) -> float:
    """Ratio of an upper bound to an estimate of this squared coefficient of variation,
    log-normal.
    """
    return float(np.exp(quantile * np.sqrt(np.log1p(squares))))


# what an `Uncertainty` draws at every instant, or takes in turn
_NOT_NUMBERS = ("jitter", "dropped", "plants")


class Normals:
    """Stands for a random generator: what it gives are columns of u (P, d), which grow with what
    is first asked for.
    """

    def __init__(self, u: Floats, random: Any = None) -> None:
        self.u = u
        self._random = random
        self._at = 0
        self.sound = np.ones(len(u), bool)

    def standard_normal(self, shape: Any) -> Floats:
        """The next columns."""
        count = int(np.prod(np.atleast_1d(shape)[1:]))
        if self._random is not None:
            self.u = np.hstack([self.u, self._random.standard_normal((len(self.u), count))])
        self._at += count
        return self.u[:, self._at - count : self._at].reshape(shape)

    def uniform(self, low: Any, high: Any, shape: Any) -> Floats:
        """The same between two ends."""
        from scipy.special import ndtr

        return np.asarray(low + (high - low) * ndtr(self.standard_normal(shape)))


def rare_failure(
    task: Any,
    law: Law,
    motions: Mapping[str, tuple[Reference, dict[str, Any]]],
    rare: float,
    confidence: float,
) -> Rare:
    """Probability that the error before rounding exceeds the limit in any motion, over the
    samples of a task.
    """
    for name in _NOT_NUMBERS:
        value = getattr(task.uncertainty, name)
        if value is not None and np.any(np.asarray(value) != 0):
            raise ValueError(
                f"rare needs what is one number of each sample; {name} is none. Leave out {name} or"
                " rare."
            )

    def response(u: Floats) -> Floats:
        normals = Normals(u)
        plants, worst = task.sampled(len(u), normals=normals), np.full(len(u), -np.inf)
        for path, settings in motions.values():
            runs = plants.under(law, path, within=task.within, **settings).run(task.threads)
            worst = np.maximum(worst, runs.unrounded.max(axis=1))
        return np.where(normals.sound, worst, -np.inf)

    grown = Normals(np.empty((2, 0)), np.random.default_rng(0))
    task.sampled(2, normals=grown)
    return subset_simulation(response, task.within, grown.u.shape[1], rare, task.seed, confidence)
