"""Records that contradict each other: identification of each alone, and the mean of the fits.

The common fit of such records is that of no machine: the difference between them moves its values
by more than its covariance, the more so where observer gains rise to follow an unmodelled effect.
The mean weighs each value of a record by its variance and the variance between records
(`random_effects`). A wrong statement of a rig is wrong in all of them. Where a record is held out
and the common fit repeats it better, the common fit counts.
"""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

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


class _Alone(NamedTuple):
    """Fit of one record, and its tests, with covariances (k, k).

    `noise`: of noise. `within`: the same, at least by the scatter between segments. `doubt`: by
    effects that the rig may lack.
    """

    fit: Fit
    detection: Detection
    noise: Floats
    within: Floats
    doubt: Floats


def of_each(problem: Problem, detection: Detection) -> Detection:
    """A detection with the mean of the fits of each record, if the records contradict each other.

    A record that alone does not determine all unknowns is left out of the mean. There is no mean
    with a rough method, or if fewer than two records, or half of them, determine all. The scatter
    between the records is dropped then: linear about the common fit, it is too small.
    """
    count = len(problem.records)
    if "disagreement" not in detection.names or detection.grouped is None or count < 2:
        return detection
    alone = dict[int, _Alone]()
    # Deviations of rough methods do not cover their own errors: they could not weigh records.
    if problem.method not in ROUGH:
        for k in range(count):
            with contextlib.suppress(ValueError):
                alone[k] = _alone(problem, k)
    # Zeros and memories belong to single records: none may be missing.
    required = count if problem.zeros or problem.memories else max(2, count / 2)
    if len(alone) >= required:
        return _mean(problem, detection, alone)
    return dataclasses.replace(detection, between=None)


def _alone(problem: Problem, k: int) -> _Alone:
    """Fit and tests of one record."""
    prior = problem.prior
    if prior is not None:
        # Every record has its share of the prior, so that their mean counts it once.
        covariance = len(problem.records) * prior.covariance
        prior = dataclasses.replace(prior, covariance=covariance)
    alone = dataclasses.replace(
        problem,
        records=(problem.records[k],),
        objective=Objective(
            problem.dynamics, problem.objective.records[k], problem.unknown, **problem.options
        ),
        held_out=None,
        prior=prior,
        checkpoint=problem.checkpoint.part(f"record {k}"),
    )
    # Whatever the method of the problem: the common fit ended with it as well.
    outcome = prediction_error(alone)
    fit = outcome.fit
    detection = detect(alone, fit, outcome)
    noise = fit.covariance
    doubt = detection.doubt
    grouped = detection.grouped
    # A record that alone does not determine all unknowns.
    if fit.fallback_reason is not None or noise is None or doubt is None or grouped is None:
        raise ValueError(fit.fallback_reason or detection.reason)
    return _Alone(fit, detection, noise, at_least(noise, grouped), doubt)


def _mean(problem: Problem, detection: Detection, alone: dict[int, _Alone]) -> Detection:
    """The detection with the mean of several fits, its covariances, and their scatter."""
    records = list(alone.values())
    fits = [record.fit for record in records]
    within = [record.within for record in records]

    # 1. Variance between records beyond that within them. Values that were not varied have none.
    values = np.array([fit.values for fit in fits])
    std = np.sqrt([np.diag(covariance) for covariance in within])
    varied = (std > 0).all(axis=0)
    std = np.where(varied, std, np.nan)
    between = differing(
        problem.unknown, values.mean(axis=0), values, std, _factor(np.mean(within, axis=0))
    )

    # 2. Weights by both variances, and the mean.
    # Values that were not varied are the same in all records.
    weight = np.where(varied, 1 / (std**2 + between.deviation**2), 1.0)
    weight /= weight.sum(axis=0)
    mean = (weight * values).sum(axis=0)

    # 3. Covariance of the mean. A bias is the same in all records and does not average out: its
    # covariances are averaged, by the roots of the weights on both sides.
    scatter = (weight**2).sum(axis=0) * (between.deviation * wider(between.freedom)) ** 2
    inner = np.diag(_weighted(weight, within))
    doubt = _weighted(np.sqrt(weight), [record.doubt for record in records])

    # 4. As a fit, with the numbers of single records one below the other.
    rms = np.array([fit.rms_innovation for fit in fits], float)
    zeros = [fit.zeros for fit in fits if fit.zeros is not None]
    resumptions: tuple[Any, ...] = ()
    if any(fit.resumptions for fit in fits):
        resumptions = tuple(resumption for fit in fits for resumption in fit.resumptions or (None,))
    mean_fit = Fit(
        unknown=problem.unknown,
        values=mean,
        candidates=mean[None],
        covariance=_weighted(weight, [record.noise for record in records]),
        rms_innovation=None if np.isnan(rms).any() else float(np.sqrt((rms**2).mean())),
        prior=problem.prior,
        zeros=np.vstack(zeros) if zeros else None,
        resumptions=resumptions,
    )
    # Moves by assumed numbers are linear: they are averaged like the values.
    assumed = {
        name: (weight * [record.detection.assumed[name] for record in records]).sum(axis=0)
        for name in detection.assumed
        if all(name in record.detection.assumed for record in records)
    }
    # Records that were left out have NaN.
    all_values, all_std = np.full((2, len(problem.records), len(mean)), np.nan)
    all_values[list(alone)] = values
    all_std[list(alone)] = std
    bias = np.diag(doubt)
    return dataclasses.replace(
        detection,
        mean=mean_fit,
        doubt=doubt,
        grouped=np.sqrt(inner + scatter + bias),
        assumed=assumed,
        between=BetweenRuns.of(all_values, all_std, between, inner, scatter, bias),
    )


def _weighted(weight: Floats, covariance: Sequence[Floats]) -> Floats:
    """Covariance (k, k) of a sum with weights (R, k) of terms with covariances (R, k, k)."""
    return np.asarray(np.einsum("ri,rij,rj->ij", weight, covariance, weight))


def _factor(covariance: Floats) -> Floats:
    """Rows whose products are the correlations of a covariance (k, k)."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    sizes, axes = np.linalg.eigh(covariance / np.outer(std, std))
    # Rounding can make the smallest eigenvalues negative.
    return np.asarray(axes * np.sqrt(np.maximum(sizes, 0.0)))
