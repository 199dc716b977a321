"""Fits of logs whose law had a memory: it began with the log, or it had been at work before, in an unknown state.

Both are fitted. In an unknown state, what of it shows in the torque is unknown beside f, and so is where and how fast
the arm began. Where that explains the log no better than by chance, the law began with the log. Whether a stated law
can have made a log at all, `torque_apart` says: its run along the log, from the best state, against the logged torque.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from identification.equation_error.law_memory import (
    FADED,
    Memory,
    Resumption,
    along_log,
    at_work,
    reading,
    state_directions,
    with_state,
)
from identification.equation_error.naming import each_named
from identification.equation_error.torque_logs import law_torque, logged_torque, torque_of
from identification.replay.experiment import with_zeros
from identification.replay.objective import Objective
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem
from plant import Arm, Law, Record, Resumed, Rig, replay
from plant.laws.resumed import AlongLog
from plant.parts.fields import Floats
from plant.simulation.followed_path import path_of, start_of
from plant.simulation.law_run import run_law

_BY_CHANCE = 5.0  # standard deviations by which a sum of squares may fall by chance, where more is unknown


def with_memory(problem: Problem, fitted: Callable[[Problem], Outcome]) -> Outcome:
    """What a method finds, of laws that began with their logs or before."""
    open_ones = [isinstance(followed.law, Resumed) and not isinstance(given.law, Resumed)
                 for followed, given in zip(problem.records, problem.objective.records, strict=True)]  # fmt: skip
    if not any(open_ones):
        return fitted(problem)
    began = _or_none(fitted, problem)
    records, memories = list(problem.records), list[Memory | None]([None] * len(problem.records))
    for k, (record, about) in enumerate(each_named(problem.records)):
        with about:
            if open_ones[k]:
                records[k], memories[k] = with_state(problem.dynamics, record, problem.unknown)
    own = problem.checkpoint.part("resumed")
    resumed = dataclasses.replace(problem, records=tuple(records), memories=tuple(memories), checkpoint=own)
    if began is None:
        return fitted(resumed)
    other = _or_none(fitted, resumed)
    if other is None:
        return began
    if began.fit.rms_innovation is None or other.fit.rms_innovation is None:
        return other
    more = sum(0 if memory is None else memory.usual.size + 2 * problem.dynamics.n for memory in memories)
    readings = sum(record.error_pulses.size for record in problem.records)
    gained = readings * (began.fit.rms_innovation**2 / other.fit.rms_innovation**2 - 1)
    return other if gained > more + _BY_CHANCE * np.sqrt(2 * more) else began


def _or_none(fitted: Callable[[Problem], Outcome], problem: Problem) -> Outcome | None:
    try:
        return fitted(problem)
    except ValueError:  # from this start no arm follows the log
        return None


def as_repeated(records: Sequence[Record], places: Sequence[Resumption | None]) -> tuple[Record, ...]:
    """Records to be simulated once more: their laws go on where they were, as was found, or as logged torques say."""
    return resumed_at(records, places) if places else tuple(map(begun, records))


def run_again(record: Record, arm: Arm, rig: Rig, law: Law) -> Record:
    """Such a record, simulated with what was found, its law with the memory that it has there."""
    resumed = dataclasses.replace(record.law, law=law) if isinstance(record.law, Resumed) else law
    return replay(arm, record, rig=rig, law=resumed)


def repeating(problem: Problem, objective: Objective, places: Sequence[Resumption | None] = ()) -> Objective:
    """The objective of the same records `as_repeated`."""
    records = as_repeated(objective.records, places)
    if all(one is other for one, other in zip(records, objective.records, strict=True)):
        return objective
    return Objective(problem.dynamics, records, objective.unknown, **problem.options)


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
    return records, [i for i, name in enumerate(problem.unknown) if not (replaced and name.startswith("law."))]


def resumed_at(
    records: Sequence[Record], places: Sequence[Resumption | None], *, reading: bool = False
) -> tuple[Record, ...]:
    """Records that go on where law and arm were, where that was found; reading their logs, or not."""
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


_BEGAN, _EQUAL = 1.1, 1e-3
"""Distance from the logged torque with a law that began with the log, relative to that of the best state, and in the
largest torque, up to which it did."""

_ROUNDS = 2  # fits of the state; a law that saturates is not linear in it


def torque_apart(record: Record) -> Floats | None:
    """How far the logged torque of each joint (n,) is from what the stated law gives, as a share of it (rms).

    None where that cannot be told: nothing logged, counts that were moved, no law or one that repeats the log, fast
    hardware with a memory, or a reference whose rounding hides the torque.
    """
    law = record.law
    if law is None or not _comparable(record):
        return None
    logged = logged_torque(record)
    if not law.has_memory(record.n) or (isinstance(law, Resumed) and law.period is not None):
        own = torque_of(record)
    else:
        found = _nearest(record, logged)
        if found is None:
            return None
        own = law_torque(found)
    rows = np.flatnonzero(record.valid > 0)
    rows = rows[rows >= FADED]
    off, size = (np.sqrt(np.mean(each[rows] ** 2, axis=0)) for each in (own - logged, logged))
    return np.asarray(off / np.maximum(size, 1e-9 * max(size.max(), 1e-300)))


def begun(record: Record) -> Record:
    """The record with its law and arm going on from where its logged torque says that they were.

    As it is where the torque does not tell: nothing logged, no memory, or a law that began with the log.
    """
    law = record.law
    if law is None or not _comparable(record) or not law.has_memory(record.n) or isinstance(law, Resumed):
        return record
    logged, rows = logged_torque(record), np.flatnonzero(record.valid > 0)
    found = _nearest(record, logged)
    if found is None:
        return record
    anew = reading(record, Resumed(law=law, state=law.initial_state(record.n)))
    off = [np.sqrt(np.mean((law_torque(each) - logged)[rows[rows >= FADED]] ** 2)) for each in (anew, found)]
    if off[0] <= _BEGAN * off[1] + _EQUAL * np.abs(logged).max():
        return record
    state: Any = found.law.state  # type: ignore[union-attr]  # AlongLog
    start = np.array(start_of(record, path_of(record)))
    return dataclasses.replace(record, law=Resumed(law=law, state=state), initial=start)


def _comparable(record: Record) -> bool:
    """Whether a torque was logged that a law may have given from the counts of the record.

    Counts that were moved (`without_delay`) are not those that the law read.
    """
    if record.law is None or record.law.replays or (record.torque is None and record.current is None):
        return False
    return record.rig.encoder.smooth or bool((record.counts == np.trunc(record.counts)).all())


def _nearest(record: Record, logged: Floats) -> Record | None:
    """The record with its law reading the log, from the state with which it is nearest to the logged torque (N, n).

    None where its reference does not tell its torque, and of fast hardware.
    """
    law: Any = record.law
    if law.period is None:
        return None
    try:
        followed, usual = at_work(record, Resumed(law=law, state=law.initial_state(record.n)))
    except ValueError:
        return None
    for _ in range(_ROUNDS):
        run = run_law(followed)
        memory, columns = state_directions(followed, run, usual)
        if not len(columns):
            break
        missing = (logged - law_torque(followed, run))[FADED:].ravel()
        own: Any = followed.law
        change = np.linalg.lstsq(columns[:, FADED:].reshape(len(columns), -1).T, missing, rcond=None)[0]
        state = memory.at(np.asarray(change, float))
        followed = dataclasses.replace(followed, law=dataclasses.replace(own, state=state))
    return followed
