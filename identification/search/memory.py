"""Fits of logs whose law had a memory: it began with the log, or it had been at work before, in an
unknown state.

Both are fitted. In an unknown state, what of it shows in the torque is unknown beside f, and so is
where and how fast the arm began. Where that explains the log no better than by chance, the law
began with the log.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from identification.equation_error.law_memory import Memory, Resumption, along_log, with_state
from identification.equation_error.naming import each_named
from identification.equation_error.stated_law import begun
from identification.replay.experiment import with_zeros
from identification.replay.objective import Objective
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem
from plant import Arm, Law, Record, Resumed, Rig, replay
from plant.laws.resumed import AlongLog

# standard deviations by which a sum of squares may fall by chance, where more is unknown
_BY_CHANCE = 5.0


def with_memory(problem: Problem, fitted: Callable[[Problem], Outcome]) -> Outcome:
    """What a method finds, of laws that began with their logs or before."""
    open_ones = [
        isinstance(followed.law, Resumed) and not isinstance(given.law, Resumed)
        for followed, given in zip(problem.records, problem.objective.records, strict=True)
    ]
    if not any(open_ones):
        return fitted(problem)
    began = _or_none(fitted, problem)
    records = list(problem.records)
    memories = list[Memory | None]([None] * len(problem.records))
    for k, (record, about) in enumerate(each_named(problem.records)):
        with about:
            if open_ones[k]:
                records[k], memories[k] = with_state(problem.dynamics, record, problem.unknown)
    own = problem.checkpoint.part("resumed")
    resumed = dataclasses.replace(
        problem, records=tuple(records), memories=tuple(memories), checkpoint=own
    )
    if began is None:
        return fitted(resumed)
    other = _or_none(fitted, resumed)
    if other is None:
        return began
    if began.fit.rms_innovation is None or other.fit.rms_innovation is None:
        return other
    more = sum(
        0 if memory is None else memory.usual.size + 2 * problem.dynamics.n for memory in memories
    )
    readings = sum(record.error_pulses.size for record in problem.records)
    gained = readings * (began.fit.rms_innovation**2 / other.fit.rms_innovation**2 - 1)
    return other if gained > more + _BY_CHANCE * np.sqrt(2 * more) else began


def _or_none(fitted: Callable[[Problem], Outcome], problem: Problem) -> Outcome | None:
    try:
        return fitted(problem)
    except ValueError:  # from this start no arm follows the log
        return None


def as_repeated(
    records: Sequence[Record], places: Sequence[Resumption | None]
) -> tuple[Record, ...]:
    """Records to be simulated once more: their laws go on where they were, as was found, or as
    logged torques say.
    """
    return resumed_at(records, places) if places else tuple(map(begun, records))


def run_again(record: Record, arm: Arm, rig: Rig, law: Law) -> Record:
    """Such a record, simulated with what was found, its law with the memory that it has there."""
    resumed = dataclasses.replace(record.law, law=law) if isinstance(record.law, Resumed) else law
    return replay(arm, record, rig=rig, law=resumed)


def repeating(
    problem: Problem, objective: Objective, places: Sequence[Resumption | None] = ()
) -> Objective:
    """The objective of the same records `as_repeated`."""
    records = as_repeated(objective.records, places)
    if all(one is other for one, other in zip(records, objective.records, strict=True)):
        return objective
    return Objective(problem.dynamics, records, objective.unknown, **problem.options)


def placed(problem: Problem, fit: Fit) -> Objective:
    """The objective of the records that are searched, with the zeros of a fit in place."""
    if fit.zeros is None:
        return problem.objective
    moved = with_zeros(problem.objective.records, fit.zeros)
    return Objective(problem.dynamics, moved, fit.unknown, **problem.options)


def as_tested(problem: Problem, fit: Fit) -> tuple[list[Record], list[int]]:
    """The records that are followed, and which of the unknowns act on them."""
    if fit.zeros is not None:
        given = with_zeros(problem.records, fit.zeros)
    else:
        searched = problem.records
        if fit.resumptions:
            searched = resumed_at(searched, fit.resumptions, reading=True)
        given = [*searched, *(() if problem.held_out is None else problem.held_out.records)]
    records = [along_log(record) for record in given]
    replaced = any(record is not before for record, before in zip(records, given, strict=True))
    return records, [
        i for i, name in enumerate(problem.unknown) if not (replaced and name.startswith("law."))
    ]


def resumed_at(
    records: Sequence[Record], places: Sequence[Resumption | None], *, reading: bool = False
) -> tuple[Record, ...]:
    """Records that go on where law and arm were, where that was found; reading their logs, or
    not.
    """
    found = []
    for record, place in zip(records, places, strict=True):
        if place is not None:
            law: Any = record.law
            if isinstance(law, Resumed):
                law = dataclasses.replace(law, state=place.state)
            if not isinstance(law, AlongLog) or not reading:
                law = Resumed(law=law.law if isinstance(law, Resumed) else law, state=place.state)
            record = dataclasses.replace(record, law=law, initial=place.initial)
        found.append(record)
    return tuple(found)
