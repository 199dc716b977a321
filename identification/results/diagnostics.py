"""Diagnostics of a fit: differences from a simulation, delay of the counts, bands of torques.

If records contradict each other, their common fit describes no machine: its values are wrong by
more than its covariance states, above all where the observer gains rise to follow an unmodelled
effect. Each record is then identified alone, and the fits are averaged. The weight of a value is
the inverse of the sum of its variance and the variance between records (`random_effects`). A wrong
statement about the rig affects all records alike, so the mean does not correct it. The common fit
is kept if it repeats the held-out records better than the mean does.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error import (
    BetweenRuns,
    at_least,
    differing,
    over_bands,
    torque_apart,
    wider,
)
from identification.replay import Objective, delay_of, is_late
from identification.results.detection import Detection
from identification.results.stepwise import detect
from identification.results.with_arm import OF_RECORDS
from identification.search import (
    FIT,
    ROUGH,
    Fit,
    Outcome,
    Predicted,
    Problem,
    doubtful,
    in_open_loop,
    placed,
    predicted,
    prediction_error,
    repeating,
)
from plant.parts import Checkpoint, Floats, Frozen, Piece, Shown, frozen, kept

# Effects that the rig may lack can raise the limit to at most this multiple of the difference
# between two runs of the model. Without a bound, tolerances would hide any difference. Set by hand.
_WIDER = 2.0


@kept
@frozen
class Diagnostics(Shown, Frozen):
    """How well the identified values repeat the records.

    Attributes
    ----------
    objective : float
        Objective (4) in the records that were searched [pulses^2].
    difference, held_out_difference : float, float or None
        Root mean square, over samples and joints, of the measured errors minus those simulated with
        the identified values [pulses]: in the searched records, and in those held out. Two runs
        that differ only in their starting points within a count give 0.58.
    bands : dict
        Pass band [Hz] -> mean ratio of the values that least squares gives on the logged torques in
        that band to the identified values, weighted by precision. Empty unless all records are
        replays.
    delay, delay_std : float
        Delay of the counts [samples] against a simulation with the values of the common fit, and
        its standard deviation; NaN and inf if the delay is unknown.
    detection : Detection
        Whether compliance, backlash, lag, other friction or late counts explain the innovations.
    law_apart : tuple
        For each searched record, an array over the joints (n,): rms difference between the logged
        torque and that of the stated law, as a share of the logged torque. The law follows the log
        from the initial state that fits best. None for a record that does not show the difference.
    expected, limit : float
        Rms difference [pulses] between runs of the model. The runs take values as likely as the
        identified ones and start at different points within a count, because a loop that hunts by
        a count never repeats itself exactly. `expected` is the geometric mean of this difference.
        A healthy log exceeds `limit` with a probability of 0.001; `limit` is at most twice the rms
        of the measured errors. Both are NaN where the difference needs no explanation.
    closest : float
        `difference` with the values of "prediction_error", if they explain the log and those of
        the chosen method do not. The log is then healthy. NaN otherwise.
    hunts : tuple of int
        Records whose loop oscillates at about the same frequency as the loop of the model, which
        oscillates by friction and counts alone. `difference` and `detection` still show other
        contradictions of these records.
    held_out_limit : float
        The limit of the records held out.
    """

    objective: float
    difference: float
    held_out_difference: float | None
    bands: dict[float, float]
    delay: float
    delay_std: float
    detection: Detection
    law_apart: tuple[Floats | None, ...] = ()
    expected: float = np.nan
    limit: float = np.nan
    closest: float = np.nan
    hunts: tuple[int, ...] = ()
    held_out_limit: float = np.nan

    def _short(self) -> str:
        return f"differ by {self.difference:.2f} pulses (rms), {self.detection._short()}"

    def _shown(self) -> Iterator[Piece]:
        size = "an unknown amount"
        if np.isfinite(self.difference):
            size = f"{self.difference:.2f} pulses (rms)"
        validation = ""
        if self.held_out_difference is not None:
            validation = f", in the validation record(s) by {self.held_out_difference:.2f}"
        yield f"simulated and measured errors differ by {size}{validation}"
        if self.hunts:
            yield (
                "the loop hunts by counts, as the model's does: two runs of it differ by"
                f" {self.expected:.2f} pulses"
            )
        yield str(self.detection)

    @classmethod
    def of(
        cls, problem: Problem, fit: Fit, objective: Objective, cost: float, outcome: Outcome
    ) -> Diagnostics:
        """Diagnose a fit to a problem.

        `objective`: that of the records with their zeros in place. `cost`: its value.
        """
        held_out = None if problem.held_out is None else repeating(problem, problem.held_out)

        # 1. The delay of the counts. Values without a covariance may be too far off to show
        # a delay, and a replayed torque has no loop.
        delay = np.nan
        delay_std = np.inf
        if fit.covariance is not None and not any(problem.replays):
            delay, delay_std = delay_of(
                problem.dynamics, objective.records, fit.unknown, fit.values, **problem.options
            )

        # 2. Effects that the rig does not model. If records disagree, the mean of their fits
        # replaces the common fit, unless the common fit repeats the held-out records better.
        # A significant delay is tried as a cause, whatever its score test.
        late = delay if is_late(delay, delay_std) else 0.0
        common = detect(problem, fit, outcome, late)
        detection = of_each(problem, common)
        if (
            detection.mean is not None
            and held_out is not None
            and _cost(fit, held_out) < _cost(detection.mean, held_out)
        ):
            detection = common
        if detection.mean is not None:
            fit = detection.mean
            objective = repeating(problem, placed(problem, fit), fit.resumptions)
            cost = _cost(fit, objective)

        # 3. The difference from a simulation, against that of two runs of the model.
        # The records held out are judged like those searched.
        objectives = [objective]
        costs = [cost]
        if held_out is not None:
            objectives.append(held_out)
            costs.append(_cost(fit, held_out))
        runs = _runs(problem, fit, objectives, costs)
        looped = not any(in_open_loop(objective.records) for objective in objectives)
        doubted = _doubted(runs, objectives) and looped
        if doubted and problem.steps < FIT.finest:
            # Coarse steps alone leave some pulses of a fine encoder: no fault of the log.
            finer = problem.in_steps(FIT.refined * problem.steps)
            again = [
                Objective(problem.dynamics, objective.records, objective.unknown, **finer.options)
                for objective in objectives
            ]
            fine_costs = [_cost(fit, objective) for objective in again]
            fine = _runs(finer, fit, again, fine_costs)
            doubted = _doubted(fine, again)
            runs = runs if doubted else fine
        if doubted and problem.method not in ROUGH:
            # Effects that the rig lacks may bias the values: let the runs differ by them too.
            widened = detection.widened(fit)
            if widened is not fit:
                runs_with_bias = _runs(problem, widened, objectives, costs)
                runs = [_wider(*pair) for pair in zip(runs, runs_with_bias, strict=True)]
                doubted = _doubted(runs, objectives)

        # 4. A rough method is at fault itself if prediction_error explains the log.
        searched = runs[0]
        closest = np.nan
        if doubted and problem.method in ROUGH:
            searched, closest = _by_prediction(problem, objectives, searched)
        return cls(
            objective=cost,
            held_out_difference=None if held_out is None else runs[1].difference,
            held_out_limit=np.nan if held_out is None else runs[1].limit,
            bands=_bands(problem, fit.values),
            delay=delay,
            delay_std=delay_std,
            detection=detection,
            law_apart=tuple(torque_apart(record) for record in problem.objective.records),
            closest=closest,
            **searched._asdict(),
        )


def _cost(fit: Fit, objective: Objective) -> float:
    """Objective (4) of the values of a fit [pulses^2]."""
    return float(objective(fit.values[None])[0])


def _runs(
    problem: Problem, fit: Fit, objectives: Sequence[Objective], costs: Sequence[float]
) -> list[Predicted]:
    """Runs of the model with values like those of a fit, for the records of each objective."""
    return [
        predicted(problem, fit, objective.records, cost)
        for objective, cost in zip(objectives, costs, strict=True)
    ]


def _doubted(runs: Sequence[Predicted], objectives: Sequence[Objective]) -> bool:
    """Whether the records of any objective differ from the model more than its runs do."""
    return any(
        doubtful(run, objective.records) for run, objective in zip(runs, objectives, strict=True)
    )


def _wider(run: Predicted, run_with_bias: Predicted) -> Predicted:
    """The run with its limit raised to that with bias, but not beyond `_WIDER` times `expected`."""
    if not run.expected > 0:  # NaN: nothing asks for an explanation
        return run
    with_bias = np.fmin(run_with_bias.limit, _WIDER * run.expected)
    return run._replace(limit=np.fmax(run.limit, with_bias))


def _by_prediction(
    problem: Problem, objectives: Sequence[Objective], run: Predicted
) -> tuple[Predicted, float]:
    """The run with `hunts` of a fit by prediction_error, and the difference of that fit.

    If that fit does not explain all records, the run is unchanged and the difference is NaN.
    """
    try:
        # Without the checkpoint, whose stages belong to the method of the problem.
        fit = prediction_error(replace(problem, checkpoint=Checkpoint(None, ""))).fit
        costs = [_cost(fit, objective) for objective in objectives]
        runs = _runs(problem, fit, objectives, costs)
    except ValueError:  # no arm follows the log
        return run, np.nan
    if fit.fallback_reason is not None or _doubted(runs, objectives):
        return run, np.nan
    # The difference of these values shows that the log is healthy.
    return run._replace(hunts=runs[0].hunts), runs[0].difference


def _bands(problem: Problem, values: Floats) -> dict[float, float]:
    """Mean ratio of least squares on logged torques to the identified f, by pass band [Hz]."""
    # Only a replay has a torque of its own.
    if not all(problem.replays):
        return {}
    identified = dict(zip(problem.unknown, values, strict=True))
    fits = over_bands(problem.dynamics, problem.records, problem.unknown, problem.known)
    ratios = {}
    for band, fit in fits.items():
        # A value of zero has no ratio.
        names = [name for name in problem.dynamics.names if name in fit.names and identified[name]]
        f = np.array([identified[name] for name in names])
        least_squares = np.array([fit[name] for name in names])
        std = fit.std[[fit.names.index(name) for name in names]]
        # A ratio of a precise value counts more; where none is known at all there is no mean.
        weights = (f / std) ** 2
        if weights.any():
            ratios[band] = float(np.average(least_squares / f, weights=weights))
    return ratios


class _Alone(NamedTuple):
    """Fit of one record, and its tests, with covariances (k, k).

    `noise`: due to noise. `within`: `noise`, raised to the scatter between segments where that is
    larger. `doubt`: due to effects that the rig may lack.
    """

    fit: Fit
    detection: Detection
    noise: Floats
    within: Floats
    doubt: Floats


def of_each(problem: Problem, detection: Detection) -> Detection:
    """Add the mean of the single-record fits to a detection, if the records contradict each other.

    A record that does not determine all unknowns by itself is left out of the mean. No mean is
    taken with a rough method, or if fewer than two records, or fewer than half of them, remain.
    With zeros or memories, all records must remain. If contradicting records get no mean, `between`
    is set to None: its scatter, linearised about the common fit, is too small.
    """
    count = len(problem.records)
    if not OF_RECORDS & {*detection.names} or detection.grouped is None or count < 2:
        return detection
    alone = {}
    # Deviations of rough methods do not cover their own errors: they could not weigh records.
    if problem.method not in ROUGH:
        for k in range(count):
            with contextlib.suppress(ValueError):
                alone[k] = _alone(problem, k)
    # Zeros and memories belong to single records: none may be missing.
    required = count if problem.zeros or problem.memories else max(2, count / 2)
    if len(alone) >= required:
        return _mean_of_fits(problem, detection, alone)
    return replace(detection, between=None)


def _alone(problem: Problem, k: int) -> _Alone:
    """Fit and tests of one record."""
    prior = problem.prior
    if prior is not None:
        # Every record has its share of the prior, so that their mean counts it once.
        covariance = len(problem.records) * prior.covariance
        prior = replace(prior, covariance=covariance)
    alone = replace(
        problem,
        records=(problem.records[k],),
        memories=problem.memories[k : k + 1],
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


def _mean_of_fits(problem: Problem, detection: Detection, alone: dict[int, _Alone]) -> Detection:
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

    # 3. Covariance of the mean. A bias is common to all records and does not average out. Its
    # covariances are therefore averaged: each is multiplied by root weights on both sides.
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
    return replace(
        detection,
        mean=mean_fit,
        doubt=doubt,
        grouped=np.sqrt(inner + scatter + bias),
        assumed=assumed,
        between=BetweenRuns.of(all_values, all_std, between, inner, scatter, bias),
    )


def _weighted(weight: Floats, covariance: Sequence[Floats]) -> Floats:
    """Covariance (k, k) of a sum with weights (R, k) of terms with covariances (R, k, k)."""
    return np.einsum("ri,rij,rj->ij", weight, covariance, weight)


def _factor(covariance: Floats) -> Floats:
    """Rows whose products are the correlations of a covariance (k, k)."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    sizes, axes = np.linalg.eigh(covariance / np.outer(std, std))
    # Rounding can make the smallest eigenvalues negative.
    return axes * np.sqrt(np.maximum(sizes, 0.0))
