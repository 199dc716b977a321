"""Whether a stated law can have made a log: its run along the log, from the best state, against
the logged torque.
"""

import dataclasses
from typing import Any

import numpy as np

from identification.equation_error.law_memory import FADED, at_work, reading, state_directions
from identification.equation_error.torque_logs import law_torque, logged_torque, torque_of
from plant import Record, Resumed
from plant.parts.fields import Floats
from plant.simulation.followed_path import path_of, start_of
from plant.simulation.law_run import run_law

# Distance from the logged torque with a law that began with the log, relative to that of the best
# state, and in the largest torque, up to which it did.
_BEGAN = 1.1
_EQUAL = 1e-3

_ROUNDS = 2  # fits of the state; a law that saturates is not linear in it


def torque_apart(record: Record) -> Floats | None:
    """How far the logged torque of each joint (n,) is from what the stated law gives, as a share of
    it (rms).

    None where that cannot be told: nothing logged, counts that were moved, no law or one that
    repeats the log, fast hardware with a memory, or a reference whose rounding hides the torque.
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
    lost = np.cumsum(record.valid == 0)
    # whose filters have seen no bridged count
    rows = FADED + np.flatnonzero(lost[FADED:] == lost[:-FADED])
    if not rows.size:
        return None
    off, size = (np.sqrt(np.mean(each[rows] ** 2, axis=0)) for each in (own - logged, logged))
    return np.asarray(off / np.maximum(size, 1e-9 * max(size.max(), 1e-300)))


def begun(record: Record) -> Record:
    """The record with its law and arm going on from where its logged torque says that they were.

    As it is where the torque does not tell: nothing logged, no memory, or a law that began with the
    log.
    """
    law = record.law
    if (
        law is None
        or not _comparable(record)
        or not law.has_memory(record.n)
        or isinstance(law, Resumed)
    ):
        return record
    logged = logged_torque(record)
    rows = np.flatnonzero(record.valid > 0)
    found = _nearest(record, logged)
    if found is None:
        return record
    anew = reading(record, Resumed(law=law, state=law.initial_state(record.n)))
    off = [
        np.sqrt(np.mean((law_torque(each) - logged)[rows[rows >= FADED]] ** 2))
        for each in (anew, found)
    ]
    if off[0] <= _BEGAN * off[1] + _EQUAL * np.abs(logged).max():
        return record
    state: Any = found.law.state  # type: ignore[union-attr]  # AlongLog
    start = np.array(start_of(record, path_of(record)))
    return dataclasses.replace(record, law=Resumed(law=law, state=state), initial=start)


def _comparable(record: Record) -> bool:
    """Whether a torque was logged that a law may have given from the counts of the record.

    Counts that were moved (`without_delay`) are not those that the law read.
    """
    if (
        record.law is None
        or record.law.replays
        or (record.torque is None and record.current is None)
    ):
        return False
    return record.rig.encoder.smooth or bool((record.counts == np.trunc(record.counts)).all())


def _nearest(record: Record, logged: Floats) -> Record | None:
    """The record with its law reading the log, from the state with which it is nearest to the
    logged torque (N, n).

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
        change = np.linalg.lstsq(
            columns[:, FADED:].reshape(len(columns), -1).T, missing, rcond=None
        )[0]
        state = memory.at(np.asarray(change, float))
        followed = dataclasses.replace(followed, law=dataclasses.replace(own, state=state))
    return followed
