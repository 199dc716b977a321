"""How well what was found repeats the records: differences, delay of the counts, least squares in bands."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.stated_law import torque_apart
from identification.replay.objective import Objective
from identification.replay.timing import delay_of, is_late
from identification.results.detection import Detection
from identification.results.stepwise import detect
from identification.search.memory import repeating, run_again
from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Record
from plant.checkup.oscillation import own_oscillation
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown

ROUNDINGS = 0.58
"""Difference [pulses, rms] that two roundings alone give."""

_SAMPLES = 8
"""Arms that are sampled for what the model expects."""

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
    expected : float
        Root mean square difference [pulses] that the model expects, the largest of arms sampled from the covariance
        that begin elsewhere within a count: a loop that hunts by a count never does so twice alike. NaN where
        `difference` asks for no explanation.
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
        expected, hunts = _expected(problem, fit, objective.records) if difference > ROUNDINGS else (np.nan, ())
        return cls(
            objective=cost,
            difference=difference,
            held_out_difference=None if kept is None else _difference(float(kept(fit.values[None])[0]), kept),
            bands=_bands(problem, fit.values),
            delay=delay,
            delay_std=delay_std,
            detection=detect(problem, fit, delay if is_late(delay, delay_std) else 0.0, rounding),
            law_apart=tuple(torque_apart(record) for record in problem.objective.records),
            expected=expected,
            hunts=hunts,
        )


def _expected(problem: Problem, fit: Fit, records: Sequence[Record]) -> tuple[float, tuple[int, ...]]:
    """`Diagnostics.expected` and `hunts`, of records that are repeated: a posterior predictive check."""
    if fit.covariance is None or any(problem.replays):
        return np.nan, ()
    try:
        runs = [_run(problem, fit.values, record) for record in records]
    except ValueError:  # it diverges, or has no sound inertia
        return np.nan, ()
    random, most = np.random.default_rng(0), np.nan
    scale, axes = np.linalg.eigh(fit.covariance)
    root = axes * np.sqrt(np.maximum(scale, 0.0))
    own = [own_oscillation(record) for record in records]
    hunts = {i for i, run in enumerate(runs) if _alike(own[i], run)}
    for _ in range(_SAMPLES):
        values = fit.values + root @ random.standard_normal(len(scale))
        squares = 0.0
        try:
            for i, run in enumerate(runs):
                shift = run.rig.to_angle(random.uniform(-0.5, 0.5, run.n))
                begun = dataclasses.replace(run, initial=np.array(run.initial) + np.stack([shift, 0 * shift]))
                other = _run(problem, values, begun)
                squares += float(np.sum((other.error_pulses - run.error_pulses) ** 2))
                hunts |= {i} if i not in hunts and _alike(own[i], other) else set()
        except ValueError:
            continue
        most = np.fmax(most, np.sqrt(squares / sum(run.error_pulses.size for run in runs)))
    return float(most), tuple(sorted(hunts))


def _run(problem: Problem, values: Floats, record: Record) -> Record:
    """A record, simulated with these values (k,) of the unknowns, its law with the memory that it has there."""
    run = run_again(record, *problem.parts(values))
    return dataclasses.replace(run, initial=np.stack([run.true_q[0], run.true_qd[0]]))  # type: ignore[index]  # simulated


def _alike(hz: float | None, run: Record) -> bool:
    """Whether the loop of a run oscillates, too, at about this frequency [Hz] of a log."""
    other = None if hz is None else own_oscillation(run)
    return hz is not None and other is not None and abs(np.log(hz / other)) < _SAME_HZ


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
