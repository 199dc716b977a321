"""The genetic algorithm of 3.7 on the load parameters, as the paper's conclusion has it: a window
replayed.

Each candidate is the arm with a load. It is simulated under the torque that was applied, corrected
a little at every sample by the counts (as in `identification.replay.prediction`), and costs the sum
of its squared innovations [pulses^2]. Without correction the replay of an arm in open loop would be
a matter of its initial speed; with it, what is compared is what the counts say of the torque, over
about the length of the kernels of the other estimator. Tracking errors of the closed loop itself
say less: its law keeps them within a pulse for any candidate.

Source: paper, conclusion (stages 1 and 2), and 3.7.
"""

import functools

import casadi as ca
import numpy as np

from identification.equation_error.least_squares import NORMAL
from identification.payload.kernel_estimate import Smoothing, Window
from identification.payload.posterior import LoadShape, PayloadEstimate, judged
from identification.search.genetic import GeneticSettings, minimize_genetic
from plant import Arm, LoggedTorque, Rig
from plant.machine.rig import smooth_rig
from plant.parts.fields import Floats
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.layout import Correction
from plant.simulation.loop_kernel import LANES, loop_kernel

_STEPS = 1  # sub-steps per sample: a window is short, and corrected

_STEP = 0.1  # of the differences for the curvature, as a share of the range of masses

_MISFIT = 4.0  # from which on no load explains a window, in the rounding's standard deviation

_ROUNDING = np.sqrt(1 / 12)  # standard deviation of a rounded count [pulses]


class GeneticEstimator:
    """A load from a window by the genetic algorithm, with the settings of 3.7; a replay forgets
    over `length` [s].
    """

    def __init__(self, arm: Arm, rig: Rig, shape: LoadShape, length: float, seed: int = 0) -> None:
        self.shape = shape
        self.arm = arm
        self.rig = rig
        self.seed = seed
        self.settings = GeneticSettings.paper()
        self._smoothing = Smoothing(length, rig.period)
        self._start = self._smoothing.samples // 2
        self._matrix = arm.dynamics.load_matrix()
        correction = Correction.with_memory(arm.n, length / rig.period)
        self._loop = ClosedLoop(
            dynamics=arm.dynamics,
            rig=smooth_rig(rig),
            law=LoggedTorque(),
            steps_per_sample=_STEPS,
            correction=correction,
            score=_squares(arm.n),
        )
        self._numbers = self._loop.number_values(np.asarray(arm.f))
        self._kernel = loop_kernel(self._loop, range(arm.dynamics.p))

    @property
    def bounds(self) -> Floats:
        """Of mass [kg] and, where it is unknown, place along the line (0 to 1), (1 or 2, 2)."""
        rows = [self.shape.mass, *([(0.0, 1.0)] if len(self.shape.places) > 1 else [])]
        return np.array(rows, dtype=float)

    def parameters(self, candidates: Floats) -> Floats:
        """Standard parameters (P, 10) of the loads of candidates (P, 1 or 2)."""
        per_kg = self.shape.per_kg
        if candidates.shape[1] == 1:
            return candidates[:, :1] * per_kg
        place = candidates[:, 1] * (len(per_kg) - 1)
        low = np.minimum(place.astype(int), len(per_kg) - 2)
        share = (place - low)[:, None]
        return candidates[:, :1] * ((1 - share) * per_kg[low] + share * per_kg[low + 1])

    def __call__(self, window: Window) -> PayloadEstimate:
        """Estimate from a window of at least three kernels."""
        costs = self._costs(window)
        result = minimize_genetic(costs, self.bounds, self.settings, self.seed)
        best, (low, high) = result.x, self.shape.mass
        near = np.repeat(best[None], 3, axis=0)
        middle = np.clip(best[0], low + _STEP * (high - low), high - _STEP * (high - low))
        near[:, 0] = middle + _STEP * (high - low) * np.array([-1, 0, 1])
        around = costs(near)
        samples = len(window) - self._start
        curvature = (around[0] - 2 * around[1] + around[2]) / (_STEP * (high - low)) ** 2 / 2
        misfit = float(np.sqrt(max(result.cost, 0.0) / (samples * self.arm.n)) / _ROUNDING)
        noise = max(misfit * _ROUNDING, _ROUNDING) ** 2 * self._smoothing.per_independent
        even = (high - low) / np.sqrt(12)
        std = float(min(even, np.sqrt(noise / curvature))) if curvature > 0 else float(even)
        message, sufficient = judged(self.shape, misfit < _MISFIT, misfit, std)
        parameters = self.parameters(best[None])[0]
        place = (
            parameters[1:4] / best[0]
            if best[0] > 0
            else self.shape.places[len(self.shape.places) // 2]
        )
        return PayloadEstimate(
            mass=float(best[0]),
            std=std,
            interval=np.clip(best[0] + NORMAL * std * np.array([-1, 1]), low, high),
            parameters=parameters,
            position=place,
            sufficient=sufficient,
            explained=misfit < _MISFIT,
            misfit=misfit,
            message=message,
        )

    def _costs(self, window: Window):
        loop = self._loop
        start = self._start
        n = self.arm.n
        q, qd, _ = self._smoothing.motion(
            self.rig.cell_centre(window.counts[: self._smoothing.samples])
        )
        angle = self.rig.cell_centre(window.counts[start:])
        counts = self.rig.position_in_pulses(angle)
        samples = len(counts)
        time = np.tile(loop.time_with(), (samples, 1))
        time[:, loop.time_fields.at(n)["logged"]] = window.torque[start:]
        tables = self._kernel.prepared(
            (
                time[:0],
                time,
                np.repeat(time, _STEPS, axis=0),
                np.column_stack([counts, np.ones(samples)]),
            )
        )
        uniform = self._numbers[list(self._kernel.uniform)]
        state = np.repeat(loop.initial_state(q[0], qd[0], self._numbers)[:, None], LANES, axis=1)

        def costs(candidates: Floats) -> Floats:
            f = self.arm.f + self.parameters(candidates) @ self._matrix.T
            blocks = [
                self._block(f[i : i + LANES], state, tables, uniform)
                for i in range(0, len(f), LANES)
            ]
            return np.concatenate(blocks)

        return costs

    def _block(self, f, state, tables, uniform):
        """Costs of at most `LANES` candidates; empty lanes repeat the last."""
        lanes = f[np.minimum(np.arange(LANES), len(f) - 1)].T.copy()
        final, _ = self._kernel.run(tables, state, lanes, uniform)
        state = self._loop.read_state(final)
        return np.where(state.ok > 0, state.score, np.inf)[: len(f)]


@functools.lru_cache(maxsize=8)
def _squares(n: int) -> ca.Function:
    """Of the innovations (n), the first part of a sample's log; the counts and a weight are its
    data.
    """
    log = ca.SX.sym("log", n)
    data = ca.SX.sym("data", n + 1)
    memory = ca.SX.sym("memory", 0)
    return ca.Function("squares", [log, data, memory], [data[-1] * ca.sumsqr(log), memory])
