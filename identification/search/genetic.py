"""The genetic algorithm of paper section 3.7: binary chromosomes in sub-populations that exchange
migrants.

Costs are minimised; sub-populations are equal contiguous blocks of rows; NaN is the worst cost,
worse than infinity. Random numbers are drawn here, from one generator, never in the objective. P
individuals in all, N per sub-population, L bits per chromosome, p variables. Read
`minimize_genetic`, `_next_generation`, then the operators. One algorithm, one file: the operators
are short and mean little apart, hence more than 250 lines.
"""

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
    _require(
        good, f"{name} must be {noun} from {low} to {high}; got {value!r}. Pass one in this range."
    )


def _within(default: Any, kind: type, low: float, high: float = INF) -> Any:
    """A setting with the range of its values; None is allowed where it is the default."""
    return field(default=default, metadata={"range": (kind, low, high)})


@dataclass(frozen=True, kw_only=True)
class GeneticSettings:
    """Every setting; the defaults are the paper's, and what it leaves open is fixed here.
    Source: paper section 3.7.

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

    individuals: int = _within(20, Integral, 2)  # N, in each sub-population
    subpopulations: int = _within(4, Integral, 1)
    generations: int = _within(40, Integral, 1)  # after the initial population
    bits_per_variable: int | tuple[int, ...] = 16  # 1 to 53; for every variable, or one for each
    coding: str = "binary"  # or "gray"
    ranking: str = "linear"  # or "nonlinear"
    # fitness of the best; at most 2 if linear, N - 1 if nonlinear
    pressure: float = _within(2.0, Real, 1)
    crossover_probability: float = _within(0.6, Real, 0, 1)  # of a pair
    mutation_probability: float | None = _within(None, Real, 0, 1)  # of a bit; None: 0.7 / L
    generation_gap: float = _within(0.94, Real, 0, 1)  # offspring per individual
    migration_rate: float = _within(0.3, Real, 0, 1)  # migrants per individual; 0: none
    migration_interval: int = _within(20, Integral, 1)  # generations
    safe: bool = True  # see `reinsert` and `migrate`; False: as in the original toolbox
    target: float | None = _within(None, Real, -INF)  # stop when the best cost is at most this

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if each.metadata and not (value is None and each.default is None):
                _check_number(each.name, value, *each.metadata["range"])
        known = self.ranking in ("linear", "nonlinear")
        _require(
            known,
            f"ranking must be 'linear' or 'nonlinear'; got {self.ranking!r}. Choose one of the"
            " two.",
        )
        _check_number(
            "pressure",
            self.pressure,
            Real,
            1,
            2 if self.ranking == "linear" else self.individuals - 1,
        )
        _require(
            isinstance(self.safe, bool),
            f"safe must be True or False; got {self.safe!r}. Pass one of the two.",
        )
        bits: Any = self.bits_per_variable
        if np.ndim(bits):
            object.__setattr__(self, "bits_per_variable", tuple(bits))
        _code(
            [(0, 1)] * max(np.size(self.bits_per_variable), 1), self.bits_per_variable, self.coding
        )

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """Return the settings of the paper with `changes` by name. Source: paper section 3.7."""
        return cls(**changes)

    @property
    def offspring(self) -> int:
        """Offspring of a sub-population in one generation: max(round(N gap), 2), halves up."""
        return max(int(self.individuals * self.generation_gap + 0.5), 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class GeneticState:
    """The running state; each generation makes a new one, so a callback may keep it.
    Source: paper section 3.1.
    """

    chromosomes: Bits  # (P, L) of 0 and 1
    costs: Floats  # (P,)
    best_x: Floats  # (p,) best individual evaluated so far
    best_cost: float = float("nan")
    generation: int = -1  # 0: the initial population is evaluated
    evaluations: int = 0
    history: Floats  # (generation + 1, 3), as in `GeneticResult`
    rng: np.random.Generator


@dataclass(frozen=True, kw_only=True, eq=False)
class GeneticResult:
    """What `minimize_genetic` found. Source: paper section 3.1."""

    x: Floats  # (p,) best individual evaluated in the whole run
    cost: float  # its cost, as evaluated
    initial_cost: float  # best of the initial population
    initial_population: Floats  # (P, p) decoded
    initial_costs: Floats  # (P,)
    final_population: Floats  # (P, p) decoded
    final_costs: Floats  # (P,)
    # (generations done + 1, 3): best, mean and worst finite cost of each population, inf if none
    history: Floats
    evaluations: int
    seed: int
    settings: GeneticSettings
    message: str  # why it stopped

    def __repr__(self) -> str:
        went = f"cost {self.initial_cost:.4g} -> {self.cost:.4g}"
        return f"GeneticResult({len(self.x)} numbers, {went}, {self.evaluations} evaluations)"


def minimize_genetic(
    objective: Callable[[Floats], ArrayLike],
    bounds: ArrayLike,
    settings: GeneticSettings | None = None,
    seed: int = 0,
    *,
    initial: ArrayLike | None = None,
    callback: Callable[[GeneticState], object] | None = None,
) -> GeneticResult:
    """Minimise an objective inside a box. Source: paper section 3.7.

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
        Called with the `GeneticState` after each generation but the initial one; a true answer
        stops the run.

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
    settings = GeneticSettings.paper() if settings is None else settings
    known = isinstance(settings, GeneticSettings)
    given = type(settings).__name__
    _require(
        known, f"settings must be GeneticSettings; got {given}. Pass None for those of the paper."
    )
    _check_number("seed", seed, Integral, 0, INF)
    code = bounds, settings.bits_per_variable, settings.coding
    shape = settings.subpopulations * settings.individuals, sum(_code(*code)[2])

    def evaluate(chromosomes: Bits) -> tuple[Floats, Floats]:
        x = decode(chromosomes, *code)
        return x, _evaluate(objective, x)

    rng = np.random.default_rng(int(seed))
    chromosomes = rng.integers(0, 2, shape, dtype=np.uint8)
    if initial is not None:
        seeds = encode(_points("initial", initial, len(np.asarray(bounds))), *code)
        _require(
            len(seeds) <= shape[0],
            f"initial must be at most {shape[0]} points; got {len(seeds)}. Pass fewer.",
        )
        chromosomes[: len(seeds)] = seeds
    x, costs = evaluate(chromosomes)
    blank = GeneticState(
        chromosomes=chromosomes, costs=costs, best_x=x[0], history=np.empty((0, 3)), rng=rng
    )
    first = state = _advance(blank, chromosomes, costs, x, costs)
    message = _reason_to_stop(state, settings)
    while not message:
        state = _next_generation(state, settings, evaluate)
        message = _reason_to_stop(state, settings, callback is not None and bool(callback(state)))
    return GeneticResult(
        x=state.best_x,
        cost=state.best_cost,
        initial_cost=first.best_cost,
        initial_population=x,
        initial_costs=first.costs,
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
    """Rank, select, recombine, mutate, evaluate, reinsert, and every migration interval migrate."""
    rng = state.rng
    rank = rank_linear if settings.ranking == "linear" else rank_nonlinear
    mutation = settings.mutation_probability
    mutation = 0.7 / state.chromosomes.shape[1] if mutation is None else mutation
    groups = np.arange(len(state.costs)).reshape(settings.subpopulations, -1)
    offspring = []
    for rows in groups:
        fitness = rank(state.costs[rows], settings.pressure)
        parents = state.chromosomes[rows[select(fitness, settings.offspring, rng)]]
        children = crossover(parents, settings.crossover_probability, rng)
        offspring.append(mutate(children, mutation, rng))
    x, tried = evaluate(np.concatenate(offspring))
    chromosomes, costs = state.chromosomes.copy(), state.costs.copy()
    for rows, new, new_costs in zip(groups, offspring, np.split(tried, len(groups)), strict=True):
        chromosomes[rows], costs[rows] = reinsert(
            chromosomes[rows], costs[rows], new, new_costs, safe=settings.safe
        )
    if (state.generation + 1) % settings.migration_interval == 0:
        count = settings.subpopulations
        rate = settings.migration_rate
        chromosomes, costs = migrate(chromosomes, costs, count, rate, rng, safe=settings.safe)
    return _advance(state, chromosomes, costs, x, tried)


def _advance(
    state: GeneticState, chromosomes: Bits, costs: Floats, x: Floats, tried: Floats
) -> GeneticState:
    """Return the state one generation later, in which points x (M, p) were evaluated at costs
    tried (M,).
    """
    best = np.argsort(tried, kind="stable")[0]
    finite = costs[np.isfinite(costs)]
    generation = state.generation + 1
    if tried[best] < state.best_cost or (np.isnan(state.best_cost) and not np.isnan(tried[best])):
        state = replace(state, best_x=x[best].copy(), best_cost=float(tried[best]))
    row = (
        np.fmin.reduce(costs, initial=INF),
        *((finite.mean(), finite.max()) if finite.size else (INF, INF)),
    )
    return replace(
        state,
        chromosomes=chromosomes,
        costs=costs,
        generation=generation,
        evaluations=state.evaluations + len(x),
        history=np.vstack([state.history, row]),
    )


def _reason_to_stop(state: GeneticState, settings: GeneticSettings, stopped: bool = False) -> str:
    """Return the message of the result, or "" while there is no reason to stop."""
    reason = ""
    done = state.generation
    if settings.target is not None and state.best_cost <= settings.target:
        reason = (
            f"Stopped in generation {done}: the best cost reached the target {settings.target:g}."
        )
    elif done == settings.generations:
        reason = f"All {done} generations done."
    elif stopped:
        reason = f"Stopped in generation {done} by the callback."
    found = (
        f"Best cost {state.best_cost:.6g}."
        if np.isfinite(state.best_cost)
        else "No candidate had a finite cost."
    )
    return reason and f"{reason} {found}"


def _evaluate(objective: Callable[[Floats], ArrayLike], x: Floats) -> Floats:
    """Return the costs (P,) of a copy of x (P, p)."""
    wanted = (
        f"objective must return real costs of shape ({len(x)},), inf or NaN for a bad candidate"
    )
    try:
        costs = np.asarray(objective(x.copy()))
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"{wanted}; it raised {said}. Mend the objective.") from error
    good = costs.shape == (len(x),) and costs.dtype.kind in "fiu"
    _require(good, f"{wanted}; got {costs.dtype} of shape {costs.shape}. Mend the objective.")
    return costs.astype(float)  # a copy


def _code(
    bounds: ArrayLike, bits_per_variable: Any, coding: str
) -> tuple[Floats, Floats, NDArray[np.int_]]:
    """Return lower (p,), upper (p,) and the bits of each variable (p,), all validated."""
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
    """Return value as a new array (rows, columns) of finite numbers."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    good = array.ndim == 2 and array.shape[1] == columns and np.isfinite(array).all()
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
    """Return points (P, p) of chromosomes (P, L) in bounds (p, 2): lb + (ub - lb) I / (2^n - 1), n
    bits per variable.

    I is read most significant bit first; in Gray code each digit is the running parity.
    Source: paper section 3.7.
    """
    lower, upper, widths = _code(bounds, bits_per_variable, coding)
    rows = _points("bits", bits, widths.sum()).astype(np.uint8)
    whole = np.empty((len(rows), len(widths)))
    for j, block in enumerate(np.split(rows, np.cumsum(widths)[:-1], axis=1)):
        digits = np.bitwise_xor.accumulate(block, axis=1) if coding == "gray" else block
        whole[:, j] = digits @ 2.0 ** np.arange(widths[j])[::-1]  # exact up to 53 bits
    return np.clip(lower + (upper - lower) * (whole / (2.0**widths - 1)), lower, upper)


def encode(
    points: ArrayLike,
    bounds: ArrayLike,
    bits_per_variable: int | tuple[int, ...],
    coding: str = "binary",
) -> Bits:
    """Return the chromosomes (k, L) nearest to points (k, p); what lies outside goes to the bound.

    The other arguments are those of `decode`. Source: paper section 3.2.
    """
    lower, upper, widths = _code(bounds, bits_per_variable, coding)
    inside = np.clip(_points("points", points, len(widths)), lower, upper)
    share = (inside - lower) / np.where(upper > lower, upper - lower, 1)
    whole = np.rint(share * (2.0**widths - 1)).astype(np.int64)
    whole = whole ^ (whole >> 1) if coding == "gray" else whole
    return np.hstack(
        [whole[:, [j]] >> np.arange(n)[::-1] & 1 for j, n in enumerate(widths)]
    ).astype(np.uint8)


def rank_linear(costs: Floats, pressure: float = 2.0) -> Floats:
    """Return fitness (N,) of costs (N,): equal steps from 2 - pressure (1 to 2) at the worst to
    pressure at the best.

    Equal costs share their mean fitness; the sum is N. Source: paper section 3.7.
    """
    return _by_rank(costs, np.linspace(2 - pressure, pressure, len(costs)))


def rank_nonlinear(costs: Floats, pressure: float = 2.0) -> Floats:
    """Return fitness (N,) of costs (N,): N X^position / sum X^i, growing to pressure (1 to N - 1)
    at the best.

    X is the positive root of (pressure - N) X^(N-1) + pressure (X^(N-2) + ... + 1) = 0.
    Source: paper section 3.7.
    """
    n = len(costs)
    # the Perron root: no other is as large
    root = np.roots([pressure - n] + [pressure] * (n - 1)).real.max()
    return _by_rank(costs, pressure * root ** np.arange(1.0 - n, 1))


def _by_rank(costs: Floats, fitness: Floats) -> Floats:
    """Give out fitness (N,), worst first, by costs (N,); equal costs share the mean. numpy sorts
    NaN last: worst.
    """
    shared = np.empty(len(costs))
    order = np.argsort(costs, kind="stable")
    shared[order[::-1]] = fitness
    ranked = np.asarray(costs)[order]
    if (ranked[1:] > ranked[:-1]).all():
        return shared
    tie = np.unique(costs, return_inverse=True)[1]
    return (np.bincount(tie, shared) / np.bincount(tie))[tie]


def select(fitness: Floats, number: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return shuffled row numbers (number,) by stochastic universal sampling: copies floor or ceil
    of expected.

    Equally spaced pointers with one random offset over the cumulated fitness (N,).
    Source: paper section 3.7.
    """
    edges = np.cumsum(fitness)
    pointers = (rng.random() + np.arange(number)) * (edges[-1] / number)
    # rounding must not point past the end
    pointers = np.minimum(pointers, np.nextafter(edges[-1], 0))
    return rng.permutation(np.searchsorted(edges, pointers, side="right"))


def crossover(bits: Bits, probability: float, rng: np.random.Generator) -> Bits:
    """Return offspring (M, L): rows (1, 2), (3, 4), ... exchange their tails with this probability.

    The cut is uniform on 1 ... L - 1; an odd last row passes through. Source: paper section 3.7.
    """
    even = len(bits) // 2 * 2
    length = bits.shape[1]
    cut = rng.integers(1, max(length, 2), (even // 2, 1))
    swap = (rng.random((even // 2, 1)) < probability) & (np.arange(length) >= cut)
    first = bits[:even:2]
    second = bits[1:even:2]
    children = bits.copy()
    children[:even:2], children[1:even:2] = (
        np.where(swap, second, first),
        np.where(swap, first, second),
    )
    return children


def mutate(bits: Bits, probability: float, rng: np.random.Generator) -> Bits:
    """Return bits (M, L), each flipped with this probability. Source: paper section 3.7."""
    return bits ^ (rng.random(bits.shape) < probability)


def reinsert(
    parents: Bits,
    parent_costs: Floats,
    offspring: Bits,
    offspring_costs: Floats,
    *,
    safe: bool = True,
) -> tuple[Bits, Floats]:
    """Return chromosomes (N, L), costs (N,): the offspring (M, L) overwrite the worst parents
    without comparison.

    If safe, the best parent stays; of too many offspring the best go in. Source: paper section 3.7.
    """
    number = min(len(offspring), len(parents) - bool(safe))
    places = np.argsort(parent_costs, kind="stable")[::-1][:number]
    chosen = np.argsort(offspring_costs, kind="stable")[:number]
    chromosomes, costs = parents.copy(), parent_costs.copy()
    chromosomes[places], costs[places] = offspring[chosen], offspring_costs[chosen]
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
    """Return chromosomes (P, L), costs (P,) after migration in a complete net, of copies, all at
    the same time.

    Each sub-population receives max(floor(N rate), 1) individuals (none at rate 0), drawn without
    replacement from as many best of every other one. If safe, they overwrite its worst, never its
    best; else its first rows, whatever their cost. Source: paper section 3.7.
    """
    groups = np.arange(len(costs)).reshape(subpopulations, -1)
    moved = chromosomes.copy()
    moved_costs = costs.copy()
    # best first
    ranked = np.take_along_axis(groups, np.argsort(costs[groups], axis=1, kind="stable"), axis=1)
    number = min(max(int(groups.shape[1] * rate + 1e-9), 1), groups.shape[1] - bool(safe))
    for own in range(subpopulations if rate > 0 and subpopulations > 1 else 0):
        migrants = rng.choice(
            np.delete(ranked, own, axis=0)[:, :number].ravel(), number, replace=False
        )
        places = ranked[own, ::-1][:number] if safe else groups[own, :number]
        moved[places], moved_costs[places] = chromosomes[migrants], costs[migrants]
    return moved, moved_costs
