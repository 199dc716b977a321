"""Posterior predictive check: do records differ from the model more than its own runs do?

Arms drawn from the covariance of the fit are simulated, with another start within a count and
within the deviations of a start that was estimated. If the model is right, the log is one run more,
and lies no further from the run of the fitted values than these runs.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Record, replay
from plant.checkup import own_oscillations
from plant.parts import frozen_settings
from plant.simulation import is_rounded

# Difference between a measured and a simulated log from rounding alone [pulses, rms].
ROUNDINGS = 0.58

# Methods whose deviations do not cover the effect of rounding on a loop that hunts. The check of
# their logs uses a fit of another method.
ROUGH = ("equation_error", "output_error", "paper")

# Probability of doubting a log that differs from the run of the model as its other runs do.
FALSE_ALARM = 1e-3


@frozen_settings
class CheckSettings:
    """Numbers of the posterior predictive check.

    Chosen by hand; ``tests/benchmarks/healthy.py`` counts the right logs that it doubts.

    Parameters
    ----------
    far : float
        Difference above which records ask for an explanation [pulses, rms].
    far_rounded : float
        The same where the path is rounded to counts, too.
    looks : tuple of (int, float)
        Runs of the model, in all, and the probability of a false alarm, of each successive look.
        The probabilities add up to `FALSE_ALARM`; few runs suffice for most logs.
    few : int
        Number of runs below which no limit is stated.
    largest : float
        Limit over the rms of the measured errors. Two runs that hunt independently differ by 1.4 of
        it; runs that differ by more than this would hide any log.
    same_frequency : float
        Difference of the logarithms of two frequencies up to which runs hunt alike.
    nearly : float
        Share of the criterion of an oscillation in a log that a run must reach to oscillate, too.
    """

    far: float = 0.9
    far_rounded: float = 1.5
    looks: tuple[tuple[int, float], ...] = ((8, 0.1 * FALSE_ALARM), (40, 0.9 * FALSE_ALARM))
    few: int = 4
    largest: float = 2.0
    same_frequency: float = 0.4
    nearly: float = 0.7


CHECK = CheckSettings()


class Predicted(NamedTuple):
    """Result of the check: differences [pulses, rms], and the records that hunt as runs do.

    `difference`: of the records from the simulation with the fitted values. `expected`: geometric
    mean of those of runs. `limit`: exceeded with the probability of a false alarm. `hunts`: numbers
    of the records.
    """

    difference: float
    expected: float = np.nan
    limit: float = np.nan
    hunts: tuple[int, ...] = ()


def predicted(problem: Problem, fit: Fit, records: Sequence[Record], cost: float) -> Predicted:
    """Posterior predictive check of records for which the fit has this objective (4), `cost`.

    The logarithms of the differences between runs are taken as normal. Where the few runs of the
    first look leave the verdict open, the second makes more.
    """
    # 1. Nothing to explain: the records are close, and no joint oscillates.
    difference = difference_of(cost, records)
    swings = {}  # number of a record -> frequency of its oscillation [Hz]
    for i, record in enumerate(records):
        frequencies = own_oscillations(record)
        if frequencies:
            swings[i] = frequencies[0]
    close = difference <= asks_from(records) and not swings
    # A replayed torque drives the arm in open loop, where all model errors accumulate. A law that
    # is stated beside a logged torque runs in its loop again.
    if in_open_loop(records) or not np.isfinite(difference) or close:
        return Predicted(difference)

    # 2. The runs with the fitted values, from which the distances are measured.
    try:
        # One failure is enough: without a run of the fit nothing can be compared.
        runs = [simulated_record(problem, fit.values, record) for record in records]
    except ValueError:  # it diverges, or has no sound inertia
        return Predicted(difference)
    # A fixed seed: the same identification gives the same verdict.
    random = np.random.default_rng(0)
    hunts = {i for i in swings if _alike(swings[i], runs[i])}
    logarithms = list[float]()
    limit = np.nan
    errors = np.concatenate([record.error_pulses for record in records])
    largest = CHECK.largest * float(np.sqrt(np.mean(errors**2)))

    # 3. Runs of drawn arms, until the verdict is clear.
    for count, chance in CHECK.looks:
        for values in _drawn(fit, random, count - len(logarithms)):
            try:
                drawn = [
                    simulated_record(problem, values, _shifted(run, record, fit, random))
                    for run, record in zip(runs, records, strict=True)
                ]
            except ValueError:  # this draw is no arm
                continue
            hunts |= {i for i in swings if _alike(swings[i], drawn[i])}
            apart = [
                one.error_pulses - run.error_pulses for one, run in zip(drawn, runs, strict=True)
            ]
            logarithms.append(0.5 * float(np.log(np.mean(np.concatenate(apart) ** 2))))
        if len(logarithms) < CHECK.few:
            return Predicted(difference, hunts=tuple(sorted(hunts)))
        limit = min(exceeded_value(logarithms, chance), largest)
        inside = difference <= np.exp(max(logarithms)) and len(hunts) == len(swings)
        if difference > limit or inside:
            break
    return Predicted(difference, float(np.exp(np.mean(logarithms))), limit, tuple(sorted(hunts)))


def in_open_loop(records: Sequence[Record]) -> bool:
    """Whether a simulation repeats a logged torque of some record in place of its law."""
    return any(record.law is None or record.law.replays for record in records)


def exceeded_value(logarithms, chance):
    """Value that one number more exceeds with this chance, if all logarithms are normal.

    This is the prediction interval of a normal sample: mean and deviation are estimates, too.
    """
    from scipy.special import stdtrit

    n = len(logarithms)
    std = np.std(logarithms, ddof=1)
    return float(
        np.exp(np.mean(logarithms) + stdtrit(n - 1, 1 - chance) * std * np.sqrt(1 + 1 / n))
    )


def _drawn(fit, random, count):
    """Values (k,) drawn from the covariance; without one, from the candidates of the fit."""
    if fit.covariance is None:
        yield from random.choice(fit.candidates, count)
        return
    # Eigenvectors, since fixed values make the covariance singular; rounding makes some negative.
    scale, axes = np.linalg.eigh(fit.covariance)
    root = axes * np.sqrt(np.maximum(scale, 0.0))
    yield from (fit.values + root @ random.standard_normal(len(scale)) for _ in range(count))


def _shifted(run, record, fit, random):
    """A run of a record with another start, within a count and the deviations of its estimate."""
    start = np.stack([run.true_q[0], run.true_qd[0]])
    start[0] += run.rig.to_angle(random.uniform(-0.5, 0.5, run.n))
    for resumption in fit.resumptions:
        # Records that were held out have starts of their own.
        estimated = resumption is not None and resumption.deviations is not None
        if estimated and np.array_equal(record.initial, resumption.initial):
            start += resumption.deviations * random.standard_normal(start.shape)
    return dataclasses.replace(run, initial=start)


def simulated_record(problem, values, record):
    """A record simulated with these values (k,) of the unknowns, from its own state of the law."""
    named = dict(zip(problem.unknown, values, strict=True))
    law = None if record.law is None else record.law.filled(named, "law.")
    return replay(problem.parts(values)[0], record, rig=record.rig.filled(named), law=law)


def _alike(hz, run):
    """Whether a joint of a run (nearly) oscillates at about this frequency of a log [Hz]."""
    frequencies = own_oscillations(run, CHECK.nearly)
    return any(abs(np.log(hz / frequency)) < CHECK.same_frequency for frequency in frequencies)


def asks_from(records: Sequence[Record]) -> float:
    """Difference above which records ask for an explanation [pulses, rms]."""
    return CHECK.far_rounded if any(map(is_rounded, records)) else CHECK.far


def doubtful(check: Any, records: Sequence[Record]) -> bool:
    """Whether records differ from the model more than its runs; `check` has difference and limit.

    A difference that is not a number is doubtful; a limit that is not one does not count.
    """
    return not check.difference <= np.fmax(asks_from(records), check.limit)


def difference_of(cost: float, records: Sequence[Record]) -> float:
    """Objective (4) as a root mean square per sample and joint [pulses]."""
    return float(np.sqrt(cost / sum(record.error_pulses.size for record in records)))
