"""Records that contradict each other: each identified alone, and the mean of what they say.

Their common fit is that of no machine: what differs between them moves its values by more than its
covariance says, the more so where observer gains rise to follow what no model explains. The mean
weighs each value of a record by what it is known to, and by the variance between records
(`random_effects`). What a rig states wrongly is wrong in all of them. Where a record is held out,
and the common fit repeats it better, that is what counts.
"""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from identification.equation_error.between_runs import BetweenRuns
from identification.equation_error.least_squares import at_least, wider
from identification.equation_error.random_effects import differing
from identification.replay.objective import Objective
from identification.results.detection import Detection
from identification.results.stepwise import detect
from identification.search.methods import prediction_error
from identification.search.outcome import Fit
from identification.search.predictive import ROUGH
from identification.search.problem import Problem
from plant.parts.fields import Floats


class _Own(NamedTuple):
    """A record's own fit, and what is said of it; covariances (k, k): of noise, with that of
    segments, of doubt.
    """

    fit: Fit
    said: Detection
    noise: Floats
    within: Floats
    doubt: Floats


def of_each(problem: Problem, detection: Detection) -> Detection:
    """What is said of records that contradict each other, with the mean of their own fits.

    One that alone does not tell all is left out of it. By a rough method, or where fewer than two,
    or half, alone tell all, it is said of the common fit, and nothing of how they differ: what is
    linear about that fit hides it.
    """
    if (
        "disagreement" not in detection.names
        or detection.grouped is None
        or len(problem.records) < 2
    ):
        return detection
    alone = dict[int, _Own]()
    for k in range(len(problem.records) if problem.method not in ROUGH else 0):
        with contextlib.suppress(ValueError):
            alone[k] = _alone(problem, k)
    least = (
        len(problem.records)
        if problem.zeros or problem.memories
        else max(2, len(problem.records) / 2)
    )
    if len(alone) >= least:
        return _mean(problem, detection, alone)
    return dataclasses.replace(detection, between=None)


def _alone(problem: Problem, k: int) -> _Own:
    """What a record alone says; of a prior it has its share."""
    own = Objective(
        problem.dynamics, problem.objective.records[k], problem.unknown, **problem.options
    )
    prior = problem.prior
    count = len(problem.records)
    alone = dataclasses.replace(
        problem,
        records=(problem.records[k],),
        objective=own,
        held_out=None,
        prior=(
            None
            if prior is None
            else dataclasses.replace(prior, covariance=count * prior.covariance)
        ),
        checkpoint=problem.checkpoint.part(f"record {k}"),
    )
    outcome = prediction_error(alone)
    fit = outcome.fit
    said = detect(alone, outcome.fit, outcome)
    noise = fit.covariance
    doubt = said.doubt
    grouped = said.grouped
    if fit.fallback_reason is not None or noise is None or doubt is None or grouped is None:
        raise ValueError(fit.fallback_reason or said.reason)
    return _Own(fit, said, noise, at_least(noise, grouped), doubt)


def _mean(problem: Problem, detection: Detection, alone: dict[int, _Own]) -> Detection:
    fits, said, noise, within, doubts = map(list, zip(*alone.values(), strict=True))
    each = np.array([fit.values for fit in fits])
    std = np.sqrt([np.diag(covariance) for covariance in within])
    varied = (std > 0).all(axis=0)
    std = np.where(varied, std, np.nan)
    apart = differing(
        problem.unknown, each.mean(axis=0), each, std, _alike(np.mean(within, axis=0))
    )
    weight = np.where(varied, 1 / (std**2 + apart.deviation**2), 1.0)
    weight /= weight.sum(axis=0)
    added = (weight**2).sum(axis=0) * (apart.deviation * wider(apart.freedom)) ** 2
    own = np.diag(_weighted(weight, within))
    doubt = _weighted(np.sqrt(weight), doubts)
    values = (weight * each).sum(axis=0)
    rms = np.array([fit.rms_innovation for fit in fits], float)
    goes_on = any(fit.resumptions for fit in fits)
    mean = Fit(
        unknown=problem.unknown,
        values=values,
        candidates=values[None],
        covariance=_weighted(weight, noise),
        rms_innovation=None if np.isnan(rms).any() else float(np.sqrt((rms**2).mean())),
        prior=problem.prior,
        zeros=None if fits[0].zeros is None else np.vstack([fit.zeros for fit in fits]),
        resumptions=(
            tuple(place for fit in fits for place in fit.resumptions or (None,)) if goes_on else ()
        ),
    )
    assumed = {
        name: (weight * [one.assumed[name] for one in said]).sum(axis=0)
        for name in detection.assumed
        if all(name in one.assumed for one in said)
    }
    # NaN of those that are left out
    every = np.full((2, len(problem.records), len(values)), np.nan)
    every[:, list(alone)] = each, std
    return dataclasses.replace(
        detection,
        mean=mean,
        doubt=doubt,
        grouped=np.sqrt(own + added + np.diag(doubt)),
        assumed=assumed,
        between=BetweenRuns.of(every[0], every[1], apart, own, added, np.diag(doubt)),
    )


def _weighted(weight: Floats, covariance: Sequence[Floats]) -> Floats:
    """Covariance (k, k) of the sum of what has weights (R, k) and covariances (R, k, k)."""
    return np.asarray(np.einsum("ri,rij,rj->ij", weight, covariance, weight))


def _alike(covariance: Floats) -> Floats:
    """Rows whose products are the correlations of a covariance (k, k)."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    sizes, axes = np.linalg.eigh(covariance / np.outer(std, std))
    return np.asarray(axes * np.sqrt(np.maximum(sizes, 0.0)))
