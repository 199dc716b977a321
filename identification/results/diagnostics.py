"""How well what was found repeats the records: differences, delay of the counts, least squares in bands."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.stated_law import torque_apart
from identification.replay.objective import Objective
from identification.replay.timing import delay_of, is_late
from identification.results.detection import Detection
from identification.results.stepwise import detect
from identification.search.memory import repeating
from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Record, replay
from plant.checkup.oscillation import own_oscillation
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown
from plant.simulation.followed_path import is_rounded

ROUNDINGS = 0.58
"""Difference [pulses, rms] that two roundings alone give."""

_FAR, _FAR_ROUNDED = 0.9, 1.5
"""Difference [pulses] from which it asks for an explanation: of the counts, and of the path as well."""

FALSE_ALARM = 1e-3
"""Probability that a log is doubted which differs from the model's run as other runs of the model do."""

_LOOKS, _FEW = ((8, 0.1 * FALSE_ALARM), (40, 0.9 * FALSE_ALARM)), 4
"""Runs of the model, and with which probability each look may doubt; and how few say nothing."""

_SAME_HZ = 0.4
"""Of the logarithm of frequencies: a loop that hunts does so in a band."""


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
    expected, limit, held_out_limit : float
        Root mean square difference [pulses] between runs of the model, with values as likely as those found, that begin
        elsewhere within a count: a loop that hunts by a count never does so twice alike. Its geometric mean; and what a
        healthy log exceeds with a probability of 0.001, in the records and in those held out. NaN where the difference
        asks for no explanation.
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
    held_out_limit: float = np.nan
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
        held_out = None if kept is None else _difference(float(kept(fit.values[None])[0]), kept)
        aside = _Predicted() if kept is None else _predicted(problem, fit, kept.records, held_out)
        return cls(
            objective=cost,
            difference=difference,
            held_out_difference=held_out,
            bands=_bands(problem, fit.values),
            delay=delay,
            delay_std=delay_std,
            detection=detect(problem, fit, delay if is_late(delay, delay_std) else 0.0, rounding),
            law_apart=tuple(torque_apart(record) for record in problem.objective.records),
            held_out_limit=aside.limit,
            **_predicted(problem, fit, objective.records, difference)._asdict(),
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
    own = [own_oscillation(record) for record in records]
    swings = {i for i, hz in enumerate(own) if hz is not None}
    if any(problem.replays) or not np.isfinite(difference) or (difference <= asks_from(records) and not swings):
        return _Predicted()
    try:
        runs = [_run(problem, fit.values, record) for record in records]
    except ValueError:  # it diverges, or has no sound inertia
        return _Predicted()
    random = np.random.default_rng(0)
    hunts, logarithms, limit = {i for i in swings if _alike(own[i], runs[i])}, list[float](), np.nan
    for count, chance in _LOOKS:
        for values in _drawn(fit, random, count - len(logarithms)):
            try:
                others = [_run(problem, values, _shifted(run, random)) for run in runs]
            except ValueError:
                continue
            hunts |= {i for i in swings if _alike(own[i], others[i])}
            apart = [other.error_pulses - run.error_pulses for other, run in zip(others, runs, strict=True)]
            logarithms.append(0.5 * float(np.log(np.mean(np.concatenate(apart) ** 2))))
        n = len(logarithms)
        if n < _FEW:
            return _Predicted(hunts=tuple(sorted(hunts)))
        seldom = stdtrit(n - 1, 1 - chance) * np.std(logarithms, ddof=1) * np.sqrt(1 + 1 / n)
        limit = float(np.exp(np.mean(logarithms) + seldom))
        if difference > limit or (difference <= np.exp(max(logarithms)) and hunts == swings):
            break
    return _Predicted(float(np.exp(np.mean(logarithms))), limit, tuple(sorted(hunts)))


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


def _alike(hz: float | None, run: Record) -> bool:
    """Whether the loop of a run oscillates, too, at about this frequency [Hz] of a log."""
    other = None if hz is None else own_oscillation(run)
    return hz is not None and other is not None and abs(np.log(hz / other)) < _SAME_HZ


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
