"""How well what was found repeats the records: differences, delay of the counts, least squares
in bands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.stated_law import torque_apart
from identification.replay.objective import Objective
from identification.replay.timing import delay_of, is_late
from identification.results.detection import Detection
from identification.results.each_record import of_each
from identification.results.stepwise import detect
from identification.search.memory import placed, repeating
from identification.search.methods import prediction_error
from identification.search.outcome import Fit, Outcome
from identification.search.predictive import ROUGH, Predicted, doubtful, predicted
from identification.search.problem import Problem
from plant.parts.checkpoint import Checkpoint
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown

_WIDER = 2.0  # difference over that of two runs which what the rig may lack explains at most


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnostics(Shown, Frozen):
    """How well what was found repeats the records.

    Attributes
    ----------
    objective : float
        Objective (4) in the records that were searched [pulses^2].
    difference, held_out_difference : float, float or None
        Root mean square, per sample and joint, between the errors measured and simulated with what
        was found [pulses]: in the records, and in those held out. Two roundings alone give 0.58.
    bands : dict
        Of logged torques: pass band [Hz] -> mean ratio of least squares in that band to f as found,
        each weighted by its precision.
    delay, delay_std : float
        By how many samples the counts are read late, against a simulation with what was found, and
        its standard deviation; NaN and inf where that is not known.
    detection : Detection
        Whether compliance, backlash, lag, other friction or late counts explain what the model does
        not.
    law_apart : tuple
        Of each record that was searched: how far the logged torque of each joint (n,) is from what
        the stated law gives along the log, from the best state, as a share of it (rms); None where
        that cannot be told.
    expected, limit : float
        Root mean square difference [pulses] between runs of the model, with values as likely as
        those found, that begin elsewhere within a count: a loop that hunts by a count never does so
        twice alike. Its geometric mean; and what a healthy log exceeds with a probability of 0.001,
        at most twice the root mean square of the measured errors. NaN where the difference asks for
        no explanation.
    closest : float
        That difference with the values of "prediction_error", if they explain a log that those of
        another method do not: the log is healthy then. NaN otherwise.
    hunts : tuple of int
        Records whose loop oscillates, as that of the model does by friction and counts alone, at
        about that frequency. What else the log contradicts is told by `difference` and `detection`,
        as of any other.
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
        known = np.isfinite(self.difference)
        by = f"{self.difference:.2f} pulses (rms)" if known else "an unknown amount"
        aside = self.held_out_difference
        kept = "" if aside is None else f", in the validation record(s) by {aside:.2f}"
        yield f"simulated and measured errors differ by {by}{kept}"
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
        """Of a fit to a problem; its objective is that of the records with their zeros in place,
        its value the cost.
        """
        delay = np.nan
        delay_std = np.inf
        kept = None if problem.held_out is None else repeating(problem, problem.held_out)
        # values that may be far off say nothing of timing
        if fit.covariance is not None and not any(problem.replays):
            delay, delay_std = delay_of(
                problem.dynamics, objective.records, fit.unknown, fit.values, **problem.options
            )
        late = delay if is_late(delay, delay_std) else 0.0
        common = detect(problem, fit, outcome, late)
        detection = of_each(problem, common)
        if (
            detection.mean is not None
            and kept is not None
            and _costs(fit, [kept]) < _costs(detection.mean, [kept])
        ):
            detection = common  # whose values tell better what is held out
        if detection.mean is not None:
            fit = detection.mean
            objective = repeating(problem, placed(problem, fit), fit.resumptions)
            (cost,) = _costs(fit, [objective])
        every = (objective,) if kept is None else (objective, kept)
        closest = np.nan
        costs = [cost, *_costs(fit, every[1:])]
        told, *aside = runs = _runs(problem, fit, every, costs)
        doubted = any(map(doubtful, runs, (each.records for each in every))) and not any(
            problem.replays
        )
        if doubted and problem.method not in ROUGH and (whole := detection.whole(fit)) is not fit:
            told, *aside = runs = [*map(_wider, runs, _runs(problem, whole, every, costs))]
            doubted = any(map(doubtful, runs, (each.records for each in every)))
        if doubted and problem.method in ROUGH:
            told, closest = _by_prediction(problem, every, told)
        return cls(
            objective=cost,
            held_out_difference=aside[0].difference if aside else None,
            held_out_limit=aside[0].limit if aside else np.nan,
            bands=_bands(problem, fit.values),
            delay=delay,
            delay_std=delay_std,
            detection=detection,
            law_apart=tuple(torque_apart(record) for record in problem.objective.records),
            closest=closest,
            **told._asdict(),
        )


def _costs(fit: Fit, every: Sequence[Objective]) -> list[float]:
    return [float(each(fit.values[None])[0]) for each in every]


def _runs(
    problem: Problem, fit: Fit, every: Sequence[Objective], costs: Sequence[float]
) -> list[Predicted]:
    """What runs with the values of a fit show, for the records of each objective, of these
    values.
    """
    pairs = zip(every, costs, strict=True)
    return [predicted(problem, fit, each.records, cost) for each, cost in pairs]


def _wider(own: Predicted, whole: Predicted) -> Predicted:
    """What runs differ by, with a limit for what the rig may lack; at most twice what they
    differ by without.
    """
    return (
        own._replace(limit=np.fmin(whole.limit, _WIDER * own.expected)) if own.expected > 0 else own
    )


def _by_prediction(
    problem: Problem, every: Sequence[Objective], own: Predicted
) -> tuple[Predicted, float]:
    """The hunting of the prediction error's fit, and its difference, if that explains all
    records; else what was.
    """
    try:
        fit = prediction_error(dataclasses.replace(problem, checkpoint=Checkpoint(None, ""))).fit
        others = _runs(problem, fit, every, _costs(fit, every))
    except ValueError:  # no arm follows the log
        return own, np.nan
    if fit.fallback_reason is not None or any(
        map(doubtful, others, (each.records for each in every))
    ):
        return own, np.nan
    return own._replace(hunts=others[0].hunts), others[0].difference


def _bands(problem: Problem, values: Floats) -> dict[float, float]:
    """Least squares on logged torques in bands of their own, in what was found: band [Hz] ->
    mean ratio.
    """
    if not all(problem.replays):
        return {}
    found = dict(zip(problem.unknown, values, strict=True))
    ratios = {}
    for band, fit in over_bands(
        problem.dynamics, problem.records, problem.unknown, problem.known
    ).items():
        names = [name for name in problem.dynamics.names if name in fit.names and found[name]]
        ours = np.array([found[name] for name in names])
        least = np.array([fit[name] for name in names])
        std = fit.std[[fit.names.index(name) for name in names]]
        ratios[band] = float(np.average(least / ours, weights=(ours / std) ** 2))
    return ratios
