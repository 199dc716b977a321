"""Jacobians of a fast law's closed loop about an arm held at a pose: derivatives of the
simulator's own sub-step.
"""

import functools

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.laws.law import Law
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.dynamics import Dynamics
from plant.parts.arguments import array
from plant.parts.fields import Floats
from plant.simulation.closed_loop import ClosedLoop

_STEP = 1e-7  # of the derivative [s]: d(following)/d(joint) = 1 + A step + O(step^2)


def jacobians(
    arm: Arm, rig: Rig, law: Law, pose: ArrayLike
) -> tuple[Floats, Floats, Floats, list[str]]:
    """The matrices A (m, m), B (m, n) and C (n, m) of `plant.linearise`, and the names of its m
    states.
    """
    n = arm.n
    q = array("pose", pose, (n,), advice="Give one angle per joint [rad].")
    if law.has_memory(n):
        raise ValueError(
            f"law must be fast and without state, like P; got {type(law).__name__}. Linearise it by"
            " hand."
        )
    loop, moving, slope, linear = _functions(arm.dynamics, rig, law)
    values = loop.sliding_values(arm.f)
    at_rest = loop.initial_state(q, np.zeros(n), values)
    # Commanded counts at which the loop holds the pose against gravity, tau(error) = h(q, 0) less
    # the springs'.
    commanded = rig.position_in_pulses(q)
    stiffness = slope(
        np.concatenate([q, np.zeros(2 * n), commanded, [loop.h]]), at_rest, values
    ).full()
    held = commanded + np.linalg.solve(stiffness, arm.h(q, np.zeros(n)) - rig.spring_torque(q))
    row = np.concatenate([q, np.zeros(2 * n), held, [_STEP]])
    A, B = (matrix.full() for matrix in linear(at_rest, row, values))
    names = [loop.state_names[i] for i in moving]
    C = np.zeros((n, len(moving)))
    C[
        :,
        [
            i
            for i, name in enumerate(names)
            if name.startswith("link[" if rig.encoder.side == "link" else "q[")
        ],
    ] = -rig.position_in_pulses(np.eye(n)).T
    return A, B, C, names


@functools.lru_cache(maxsize=16)
def _functions(
    dynamics: Dynamics, rig: Rig, law: Law
) -> tuple[ClosedLoop, list[int], ca.Function, ca.Function]:
    """The loop; which of its states move; (time, state, numbers) -> stiffness [N m per pulse];
    and -> A, B.
    """
    n = dynamics.n
    loop = ClosedLoop(dynamics=dynamics, rig=rig, law=law, steps_per_sample=1, smooth=True)
    vectors = ("state", loop.state_names), ("time", loop.time_names), ("numbers", loop.number_names)
    state, time, numbers = (ca.SX.sym(name, len(names)) for name, names in vectors)
    following = loop.substep(state, time, numbers)[0]
    pulses = time[3 * n : 4 * n]
    moving = [
        i for i, name in enumerate(loop.state_names) if name.startswith(("q", "link", "driven"))
    ]
    A = (ca.jacobian(following[moving], state[moving]) - ca.DM.eye(len(moving))) / _STEP
    B = ca.jacobian(following[moving], pulses) / _STEP
    torque = loop.sample(state, time, numbers, [])[1][n : 2 * n]
    slope = ca.Function("slope", [time, state, numbers], [ca.jacobian(torque, pulses)])
    return loop, moving, slope, ca.Function("linear", [state, time, numbers], [A, B])
