"""`GeneticEstimator`: the genetic algorithm of 3.7 on the parameters of a load, on a window.

Each candidate is the arm with a load. It is simulated under the applied torque, corrected a little
at every sample by the counts (as in `identification.replay.prediction`), and costs the sum of its
squared innovations [pulses^2]. Without the correction, a simulation in open loop would depend above
all on the initial speed; with it, each innovation depends on the torques of about the last
`length`. A simulation of the closed loop would show less: its law keeps the tracking error within a
pulse for any candidate.

Source: paper, conclusion (stages 1 and 2), and 3.7.
"""

import functools

import casadi as ca
import numpy as np

from identification.equation_error import NORMAL
from identification.payload.kernel_estimate import Smoothing, Window
from identification.payload.posterior import LoadShape, PayloadEstimate, judged, unheard
from identification.search import GeneticSettings, minimize_genetic
from plant import Arm, LoggedTorque, Rig
from plant.machine import smooth_rig
from plant.parts import Floats, frozen_settings
from plant.simulation import LANES, ClosedLoop, Correction, loop_kernel

_ROUNDING = np.sqrt(1 / 12)  # standard deviation of a rounded count [pulses]


@frozen_settings
class GeneticEstimatorSettings:
    """Numbers of the genetic estimator beside those of its genetic algorithm.

    Chosen by hand; ``tests/benchmarks/payload.py genetic`` measures errors of the mass.

    Parameters
    ----------
    steps : int
        Sub-steps per sample of the simulation; one is enough for a short, corrected window.
    difference : float
        Step of the differences for the curvature, as a share of the range of masses.
    misfit : float
        RMS innovation above which no load explains a window, in standard deviations of a rounded
        count.
    """

    # Simulation, interval and verdict.
    steps: int = 1
    difference: float = 0.1
    misfit: float = 4.0


SETTINGS = GeneticEstimatorSettings()


class GeneticEstimator:
    """Estimator of a load by the genetic algorithm of 3.7, on a window of counts and torques.

    `length`: time over which the correction by the counts forgets [s].
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
        # Gains by which the simulation forgets its start within `length`.
        correction = Correction.with_memory(arm.n, length / rig.period)
        self._loop = ClosedLoop(
            dynamics=arm.dynamics,
            rig=smooth_rig(rig),
            law=LoggedTorque(),
            steps_per_sample=SETTINGS.steps,
            correction=correction,
            score=_squares(arm.n),
        )
        # Only f differs between candidates.
        self._numbers = self._loop.number_values(np.asarray(arm.f))
        self._kernel = loop_kernel(self._loop, range(arm.dynamics.p))

    @property
    def bounds(self) -> Floats:
        """Bounds of the mass [kg] and of an unknown centre on its line (0 to 1), (1 or 2, 2)."""
        # Variables of the genetic algorithm.
        rows = [self.shape.mass]
        if len(self.shape.places) > 1:
            rows.append(np.array([0.0, 1.0]))
        return np.array(rows, dtype=float)

    def parameters(self, candidates: Floats) -> Floats:
        """Standard parameters (P, 10) of the loads of candidates (P, 1 or 2)."""
        per_kg = self.shape.per_kg
        if candidates.shape[1] == 1:
            return candidates[:, :1] * per_kg
        # Linear interpolation between the two nearest centres of the shape.
        centre = candidates[:, 1] * (len(per_kg) - 1)
        low = np.minimum(centre.astype(int), len(per_kg) - 2)
        share = (centre - low)[:, None]
        return candidates[:, :1] * ((1 - share) * per_kg[low] + share * per_kg[low + 1])

    def __call__(self, window: Window) -> PayloadEstimate:
        """Estimate from a window, which must be as long as a kernel and should be as long as three.

        Raises
        ------
        ValueError
            A window that is shorter than the kernel, or of other joints.
        """
        window.require_joints(self.arm.n)
        if not window.finite:
            return unheard(self.shape, finite=False)
        # 1. The best mass and centre.
        costs = self._costs(window)
        result = minimize_genetic(costs, self.bounds, self.settings, self.seed)
        best = result.x
        low, high = self.shape.mass

        # 2. Curvature of the cost along the mass, by three points within the range.
        step = SETTINGS.difference * (high - low)
        points = np.repeat(best[None], 3, axis=0)
        points[:, 0] = np.clip(best[0], low + step, high - step) + step * np.array([-1, 0, 1])
        around = costs(points)
        samples = len(window) - self._start
        curvature = (around[0] - 2 * around[1] + around[2]) / step**2 / 2

        # 3. Its standard deviation, for innovations that are correlated over the memory of the
        # correction; at most that of a uniform distribution.
        misfit = float(np.sqrt(max(result.cost, 0.0) / (samples * self.arm.n)) / _ROUNDING)
        noise = max(misfit * _ROUNDING, _ROUNDING) ** 2 * self._smoothing.per_independent
        uniform = (high - low) / np.sqrt(12)
        std = float(min(uniform, np.sqrt(noise / curvature))) if curvature > 0 else float(uniform)
        explained = misfit <= SETTINGS.misfit
        message, sufficient = judged(self.shape, explained, misfit, std)
        # The standard parameters include the centre as first moments.
        parameters = self.parameters(best[None])[0]
        centres = self.shape.places
        # The first moments of no mass say nothing of its centre.
        position = parameters[1:4] / best[0] if best[0] > 0 else centres[len(centres) // 2]
        return PayloadEstimate(
            mass=float(best[0]),
            std=std,
            interval=np.clip(best[0] + NORMAL * std * np.array([-1, 1]), low, high),
            parameters=parameters,
            position=position,
            sufficient=sufficient,
            explained=explained,
            misfit=misfit,
            message=message,
        )

    def _costs(self, window):
        """Cost function of a window: candidates (P, 1 or 2) -> squared innovations (P,)."""
        # 1. Begin in the middle of the first kernel, with the smoothed position and speed.
        loop = self._loop
        start = self._start
        n = self.arm.n
        size = self._smoothing.samples
        q, qd, _ = self._smoothing.motion(self.rig.cell_centre(window.counts[:size]))
        # The middle of a kernel of an even number of samples lies half a period before the start.
        late = (start - (size - 1) / 2) * self.rig.period
        begin = q[0] + late * qd[0]

        # 2. Tables of the kernel: logged torque, counts, and a weight of 1 for each.
        angle = self.rig.cell_centre(window.counts[start:])
        counts = self.rig.position_in_pulses(angle)
        samples = len(counts)
        time = np.tile(loop.time_with(), (samples, 1))
        time[:, loop.time_fields.at(n)["logged"]] = window.torque[start:]
        tables = self._kernel.prepared(
            (
                time[:0],
                time,
                np.repeat(time, loop.steps_per_sample, axis=0),
                np.column_stack([counts, np.ones(samples)]),
            )
        )
        uniform = self._numbers[list(self._kernel.uniform)]
        # One initial state for all candidates.
        state = np.repeat(loop.initial_state(begin, qd[0], self._numbers)[:, None], LANES, axis=1)

        def costs(candidates):
            f = self.arm.f + self.parameters(candidates) @ self._matrix.T
            # The kernel simulates LANES candidates side by side.
            blocks = [
                self._block(f[i : i + LANES], state, tables, uniform)
                for i in range(0, len(f), LANES)
            ]
            return np.concatenate(blocks)

        return costs

    def _block(self, f, state, tables, uniform):
        """Costs of at most `LANES` candidates; empty lanes repeat the last one."""
        lanes = f[np.minimum(np.arange(LANES), len(f) - 1)].T.copy()
        final, _ = self._kernel.run(tables, state, lanes, uniform)
        state = self._loop.read_state(final)
        return np.where(state.ok > 0, state.score, np.inf)[: len(f)]


@functools.lru_cache(maxsize=8)
def _squares(n):
    """Score of a sample: its squared innovations, times its weight, as a casadi Function.

    The log of a sample begins with the innovations (n); its data are counts (n) and a weight.
    """
    log = ca.SX.sym("log", n)
    data = ca.SX.sym("data", n + 1)
    memory = ca.SX.sym("memory", 0)
    return ca.Function("squares", [log, data, memory], [data[-1] * ca.sumsqr(log), memory])
