"""Objective (4): distance of simulated from measured tracking errors, for a whole population."""

import functools
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import of_each
from identification.replay.experiment import Experiment, as_records
from plant import Dynamics, Record
from plant.compiler import cores, shared_out
from plant.machine import least_inertia_margin
from plant.parts import Floats, array, known_options, whole
from plant.simulation import LANES

# Up to so many joints the inertia of candidates is checked at few poses: a thread takes longer to
# start than it saves.
_SINGLE_THREADED = 2


@functools.lru_cache
def squared_error(n: int) -> ca.Function:
    """The term of one sample: (log, data, memory) -> weighted sum of (e^r - e^m)^2, memory.

    The sum is over the joints. The data are the measured errors (n) and the root of the sample's
    weight. Source: paper eq. (4).
    """
    # The log begins with the tracking errors; torque, position and speed follow.
    log = ca.SX.sym("log", 4 * n)
    data = ca.SX.sym("data", n + 1)
    memory = ca.SX.sym("memory", 0)
    return ca.Function(
        "squared_error", [log, data, memory], [ca.sumsqr(data[n] * (data[:n] - log[:n])), memory]
    )


@known_options
class Objective:
    """Sum of squared differences of tracking errors [pulses^2], for a population of candidates.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
        Each with its law; they may differ in rig, law and reference.
    unknown : sequence of str, optional
        Names of what a candidate gives, in its order; by default f. Any number of rig and law can
        be named too, as ``drive.viscous[0]`` or ``law.gain[1]``; "friction" and "gains" stand for
        one number of each kind per joint. If no f is named, all of f comes first.
    steps_per_sample, sweeps : int
        Sub-steps of the simulation, and sweeps of its friction law, as for `plant.simulate`.
    threads : int, optional
        By default one per core. The result is the same bits for any number.

    Notes
    -----
    A candidate costs inf if it is not finite, if its rig or law would be refused, or if its run
    diverges. It also costs inf if D(q) - diag(Jm_min k^2) is not positive semidefinite at every
    checked pose, since no controller could be built on such an arm.

    See Also
    --------
    identification.identify, plant.replay

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import Objective
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.5)
    >>> objective = Objective(puma560.dynamics(), record)
    >>> costs = objective([puma560.arm().f, 1.1 * puma560.arm().f])
    >>> print(costs[0] < costs[1])
    True

    Source: paper eq. (4).
    """

    def __init__(
        self,
        dynamics: Dynamics,
        records: Record | Iterable[Record],
        unknown: Iterable[str] | None = None,
        *,
        steps_per_sample: int = 4,
        sweeps: int = 3,
        threads: int | None = None,
    ) -> None:
        self.threads = (
            cores() if threads is None else whole("threads", threads, "Leave it out for all.")
        )
        self.dynamics = dynamics
        self.records, self.unknown = as_records(dynamics, records, unknown)
        settings = {"steps_per_sample": steps_per_sample, "sweeps": sweeps}
        self._experiments = of_each(
            lambda record: _Scored(dynamics, record, self.unknown, settings), self.records
        )

    @property
    def p(self) -> int:
        """Length of a candidate."""
        return len(self.unknown)

    def __call__(self, population: ArrayLike) -> Floats:
        """Costs (P,) [pulses^2] of candidates (P, p).

        Raises
        ------
        ValueError
            Not a (P, p) array of numbers.
        """
        population = array(
            "population",
            population,
            ("P", self.p),
            finite=False,
            advice="Give one candidate per row.",
        )
        # Record by record, always in this order: a sum in another order has other last bits.
        costs = np.zeros(len(population))
        for experiment in self._experiments:
            costs += experiment.costs(population, self.threads)
        return costs


class _Scored(Experiment):
    """One record, ready to be replayed with any number of candidates."""

    def __init__(
        self, dynamics: Dynamics, record: Record, unknown: tuple[str, ...], settings: dict[str, Any]
    ) -> None:
        super().__init__(dynamics, record, unknown, score=squared_error(dynamics.n), **settings)
        self._kernel = self.kernel(self.places)

    @functools.cached_property
    def _tables(self) -> tuple[Any, ...]:
        """Tables that a run reads: large, and made for the first run."""
        return self._kernel.along(
            self.loop, **self.driven, data=self.data(self.record.error_pulses)
        )

    def costs(self, population: Floats, threads: int) -> Floats:
        """Costs (P,) of candidates (P, p); inf of those that no arm, rig or law can have."""
        # All numbers of the loop, a row per candidate. The lanes of the kernel take the unknowns.
        numbers = np.repeat(self.numbers[None], len(population), axis=0)
        numbers[:, self.places] = population
        costs = np.full(len(population), np.inf)

        # 1. Leave out candidates that no arm can have: their simulations would be wasted.
        sound = np.flatnonzero(np.isfinite(population).all(axis=1))
        sound = sound[self._all_margins(numbers[sound], threads) >= 0]

        # 2. Simulate the others, as many as a kernel has lanes in a block.
        blocks = [sound[i : i + LANES] for i in range(0, len(sound), LANES)]
        results = shared_out(lambda rows: self._block(population[rows]), blocks, threads)
        costs[sound] = np.concatenate([np.empty(0), *results])
        return costs

    def _all_margins(self, numbers: Floats, threads: int) -> Floats:
        """`_margins` of all candidates, by several threads if the arm has enough joints."""
        if self.loop.n <= _SINGLE_THREADED or threads == 1:
            return self._margins(numbers)
        size = max(1, -(-len(numbers) // threads))
        blocks = [numbers[i : i + size] for i in range(0, len(numbers), size)]
        return np.concatenate([np.empty(0), *shared_out(self._margins, blocks, threads)])

    def _margins(self, numbers: Floats) -> Floats:
        """Smallest pivot (P,) of D less the motors' own inertia, of each candidate.

        `numbers` (P, k): all numbers of the candidates.
        """
        p = self.loop.dynamics.p
        f = numbers[:, :p]
        # All candidates share rig and law: one check of the whole population.
        if max(self.places) < p:
            return least_inertia_margin(self.loop.dynamics, self.record.rig, f)
        # Gears and motors differ between candidates, and with them the least inertia.
        margins = np.full(len(f), -np.inf)
        rig_size = len(self.record.rig.number_values())
        for i, row in enumerate(numbers):
            try:
                rig = self.record.rig.with_numbers(row[-rig_size:])
                self.loop.law.with_numbers(row[p:-rig_size])
            except ValueError:
                # No rig, or no law, can have these numbers: the candidate costs inf.
                continue
            margins[i] = least_inertia_margin(self.loop.dynamics, rig, f[i : i + 1])[0]
        return margins

    def _block(self, candidates: Floats) -> Floats:
        """Costs of at most `LANES` candidates."""
        # Empty lanes repeat the last candidate: a kernel has no lane that does nothing.
        lanes = candidates[np.minimum(np.arange(LANES), len(candidates) - 1)].T.copy()
        numbers = np.repeat(self.numbers[:, None], LANES, axis=1)
        numbers[self.places] = lanes
        state = np.ascontiguousarray(self.loop.initial_state(*self.began(numbers), numbers))
        final, steps = self._kernel.run(
            self._tables, state, lanes, self.numbers[list(self._kernel.uniform)]
        )
        score = self.loop.read_state(final).score
        # A run that stopped early has a small score, since its sum lacks the rest of the log.
        complete = self.loop.sound(final) & np.isfinite(score) & (steps == self.steps)
        return np.where(complete, score, np.inf)[: len(candidates)]
