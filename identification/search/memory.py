"""Fits of logs whose law has a memory: it started with the log, or earlier, in an unknown state.

Both hypotheses are fitted. Under the second one, the part of the state that shows in the torque is
unknown beside f, and so are position and speed of the arm at the first sample. If the second fit
explains the log no better than by chance, the law started with the log, unless the motion shows
that it had been at work.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from identification.equation_error import (
    Memory,
    Resumption,
    along_log,
    begun,
    each_named,
    passes_start,
    told_by_torque,
    with_state,
)
from identification.replay import Objective, gauss_newton, variance_inflation, with_zeros
from identification.replay.weak_directions import SETTINGS as WEAK
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem
from plant import Arm, Law, Record, Resumed, Rig, replay
from plant.laws import AlongLog
from plant.machine import InnerLoop
from plant.parts import Floats
from plant.simulation import in_motion, is_start_open

# Steps of the differences, in standard deviations of the unknowns: small against the width of the
# likelihood.
_STEP = 0.05


def with_memory(problem: Problem, fitted: Callable[[Problem], Outcome]) -> Outcome:
    """Outcome of a method for laws that started with their logs or before: the better of both."""
    # The records of the objective are those of the user, where a state may be stated.
    unstated = [
        isinstance(record.law, Resumed) and not isinstance(original.law, Resumed) and not memory
        for record, original, memory in zip(
            problem.records, problem.objective.records, problem.each_memory, strict=True
        )
    ]
    if not any(unstated):
        return fitted(problem)

    # 1. The laws started with their logs.
    began = _or_none(fitted, problem)

    # 2. They had been running: their states are unknown.
    records = list(problem.records)
    memories = problem.each_memory
    for k, (record, about) in enumerate(each_named(problem.records)):
        with about:
            if unstated[k]:
                records[k], memories[k] = with_state(problem.dynamics, record, problem.unknown)
    # Filters of fast hardware fade within a sample or two, whatever was in them.
    laws: list[Any] = [record.law for record in problem.records]
    fast = all(law.period is None for law in laws)
    if began is not None and fast and not any(memory and memory.usual.size for memory in memories):
        return began
    problem_resumed = replace(
        problem,
        records=tuple(records),
        memories=tuple(memories),
        checkpoint=problem.checkpoint.part("resumed"),
    )
    if began is None:
        # There is no alternative any more: its error is that of the log.
        return fitted(problem_resumed)
    resumed = _or_none(fitted, problem_resumed)
    if resumed is None:
        return began
    if began.fit.covariance is None or resumed.fit.gains is None:
        return resumed

    # 3. The likelier hypothesis stays until the log refutes it. For the comparison the arm's
    # position and speed at the first sample are unknown in both, within a count.
    stated = tuple(
        None if memory is None else Memory.known(_state_of(law))
        for law, memory in zip(laws, memories, strict=True)
    )
    began_near = replace(problem, memories=stated)
    # A controller that had been moving the arm was at work; else the simpler hypothesis is the
    # likelier one.
    running = any(map(in_motion, problem.objective.records))
    # The readings may not determine the state, or may determine the values much less once the
    # state is unknown. Then neither hypothesis is simpler: the state is assumed to lie where a
    # running law keeps it, if `passes_start` holds for any record.
    untold = bool(resumed.fit.undetermined)
    untold |= bool((WEAK.determined * resumed.fit.std > began.fit.std).any())
    running |= untold and any(
        memory is not None and passes_start(record, memory)
        for record, memory in zip(problem.records, memories, strict=True)
    )
    refuted = _refuted(began_near, began.fit, resumed.fit, memories, running=running)
    return resumed if refuted else began


def _state_of(law: Any) -> Floats:
    """State (s,) with which a law resumes; empty of one that begins with its log."""
    return law.state if isinstance(law, Resumed) else np.empty(0)


def with_starts(problem: Problem) -> Problem:
    """The problem with position and speed at the first sample unknown where a log was cut.

    The counts show both only roughly, and a soft loop remembers its start for a second.
    """
    memories = problem.each_memory
    for k, (record, logged) in enumerate(
        zip(problem.records, problem.objective.records, strict=True)
    ):
        law: Any = record.law
        # The start is not made unknown in two cases. Of a repeated torque or current, and of a
        # servo, the first samples are left out instead. Of a replayed law, a state that the user
        # states comes with the instant at which the controller read the arm.
        start_is_known = law.replays in ("torque", "current") or isinstance(law, InnerLoop)
        start_is_known |= bool(law.replays) and isinstance(logged.law, Resumed)
        if memories[k] is None and is_start_open(logged) and not start_is_known:
            memories[k] = Memory.known(_state_of(law))
    return problem if not any(memories) else replace(problem, memories=tuple(memories))


def _refuted(fresh, began, resumed, memories, *, running):
    """Whether the logs refute that their laws started with them.

    `running`: whether the laws are presumed to have been at work before. The weight of a vertical
    slide and the integral of its controller can fit a log under either hypothesis. A law that is
    presumed to have been at work therefore keeps its unknown state, unless the fit with that state
    is much worse because its search ended much too early.

    After a first check, both hypotheses are compared at the same observer gains. Gains that are
    searched may differ for a reason other than the state of the law.

    Source: G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    """
    # The fit with unknown states has fewer readings and more unknowns. It should be no worse,
    # unless its search ended too early.
    if not running and began.rms_innovation <= resumed.rms_innovation:
        return False
    try:
        simple = _at_gains(fresh, began, resumed.gains)
    except ValueError:  # with these gains it does not follow the log
        return True
    freedom = sum(memory.usual.size for memory in memories if memory is not None)
    # The rows in which the state of the law acts at once are left out of both.
    readings = np.count_nonzero(simple.residual)
    unit = resumed.rms_innovation**2 * variance_inflation(simple.residual)
    gain = readings * (simple.rms_innovation**2 - resumed.rms_innovation**2)
    evidence = unit * freedom * np.log(readings)
    return gain > (-evidence if running else evidence)


def _at_gains(problem, fit, gains):
    """The solution of a problem near a fit, with these observer gains (2n,)."""
    prediction = problem.prediction(zeros=problem.zeros, memories=problem.memories)
    k = len(fit.values)
    place = slice(k, k + len(gains))
    start = np.append(fit.values, prediction.nuisances)
    start[place] = gains
    steps = np.append(_STEP * fit.std, prediction.nuisance_steps)
    # A step of zero keeps the gains.
    steps[place] = 0
    bounds = np.vstack([problem.bounds, prediction.nuisance_bounds])
    return gauss_newton(prediction, start, steps, bounds)


def _or_none(fitted, problem):
    """The outcome, or None where the fit fails."""
    try:
        return fitted(problem)
    except ValueError:  # from this start no arm follows the log
        return None


def as_repeated(
    records: Sequence[Record], resumptions: Sequence[Resumption | None]
) -> tuple[Record, ...]:
    """Records to simulate again: their laws resume from the fitted states, or those of the log."""
    if not resumptions:
        return tuple(map(begun, records))
    fitted = resumed_at(records, resumptions)
    return tuple(
        begun(record) if resumption is None else record
        for record, resumption in zip(fitted, resumptions, strict=True)
    )


def run_again(record: Record, arm: Arm, rig: Rig, law: Law) -> Record:
    """A record simulated with another arm, rig and law; the law resumes from the record's state."""
    # The fitted controller replaces the inner law; its state stays.
    resumed = replace(record.law, law=law) if isinstance(record.law, Resumed) else law
    return replay(arm, record, rig=rig, law=resumed)


def repeating(
    problem: Problem, objective: Objective, resumptions: Sequence[Resumption | None] = ()
) -> Objective:
    """The objective of the same records `as_repeated`."""
    records = as_repeated(objective.records, resumptions)
    # An objective has compiled kernels and tables: do not make the same one again.
    if all(record is old for record, old in zip(records, objective.records, strict=True)):
        return objective
    return Objective(problem.dynamics, records, objective.unknown, **problem.options)


def placed(problem: Problem, fit: Fit) -> Objective:
    """The objective of the fitted records, their counters moved by the zeros of a fit."""
    if fit.zeros is None:
        return problem.objective
    # Zeros shift the measured positions, so the objective needs other records.
    moved = with_zeros(problem.objective.records, fit.zeros)
    return Objective(problem.dynamics, moved, fit.unknown, **problem.options)


def as_tested(problem: Problem, fit: Fit) -> tuple[list[Record], list[int]]:
    """Records for the tests of the rig, and the numbers of the unknowns that act on them."""
    if fit.zeros is not None:
        # The zeros of the validation records are unknown.
        followed = list(with_zeros(problem.records, fit.zeros))
    else:
        followed = list(problem.records)
        if fit.resumptions:
            followed = list(resumed_at(followed, fit.resumptions, reading=True))
        if problem.held_out is not None:
            followed += problem.held_out.records
    records = [(told_by_torque(record) or (along_log(record),))[0] for record in followed]
    replaced = any(record is not old for record, old in zip(records, followed, strict=True))
    # A law that reads its log does not depend on the numbers of the controller.
    acting = [
        i for i, name in enumerate(problem.unknown) if not (replaced and name.startswith("law."))
    ]
    return records, acting


def resumed_at(
    records: Sequence[Record], resumptions: Sequence[Resumption | None], *, reading: bool = False
) -> tuple[Record, ...]:
    """Records that resume from the fitted states of law and arm; if `reading`, along their logs."""
    resumed = []
    for record, resumption in zip(records, resumptions, strict=True):
        if resumption is not None:
            state = resumption.state
            law: Any = record.law
            if isinstance(law, Resumed):
                law = replace(law, state=state)
            # The controller itself resumes from the fitted state, unless `reading` and its law
            # follows the log. Without a memory only the motion of the arm is resumed.
            if state.size and (not isinstance(law, AlongLog) or not reading):
                law = Resumed(law=law.law if isinstance(law, Resumed) else law, state=state)
            record = replace(record, law=law, initial=resumption.initial)
        resumed.append(record)
    return tuple(resumed)
