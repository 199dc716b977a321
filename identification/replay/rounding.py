"""The log that a model makes itself, with encoders that round, where `Prediction`'s model does not."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.replay.experiment import Experiment
from plant import Law, Phase, Record
from plant.motion.reference import Motion
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.followed_path import Logged
from plant.simulation.threads import shared_out

_STEPS = 16
"""Sub-steps per sample: fast hardware feels each count when it comes."""


_AT_ONCE = 1 << 13
"""Samples that are simulated at once: the tables of so many sub-steps are large."""


class Rounding(Experiment):
    """The loop of a record, as `loop` has it, without correction and with rounding."""

    def __init__(self, loop: ClosedLoop, record: Record) -> None:
        rig, n = record.rig, record.n
        self._own = np.zeros(n) if rig.encoder.phase is None else rig.encoder.phase.shift
        phased = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, phase=Phase(shift=self._own)))
        super().__init__(
            loop.dynamics, dataclasses.replace(record, rig=phased), loop.dynamics.names, steps_per_sample=_STEPS,
            sweeps=loop.sweeps,
        )  # fmt: skip
        self._kernel = self.kernel()
        self._reference = self.driven["path"](self.clock.t)[1]

    def path(self, smooth: bool) -> Any:
        """The commanded path; of logged counts, the smoothest motion that they allow, rounded at every instant."""
        path = super().path(smooth)
        return _Rounded(path) if isinstance(path, Logged) and path.whole else path

    def counts(
        self, start: Any, numbers: NDArray[np.float64], names: Sequence[str], shifts: Sequence[NDArray[np.float64]],
        threads: int,
    ) -> list[NDArray[np.float64]]:  # fmt: skip
        """Counts (N, n) from a start, with numbers (k,) of these names, for encoders shifted by so many pulses (n,).

        Raises a ValueError: an arm that diverges.
        """
        own, n = self.numbers.copy(), self.loop.n
        places = {name: i for i, name in enumerate(self.loop.number_names)}
        for name, value in zip(names, numbers.tolist(), strict=True):
            if name in places:
                own[places[name]] = value
        phase = [places[f"encoder.phase.shift[{i}]"] for i in range(n)]
        q, qd = start
        runs = [_Run(self.loop.initial_state(q, qd, own), own.copy(), np.empty((len(self.clock), n))) for _ in shifts]
        for run, shift in zip(runs, shifts, strict=True):
            run.numbers[phase] = self._own + shift
        begin = 0
        for tables in self._kernel.blocks(self.loop, **self.driven, samples=_AT_ONCE):
            rows = slice(begin, begin + len(tables[1]))
            shared_out(functools.partial(self._block, tables, rows), runs, threads)
            begin = rows.stop
        for run in runs:
            if not (run.state[-1] > 0 and bounded(run.state[: 2 * n]) and np.isfinite(run.errors).all()):
                raise ValueError("the model must stay on the log's path; simulated with what was found, it diverges.")
        return [np.asarray((self._reference - run.errors)[self.clock.rows]) for run in runs]

    def _block(self, tables: tuple[Any, ...], rows: slice, run: _Run) -> None:
        """One block of samples of a run."""
        log = np.full((len(tables[1]), self.loop.n_log), np.nan)
        errors = np.empty((len(log) * self.loop.steps_per_sample, self.loop.n))
        final, _ = self._kernel.run(tables, run.state[:, None], np.empty((0, 1)), run.numbers, (log, errors))
        run.state, run.errors[rows] = final[:, 0], log[:, : self.loop.n]


@dataclasses.dataclass
class _Run:
    """Where a run has come to: state (s,), its numbers, and errors (M, n) [pulses] up to there."""

    state: NDArray[np.float64]
    numbers: NDArray[np.float64]
    errors: NDArray[np.float64]


class _Rounded:
    """A smooth motion through logged counts, in counts."""

    def __init__(self, logged: Logged) -> None:
        self.logged = logged

    def __call__(self, t: NDArray[np.float64]) -> tuple[Motion, NDArray[np.float64]]:
        motion = self.logged.smoothed(t)
        return motion, self.logged.rig.counts(motion.q)

    def setpoint(self, t: NDArray[np.float64], law: Law) -> Motion:
        """What a law is given at times t (N,)."""
        return self.logged.setpoint(t, law)
