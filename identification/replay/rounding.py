"""The log that a model makes itself, with encoders that round, where `Prediction`'s model does not."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.replay.experiment import Experiment
from plant import Law, Motion, Phase, Record
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.followed_path import Logged

__all__ = ["Rounding"]

_STEPS = 16
"""Sub-steps per sample: fast hardware feels each count when it comes."""


class Rounding(Experiment):
    """The loop of a record, as `loop` has it, without correction and with rounding.

    Parameters
    ----------
    loop : ClosedLoop
    record : Record
    """

    def __init__(self, loop: ClosedLoop, record: Record) -> None:
        rig, n = record.rig, record.n
        self._own = np.zeros(n) if rig.encoder.phase is None else rig.encoder.phase.shift
        phased = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, phase=Phase(shift=self._own)))
        super().__init__(
            loop.dynamics, dataclasses.replace(record, rig=phased), loop.dynamics.names, steps_per_sample=_STEPS,
            sweeps=loop.sweeps,
        )  # fmt: skip
        self._kernel = self.kernel()
        nothing = self.data(np.zeros((len(record), n)))
        self._tables = self._kernel.prepared((*self.times, nothing), logged=True)
        self._reference, self.times = self.times[1][:, 3 * n : 4 * n].copy(), ()  # of so many sub-steps they are large

    def path(self, smooth: bool) -> Any:
        """The commanded path; of logged counts, the smoothest motion that they allow, rounded at every instant."""
        path = super().path(smooth)
        return _Rounded(path) if isinstance(path, Logged) and path.whole else path

    def counts(
        self, start: Any, numbers: NDArray[np.float64], names: Sequence[str], shift: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Counts (N, n) from a start, with numbers (k,) of these names, and encoders shifted by so many pulses (n,).

        Raises
        ------
        ValueError
            An arm that diverges.
        """
        own, n = self.numbers.copy(), self.loop.n
        places = {name: i for i, name in enumerate(self.loop.number_names)}
        for name, value in zip(names, numbers.tolist(), strict=True):
            if name in places:
                own[places[name]] = value
        for i in range(n):
            own[places[f"encoder.phase.shift[{i}]"]] = self._own[i] + shift[i]
        log, errors = np.full((len(self.clock), self.loop.n_log), np.nan), np.empty((self.steps, n))
        q, qd = start
        state = self.loop.initial_state(q, qd, own)
        final, _ = self._kernel.run(self._tables, state[:, None], np.empty((0, 1)), own, (log, errors))
        if not (final[-1, 0] > 0 and bounded(final[: 2 * n, 0]) and np.isfinite(log[:, :n]).all()):
            raise ValueError("the model must stay on the log's path; simulated with what was found, it diverges.")
        return np.asarray((self._reference - log[:, :n])[self.clock.rows])


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
