"""Genetic algorithm of paper section 3.7: binary chromosomes, sub-populations, migration.

Costs are minimised; sub-populations are equal contiguous blocks of rows; NaN is the worst cost,
worse than infinity. Random numbers are drawn here, from one generator, never in the objective. P
individuals in all, N per sub-population, L bits per chromosome, p variables. Read
`minimize_genetic`, `_next_generation`, then the operators.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

INF = float("inf")
Floats: TypeAlias = NDArray[np.float64]
Bits: TypeAlias = NDArray[np.uint8]


def _require(good: Any, message: str) -> None:
    if not good:
        raise ValueError(message)


def _check_number(name: str, value: Any, kind: Any, low: float, high: float) -> None:
    good = isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high
    noun = "a whole number" if kind is Integral else "a number"
    span = f"from {low} to {high}" if math.isfinite(high) else f"of at least {low}"
    _require(good, f"{name} must be {noun} {span}; got {value!r}. Pass one.")


def _within(default: Any, kind: type, low: float, high: float = INF) -> Any:
    """Dataclass field with the range of its values; None is allowed where it is the default."""
    return field(default=default, metadata={"range": (kind, low, high)})


@dataclass(frozen=True, kw_only=True)
class GeneticSettings:
    """Settings of the genetic algorithm; the defaults are the paper's. Source: paper section 3.7.

    Where the paper states no value the default is chosen by hand.

    Parameters
    ----------
    individuals : int
        N, in each sub-population.
    subpopulations : int
    generations : int
        After the initial population.
    bits_per_variable : int or tuple of int
        1 to 53; for every variable, or one for each.
    coding : {"binary", "gray"}
    ranking : {"linear", "nonlinear"}
    pressure : float
        Fitness of the best individual; at most 2 if linear, N - 1 if nonlinear.
    crossover_probability : float
        Of a pair.
    mutation_probability : float or None
        Of a bit; None for 0.7 / L.
    generation_gap : float
        Offspring per individual.
    migration_rate : float
        Migrants per individual; 0 for none.
    migration_interval : int
        Generations from one migration to the next.
    safe : bool
        Whether the best individual of a sub-population always survives, see `reinsert` and
        `migrate`; False as in the toolbox that the paper used.
    target : float or None
        Cost at which the search stops.

    See Also
    --------
    identification.minimize_genetic, identification.identify

    Examples
    --------
    >>> from identification import GeneticSettings
    >>> settings = GeneticSettings(generations=10)
    >>> settings.individuals, settings.subpopulations
    (20, 4)
    """

    # Population and duration of the run.
    individuals: int = _within(20, Integral, 2)
    subpopulations: int = _within(4, Integral, 1)
    generations: int = _within(40, Integral, 1)
    # Representation of a point, see `decode`.
    bits_per_variable: int | tuple[int, ...] = 16
    coding: str = "binary"
    # Operators of a generation, in their order: selection, recombination, mutation.
    ranking: str = "linear"
    pressure: float = _within(2.0, Real, 1)
    crossover_probability: float = _within(0.6, Real, 0, 1)
    mutation_probability: float | None = _within(None, Real, 0, 1)
    generation_gap: float = _within(0.94, Real, 0, 1)
    # Exchange between sub-populations, survival, and end.
    migration_rate: float = _within(0.3, Real, 0, 1)
    migration_interval: int = _within(20, Integral, 1)
    safe: bool = True
    target: float | None = _within(None, Real, -INF)

    def __post_init__(self) -> None:
        # Metadata of a field hold its range; the others are checked below.
        for setting in fields(self):
            value = getattr(self, setting.name)
            if setting.metadata and not (value is None and setting.default is None):
                _check_number(setting.name, value, *setting.metadata["range"])
        _require(
            self.ranking in ("linear", "nonlinear"),
            f"ranking must be 'linear' or 'nonlinear'; got {self.ranking!r}. Choose one of the"
            " two.",
        )
        # With more pressure the worst fitness would be negative, or no root X would exist.
        highest = 2 if self.ranking == "linear" else self.individuals - 1
        _check_number("pressure", self.pressure, Real, 1, highest)
        _require(
            isinstance(self.safe, bool),
            f"safe must be True or False; got {self.safe!r}. Pass one of the two.",
        )
        bits: Any = self.bits_per_variable
        if np.ndim(bits):
            # A list would make the frozen settings mutable.
            object.__setattr__(self, "bits_per_variable", tuple(bits))
        # The number of variables is not known yet: check bits and coding with any box of as many.
        _code([(0, 1)] * max(np.size(bits), 1), self.bits_per_variable, self.coding)

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """Settings of the paper with `changes` by name. Source: paper section 3.7."""
        return cls(**changes)

    @property
    def offspring(self) -> int:
        """Offspring of a sub-population in a generation: max(round(N gap), 2), halves up."""
        return max(int(self.individuals * self.generation_gap + 0.5), 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class GeneticState:
    """Running state, which a callback may store: each generation makes a new one.
    Source: paper section 3.1.

    `chromosomes` (P, L): of 0 and 1. `costs` (P,). `best_x` (p,), `best_cost`: best individual
    evaluated so far. `generation`: 0 after the initial population is evaluated. `history`
    (generation + 1, 3): as in `GeneticResult`.
    """

    chromosomes: Bits
    costs: Floats
    best_x: Floats
    best_cost: float = float("nan")
    generation: int = -1
    evaluations: int = 0
    history: Floats
    rng: np.random.Generator


@dataclass(frozen=True, kw_only=True, eq=False)
class GeneticResult:
    """Result of `minimize_genetic`. Source: paper section 3.1.

    `x` (p,), `cost`: best individual evaluated in the run. `initial_cost`: best of the initial
    population. `initial_population`, `final_population` (P, p): decoded. `initial_costs`,
    `final_costs` (P,). `history` (generations done + 1, 3): best, mean and worst finite cost of
    each population, inf if none. `message`: reason for the stop.
    """

    x: Floats
    cost: float
    initial_cost: float
    initial_population: Floats
    initial_costs: Floats
    final_population: Floats
    final_costs: Floats
    history: Floats
    evaluations: int
    seed: int
    settings: GeneticSettings
    message: str

    def __repr__(self) -> str:
        costs = f"cost {self.initial_cost:.4g} -> {self.cost:.4g}"
        return f"GeneticResult({len(self.x)} numbers, {costs}, {self.evaluations} evaluations)"


def minimize_genetic(
    objective: Callable[[Floats], ArrayLike],
    bounds: ArrayLike,
    settings: GeneticSettings | None = None,
    seed: int = 0,
    *,
    initial: ArrayLike | None = None,
    callback: Callable[[GeneticState], object] | None = None,
) -> GeneticResult:
    """Minimise an objective inside a box by the genetic algorithm. Source: paper section 3.7.

    Parameters
    ----------
    objective : callable
        Population (P, p) -> costs (P,); called once per generation, with all sub-populations
        together.
    bounds : array_like (p, 2)
        Lower and upper bound of each variable; equal bounds fix it.
    settings : GeneticSettings, optional
        By default `GeneticSettings.paper()`.
    seed : int
        Same seed, same bits.
    initial : array_like (k, p), optional
        Points whose nearest chromosomes become the first k rows of the initial population.
    callback : callable, optional
        Called with the `GeneticState` after each generation but the initial one; the run stops
        where it returns a true value.

    Returns
    -------
    GeneticResult

    Raises
    ------
    ValueError
        If an argument cannot be used, or the objective raises or does not return (P,) real numbers.

    See Also
    --------
    identification.GeneticSettings

    Examples
    --------
    >>> from identification import minimize_genetic
    >>> result = minimize_genetic(lambda x: ((x - 0.3) ** 2).sum(axis=1), [(0, 1), (0, 1)], seed=1)
    >>> result.x.round(2)
    array([0.3, 0.3])
    """
    # 1. Validate the arguments.
    settings = GeneticSettings.paper() if settings is None else settings
    _require(
        isinstance(settings, GeneticSettings),
        f"settings must be GeneticSettings; got {type(settings).__name__}. Pass None for those of"
        " the paper.",
    )
    _check_number("seed", seed, Integral, 0, INF)
    code = bounds, settings.bits_per_variable, settings.coding
    shape = settings.subpopulations * settings.individuals, sum(_code(*code)[2])

    # The one way to the objective, for the initial population and for all offspring.
    def evaluate(chromosomes: Bits) -> tuple[Floats, Floats]:
        x = decode(chromosomes, *code)
        return x, _evaluate(objective, x)

    # 2. Draw the initial population. It is drawn in full before points replace rows of it, so that
    # `initial` changes no other row.
    rng = np.random.default_rng(int(seed))
    chromosomes = rng.integers(0, 2, shape, dtype=np.uint8)
    if initial is not None:
        # A point is replaced by its nearest chromosome, so its cost may differ a little.
        seeds = encode(_points("initial", initial, len(np.asarray(bounds))), *code)
        _require(
            len(seeds) <= shape[0],
            f"initial must be at most {shape[0]} points; got {len(seeds)}. Pass fewer.",
        )
        chromosomes[: len(seeds)] = seeds
    x, costs = evaluate(chromosomes)
    # A state before any cost is known: `_advance` makes it generation 0.
    blank = GeneticState(
        chromosomes=chromosomes, costs=costs, best_x=x[0], history=np.empty((0, 3)), rng=rng
    )
    initial_state = _advance(blank, chromosomes, costs, x, costs)

    # 3. Generations, until there is a reason to stop.
    state = initial_state
    message = _reason_to_stop(state, settings)
    # The callback sees no state before generation 1, so that every run has one generation.
    while not message:
        state = _next_generation(state, settings, evaluate)
        message = _reason_to_stop(state, settings, callback is not None and bool(callback(state)))
    return GeneticResult(
        x=state.best_x,
        cost=state.best_cost,
        initial_cost=initial_state.best_cost,
        initial_population=x,
        initial_costs=initial_state.costs,
        final_population=decode(state.chromosomes, *code),
        final_costs=state.costs,
        history=state.history,
        evaluations=state.evaluations,
        seed=int(seed),
        settings=settings,
        message=message,
    )


def _next_generation(
    state: GeneticState,
    settings: GeneticSettings,
    evaluate: Callable[[Bits], tuple[Floats, Floats]],
) -> GeneticState:
    """Rank, select, recombine, mutate, evaluate, reinsert; migrate at the end of an interval."""
    # 1. Offspring of each sub-population, by itself.
    rng = state.rng
    # Costs only count by their rank: their scale does not matter, and some may be infinite.
    rank = rank_linear if settings.ranking == "linear" else rank_nonlinear
    mutation = settings.mutation_probability
    mutation = 0.7 / state.chromosomes.shape[1] if mutation is None else mutation
    # Row numbers of each sub-population.
    groups = np.arange(len(state.costs)).reshape(settings.subpopulations, -1)
    offspring = []
    for rows in groups:
        fitness = rank(state.costs[rows], settings.pressure)
        # Selection, recombination and mutation draw from one generator in this order; any other
        # order gives another run of the same seed.
        parents = state.chromosomes[rows[select(fitness, settings.offspring, rng)]]
        children = crossover(parents, settings.crossover_probability, rng)
        offspring.append(mutate(children, mutation, rng))

    # 2. Evaluate all of them at once: the objective runs them side by side.
    x, new_costs = evaluate(np.concatenate(offspring))
    parts = np.split(new_costs, len(groups))

    # 3. Reinsert and migrate; the previous state stays as it is.
    chromosomes = state.chromosomes.copy()
    costs = state.costs.copy()
    for rows, children, children_costs in zip(groups, offspring, parts, strict=True):
        chromosomes[rows], costs[rows] = reinsert(
            chromosomes[rows], costs[rows], children, children_costs, safe=settings.safe
        )
    if (state.generation + 1) % settings.migration_interval == 0:
        count = settings.subpopulations
        rate = settings.migration_rate
        chromosomes, costs = migrate(chromosomes, costs, count, rate, rng, safe=settings.safe)
    return _advance(state, chromosomes, costs, x, new_costs)


def _advance(
    state: GeneticState, chromosomes: Bits, costs: Floats, x: Floats, new_costs: Floats
) -> GeneticState:
    """State of the next generation, after points x (M, p) were evaluated at new_costs (M,)."""
    # Not argmin, which takes NaN for the least.
    best = np.argsort(new_costs, kind="stable")[0]
    cost = new_costs[best]
    # The best cost is NaN until a cost is a number, and a comparison with NaN is false.
    if cost < state.best_cost or (np.isnan(state.best_cost) and not np.isnan(cost)):
        state = replace(state, best_x=x[best].copy(), best_cost=float(cost))
    # Statistics of the population that remains, not of the offspring.
    finite = costs[np.isfinite(costs)]
    mean, worst = (finite.mean(), finite.max()) if finite.size else (INF, INF)
    row = (np.fmin.reduce(costs, initial=INF), mean, worst)
    return replace(
        state,
        chromosomes=chromosomes,
        costs=costs,
        generation=state.generation + 1,
        evaluations=state.evaluations + len(x),
        history=np.vstack([state.history, row]),
    )


def _reason_to_stop(state: GeneticState, settings: GeneticSettings, stopped: bool = False) -> str:
    """Message of the result, or "" while there is no reason to stop."""
    # Where several reasons hold, the message has the target.
    done = state.generation
    if settings.target is not None and state.best_cost <= settings.target:
        reason = (
            f"Stopped in generation {done}: the best cost reached the target {settings.target:g}."
        )
    elif done == settings.generations:
        reason = f"All {done} generations done."
    elif stopped:
        reason = f"Stopped in generation {done} by the callback."
    else:
        return ""
    if np.isfinite(state.best_cost):
        return f"{reason} Best cost {state.best_cost:.6g}."
    return f"{reason} No candidate had a finite cost."


def _evaluate(objective: Callable[[Floats], ArrayLike], x: Floats) -> Floats:
    """Costs (P,) of points (P, p); the objective gets a copy, which it may change."""
    wanted = (
        f"objective must return real costs of shape ({len(x)},), inf or NaN for a bad candidate"
    )
    try:
        # Whatever the objective raises is reported with the shape that it must return.
        costs = np.asarray(objective(x.copy()))
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"{wanted}; it raised {message}. Mend the objective.") from error
    good = costs.shape == (len(x),) and costs.dtype.kind in "fiu"
    _require(good, f"{wanted}; got {costs.dtype} of shape {costs.shape}. Mend the objective.")
    return costs.astype(float)  # a copy


def _code(
    bounds: ArrayLike, bits_per_variable: Any, coding: str
) -> tuple[Floats, Floats, NDArray[np.int_]]:
    """Lower (p,) and upper bounds (p,) and the bits of each variable (p,), all validated."""
    # A range wider than the largest double has no width to scale by.
    ends = _points("bounds", bounds, 2)
    for j, (low, high) in enumerate(ends.tolist()):
        good = low <= high and high - low < INF
        _require(
            good,
            f"bounds must be lower <= upper, less than inf apart; got {(low, high)} at {j}. Swap or"
            " narrow.",
        )
    widths = (
        tuple(bits_per_variable) if np.ndim(bits_per_variable) else (bits_per_variable,) * len(ends)
    )
    # 53 bits are exact in a double.
    for bits in widths:
        _check_number("bits_per_variable", bits, Integral, 1, 53)
    need = f"bits_per_variable must be an int or one for each of the {len(ends)} variables"
    _require(
        len(widths) == len(ends) > 0,
        f"{need}; got {len(widths)}. Pass an int, or as many as bounds has rows.",
    )
    _require(
        coding in ("binary", "gray"),
        f"coding must be 'binary' or 'gray'; got {coding!r}. Choose one of the two.",
    )
    return ends[:, 0], ends[:, 1], np.array(widths, int)


def _points(name: str, value: ArrayLike, columns: int) -> Floats:
    """A value as a new array (rows, columns) of finite numbers."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        # A value that is no array of numbers fails the check below, with the same message.
        array = np.array(np.nan)
    good = array.ndim == 2 and array.shape[1] == columns and np.isfinite(array).all()
    # The message has the shape if that is wrong, otherwise the start of the value.
    got = f"shape {array.shape}" if np.isfinite(array).all() else f"{value!r:.60}".replace("\n", "")
    _require(
        good,
        f"{name} must be finite numbers of shape (any, {columns}); got {got}. Pass such an array.",
    )
    return array


def decode(
    bits: ArrayLike,
    bounds: ArrayLike,
    bits_per_variable: int | tuple[int, ...],
    coding: str = "binary",
) -> Floats:
    """Points (P, p) of chromosomes (P, L) in bounds (p, 2): lb + (ub - lb) I / (2^n - 1).

    I is the integer of n bits of a variable, most significant bit first; in Gray code each of its
    digits is the parity of the bits up to it. Source: paper section 3.7.
    """
    lower, upper, widths = _code(bounds, bits_per_variable, coding)
    # Bits enter as numbers, so that the same check refuses a wrong shape.
    rows = _points("bits", bits, widths.sum()).astype(np.uint8)
    integers = np.empty((len(rows), len(widths)))
    for j, block in enumerate(np.split(rows, np.cumsum(widths)[:-1], axis=1)):
        digits = np.bitwise_xor.accumulate(block, axis=1) if coding == "gray" else block
        integers[:, j] = digits @ 2.0 ** np.arange(widths[j])[::-1]  # exact up to 53 bits
    # Rounding could leave the bounds by the last digit.
    return np.clip(lower + (upper - lower) * (integers / (2.0**widths - 1)), lower, upper)


def encode(
    points: ArrayLike,
    bounds: ArrayLike,
    bits_per_variable: int | tuple[int, ...],
    coding: str = "binary",
) -> Bits:
    """Chromosomes (k, L) nearest to points (k, p); a point outside the bounds moves to the bound.

    The other arguments are those of `decode`. Source: paper section 3.2.
    """
    lower, upper, widths = _code(bounds, bits_per_variable, coding)
    inside = np.clip(_points("points", points, len(widths)), lower, upper)
    # Equal bounds fix a variable: any chromosome decodes to it.
    share = (inside - lower) / np.where(upper > lower, upper - lower, 1)
    integers = np.rint(share * (2.0**widths - 1)).astype(np.int64)
    if coding == "gray":
        integers = integers ^ (integers >> 1)
    digits = [integers[:, [j]] >> np.arange(n)[::-1] & 1 for j, n in enumerate(widths)]
    return np.hstack(digits).astype(np.uint8)


def rank_linear(costs: Floats, pressure: float = 2.0) -> Floats:
    """Fitness (N,) of costs (N,): linear in rank, from 2 - pressure (worst) to pressure (best).

    `pressure` is 1 to 2. Equal costs share their mean fitness; the sum is N.
    Source: paper section 3.7.
    """
    # With these ends the mean fitness is 1.
    return _by_rank(costs, np.linspace(2 - pressure, pressure, len(costs)))


def rank_nonlinear(costs: Floats, pressure: float = 2.0) -> Floats:
    """Fitness (N,) of costs (N,): N X^rank / sum X^i, growing to the pressure at the best.

    `pressure` is 1 to N - 1. X is the positive root of
    (pressure - N) X^(N-1) + pressure (X^(N-2) + ... + 1) = 0.
    Source: paper section 3.7.
    """
    n = len(costs)
    # the Perron root: no other is as large
    root = np.roots([pressure - n] + [pressure] * (n - 1)).real.max()
    return _by_rank(costs, pressure * root ** np.arange(1.0 - n, 1))


def _by_rank(costs: Floats, fitness: Floats) -> Floats:
    """Assign fitness (N,), worst first, to costs (N,); equal costs share the mean.

    numpy sorts NaN last, so it is the worst cost.
    """
    # `order` is best first, the fitness worst first.
    shared = np.empty(len(costs))
    order = np.argsort(costs, kind="stable")
    shared[order[::-1]] = fitness
    ranked = np.asarray(costs)[order]
    if (ranked[1:] > ranked[:-1]).all():  # no two costs are equal
        return shared
    # Mean fitness of the individuals with the same cost.
    tie = np.unique(costs, return_inverse=True)[1]
    return (np.bincount(tie, shared) / np.bincount(tie))[tie]


def select(fitness: Floats, number: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Shuffled row numbers (number,) by stochastic universal sampling.

    Each row occurs as often as its share of the fitness times `number`, rounded up or down. Equally
    spaced pointers with one random offset fall on the cumulated fitness (N,). Source: paper section
    3.7.
    """
    # One offset for all pointers has less scatter than independent draws.
    edges = np.cumsum(fitness)
    pointers = (rng.random() + np.arange(number)) * (edges[-1] / number)
    # rounding must not point past the end
    pointers = np.minimum(pointers, np.nextafter(edges[-1], 0))
    return rng.permutation(np.searchsorted(edges, pointers, side="right"))


def crossover(bits: Bits, probability: float, rng: np.random.Generator) -> Bits:
    """Offspring (M, L): rows (1, 2), (3, 4), ... exchange their tails with this probability.

    The cut is uniform on 1 ... L - 1; an odd last row passes through. Source: paper section 3.7.
    """
    even = len(bits) // 2 * 2
    length = bits.shape[1]
    # A chromosome of one bit has no place to cut; the draw takes place all the same.
    cut = rng.integers(1, max(length, 2), (even // 2, 1))
    swap = (rng.random((even // 2, 1)) < probability) & (np.arange(length) >= cut)
    mothers = bits[:even:2]
    fathers = bits[1:even:2]
    children = bits.copy()
    children[:even:2] = np.where(swap, fathers, mothers)
    children[1:even:2] = np.where(swap, mothers, fathers)
    return children


def mutate(bits: Bits, probability: float, rng: np.random.Generator) -> Bits:
    """Bits (M, L), each flipped with this probability. Source: paper section 3.7."""
    # Exclusive or flips a bit where the draw is below the probability.
    return bits ^ (rng.random(bits.shape) < probability)


def reinsert(
    parents: Bits,
    parent_costs: Floats,
    offspring: Bits,
    offspring_costs: Floats,
    *,
    safe: bool = True,
) -> tuple[Bits, Floats]:
    """Chromosomes (N, L), costs (N,) after offspring (M, L) replace the worst parents.

    Offspring replace parents of lower cost, too. If safe, the best parent stays. Of more offspring
    than places the best are taken.
    Source: paper section 3.7.
    """
    # Replacing all but the best parent keeps the best cost from rising.
    number = min(len(offspring), len(parents) - bool(safe))
    worst = np.argsort(parent_costs, kind="stable")[::-1][:number]
    best = np.argsort(offspring_costs, kind="stable")[:number]
    chromosomes = parents.copy()
    costs = parent_costs.copy()
    chromosomes[worst] = offspring[best]
    costs[worst] = offspring_costs[best]
    return chromosomes, costs


def migrate(
    chromosomes: Bits,
    costs: Floats,
    subpopulations: int,
    rate: float,
    rng: np.random.Generator,
    *,
    safe: bool = True,
) -> tuple[Bits, Floats]:
    """Chromosomes (P, L), costs (P,) after simultaneous migration of copies in a complete net.

    Each sub-population receives m = max(floor(N rate), 1) individuals, none at rate 0. They are
    drawn without replacement from the m best of every other sub-population. If safe, m is at most
    N - 1 and they replace the worst; else the leading rows, whatever their cost. Source: paper
    section 3.7.
    """
    if rate == 0 or subpopulations == 1:
        return chromosomes.copy(), costs.copy()
    # All migrants are copies of the populations before migration.
    groups = np.arange(len(costs)).reshape(subpopulations, -1)
    moved = chromosomes.copy()
    moved_costs = costs.copy()
    # best first
    ranked = np.take_along_axis(groups, np.argsort(costs[groups], axis=1, kind="stable"), axis=1)
    # In binary 100 * 0.29 is less than 29; the small number restores the integer.
    number = min(max(int(groups.shape[1] * rate + 1e-9), 1), groups.shape[1] - bool(safe))
    for group in range(subpopulations):
        # The complete net: every sub-population but this one may send.
        candidates = np.delete(ranked, group, axis=0)[:, :number].ravel()
        migrants = rng.choice(candidates, number, replace=False)
        replaced = ranked[group, ::-1][:number] if safe else groups[group, :number]
        moved[replaced] = chromosomes[migrants]
        moved_costs[replaced] = costs[migrants]
    return moved, moved_costs
