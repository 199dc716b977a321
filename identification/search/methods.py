"""Ways to find what is unknown in a log, all with one interface: a `Search` in, an `Outcome` out.

paper             the genetic algorithm of 3.7 on objective (4), in given ranges
genetic           the same with ranges and settings of one's own
equation_error    the torque equation in a pass band, by least squares (`identification.equation_error.pulse_fit`)
didim             the same with the motion of a simulated arm in place of the measured one, again and again
output_error      simulated against counted positions, from the equation error's start, by Gauss-Newton
prediction_error  predicted against counted positions (`identification.replay.prediction`), from the same start
seeded            equation error, then the genetic algorithm in a box around it, then the prediction error

Sources: paper 3.2, 3.7 (paper, genetic); M. Gautier, A. Janot, P.-O. Vandanjon, A new closed-loop output error method
for parameter identification of robot dynamics, IEEE Transactions on Control Systems Technology 21 (2013) (didim).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from identification.equation_error.pulse_fit import fit_sides, linear, pass_band, sides_in
from identification.replay.prediction import Prediction
from identification.search.genetic import minimize_genetic
from identification.search.polish import polished, require_fast, start_of_fit, torque_fit
from identification.search.problem import Outcome

__all__ = ["METHODS"]

_BOX = 4.0
"""Half width of the box around the equation error, in its standard deviations."""

_NEAR, _NEIGHBOURS = 0.03, 119
"""Standard deviations around the prediction error's fit at which so many vectors are tried on objective (4)."""

_AT_MOST = 1.5
"""Objective (4) that the prediction error's fit may have, in that of the genetic algorithm's best."""

_NOISE = 0.05
"""Share by which objective (4) moves with the last digit of a candidate: single counts decide."""

_ROUNDS = 10
"""Of `didim`, at most."""

_BELOW = 0.25
"""Its band, as a share of the pass band."""

_SETTLED = 0.02
"""Change, in standard deviations, below which it ends."""


def paper(search):
    """The genetic algorithm in the ranges."""
    if search.everywhere is None:
        raise ValueError(
            f"ranges must be given for {', '.join(search.unknown)}; got None. Pass (low, high) for each, or give the "
            "Dynamics its ranges."
        )
    result = _genetic(search, search.everywhere)
    candidates = _as_good(np.vstack([result.x, result.final_population]), np.append(result.cost, result.final_costs))
    return Outcome(
        values=result.x, candidates=candidates, evaluations=result.evaluations, message=result.message, genetic=result
    )


def _as_good(vectors, costs):
    """Those within the noise of the best, once each, best first."""
    order = np.argsort(costs, kind="stable")
    order = order[costs[order] <= (1 + _NOISE) * costs[order[0]]]
    _, first = np.unique(vectors[order], axis=0, return_index=True)
    return vectors[order[np.sort(first)]]


def _genetic(search, ranges):
    return minimize_genetic(search.objective, ranges, search.settings, search.seed, callback=search.show)


def equation_error(search):
    """Least squares on the torque equation."""
    return _of_fit(search, torque_fit(search))


def didim(search):
    """The torque equation along the motion of the arm found last, until that no longer changes.

    It is compared below the slow mode: how that swings depends on the rounding of single counts, which a simulation
    does not repeat.
    """
    fit = torque_fit(search)
    stages = {"equation error": start_of_fit(search, fit)[0]}
    simulated = Prediction(search.dynamics, search.records, search.unknown, free=True, **search.options)
    unknown = linear(search.dynamics, search.unknown)
    bands = [_BELOW * pass_band(record) for record in search.records]
    while simulated.evaluations < _ROUNDS:
        motions = simulated.motions(start_of_fit(search, fit)[0])
        if not all(np.isfinite(q).all() for q in motions):
            raise ValueError(
                "the simulated arm must stay on its path; what was found so far diverges. Log a slower motion."
            )
        log = zip(search.records, bands, motions, strict=True)
        sides = [sides_in(search.dynamics, record, band, unknown, q) for record, band, q in log]
        before, fit = fit, fit_sides(unknown, search.known, sides)
        if (np.abs(fit.values - before.values) < _SETTLED * fit.std).all():
            break
    return dataclasses.replace(_of_fit(search, fit), evaluations=simulated.evaluations, stages=stages)


def output_error(search):
    """Gauss-Newton on simulated positions."""
    require_fast(search)
    values, step = start_of_fit(search, torque_fit(search))
    return polished(search, values, step, {"equation error": values}, free=True)


def prediction_error(search):
    """Gauss-Newton on predicted positions."""
    require_fast(search)
    values, step = start_of_fit(search, torque_fit(search))
    return polished(search, values, step, {"equation error": values})


def seeded(search):
    """Equation error, genetic algorithm around it, prediction error from there.

    Without a controller in the log there is no genetic algorithm between: a free run adds up all that the model lacks.

    Last, of some vectors within some hundredths of a standard deviation, which the log cannot tell apart, the one whose
    simulated errors repeat the measured ones best: objective (4) depends on single counts.
    """
    if any(record.law.replays for record in search.records):
        return prediction_error(search)
    require_fast(search)
    values, step = start_of_fit(search, torque_fit(search))
    box = np.column_stack([values - _BOX * step, values + _BOX * step])
    low, high = search.bounds.T
    box = np.column_stack([np.clip(box[:, 0], low, high), np.clip(box[:, 1], low, high)])
    result = _genetic(search, box)
    if not np.isfinite(result.cost) and search.everywhere is not None:  # the log was too poor for a box
        result = _genetic(search, search.everywhere)
    stages = {"equation error": values, "genetic": result.x}
    if not np.isfinite(result.cost):
        return Outcome(values=values, genetic=result, evaluations=result.evaluations, stages=stages)
    outcome = polished(search, result.x, step, stages)
    stages["prediction error"] = outcome.values
    moves = np.random.default_rng(search.seed).normal(size=(_NEIGHBOURS, len(step)))
    moves = _NEAR * (moves[:, None, :] * _root(outcome.covariance)).sum(axis=2)
    near = np.clip(np.vstack([outcome.values, outcome.values + moves]), *search.bounds.T)
    costs = search.objective(near)
    evaluations = result.evaluations + outcome.evaluations + len(near)
    found = dataclasses.replace(
        outcome, values=near[int(np.argmin(costs))], candidates=_as_good(near, costs), genetic=result,
        evaluations=evaluations,
    )  # fmt: skip
    if outcome.trouble is None and costs.min() <= _AT_MOST * result.cost:
        return found
    trouble = outcome.trouble or (
        "the fit that follows the counts does not repeat the errors when simulated; check rig, law and signs"
    )
    message = "The genetic algorithm's best, in a box around the equation error."
    return dataclasses.replace(
        found, values=result.x, candidates=None, covariance=None, scatter=None, message=message, trouble=trouble
    )


METHODS = {
    "seeded": seeded,
    "paper": paper,
    "genetic": paper,
    "equation_error": equation_error,
    "didim": didim,
    "output_error": output_error,
    "prediction_error": prediction_error,
}


def _of_fit(search, fit):
    values, _ = start_of_fit(search, fit)
    covariance = np.zeros((len(values), len(values)))
    places = [search.unknown.index(name) for name in fit.names]
    covariance[np.ix_(places, places)] = fit.covariance
    message = f"{fit.rows} equations, relative torque error {fit.relative_error:.1%}."
    return Outcome(values=values, covariance=covariance, message=message)


def _root(covariance):
    """A lower triangle L with L L^T = covariance, in plain sums; zero rows stay zero."""
    root = np.zeros_like(covariance)
    for i in range(len(root)):
        for j in range(i):
            if root[j, j]:
                root[i, j] = (covariance[i, j] - (root[i, :j] * root[j, :j]).sum()) / root[j, j]
        root[i, i] = np.sqrt(max(0.0, covariance[i, i] - (root[i, :i] ** 2).sum()))
    return root
