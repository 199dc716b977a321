"""`identify`: from records to an arm by the identification procedure of the paper."""

import contextlib
import functools
import itertools
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import (
    Mistakes,
    Prior,
    RecordError,
    advice,
    from_prior,
    law_differs,
    mistakes_of,
    ranked_own_rows,
    record_label,
    restated,
    torque_apart,
    wrong_statements,
)
from identification.preparation import prepare, with_gears
from identification.results import (
    Diagnostics,
    Identification,
    doubts,
    of_statements,
    warn_of_doubts,
)
from identification.search import (
    METHODS,
    GeneticSettings,
    Outcome,
    Problem,
    Search,
    Tolerances,
    placed,
    repeating,
)
from plant import Dynamics, Hypothesis, Record
from plant.checkup import require_rows
from plant.parts import (
    Checkpoint,
    ProgressBar,
    instance,
    known_options,
    progress_bar,
    versions,
    warn,
)


@known_options
def identify(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    *,
    seed: int = 0,
    method: str = "seeded",
    progress: bool = True,
    ranges: ArrayLike | None = None,
    unknown: Iterable[str] | str | None = None,
    settings: GeneticSettings | None = None,
    steps_per_sample: int = 4,
    sweeps: int = 3,
    threads: int | None = None,
    held_out: Record | Sequence[Record] | None = None,
    zeros: bool = False,
    elasticity: bool = False,
    tolerances: Tolerances | None = None,
    prior: Any = None,
    hypotheses: Sequence[Hypothesis[Any]] = (),
    checkpoint: str | Path | Checkpoint | None = None,
) -> Identification:
    """Find the parameters with which the model repeats the tracking errors of the robot.

    ``method="paper"`` takes steps 1-6 of section 3.2 of the paper: the robot has followed a
    trajectory under P control (1) and its errors are in the record (2); a population is drawn from
    the ranges (3), evaluated by objective (4), and evolved (5); the best individual of all
    generations is the result (6). The default method places the ranges around a fit of the torque
    equation to the counts, and starts a prediction-error fit from the best individual.

    Parameters
    ----------
    dynamics : Dynamics
        The equations of motion, in which the parameters f of the arm are unknown.
    records : Record or sequence of Record
        From `plant.simulate` or one of `Record`'s readers. Of a log under a law without memory only
        pulses are read. A sampled law with memory is replaced by the logged torques or currents if
        all its numbers are known; where none are logged, its torques are computed along reference
        and counts. `LoggedTorque` and `LoggedCurrent` repeat what their log holds. Values are
        fitted to all samples; but of a record of more than 50,000 samples, the genetic algorithm
        and the tests of the rig take only 20 parts of 2,500 samples, spread over the record.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    method : {"seeded", "paper", "equation_error", "output_error", "prediction_error"}
        - "seeded": "equation_error", the genetic algorithm in a box around it (by default not with
          more than 30 unknowns), then "prediction_error"
        - "paper": the genetic algorithm of 3.7, as printed if no `settings` are given, on objective
          (4), in ranges
        - "equation_error": least squares on the torque equation in a pass band
        - "output_error": simulated against counted positions, by Gauss-Newton
        - "prediction_error": predicted against counted positions, by Gauss-Newton
    progress : bool
        Show a progress bar, where standard error is a terminal; and print there what is plainly
        wrong with a record before the search begins.
    ranges : (k, 2) array_like, optional
        Where to search each unknown; "paper" takes ``dynamics.ranges`` by default, the others need
        none.
    unknown : str or sequence of str, optional
        Names of the unknowns: all of f by default; numbers of rig or law may be added
        (``drive.viscous[0]``). Words stand for several: "f", "friction", "gains" (of the law).
        Where no name is one of f, all of f is unknown beside them, as on the command line.
    settings : GeneticSettings, optional
        By default `GeneticSettings.paper()`.
    steps_per_sample : int
        Number of sub-steps of the model between two samples, at first. The default method adds
        sub-steps until a further increase changes its innovations (errors of its predictions) by no
        more than a small part of the rounding error.
    sweeps : int
        Number of sweeps of the model's friction law in each sub-step.
    threads : int, optional
        By default one per core.
    held_out : Record or sequence of Record, optional
        Records that are not fitted: the result is only tested on them. By default this is the last
        of several records; with ``method="paper"`` there is none. Give () to fit all records.
    zeros : bool
        For logs that replay their torque: the counters were set to zero where the arm happened to
        hang. The joint positions at that moment are then further unknowns of each record
        (``found.fit.zeros``). Held-out records are taken as they are.
    elasticity : bool
        Find stiffness and damping of all gears too, whatever the rigs state:
        ``found.fit.resonance``.
    tolerances : Tolerances, optional
        How far the values stated in the rigs may be from the truth. The intervals of the result
        include this uncertainty. ``Tolerances.none()`` takes the rigs as exact.
    prior : float, (bodies, float), (f, float) or Prior, optional
        Knowledge of f before the log, for the part of f that the log does not excite: the relative
        standard deviation of the chain's own bodies, as 0.3; or ``(bodies, 0.3)`` of other bodies,
        one `Body` per link; or ``(f, 0.3)``. The result lists the combinations of f that come from
        it (``found.fit.prior``). The default is the chain's own bodies, to 0.3, and is used only
        where a joint hardly moves, where no arm follows from the log alone, or where the search
        falls back to a rougher method; a warning says so.
    hypotheses : sequence of Hypothesis
        Mistakes of your own in the first record, as ``record.check(hypotheses=...)`` takes them;
        here the equation of motion of the arm judges them too. Those that explain the log better
        are among ``found.causes``; one that changes nothing, or cannot be undone in this log, is
        named in ``found.failed`` and left out.
    checkpoint : str or Path, optional
        File in which finished stages are stored. If the process is killed, a new call with this
        file continues the work, and gives the same bits. A file that belongs to other inputs, other
        versions or another processor is refused.

    Returns
    -------
    Identification
        Where the only record has a mistake that can be corrected, the corrected record is
        identified as well, by "prediction_error" without ranges, and not where hypotheses of your
        own explain the log. What it shows is in ``found.beside`` and among the warnings.

    Raises
    ------
    ValueError
        Bad input, or no candidate that can be simulated.

    Warns
    -----
    IdentificationWarning
        The result is unreliable: its ``.warnings``.

    See Also
    --------
    identification.Identification, identification.Tolerances, identification.fit_torque,
    identification.spread

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> found = identify(puma560.dynamics(), record, seed=1, progress=False)
    >>> error = abs(found.arm.f - puma560.arm().f)
    >>> print((error < 4 * found.fit.std).all())
    True

    Source: paper 3.2, 3.7.
    """
    started = time.perf_counter()
    hypotheses = require_rows(hypotheses)
    # Options of the model, which every method passes on to it.
    options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "threads": threads}
    # Elastic gears change the records and the unknowns, so they come before all checks.
    if instance("elasticity", elasticity, bool, "Give True or False."):
        records, held_out, unknown = with_gears(
            dynamics, records, held_out, unknown, method, ranges
        )
    tolerances = instance(
        "tolerances",
        Tolerances() if tolerances is None else tolerances,
        Tolerances,
        "Give Tolerances(gear=0.01).",
    )
    problem_of = functools.partial(
        prepare,
        dynamics,
        unknown=unknown,
        seed=seed,
        zeros=zeros,
        options=options,
        tolerances=tolerances,
        prior=prior,
    )
    with progress_bar(sum(_SHARES.values()), "identify", "share", progress) as bar:
        second_look = _SecondLook(dynamics, records, problem_of)
        with _part(bar, "the logs"), second_look.at_refusal(RecordError):
            problem = problem_of(
                records, held_out=held_out, method=method, ranges=ranges, settings=settings
            )
        # The stored stages are bound to the inputs: a change of any refuses the file.
        with (
            Checkpoint(checkpoint, "identify").bind(lambda: problem.inputs) as stored,
            second_look.at_refusal(ValueError),
        ):
            problem = replace(problem, checkpoint=stored)
            # What is wrong is better known before a search of minutes than after it.
            if progress and (cause := _likely_cause(problem, plain=True)):
                bar.print(f"identify: {cause}")
            result = _with_hypotheses(problem, hypotheses, bar, started)
        # The warnings come once, at the end, because `_identified` can run again with a prior.
        with _part(bar, "warnings"):
            result = second_look.beside(result)
            warn_of_doubts(result, "identify")
    return result


@dataclass(frozen=True, eq=False)
class _SecondLook:
    """What the only log of an identification shows once its mistakes are corrected.

    `problem_of` makes the problem of a record.
    """

    dynamics: Dynamics
    records: Record | Sequence[Record]
    problem_of: Callable[..., Problem]

    @functools.cached_property
    def mistakes(self) -> Mistakes | None:
        """The mistakes of the log; None where it cannot be examined, or is one of several."""
        # Several records have several mistakes, which a user corrects one after the other.
        records = [self.records] if isinstance(self.records, Record) else self.records
        if not isinstance(records, Sequence) or len(records) != 1:
            return None
        (record,) = records
        with contextlib.suppress(ValueError):
            return mistakes_of(self.dynamics, record)
        return None

    @functools.cached_property
    def result(self) -> Identification | None:
        """The corrected log, identified; None where nothing is corrected, or it is refused too."""
        if self.mistakes is None or not self.mistakes.lines:
            return None
        with contextlib.suppress(ValueError), warnings.catch_warnings():
            # Its doubts are listed beside those of the log as it is.
            warnings.simplefilter("ignore")
            problem = self.problem_of(
                self.mistakes.corrected, held_out=None, method=_QUICKEST, ranges=None, settings=None
            )
            with progress_bar(sum(_SHARES.values()), "identify", "share", False) as bar:
                return _identified(problem, bar, time.perf_counter())
        return None

    @contextlib.contextmanager
    def at_refusal(self, kind: type[ValueError]) -> Iterator[None]:
        """A context whose refusals of a kind also say what is wrong with the log."""
        try:
            yield
        except kind as error:
            lines = self.mistakes.lines if self.mistakes is not None else ()
            further = [line for line in lines if line not in str(error)]
            text = " ".join([str(error), *["The log shows:"][: len(further)], *further])
            if self.result is not None and self.result.doubts:
                text = " ".join([text, "With that corrected:", *self.result.doubts])
            if text == str(error):
                raise
            if isinstance(error, RecordError):
                raise RecordError(text, error.record, "") from error
            raise ValueError(text) from error

    def beside(self, result: Identification) -> Identification:
        """A result with what the corrected log shows, where mistakes are named."""
        # A user's own rows are not among those that are corrected.
        if not result.mistakes or result.own_causes or self.result is None:
            return result
        return replace(result, beside=self.result.causes, left=tuple(self.result.doubts))


# Method of a second look at a log.
_QUICKEST = "prediction_error"

# Shares of the time, of an arm with six joints (``tests/benchmarks/waiting.py --profile``).
_SHARES = {"the logs": 0.1, "search": 0.45, "tests of the rig": 0.35, "warnings": 0.1}


def _part(bar: ProgressBar, name: str) -> contextlib.AbstractContextManager[None]:
    return bar.part(_SHARES[name], name)


def _with_hypotheses(
    problem: Problem, hypotheses: Sequence[Hypothesis[Any]], bar: ProgressBar, started: float
) -> Identification:
    """Identify, and rank a user's own hypotheses; a refusal begins with the likeliest of them."""
    if not hypotheses:
        return _identified(problem, bar, started)
    causes, failed = ranked_own_rows(problem.dynamics, problem.records[0], hypotheses)
    try:
        result = _identified(problem, bar, started)
    except ValueError as error:
        if not causes:
            raise
        raise ValueError(f"{causes[0].line} Correct that first; as it is, {error}") from error
    return replace(result, own_causes=causes, failed=failed)


def _identified(problem: Problem, bar: ProgressBar, started: float) -> Identification:
    """Identify. If that fails, or takes a rougher method, try the model's bodies as a prior."""
    try:
        with _part(bar, "search"):
            outcome = problem.checkpoint.stage("search", lambda: search(problem))
        with _part(bar, "tests of the rig"):
            result = _assess(problem, outcome, started)
    except ValueError as error:
        # A prior helps with f only: an error that names a number of rig or law stays.
        names = problem.dynamics.names
        if getattr(error, "name", names[0]) in names:
            # Where no arm follows from the log alone, one may follow with a prior.
            reason = "no arm follows from the log alone"
            if with_prior := _beside_model(problem, bar, started, reason):
                return with_prior
        # A wrong statement can cause any error, so it is named first.
        if cause := _likely_cause(problem):
            raise ValueError(f"{cause} Correct that first; as it is, {error}") from error
        raise
    # If the search fell back to a rougher method, the model's own bodies as a prior may do better.
    if result.fit.fallback_reason is None:
        return result
    reason = f"the log alone gives a rougher fit: {result.fit.fallback_reason}"
    return _beside_model(problem, bar, started, reason) or result


def _beside_model(
    problem: Problem, bar: ProgressBar, started: float, reason: str
) -> Identification | None:
    """Identify with the model's own bodies as a prior; None where that cannot help.

    `reason` is why the log alone does not suffice, for the warning.
    """
    dynamics = problem.dynamics
    records = problem.records
    if problem.prior is not None:
        return None
    # The bodies of a model file are known roughly; a chain may have none.
    prior = Prior.of_model(dynamics, records[0].rig)
    if prior is None or not from_prior(dynamics, records, prior):
        return None
    # Its stages are kept apart from those without the prior.
    part = problem.checkpoint.part("prior")
    with contextlib.suppress(ValueError):
        problem = replace(problem, prior=prior, checkpoint=part)
        result = _identified(problem, bar, started)
        # A result with doubts would hide the reason why the log alone does not suffice.
        if not doubts(result):
            text = advice(dynamics, records, prior)
            warn(f"identify: {reason}. {text}")
            return result
    return None


def search(problem: Problem) -> Outcome:
    """Run the method of a problem; half of its progress is for generations, half for a fit."""
    total = 2 * problem.settings.generations
    with progress_bar(total, "search", "generation", False) as bar:
        # The method calls it after every generation.
        def show(best: float) -> None:
            bar.set_postfix_str(f"best {best:.0f} pulses^2")
            bar.update()

        return METHODS[problem.method](replace(problem, show=show))


def _assess(problem: Problem, outcome: Outcome, started: float) -> Identification:
    """The result: the arm, and how well it repeats the records."""
    # The tests take as many sub-steps as the fit needed.
    problem = problem.in_steps(outcome.steps)
    # 1. Objective (4) of the values.
    # Methods do not store the prior; the result reports which combinations come from it.
    fit = replace(outcome.fit, prior=problem.prior)
    objective = repeating(problem, placed(problem, fit), fit.resumptions)
    # Infinite if a simulation diverges.
    cost = float(objective(fit.values[None])[0])
    if outcome.genetic is not None and not np.isfinite(cost):
        raise ValueError(
            f"some candidate must reproduce the experiment; all {outcome.evaluations} diverged or"
            " had no sound inertia. Widen or correct the ranges, and check gains, gears and signs"
            " of rig and law, and axes, lengths and gravity of the chain."
        )

    # 2. Diagnostics, which can replace the fit by the mean of several, and widen its covariance.
    diagnostics = problem.checkpoint.stage(
        "diagnostics", lambda: Diagnostics.of(problem, fit, objective, cost, outcome)
    )
    fit = diagnostics.detection.widened(fit)
    arm, rig, law = problem.parts(fit.values)
    # Backlash yields like a soft gear, so the stiffness is then reported as a bound.
    if fit.resonance is not None and diagnostics.detection.played:
        resonance = fit.resonance.beside_backlash(diagnostics.detection.played)
        fit = replace(fit, resonance=resonance)
    return Identification(
        arm=arm,
        rig=rig,
        law=law,
        # With the zeros of the fit in place.
        records=placed(problem, fit).records,
        held_out=() if problem.held_out is None else problem.held_out.records,
        versions=versions(),
        fit=fit,
        search=Search.of(problem, outcome, diagnostics.objective, time.perf_counter() - started),
        diagnostics=diagnostics,
    )


def _likely_cause(problem: Problem, *, plain: bool = False) -> str:
    """The first contradiction between the records and what is stated, as a sentence; or none.

    `plain`: of records that contradict the torque of their law, or the equation of motion.
    """
    dynamics = problem.dynamics
    for k, record in enumerate(problem.records):
        # A test of the statements refuses a log that is too short.
        with contextlib.suppress(ValueError):
            # A checkup takes seconds, and accuses no log that nothing else doubts. The equation of
            # motion of the first record is examined in any case.
            if plain and not (
                law_differs(torque_apart(record)) or (k == 0 and restated(dynamics, record))
            ):
                continue
            statements = of_statements(record.rig, problem.records, dynamics.chain)
            for line in itertools.chain(wrong_statements(dynamics, record), statements):
                label = record_label(problem.records, k)
                return f"{label}: {line}" if label else line
    return ""
