"""From records to an arm: the identification procedure of the paper."""

import contextlib
import dataclasses
import functools
import itertools
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.excitation import advice, from_prior
from identification.equation_error.naming import misread
from identification.equation_error.prior import Prior
from identification.preparation import prepare, with_gears
from identification.results.diagnostics import Diagnostics
from identification.results.identification import Identification
from identification.results.restated import restated
from identification.results.summary import doubts, warn_of_doubts
from identification.results.trust import of_statements
from identification.search.genetic import GeneticSettings
from identification.search.memory import placed, repeating
from identification.search.methods import METHODS
from identification.search.outcome import Outcome, Search
from identification.search.problem import Problem, Tolerances
from plant import Dynamics, Record
from plant.parts.arguments import instance, known_options
from plant.parts.checkpoint import Checkpoint
from plant.parts.messages import progress_bar, warn
from plant.parts.saved import versions


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
    checkpoint: str | Path | Checkpoint | None = None,
) -> Identification:
    """Find the parameters with which the model repeats the tracking errors of the robot.

    Steps 1-6 of 3.2: the robot has followed a trajectory under P control (1) and its errors are in
    the record (2); a population is drawn from the ranges (3), evaluated by objective (4), and
    evolved (5); the best ever seen is the result (6). That is ``method="paper"``. By default the
    ranges are drawn around a fit of the torque equation to the counts, and the best is the start of
    a prediction-error fit.

    Parameters
    ----------
    dynamics : Dynamics
        The equations with f open.
    records : Record or sequence of Record
        From `plant.simulate` or one of `Record`'s readers. Of a log under a law without memory only
        pulses are read; of other laws the logged torques or currents, or, where there are none,
        what the law gives from reference and counts. `LoggedTorque` and `LoggedCurrent` repeat
        theirs. Values are fitted to all samples; of a record of more than 50,000 the genetic
        algorithm and the tests of the rig take 20 parts of 2,500, spread over it.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    method : {"seeded", "paper", "equation_error", "output_error", "prediction_error"}
        - "seeded": "equation_error", the genetic algorithm in a box around it (by default not with
          more than 30 unknowns), then "prediction_error"
        - "paper": the genetic algorithm of 3.7, as printed if no `settings` are given, on objective
          (4), in ranges
        - "equation_error": least squares on the torque equation in a pass band
        - "output_error": simulated against counted positions, by Gauss-Newton
        - "prediction_error": predicted against counted positions, by Gauss-Newton progress : bool
    Show a progress bar, where standard error is a terminal. ranges : (k, 2) array_like, optional
    Where to search each unknown; "paper" takes ``dynamics.ranges`` by default, the others need
    none. unknown : sequence of str or {"friction", "gains"}, optional Names of what to find: all of
    f by default; numbers of rig or law may be added (``drive.viscous[0]``). Words stand for many:
    "f", "friction", "gains" (of the law); one of the last two alone is beside f. settings :
    GeneticSettings, optional By default `GeneticSettings.paper()`. steps_per_sample : int Sub-steps
    of the model between two samples. sweeps : int Of its friction law in each. threads : int,
    optional By default one per core. held_out : Record or sequence of Record, optional Records that
    are not searched, only repeated with what was found; by default the last of several, except by
    the paper's method. Give () to search them all. zeros : bool In logs that replay their torque:
    the counters were set to zero where the arm happened to hang, so where the joints are then is
    found as well, for each record (``found.fit.zeros``). Held-out records are taken as they are.
    elasticity : bool Find stiffness and damping of all gears too, whatever the rigs say of them:
    ``found.fit.resonance``. tolerances : Tolerances, optional Within which the rigs are right;
    intervals count them. ``Tolerances.none()`` takes rigs for exact. prior : float, or tuple of
    bodies or f and a float, optional What is known of f before the log, for what the log does not
    excite: the relative standard deviation of the chain's own bodies, as 0.3; or ``(bodies, 0.3)``
    of others, one `Body` per link; or ``(f, 0.3)``. The result says which combinations of f come
    from it (``found.fit.prior``). By default the chain's own bodies, to 0.3, and only where a joint
    hardly moves, or no arm follows from the log alone; that is a warning. checkpoint : str or Path,
    optional File in which finished stages are kept: killed and called again with it, the work goes
    on, to the same bits. One of other inputs, versions or another processor is refused.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        Bad input, or no candidate that can be simulated.

    Warns
    -----
    IdentificationWarning
        What was found is unreliable: its ``.warnings``.

    See Also
    --------
    identification.Identification, identification.Tolerances, identification.fit_torque, identification.spread

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
    options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "threads": threads}
    if instance("elasticity", elasticity, bool, "Give True or False."):
        records, held_out, unknown = with_gears(
            dynamics, records, held_out, unknown, method, ranges
        )
    tolerances = instance(
        "tolerances", tolerances or Tolerances(), Tolerances, "Give Tolerances(gear=0.01)."
    )
    problem = prepare(
        dynamics,
        records,
        unknown,
        held_out,
        method,
        ranges,
        settings,
        seed,
        zeros,
        options,
        tolerances,
        prior,
    )
    with Checkpoint(checkpoint, "identify").bind(lambda: problem.inputs) as kept:
        found = _found(dataclasses.replace(problem, checkpoint=kept), progress, started)
    warn_of_doubts(found, "identify")
    return found


def _found(problem: Problem, progress: bool, started: float) -> Identification:
    """What the log tells; where that is no arm, what it tells beside the model's own bodies."""
    outcome = functools.partial(search, problem, progress)
    try:
        found = _assess(problem, problem.checkpoint.stage("search", outcome), started)
    except ValueError as error:
        other = _beside_model(problem, progress, started)
        if (
            other is None
            or getattr(error, "name", problem.dynamics.names[0]) not in problem.dynamics.names
        ):
            if wrong := next(filter(None, map(misread, problem.records)), ""):
                raise ValueError(f"{wrong[1:]} Correct that first; as it is, {error}") from error
            raise
        return other
    other = None if found.fit.fallback_reason is None else _beside_model(problem, progress, started)
    return found if other is None else other


def _beside_model(problem: Problem, progress: bool, started: float) -> Identification | None:
    """What the log tells beside the model's own bodies, if these are known and that leaves no
    doubt.
    """
    dynamics = problem.dynamics
    records = problem.records
    known = problem.prior
    own = Prior.of_model(dynamics, records[0].rig) if known is None else None
    if own is not None and from_prior(dynamics, records, own):
        part = problem.checkpoint.part("prior")
        with contextlib.suppress(ValueError):
            found = _found(
                dataclasses.replace(problem, prior=own, checkpoint=part), progress, started
            )
            if not doubts(found):
                warn(
                    f"identify: no arm follows from the log alone. {advice(dynamics, records, own)}"
                )
                return found
    return None


def search(problem: Problem, progress: bool) -> Outcome:
    """What the method finds; a progress bar counts generations."""
    total = problem.settings.generations
    with progress_bar(total, "identify", "generation", progress) as bar:

        def show(best: float) -> None:
            bar.set_postfix_str(f"best {best:.0f} pulses^2")
            bar.update()

        return METHODS[problem.method](dataclasses.replace(problem, show=show))


def _assess(problem: Problem, outcome: Outcome, started: float) -> Identification:
    """The result: the arm, and how well it repeats the records."""
    fit = dataclasses.replace(outcome.fit, prior=problem.prior)
    genetic = outcome.genetic
    objective = repeating(problem, placed(problem, fit), fit.resumptions)
    cost = float(objective(fit.values[None])[0])
    if genetic is not None and not np.isfinite(cost):
        dynamics = problem.dynamics
        record = problem.records[0]
        signs = restated(dynamics, record)
        others = of_statements(record.rig, problem.records, dynamics.chain)
        told = "".join(
            f" The log says: {line}" for line in itertools.islice(itertools.chain(signs, others), 1)
        )
        raise ValueError(
            f"some candidate must reproduce the experiment; all {outcome.evaluations} diverged or"
            " had no sound inertia. Widen or correct the ranges, and check gains, gears and signs"
            f" of rig and law, and axes, lengths and gravity of the chain.{told}"
        )
    diagnostics = problem.checkpoint.stage(
        "diagnostics", lambda: Diagnostics.of(problem, fit, objective, cost, outcome)
    )
    fit = diagnostics.detection.whole(fit)
    arm, rig, law = problem.parts(fit.values)
    if fit.resonance is not None and diagnostics.detection.played:
        fit = dataclasses.replace(
            fit, resonance=fit.resonance.beside_backlash(diagnostics.detection.played)
        )
    return Identification(
        arm=arm,
        rig=rig,
        law=law,
        records=placed(problem, fit).records,
        held_out=() if problem.held_out is None else problem.held_out.records,
        versions=versions(),
        fit=fit,
        search=Search.of(problem, outcome, diagnostics.objective, time.perf_counter() - started),
        diagnostics=diagnostics,
    )
