"""Objective (4): how far a candidate arm's tracking errors are from the measured ones, a whole population at once."""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np

from plant.check import array, instance, known_options
from plant.dynamics import Dynamics
from plant.inertia import least_inertia_margin
from plant.kernel import LANES
from plant.loop import ClosedLoop, bounded
from plant.record import Record
from plant.simulator import loop_kernel
from plant.tables import path_of, start_of, time_tables

__all__ = ["Objective", "squared_error"]


@functools.lru_cache
def squared_error(n):
    """The term that one sample adds, (log, measured error) -> sum over joints of (e^r - e^m)^2.

    Source: paper eq. (4).
    """
    log, measured = ca.SX.sym("log", 4 * n), ca.SX.sym("measured", n)
    return ca.Function("squared_error", [log, measured], [ca.sumsqr(measured - log[:n])])


@known_options
class Objective:
    """Sum of squared differences of tracking errors [pulses^2], for a population of candidates.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
        Each with its law; they may differ in rig, law and reference.
    unknown : sequence of str, optional
        Names of what a candidate gives, in its order; by default f. Any number of rig and law can be named too, as
        ``drive.viscous[0]`` or ``law.gain[1]``.
    steps_per_sample, sweeps : int
        Sub-steps of the simulation, and sweeps of its friction law, as for `plant.simulate`.
    threads : int, optional
        By default one per core. The result is the same bits for any number.

    Notes
    -----
    A candidate costs inf when it is not finite, when its rig or law would be refused, when its run diverges, or when
    D(q) - diag(Jm_min k^2) is not positive semidefinite for all q: no controller could be built on such an arm.

    Source: paper eq. (4).
    """

    def __init__(self, dynamics, records, unknown=None, *, steps_per_sample=4, sweeps=3, threads=None):
        records = tuple(records) if np.iterable(records) else (records,)
        if not records or not all(isinstance(record, Record) for record in records):
            given = type(next(r for r in records if not isinstance(r, Record))).__name__ if records else "none"
            raise ValueError(f"records must be at least one Record; got {given}. Pass what simulate or from_csv gave.")
        if threads is not None and (not isinstance(threads, (int, np.integer)) or threads < 1):
            raise ValueError(f"threads must be a whole number of at least 1; got {threads!r}. Leave it out for all.")
        instance("dynamics", dynamics, Dynamics, "Pass the equations with f open, such as puma560.dynamics().")
        if isinstance(unknown, str) or not (unknown is None or np.iterable(unknown)):
            raise ValueError(f"unknown must be a sequence of names; got {unknown!r}. Write ({unknown!r},).")
        self.dynamics, self.records = dynamics, records
        self.unknown = tuple(dynamics.names if unknown is None else unknown)
        twice = [name for i, name in enumerate(self.unknown) if name in self.unknown[:i]]
        if twice:
            raise ValueError(f"unknown must name each number once; {twice[0]} comes twice. Leave one out.")
        self.threads = int(threads or _cores())
        settings = {"steps_per_sample": steps_per_sample, "sweeps": sweeps}
        self._experiments = [_Experiment(dynamics, record, self.unknown, settings) for record in records]

    @property
    def p(self):
        """Length of a candidate."""
        return len(self.unknown)

    def __call__(self, population):
        """Costs (P,) [pulses^2] of candidates (P, p).

        Raises
        ------
        ValueError
            Not a (P, p) array of numbers.
        """
        population = array("population", population, ("P", self.p), finite=False, advice="Give one candidate per row.")
        costs = np.zeros(len(population))
        for experiment in self._experiments:
            costs += experiment.costs(population, self.threads)
        return costs


class _Experiment:
    """One record, ready to be replayed with any number of candidates."""

    def __init__(self, dynamics, record, unknown, settings):
        if record.law is None:
            raise ValueError("the record must name the law that made it; got None. Pass law= to Record.from_csv.")
        if record.n != dynamics.n:
            raise ValueError(
                f"the record must have {dynamics.n} joints; it has {record.n}. Use the record of this arm."
            )
        _uniform(record)
        loop = ClosedLoop(
            dynamics=dynamics,
            rig=record.rig,
            law=record.law,
            score=squared_error(dynamics.n),
            **settings,
        )
        names = loop.number_names
        for name in unknown:
            if name not in names:
                raise ValueError(
                    f"unknown must name numbers of this experiment; got {name!r}. Known: {', '.join(names)}."
                )
        self._lanes = [names.index(name) for name in unknown]
        self._kernel = loop_kernel(loop, self._lanes)
        path = path_of(record)
        samples = len(record)
        self._tables = self._kernel.prepared((*time_tables(loop, path, samples), record.error_pulses))
        self._numbers = loop.number_values(np.full(dynamics.p, np.nan))
        self._state = loop.initial_state(*start_of(record, path))
        self._steps = samples * loop.steps_per_sample
        self._dynamics, self._record = dynamics, record
        open_f = [name for name in dynamics.names if name not in unknown]
        if open_f:
            raise ValueError(
                f"unknown must include all of f; {', '.join(open_f)} are missing. Add them to unknown, and fix what is "
                "known by equal ends of its range."
            )

    def costs(self, population, threads):
        """Costs (P,), inf for what cannot be."""
        numbers = np.repeat(self._numbers[None], len(population), axis=0)
        numbers[:, self._lanes] = population
        costs = np.full(len(population), np.inf)

        sound = np.flatnonzero(np.isfinite(population).all(axis=1))
        sound = sound[self._margins(numbers[sound]) >= 0]
        blocks = [sound[i : i + LANES] for i in range(0, len(sound), LANES)]
        results = _shared_out(lambda rows: self._block(population[rows]), blocks, threads)
        costs[sound] = np.concatenate([np.empty(0), *results])
        return costs

    def _margins(self, numbers):
        """Room (P,) that D leaves for the motors' own inertia, of candidates given by all their numbers (P, k)."""
        p, f = self._dynamics.p, numbers[:, : self._dynamics.p]
        if max(self._lanes) < p:
            return least_inertia_margin(self._dynamics, self._record.rig, f)
        margins, rig_size = np.full(len(f), -np.inf), len(self._record.rig.number_values())
        for i, row in enumerate(numbers):
            try:
                rig = self._record.rig.with_numbers(row[-rig_size:])
                self._record.law.with_numbers(row[p:-rig_size])
            except ValueError:  # such a rig, or such a law, there cannot be
                continue
            margins[i] = least_inertia_margin(self._dynamics, rig, f[i : i + 1])[0]
        return margins

    def _block(self, candidates):
        """Costs of at most `LANES` candidates; empty lanes repeat the last."""
        lanes = np.empty((len(self._lanes), LANES))
        lanes[:, : len(candidates)] = candidates.T
        lanes[:, len(candidates) :] = candidates[-1][:, None]
        state = np.repeat(self._state[:, None], LANES, axis=1)
        final, steps = self._kernel.run(self._tables, state, lanes, self._numbers[list(self._kernel.uniform)])
        score, ok = final[-2], final[-1]
        complete = (ok > 0) & bounded(final[: 2 * self._dynamics.n]) & np.isfinite(score) & (steps == self._steps)
        return np.where(complete, score, np.inf)[: len(candidates)]


def _cores():
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _shared_out(function, items, threads):
    """[function(item) for item in items], by so many threads, of which this is one."""
    results, places = [None] * len(items), iter(range(len(items)))

    def work():
        for i in places:
            results[i] = function(items[i])

    others = min(threads, len(items)) - 1
    if others < 1:
        work()
        return results
    with ThreadPoolExecutor(others) as pool:
        running = [pool.submit(work) for _ in range(others)]
        work()
        for future in running:
            future.result()
    return results


def _uniform(record):
    """Refuse time stamps that are not t_0 + k period: the model's samples would drift from the robot's."""
    late = record.t - record.t[0] - np.arange(len(record)) * record.rig.period
    wrong = np.flatnonzero(np.abs(late) > 0.01 * record.rig.period)
    if len(wrong):
        raise ValueError(
            f"t must advance by the rig's period {record.rig.period:.6g} s; sample {wrong[0]} is "
            f"{late[wrong[0]]:+.3g} s off. Resample the log or correct the period."
        )
