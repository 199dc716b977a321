"""Posterior predictive check: whether records differ from what was found no more than runs of that
model would.

Arms as likely as the one found, that begin elsewhere within a count, are simulated; a healthy log
is one run more.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Record, replay
from plant.checkup.oscillation import own_oscillations
from plant.parts.fields import Floats
from plant.simulation.followed_path import is_rounded

ROUNDINGS = 0.58  # difference [pulses, rms] that two roundings alone give

# Difference [pulses] from which it asks for an explanation: of the counts, and of the path as well.
_FAR = 0.9
_FAR_ROUNDED = 1.5

# Methods whose deviations do not cover what rounding makes of a loop that hunts; others judge the
# log for them.
ROUGH = ("equation_error", "output_error", "paper")

# probability that a log is doubted which differs from the model's run as other runs of the model do
FALSE_ALARM = 1e-3

# Runs of the model, and with which probability each look may doubt; and how few say nothing.
_LOOKS = ((8, 0.1 * FALSE_ALARM), (40, 0.9 * FALSE_ALARM))
_FEW = 4

# Difference over the rms of measured errors that no healthy log exceeds (two runs that hunt
# independently differ by 1.4 of it; runs of a model that differ by more would hide any log);
# logarithm of frequencies that hunt alike; and how much of what is told of a log a run has to show.
_OWN = 2.0
_SAME_HZ = 0.4
_NEARLY = 0.7


class Predicted(NamedTuple):
    """By how much the records differ from what was found, and runs of it from each other (geometric
    mean), and seldom more [pulses, rms]; and the records that hunt as runs do.
    """

    difference: float
    expected: float = np.nan
    limit: float = np.nan
    hunts: tuple[int, ...] = ()


def predicted(problem: Problem, fit: Fit, records: Sequence[Record], cost: float) -> Predicted:
    """What arms as likely as the one found show, for records of which it has this objective (4).

    If nothing is wrong the log is a run like theirs, as far as they are from that of the values.
    Logarithms of these distances are taken for normal. Where the first runs leave it open whether
    the log is one of them, more are made.
    """
    difference = difference_of(cost, records)
    swings = {i: hz[0] for i, record in enumerate(records) if (hz := own_oscillations(record))}
    if (
        any(problem.replays)
        or not np.isfinite(difference)
        or (difference <= asks_from(records) and not swings)
    ):
        return Predicted(difference)
    try:
        runs = [_run(problem, fit.values, record) for record in records]
    except ValueError:  # it diverges, or has no sound inertia
        return Predicted(difference)
    random = np.random.default_rng(0)
    hunts = {i for i in swings if _alike(swings[i], runs[i])}
    logarithms = list[float]()
    limit = np.nan
    most = _OWN * float(
        np.sqrt(np.mean(np.concatenate([record.error_pulses for record in records]) ** 2))
    )
    for count, chance in _LOOKS:
        for values in _drawn(fit, random, count - len(logarithms)):
            try:
                others = [_run(problem, values, _shifted(run, random)) for run in runs]
            except ValueError:
                continue
            hunts |= {i for i in swings if _alike(swings[i], others[i])}
            apart = [
                other.error_pulses - run.error_pulses
                for other, run in zip(others, runs, strict=True)
            ]
            logarithms.append(0.5 * float(np.log(np.mean(np.concatenate(apart) ** 2))))
        if len(logarithms) < _FEW:
            return Predicted(difference, hunts=tuple(sorted(hunts)))
        limit = min(_exceeded(logarithms, chance), most)
        if difference > limit or (
            difference <= np.exp(max(logarithms)) and len(hunts) == len(swings)
        ):
            break
    return Predicted(difference, float(np.exp(np.mean(logarithms))), limit, tuple(sorted(hunts)))


def _exceeded(logarithms: list[float], chance: float) -> float:
    """What one more number exceeds with this chance, of the same normal distribution as the
    others' logarithms.
    """
    from scipy.special import stdtrit

    n = len(logarithms)
    std = np.std(logarithms, ddof=1)
    return float(
        np.exp(np.mean(logarithms) + stdtrit(n - 1, 1 - chance) * std * np.sqrt(1 + 1 / n))
    )


def _drawn(fit: Fit, random: np.random.Generator, count: int) -> Iterator[Floats]:
    """Values (k,) as likely as those found: of the covariance, or for want of one those that
    repeat the log as well.
    """
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
    """A record, simulated with these values (k,) of the unknowns, its law with the memory that
    it has there.
    """
    named = dict(zip(problem.unknown, values, strict=True))
    law = record.law
    given = None if law is None else law.filled(named, "law.")
    return replay(problem.parts(values)[0], record, rig=record.rig.filled(named), law=given)


def _alike(hz: float, run: Record) -> bool:
    """Whether a joint of a run oscillates, too, or nearly, at about this frequency [Hz] of a
    log.
    """
    return any(abs(np.log(hz / other)) < _SAME_HZ for other in own_oscillations(run, _NEARLY))


def asks_from(records: Sequence[Record]) -> float:
    """Difference [pulses] from which records ask for an explanation."""
    return _FAR_ROUNDED if any(map(is_rounded, records)) else _FAR


def doubtful(told: Any, records: Sequence[Record]) -> bool:
    """Whether records differ by more than the model's runs seldom do; `told`: what has their
    difference and limit.
    """
    return not told.difference <= np.fmax(asks_from(records), told.limit)


def difference_of(cost: float, records: Sequence[Record]) -> float:
    """Objective (4) as a root mean square per sample and joint [pulses]."""
    return float(np.sqrt(cost / sum(record.error_pulses.size for record in records)))
