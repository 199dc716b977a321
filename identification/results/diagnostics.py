"""How well what was found repeats the records: differences, delay of the counts, least squares in bands."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.stated_law import torque_apart
from identification.replay.objective import Objective
from identification.replay.timing import delay_of, is_late
from identification.results.detection import Detection
from identification.results.stepwise import detect
from identification.search.memory import repeating
from identification.search.methods import prediction_error
from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Record, replay
from plant.checkup.oscillation import own_oscillation
from plant.parts.checkpoint import Checkpoint
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown
from plant.simulation.followed_path import is_rounded

ROUNDINGS = 0.58
"""Difference [pulses, rms] that two roundings alone give."""

_FAR, _FAR_ROUNDED = 0.9, 1.5
"""Difference [pulses] from which it asks for an explanation: of the counts, and of the path as well."""

_ROUGH = ("equation_error", "didim", "output_error", "paper")
"""Methods whose deviations do not cover what rounding makes of a loop that hunts; others judge the log for them."""

FALSE_ALARM = 1e-3
"""Probability that a log is doubted which differs from the model's run as other runs of the model do."""

_LOOKS, _FEW = ((8, 0.1 * FALSE_ALARM), (40, 0.9 * FALSE_ALARM)), 4
"""Runs of the model, and with which probability each look may doubt; and how few say nothing."""

_OWN, _SAME_HZ = 2.0, 0.4
"""Difference over the rms of measured errors that no healthy log exceeds (two runs that hunt independently differ by
1.4 of it; runs of a model that differ by more would hide any log); logarithm of frequencies that hunt alike."""


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnostics(Shown, Frozen):
    """How well what was found repeats the records.

    Attributes
    ----------
    objective : float
        Objective (4) in the records that were searched [pulses^2].
    difference, held_out_difference : float, float or None
        Root mean square, per sample and joint, between the errors measured and simulated with what was found [pulses]:
        in the records, and in those held out. Two roundings alone give 0.58.
    bands : dict
        Of logged torques: pass band [Hz] -> mean ratio of least squares in that band to f as found, each weighted by
        its precision.
    delay, delay_std : float
        By how many samples the counts are read late, against a simulation with what was found, and its standard
        deviation; NaN and inf where that is not known.
    detection : Detection
        Whether compliance, backlash, lag, other friction or late counts explain what the model does not.
    law_apart : tuple
        Of each record that was searched: how far the logged torque of each joint (n,) is from what the stated law gives
        along the log, from the best state, as a share of it (rms); None where that cannot be told.
    expected, limit : float
        Root mean square difference [pulses] between runs of the model, with values as likely as those found, that begin
        elsewhere within a count: a loop that hunts by a count never does so twice alike. Its geometric mean; and what a
        healthy log exceeds with a probability of 0.001, at most twice the root mean square of the measured errors. NaN
        where the difference asks for no explanation.
    closest : float
        That difference with the values of "prediction_error", if they explain a log that those of another method do
        not: the log is healthy then. NaN otherwise.
    hunts : tuple of int
        Records whose loop oscillates, as that of the model does by friction and counts alone, at about that frequency.
        What else the log contradicts is told by `difference` and `detection`, as of any other.
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

    def _short(self) -> str:
        return f"differ by {self.difference:.2f} pulses (rms), {self.detection._short()}"

    def _shown(self) -> Iterator[Piece]:
        known = np.isfinite(self.difference)
        by = f"{self.difference:.2f} pulses (rms)" if known else "an unknown amount"
        aside = self.held_out_difference
        kept = "" if aside is None else f", in the validation record(s) by {aside:.2f}"
        yield f"simulated and measured errors differ by {by}{kept}"
        if self.hunts:
            yield f"the loop hunts by counts, as the model's does: two runs of it differ by {self.expected:.2f} pulses"
        yield str(self.detection)

    @classmethod
    def of(cls, problem: Problem, fit: Fit, objective: Objective, cost: float, rounding: Floats | None) -> Diagnostics:
        """Of a fit to a problem; its objective is that of the records with their zeros in place, its value the cost."""
        delay, delay_std = np.nan, np.inf
        kept = None if problem.held_out is None else repeating(problem, problem.held_out)
        if fit.covariance is not None and not any(problem.replays):  # values that may be far off say nothing of timing
            delay, delay_std = delay_of(problem.dynamics, objective.records, fit.unknown, fit.values, **problem.options)
        difference = _difference(cost, objective)
        predicted, closest = _predicted(problem, fit, objective.records, difference), np.nan
        doubted = difference > np.fmax(asks_from(objective.records), predicted.limit) and not any(problem.replays)
        if doubted and problem.method in _ROUGH:
            predicted, closest = _by_prediction(problem, objective, predicted)
        return cls(
            objective=cost,
            difference=difference,
            held_out_difference=None if kept is None else _difference(float(kept(fit.values[None])[0]), kept),
            bands=_bands(problem, fit.values),
            delay=delay,
            delay_std=delay_std,
            detection=detect(problem, fit, delay if is_late(delay, delay_std) else 0.0, rounding),
            law_apart=tuple(torque_apart(record) for record in problem.objective.records),
            closest=closest,
            **predicted._asdict(),
        )


class _Predicted(NamedTuple):
    """By how much runs of the model differ (geometric mean), and seldom more; and the records that hunt as they do."""

    expected: float = np.nan
    limit: float = np.nan
    hunts: tuple[int, ...] = ()


def _predicted(problem: Problem, fit: Fit, records: Sequence[Record], difference: float) -> _Predicted:
    """A posterior predictive check: arms as likely as the one found begin elsewhere within a count.

    If nothing is wrong the log is a run like theirs, as far as they are from that of the values. Logarithms of these
    distances are taken for normal. Where the first runs leave it open whether the log is one of them, more are made.
    """
    swings = {i: hz for i, record in enumerate(records) if (hz := own_oscillation(record)) is not None}
    if any(problem.replays) or not np.isfinite(difference) or (difference <= asks_from(records) and not swings):
        return _Predicted()
    try:
        runs = [_run(problem, fit.values, record) for record in records]
    except ValueError:  # it diverges, or has no sound inertia
        return _Predicted()
    random = np.random.default_rng(0)
    hunts, logarithms, limit = {i for i in swings if _alike(swings[i], runs[i])}, list[float](), np.nan
    most = _OWN * float(np.sqrt(np.mean(np.concatenate([record.error_pulses for record in records]) ** 2)))
    for count, chance in _LOOKS:
        for values in _drawn(fit, random, count - len(logarithms)):
            try:
                others = [_run(problem, values, _shifted(run, random)) for run in runs]
            except ValueError:
                continue
            hunts |= {i for i in swings if _alike(swings[i], others[i])}
            apart = [other.error_pulses - run.error_pulses for other, run in zip(others, runs, strict=True)]
            logarithms.append(0.5 * float(np.log(np.mean(np.concatenate(apart) ** 2))))
        if len(logarithms) < _FEW:
            return _Predicted(hunts=tuple(sorted(hunts)))
        limit = min(_exceeded(logarithms, chance), most)
        if difference > limit or (difference <= np.exp(max(logarithms)) and len(hunts) == len(swings)):
            break
    return _Predicted(float(np.exp(np.mean(logarithms))), limit, tuple(sorted(hunts)))


def _by_prediction(problem: Problem, objective: Objective, own: _Predicted) -> tuple[_Predicted, float]:
    """The hunting of the prediction error's fit, and its difference, if that explains the records; else what was."""
    try:
        fit = prediction_error(dataclasses.replace(problem, checkpoint=Checkpoint(None, ""))).fit
        difference = _difference(float(objective(fit.values[None])[0]), objective)
    except ValueError:  # no arm follows the log
        return own, np.nan
    other = _predicted(problem, fit, objective.records, difference)
    if fit.fallback_reason is not None or not difference <= np.fmax(asks_from(objective.records), other.limit):
        return own, np.nan
    return own._replace(hunts=other.hunts), difference


def _exceeded(logarithms: list[float], chance: float) -> float:
    """What one more number exceeds with this chance, of the same normal distribution as the others' logarithms."""
    from scipy.special import stdtrit

    n, std = len(logarithms), np.std(logarithms, ddof=1)
    return float(np.exp(np.mean(logarithms) + stdtrit(n - 1, 1 - chance) * std * np.sqrt(1 + 1 / n)))


def _drawn(fit: Fit, random: np.random.Generator, count: int) -> Iterator[Floats]:
    """Values (k,) as likely as those found: of the covariance, or for want of one those that repeat the log as well."""
    if fit.covariance is None:
        yield from random.choice(fit.candidates, count)
        return
    scale, axes = np.linalg.eigh(fit.covariance)
    root = axes * np.sqrt(np.maximum(scale, 0.0))
    yield from (fit.values + root @ random.standard_normal(len(scale)) for _ in range(count))


def _shifted(run: Record, random: np.random.Generator) -> Record:
    """A simulated record, to begin elsewhere within a count."""
    start = np.stack([run.true_q[0], run.true_qd[0]])  # type: ignore[index]  # simulated
    start[0] += run.rig.to_angle(random.uniform(-0.5, 0.5, run.n))
    return dataclasses.replace(run, initial=start)


def _run(problem: Problem, values: Floats, record: Record) -> Record:
    """A record, simulated with these values (k,) of the unknowns, its law with the memory that it has there."""
    named, law = dict(zip(problem.unknown, values, strict=True)), record.law
    given = None if law is None else law.filled(named, "law.")
    return replay(problem.parts(values)[0], record, rig=record.rig.filled(named), law=given)


def _alike(hz: float, run: Record) -> bool:
    """Whether the loop of a run oscillates, too, at about this frequency [Hz] of a log."""
    other = own_oscillation(run)
    return other is not None and abs(np.log(hz / other)) < _SAME_HZ


def asks_from(records: Sequence[Record]) -> float:
    """Difference [pulses] from which records ask for an explanation."""
    return _FAR_ROUNDED if any(map(is_rounded, records)) else _FAR


def _difference(cost: float, objective: Objective) -> float:
    """Objective (4) as a root mean square per sample and joint [pulses]."""
    return float(np.sqrt(cost / sum(record.error_pulses.size for record in objective.records)))


def _bands(problem: Problem, values: Floats) -> dict[float, float]:
    """Least squares on logged torques in bands of their own, in what was found: band [Hz] -> mean ratio."""
    if not all(problem.replays):
        return {}
    found, ratios = dict(zip(problem.unknown, values, strict=True)), {}
    for band, fit in over_bands(problem.dynamics, problem.records, problem.unknown, problem.known).items():
        names = [name for name in problem.dynamics.names if name in fit.names and found[name]]
        ours, least = np.array([found[name] for name in names]), np.array([fit[name] for name in names])
        std = fit.std[[fit.names.index(name) for name in names]]
        ratios[band] = float(np.average(least / ours, weights=(ours / std) ** 2))
    return ratios
