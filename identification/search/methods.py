"""Methods of identification, all with one interface: a `Problem` in, an `Outcome` out; `identify`
lists them.

Source: paper 3.2, 3.7.
"""

import contextlib
import dataclasses
from collections.abc import Callable

import numpy as np

from identification.equation_error.least_squares import covariance_of
from identification.replay.objective import Objective
from identification.replay.timing import delay_of, is_late
from identification.search.elastic import elastic
from identification.search.genetic import GeneticResult, GeneticSettings, minimize_genetic
from identification.search.memory import with_memory
from identification.search.outcome import Fit, Outcome
from identification.search.polish import polished, start_of_fit, torque_fit
from identification.search.predictive import difference_of, doubtful, predicted
from identification.search.problem import Problem, in_parts, is_long
from plant.parts.fields import Floats

_BOX = 4.0  # half width of the box around the equation error, in its standard deviations

# Standard deviations around the prediction error's fit at which so many vectors are tried on
# objective (4).
_NEAR = 0.03
_NEIGHBOURS = 119

# unknowns from which on the paper's 60 individuals are too few for a box around what is the better
# start
_MANY = 30

# relative noise of objective (4) over the last digits of a candidate: single counts decide
_NOISE = 0.05


def paper(problem: Problem) -> Outcome:
    """The genetic algorithm in the ranges."""
    if problem.everywhere is None:
        raise ValueError(
            f"ranges must be given for {', '.join(problem.unknown)}; got None. Pass (low, high) for"
            " each, or give the Dynamics its ranges."
        )
    result = _genetic(problem, problem.everywhere)
    candidates = _as_good(
        np.vstack([result.x, result.final_population]), np.append(result.cost, result.final_costs)
    )
    fit = Fit(unknown=problem.unknown, values=result.x, candidates=candidates)
    return Outcome(fit=fit, evaluations=result.evaluations, message=result.message, genetic=result)


def _as_good(vectors: Floats, costs: Floats) -> Floats:
    """Those within the noise of the best, once each, best first."""
    order = np.argsort(costs, kind="stable")
    order = order[costs[order] <= (1 + _NOISE) * costs[order[0]]]
    _, first = np.unique(vectors[order], axis=0, return_index=True)
    return vectors[order[np.sort(first)]]


def _genetic(problem: Problem, ranges: Floats) -> GeneticResult:
    costs = problem.checkpoint.remembered("costs", problem.costs)
    show = problem.show
    shown = None if show is None else lambda state: show(state.best_cost)
    return minimize_genetic(costs, ranges, problem.settings, problem.seed, callback=shown)


def equation_error(problem: Problem) -> Outcome:
    """Least squares on the torque equation."""
    fit = torque_fit(problem)
    values, _ = start_of_fit(problem, fit)
    covariance = covariance_of(problem.unknown, fit.names, fit.covariance)
    message = f"{fit.rows} equations, relative torque error {fit.relative_error:.1%}."
    found = Fit(
        unknown=problem.unknown, values=values, candidates=values[None], covariance=covariance
    )
    return Outcome(fit=found, message=message)


def output_error(problem: Problem) -> Outcome:
    """Gauss-Newton on simulated positions."""
    if problem.elastic:
        return elastic(problem, simulated=True)
    return _followed(problem, simulated=True)


def prediction_error(problem: Problem) -> Outcome:
    """Gauss-Newton on predicted positions."""
    if problem.elastic:
        return elastic(problem)
    return with_memory(problem, _followed)


def _followed(problem: Problem, *, simulated: bool = False) -> Outcome:
    values, step = start_of_fit(problem, torque_fit(problem))
    start = {"equation error": values}
    return problem.checkpoint.stage(
        "fit", lambda: polished(problem, values, step, start, simulated=simulated)
    )


def seeded(problem: Problem) -> Outcome:
    """Equation error, genetic algorithm around it, prediction error from there.

    With many unknowns it goes without the genetic algorithm, where an arm comes of it and no
    settings were given. A log that replays its torques skips the genetic algorithm: an uncorrected
    run accumulates all model errors.

    Last, of some vectors within some hundredths of a standard deviation, which fit the log equally
    well, the one whose simulated errors repeat the measured ones best: objective (4) depends on
    single counts.
    """
    if any(problem.replays) or problem.elastic:
        return prediction_error(problem)
    values, step = start_of_fit(problem, torque_fit(problem))
    if len(values) > _MANY and problem.settings == GeneticSettings.paper():
        with contextlib.suppress(ValueError):
            direct = problem.checkpoint.stage(
                "direct", lambda: polished(problem, values, step, {"equation error": values})
            )
            near, costs = _neighbours(problem, direct.fit)
            if direct.fit.fallback_reason is None and np.isfinite(costs.min()):
                return _with_best(direct, near, costs)
    room = _BOX * step
    if problem.prior is not None:  # not far outside it: few such numbers are an arm
        places = problem.prior.places(problem.unknown)
        room[places] = np.minimum(room[places], np.sqrt(np.diag(problem.prior.covariance)))
    part = _in_parts(problem)
    result = _genetic(part, np.clip([values - room, values + room], *problem.bounds.T).T)
    # the log was too poor for a box
    if not np.isfinite(result.cost) and problem.everywhere is not None:
        result = _genetic(part, problem.everywhere)
    stages = {"equation error": values, "genetic": result.x}
    if not np.isfinite(result.cost):
        fit = Fit(unknown=problem.unknown, values=values, candidates=values[None])
        return Outcome(fit=fit, genetic=result, evaluations=result.evaluations, stages=stages)
    outcome = problem.checkpoint.stage("fit", lambda: polished(problem, result.x, step, stages))
    fit = outcome.fit
    near, costs = _neighbours(problem, fit)
    outcome = dataclasses.replace(
        outcome, genetic=result, evaluations=result.evaluations + outcome.evaluations
    )
    if fit.fallback_reason is None and np.isfinite(costs.min()):
        best = _with_best(outcome, near, costs)
        cost = result.cost if part is problem else float(problem.costs(result.x[None])[0])
        if not _only_genetic(problem, best.fit, float(costs.min()), cost):
            return best
    delayed = delay_of(
        problem.dynamics, problem.records, problem.unknown, fit.values, **problem.options
    )
    if fit.fallback_reason is None and is_late(*delayed):
        # only another arm repeats errors of late counts; this one's intervals count the delay
        return outcome
    reason = fit.fallback_reason or (
        "the fit that follows the counts does not reproduce the errors when simulated; check rig,"
        " law and signs"
    )
    message = "The genetic algorithm's best, in a box around the equation error."
    fit = Fit(
        unknown=problem.unknown, values=result.x, candidates=result.x[None], fallback_reason=reason
    )
    return dataclasses.replace(outcome, fit=fit, message=message)


def _in_parts(problem: Problem) -> Problem:
    """The problem with an objective (4) of parts of its long records; itself where none is long."""
    records = problem.objective.records
    if not any(map(is_long, records)):
        return problem
    parts = [part for record in records for part in in_parts(record)]
    objective = Objective(problem.dynamics, parts, problem.unknown, **problem.options)
    return dataclasses.replace(problem, objective=objective)


def _neighbours(problem: Problem, fit: Fit) -> tuple[Floats, Floats]:
    """A fit and vectors (P, k) within hundredths of its standard deviations; objective (4) of
    each (P,).
    """
    moves = np.random.default_rng(problem.seed).normal(size=(_NEIGHBOURS, len(fit.values)))
    moves = _NEAR * (moves[:, None, :] * _root(np.asarray(fit.covariance))).sum(axis=2)
    near = np.clip(np.vstack([fit.values, fit.values + moves]), *problem.bounds.T)
    return near, problem.costs(near)


def _with_best(outcome: Outcome, near: Floats, costs: Floats) -> Outcome:
    """An outcome with that of some vectors (P, k) whose objective (4) is least."""
    outcome.stages["prediction error"] = outcome.fit.values
    fit = dataclasses.replace(
        outcome.fit, values=near[int(np.argmin(costs))], candidates=_as_good(near, costs)
    )
    return dataclasses.replace(outcome, fit=fit, evaluations=outcome.evaluations + len(near))


def _only_genetic(problem: Problem, fit: Fit, cost: float, other: float) -> bool:
    """Whether the genetic algorithm's best, of this other objective (4), explains the records,
    and the fit does not.
    """
    records = problem.objective.records
    if cost <= other:
        return False
    own = predicted(problem, fit, records, cost)
    return doubtful(own, records) and not doubtful(
        own._replace(difference=difference_of(other, records)), records
    )


_EVERY: tuple[Callable[..., Outcome], ...] = (
    seeded,
    paper,
    equation_error,
    output_error,
    prediction_error,
)
METHODS: dict[str, Callable[[Problem], Outcome]] = {method.__name__: method for method in _EVERY}


def _root(covariance: Floats) -> Floats:
    """A lower triangle L with L L^T = covariance, in plain sums; zero rows stay zero."""
    root = np.zeros_like(covariance)
    for i in range(len(root)):
        for j in range(i):
            if root[j, j]:
                root[i, j] = (covariance[i, j] - (root[i, :j] * root[j, :j]).sum()) / root[j, j]
        root[i, i] = np.sqrt(max(0.0, covariance[i, i] - (root[i, :i] ** 2).sum()))
    return root
