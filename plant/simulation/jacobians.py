"""Jacobians of a fast law's closed loop about an arm held at a pose: derivatives of the simulator's own sub-step."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.laws.law import Law
from plant.machine.friction_step import DRY_FRICTION
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.parts.arguments import array
from plant.simulation.closed_loop import ClosedLoop

__all__ = ["jacobians"]


def jacobians(
    arm: Arm, rig: Rig, law: Law, pose: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], list[str]]:
    """The matrices A (m, m), B (m, n) and C (n, m) of `plant.linearise`, and the names of its m states."""
    n = arm.n
    q = array("pose", pose, (n,), advice="Give one angle per joint [rad].")
    if law.has_memory(n):
        raise ValueError(f"law must be fast and without state, like P; got {type(law).__name__}. Linearise it by hand.")
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=1, smooth=True)
    state, time, numbers = (ca.SX.sym(name, len(names)) for name, names in _vectors(loop))
    following, error = loop.substep(state, time, numbers)
    pulses = time[3 * n : 4 * n]
    moving = [i for i, name in enumerate(loop.state_names) if name.startswith(("q", "link", "driven"))]
    # Commanded counts at which the loop holds the pose against gravity.
    step = 1e-7  # [s]: of the derivative, d(following)/d(joint) = 1 + A step + O(step^2)
    A = (ca.jacobian(following[moving], state[moving]) - ca.DM.eye(len(moving))) / step
    B = ca.jacobian(following[moving], pulses) / step
    values = loop.number_values(arm.f)
    for i, name in enumerate(loop.number_names):
        if name.startswith(DRY_FRICTION):
            values[i] = 0.0
    at_rest = loop.initial_state(q, np.zeros(n), values)
    held = rig.position_in_pulses(q) + _holding(arm, rig, loop, at_rest, values)
    row = np.concatenate([q, np.zeros(2 * n), held, [step]])
    function = ca.Function("linear", [state, time, numbers], [A, B])
    A, B = (matrix.full() for matrix in function(at_rest, row, values))
    names = [loop.state_names[i] for i in moving]
    C = np.zeros((n, len(moving)))
    C[
        :, [i for i, name in enumerate(names) if name.startswith("link[" if rig.encoder.side == "link" else "q[")]
    ] = -rig.position_in_pulses(np.eye(n)).T
    return A, B, C, names


def _vectors(loop: ClosedLoop) -> tuple[tuple[str, list[str]], ...]:
    return ("state", loop.state_names), ("time", loop.time_names), ("numbers", loop.number_names)


def _holding(
    arm: Arm, rig: Rig, loop: ClosedLoop, state: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Error in pulses at which the law holds the arm, tau(error) = h(q, 0) less the springs', by its stiffness."""
    n = arm.n
    time = ca.SX.sym("time", len(loop.time_names))
    log = loop.sample(state, time, values, [])[1][n : 2 * n]
    row = np.concatenate([state[:n], np.zeros(2 * n), rig.position_in_pulses(state[:n]), [loop.h]])
    slope = ca.Function("slope", [time], [ca.jacobian(log, time[3 * n : 4 * n])])(row).full()
    return np.linalg.solve(slope, arm.h(state[:n], np.zeros(n)) - rig.spring_torque(state[:n]))
