"""Whether a stated law can have made a log: its run along the log, from the best state, against the logged torque."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.law_memory import FADED, at_work, state_directions
from identification.equation_error.motor_torque import driven, logged_torque
from plant import Record, Resumed
from plant.laws.commanded import commanded_torque
from plant.simulation.clock import Clock
from plant.simulation.law_run import run_law

__all__ = ["torque_apart"]

_ROUNDS = 2
"""Fits of the state; a law that saturates is not linear in it."""


def torque_apart(record: Record) -> NDArray[np.float64] | None:
    """How far the logged torque of each joint (n,) is from what the stated law gives, as a share of it (rms).

    None where that cannot be told: nothing logged, counts that were moved, no law or one that repeats the log, fast
    hardware with a memory, or a reference whose rounding hides the torque.
    """
    law, n = record.law, record.n
    if law is None or law.replays or (record.torque is None and record.current is None):
        return None
    if not (record.rig.encoder.smooth or (record.counts == np.trunc(record.counts)).all()):
        return None  # counts that were moved (`without_delay`) are not those that the law read
    logged = logged_torque(record)
    if not law.has_memory(n):
        commanded = commanded_torque(record)
        own = None if commanded is None else driven(record, record.rig.drive.limited(commanded))
    else:
        own = None if law.period is None else _along(record, logged)
    if own is None:
        return None
    rows = np.flatnonzero(record.valid > 0)
    rows = rows[rows >= FADED]
    off, size = (np.sqrt(np.mean(each[rows] ** 2, axis=0)) for each in (own - logged, logged))
    return np.asarray(off / np.maximum(size, 1e-9 * max(size.max(), 1e-300)))


def _along(record: Record, logged: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Torque (N, n) of a law with a memory, from the state with which it is nearest to the logged one."""
    law = record.law
    resumed = law if isinstance(law, Resumed) else Resumed(law=law, state=law.initial_state(record.n))  # type: ignore[union-attr, arg-type]  # a law
    try:
        followed, usual = at_work(record, resumed)
    except ValueError:  # its reference does not tell its torque
        return None
    if isinstance(law, Resumed):  # in a stated state
        followed = dataclasses.replace(record, law=law.along(record.rig))
    clock = Clock.of(followed)
    t, period, rows = clock.t[clock.rows], record.rig.period, slice(FADED, None)
    for _ in range(0 if isinstance(law, Resumed) else _ROUNDS):
        run = run_law(followed)
        memory, columns = state_directions(followed, run, usual)
        if not len(columns):
            break
        missing = (logged - driven(followed, run.around(t, period)))[rows].ravel()
        own: Any = followed.law
        change = np.linalg.lstsq(columns[:, rows].reshape(len(columns), -1).T, missing, rcond=None)[0]
        followed = dataclasses.replace(
            followed, law=dataclasses.replace(own, state=memory.at(np.asarray(change, float)))
        )
    return driven(followed, run_law(followed).around(t, period))
