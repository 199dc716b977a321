"""Methods of identification, all with one interface: from a `Problem` to an `Outcome`.

`METHODS` at the end lists them by name; `seeded`, the default, uses the steps of all others.
Source: paper 3.2, 3.7.
"""

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from identification.equation_error import covariance_of
from identification.replay import Objective, delay_of, is_late
from identification.search.elastic import elastic
from identification.search.genetic import GeneticSettings, minimize_genetic
from identification.search.memory import placed, repeating, with_memory, with_starts
from identification.search.outcome import Fit, Outcome
from identification.search.polish import (
    FIT,
    arm_of_torques,
    excess_of_torque,
    polished,
    start_of_fit,
    torque_fit,
)
from identification.search.predictive import asks_from, difference_of, doubtful, predicted
from identification.search.problem import Problem, in_parts, is_long
from plant.parts import frozen_settings


@frozen_settings
class SeededSettings:
    """Numbers of the default method beside those of its genetic algorithm.

    All are chosen by hand; ``tests/benchmarks/identification_study.py`` measures the errors of f.

    Parameters
    ----------
    box : float
        Half width of the ranges of the genetic algorithm around the torque equation's fit, in
        standard deviations of that.
    neighbours : int
        Vectors around the prediction-error fit of which the one with the least objective (4) is
        taken, beside the fit.
    spread : float
        Spread of these vectors, in standard deviations of the fit: small enough for all of them to
        be equally likely.
    direct : int
        Number of unknowns above which the method goes without the genetic algorithm: the
        individuals of the paper are too few for a box of so many dimensions.
    excess : float
        Error of logged torques under the values of a fit, over that of a fit that is nearer to
        them (of the torque equation, or by prediction error): from there on the latter is the arm.
        The output error of the EMPS has 1.6. The worst of the double pendulum's
        records has 1.6, a six-joint bag whose prediction lost the arm 2.5.
    along : float
        Departure of the model, driven by the logged torques alone, as a share of the motion (rms):
        below it the model runs along whole logs, and the output error counts as well. The slide of
        the EMPS has 0.05, arms under gravity have more than 1; chosen by hand between.
    closer : float
        Departure of an output-error fit over that of the prediction-error fit, below which it is
        the result. The slide of the EMPS has 0.6, the double pendulum, which gains nothing from it
        on records kept aside, 0.9.
    noise : float
        Relative noise of objective (4) over the last digits of a vector, since single counts decide
        it. Candidates within it are as good as the best.
    """

    box: float = 4.0
    neighbours: int = 119
    spread: float = 0.03
    direct: int = 30
    excess: float = 2.0
    along: float = 0.1
    closer: float = 0.75
    noise: float = 0.05


SEEDED = SeededSettings()


def paper(problem: Problem) -> Outcome:
    """Genetic algorithm of the paper on objective (4), in the ranges. Source: paper 3.7."""
    if problem.everywhere is None:
        raise ValueError(
            f"ranges must be given for {', '.join(problem.unknown)}; got None. Pass (low, high) for"
            " each, or give the Dynamics its ranges."
        )
    # The ranges of the problem, not a box: this is the method of the paper.
    result = _genetic(problem, problem.everywhere)
    # The best individual of the run need not have survived to the final population.
    candidates = _as_good(
        np.vstack([result.x, result.final_population]), np.append(result.cost, result.final_costs)
    )
    fit = Fit(unknown=problem.unknown, values=result.x, candidates=candidates)
    return Outcome(fit=fit, evaluations=result.evaluations, message=result.message, genetic=result)


def _as_good(vectors, costs):
    """Vectors whose cost is that of the best within its noise, without repetitions, best first."""
    order = np.argsort(costs, kind="stable")
    order = order[costs[order] <= (1 + SEEDED.noise) * costs[order[0]]]
    # `unique` sorts the vectors; sorting the indices restores the order of costs.
    _, unique = np.unique(vectors[order], axis=0, return_index=True)
    return vectors[order[np.sort(unique)]]


def _genetic(problem, ranges):
    """Genetic algorithm on objective (4) in these ranges, with checkpoint and progress."""
    # An interrupted run repeats its random numbers and reads the stored costs.
    costs = problem.checkpoint.remembered("costs", problem.costs)
    # The progress bar needs the best cost alone.
    show = problem.show
    shown = None if show is None else lambda state: show(state.best_cost)
    return minimize_genetic(costs, ranges, problem.settings, problem.seed, callback=shown)


def equation_error(problem: Problem) -> Outcome:
    """Weighted least squares on the torque equation."""
    fit = torque_fit(problem)
    values, _ = start_of_fit(problem, fit)
    # Unknowns that the torque equation lacks get no variance.
    covariance = covariance_of(problem.unknown, fit.names, fit.covariance)
    message = f"{fit.rows} equations, relative torque error {fit.relative_error:.1%}."
    solved = Fit(
        unknown=problem.unknown, values=values, candidates=values[None], covariance=covariance
    )
    return Outcome(fit=solved, message=message)


def output_error(problem: Problem) -> Outcome:
    """Gauss-Newton on simulated positions: observer gains of zero."""
    if problem.elastic:
        return elastic(problem, simulated=True)
    return _followed(problem, simulated=True)


def prediction_error(problem: Problem) -> Outcome:
    """Gauss-Newton on positions predicted one sample ahead, with fitted observer gains."""
    if problem.elastic:
        return elastic(problem)
    return with_memory(problem, _followed)


def _followed(problem, *, simulated=False):
    """Gauss-Newton from the torque equation's fit, for rigid gears and one model of the law.

    Logged torques that no arm follows by prediction still give one by the torque equation.
    """
    problem = with_starts(problem)
    try:
        values, step = start_of_fit(problem, torque_fit(problem))
        # Stages are part of the result, so that a user can compare them.
        start = {"equation error": values}
        outcome = problem.checkpoint.stage(
            "fit", lambda: polished(problem, values, step, start, simulated=simulated)
        )
        if simulated or not problem.repeats_torques:
            return outcome
        excess = excess_of_torque(problem, outcome.fit.values, values)
        if excess < SEEDED.excess:
            return outcome
        reason = ValueError(
            f"predicted positions ask for an arm that leaves {excess:.2g} times as much of the"
            " torques unexplained"
        )
    except ValueError as error:
        if simulated or not problem.repeats_torques:
            raise
        reason = error
    return problem.checkpoint.stage("torques", lambda: arm_of_torques(problem, reason))


def seeded(problem: Problem) -> Outcome:
    """Equation error, genetic algorithm around it, prediction error from there, best neighbour.

    A log that replays its torques skips the genetic algorithm: an uncorrected simulation
    accumulates all model errors. Where it still runs along the whole log, output error follows
    prediction error. With many unknowns the method skips it, too, unless the user sets
    its settings or the result is no arm.

    Vectors within some hundredths of a standard deviation fit the log equally well. Since objective
    (4) depends on single counts, the result is the one of them that repeats the tracking errors
    best.
    """
    # A fit of elastic gears has starts of its own, see `elastic`.
    if problem.elastic:
        return prediction_error(problem)
    if any(problem.replays):
        return _with_simulation(problem, prediction_error(problem))
    return with_memory(problem, _searched)


def _searched(problem: Problem) -> Outcome:
    """The stages of `seeded`; of laws in an unknown state, the fit alone."""
    # Objective (4) begins where the law was, which is a result of the fit.
    if any(problem.memories):
        return _followed(problem)

    # 1. Equation error; with many unknowns the fit follows at once.
    problem = with_starts(problem)
    values, step = start_of_fit(problem, torque_fit(problem))
    if len(values) > SEEDED.direct and problem.settings == GeneticSettings.paper():
        with contextlib.suppress(ValueError):
            direct = problem.checkpoint.stage(
                "direct", lambda: polished(problem, values, step, {"equation error": values})
            )
            # Even a good fit is refused if none of its neighbours can be simulated.
            neighbours, costs = _neighbours(_resumed(problem, direct.fit), direct.fit)
            if direct.fit.fallback_reason is None and np.isfinite(costs.min()):
                return _with_best(direct, neighbours, costs)

    # 2. Genetic algorithm around it.
    part = _in_parts(problem)
    result = _genetic(part, _box(problem, values, step))
    if not np.isfinite(result.cost) and problem.everywhere is not None:
        # The log was too poor: its fit and deviations put the box where there is no arm.
        result = _genetic(part, problem.everywhere)
    stages = {"equation error": values, "genetic": result.x}
    if not np.isfinite(result.cost):
        fit = Fit(unknown=problem.unknown, values=values, candidates=values[None])
        return Outcome(fit=fit, genetic=result, evaluations=result.evaluations, stages=stages)

    # 3. Prediction error from its best, and the neighbour with the least objective (4).
    outcome = problem.checkpoint.stage("fit", lambda: polished(problem, result.x, step, stages))
    fit = outcome.fit
    resumed = _resumed(problem, fit)
    outcome = replace(outcome, genetic=result, evaluations=result.evaluations + outcome.evaluations)
    # Coarse steps alone leave some pulses of a fine encoder: finer ones have the last word.
    for steps in (1, max(FIT.fine_steps, outcome.steps)):
        judge = resumed.in_steps(steps)
        neighbours, costs = _neighbours(judge, fit)
        if fit.fallback_reason is not None or not np.isfinite(costs.min()):
            break
        best = _with_best(outcome, neighbours, costs)
        # Objective (4) of parts, or of other starts, cannot be compared with that of the fit.
        same = part is problem and judge is problem
        cost = result.cost if same else float(judge.costs(result.x[None])[0])
        if not _only_genetic(judge, best.fit, float(costs.min()), cost):
            return best

    # 4. The fit does not reproduce the errors: late counts explain that, or its values are wrong.
    delayed = delay_of(
        problem.dynamics, problem.records, problem.unknown, fit.values, **problem.options
    )
    if fit.fallback_reason is None and is_late(*delayed):
        # Only a wrong arm repeats errors of late counts; the intervals of the fit include a delay.
        return outcome
    # The best of the genetic algorithm at least repeats the errors.
    reason = fit.fallback_reason or (
        "the fit that follows the counts does not reproduce the errors when simulated; check rig,"
        " law and signs"
    )
    message = "The genetic algorithm's best, in a box around the equation error."
    fit = Fit(
        unknown=problem.unknown, values=result.x, candidates=result.x[None], fallback_reason=reason
    )
    return replace(outcome, fit=fit, message=message)


def _with_simulation(problem, outcome):
    """The outcome with the values by output error, where these repeat logged torques better.

    One sample ahead, a model that lacks something follows a log by its observer; in open loop its
    errors add up, and friction must be right on average over the whole log.
    """
    fit = outcome.fit
    # Unknown zeros need the observer: without it each would bend a whole record.
    if not problem.repeats_torques or problem.zeros or fit.fallback_reason is not None:
        return outcome

    # 1. Only a model that departs from the log by more than rounding, and yet runs along it.
    records = problem.records
    apart = _departure(problem, fit)
    motion = np.concatenate([record.counts - record.counts.mean(axis=0) for record in records])
    if not asks_from(records) < apart < SEEDED.along * np.sqrt(np.mean(motion**2)):
        return outcome

    # 2. Output error, which must explain the torques nearly as well.
    try:
        simulated = problem.checkpoint.stage("simulated", lambda: output_error(problem)).fit
    except ValueError:
        return outcome
    closer = _departure(problem, simulated) < SEEDED.closer * apart
    if not closer or excess_of_torque(problem, simulated.values, fit.values) > SEEDED.excess:
        return outcome

    # 3. Two estimates of one arm differ by what the model lacks: the intervals hold both.
    difference = simulated.values - fit.values
    outcome.stages["prediction error"] = fit.values
    values = simulated.values
    covariance = fit.covariance + np.outer(difference, difference)
    fit = replace(fit, values=values, candidates=values[None], covariance=covariance)
    return replace(
        outcome, fit=fit, message=f"{outcome.message} The values are those of the output error."
    )


def _departure(problem, fit):
    """Difference between logs and the model in open loop [pulses, rms]."""
    objective = repeating(problem, placed(problem, fit), fit.resumptions)
    return difference_of(float(objective(fit.values[None])[0]), problem.records)


def _resumed(problem, fit):
    """The problem whose objective (4) begins where the fit found law and arm."""
    objective = repeating(problem, problem.objective, fit.resumptions)
    return problem if objective is problem.objective else replace(problem, objective=objective)


def _box(problem, values, step):
    """Ranges (k, 2) of the genetic algorithm around the torque equation's fit, within bounds."""
    width = SEEDED.box * step
    if problem.prior is not None:
        # Few vectors far outside a prior are an arm.
        columns = problem.prior.places(problem.unknown)
        width[columns] = np.minimum(width[columns], np.sqrt(np.diag(problem.prior.covariance)))
    return np.clip([values - width, values + width], *problem.bounds.T).T


def _in_parts(problem):
    """The problem with objective (4) of the parts of its long records; itself if none is long."""
    records = problem.objective.records
    if not any(map(is_long, records)):
        return problem
    # A short record is its own single part.
    parts = [part for record in records for part in in_parts(record)]
    objective = Objective(problem.dynamics, parts, problem.unknown, **problem.options)
    return replace(problem, objective=objective)


def _neighbours(problem, fit):
    """A fit with vectors (P, k) close to it, and objective (4) of all of them (P,)."""
    random = np.random.default_rng(problem.seed)
    moves = random.normal(size=(SEEDED.neighbours, len(fit.values)))
    # Sums, not a matrix product, whose bits depend on the processor.
    moves = SEEDED.spread * (moves[:, None, :] * triangular_root(np.asarray(fit.covariance))).sum(
        axis=2
    )
    neighbours = np.clip(np.vstack([fit.values, fit.values + moves]), *problem.bounds.T)
    return neighbours, problem.costs(neighbours)


def _with_best(outcome, vectors, costs):
    """The outcome with the one of these vectors (P, k) that has the least objective (4)."""
    # The values of the fit itself stay visible among the stages.
    outcome.stages["prediction error"] = outcome.fit.values
    fit = replace(
        outcome.fit, values=vectors[int(np.argmin(costs))], candidates=_as_good(vectors, costs)
    )
    return replace(outcome, fit=fit, evaluations=outcome.evaluations + len(vectors))


def _only_genetic(problem, fit, cost, genetic_cost):
    """Whether the genetic algorithm's best explains the records, and the fit does not.

    `cost`, `genetic_cost`: objective (4) of the fit and of the genetic algorithm's best.
    """
    records = problem.objective.records
    # Simulating the model many times is costly: the check runs only where it can decide.
    if cost <= genetic_cost:
        return False
    check = predicted(problem, fit, records, cost)
    genetic_check = check._replace(difference=difference_of(genetic_cost, records))
    return doubtful(check, records) and not doubtful(genetic_check, records)


# `identify` lists them in this order.
METHODS: dict[str, Callable[[Problem], Outcome]] = {
    "seeded": seeded,
    "paper": paper,
    "equation_error": equation_error,
    "output_error": output_error,
    "prediction_error": prediction_error,
}


def triangular_root(covariance):
    """Lower triangle L with L L^T = covariance; zero rows stay zero.

    numpy's Cholesky factor refuses a singular covariance, which fixed values make.
    """
    root = np.zeros_like(covariance)
    # Column by column, as Cholesky's algorithm; rounding may leave a small negative square.
    for i in range(len(root)):
        for j in range(i):
            if root[j, j]:
                root[i, j] = (covariance[i, j] - (root[i, :j] * root[j, :j]).sum()) / root[j, j]
        root[i, i] = np.sqrt(max(0.0, covariance[i, i] - (root[i, :i] ** 2).sum()))
    return root
