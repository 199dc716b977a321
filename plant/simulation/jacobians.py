"""Jacobians of a fast law's loop about an arm held at a pose: derivatives of the sub-step."""

import functools

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.laws import Law
from plant.machine import Rig
from plant.mechanics import Arm
from plant.parts import Floats, array
from plant.simulation.closed_loop import ClosedLoop


def jacobians(
    arm: Arm, rig: Rig, law: Law, pose: ArrayLike
) -> tuple[Floats, Floats, Floats, list[str]]:
    """Matrices A (m, m), B (m, n) and C (n, m) of `plant.linearise`, and names of its m states."""
    n = arm.n
    q = array("pose", pose, (n,), advice="Give one angle per joint [rad].")
    if law.has_memory(n):
        raise ValueError(
            f"law must be fast and without state, like P; got {type(law).__name__}. Linearise it by"
            " hand."
        )
    # d(following)/d(state) of a sub-step of this length [s] is 1 + A step + O(step^2); at 1e-7 s
    # both the quadratic term and rounding are small.
    step = 1e-7
    loop, moving, slope, linear = _functions(arm.dynamics, rig, law, step)
    values = loop.sliding_values(arm.f)
    at_rest = loop.initial_state(q, np.zeros(n), values)
    # Commanded counts at which the loop holds the pose against gravity, tau(error) = h(q, 0) less
    # the springs'.
    commanded = rig.position_in_pulses(q)
    stiffness = slope(loop.time_with(q_r=q, pulses_r=commanded), at_rest, values).full()
    holding = commanded + np.linalg.solve(stiffness, arm.h(q, np.zeros(n)) - rig.spring_torque(q))
    row = loop.time_with(q_r=q, pulses_r=holding, h=step)
    A, B = (matrix.full() for matrix in linear(at_rest, row, values))
    names = [loop.state_names[i] for i in moving]
    C = np.zeros((n, len(moving)))
    # The states that the encoders measure.
    measured = "link[" if rig.encoder.side == "link" else "q["
    columns = [i for i, name in enumerate(names) if name.startswith(measured)]
    # The commanded counts enter by the error, commanded minus counted: hence the sign.
    C[:, columns] = -rig.position_in_pulses(np.eye(n)).T
    return A, B, C, names


@functools.lru_cache(maxsize=16)
def _functions(dynamics, rig, law, step):
    """The loop, places of its states that move, and two functions.

    (time, state, numbers) -> stiffness [N m per pulse]; (state, time, numbers) -> A, B.
    """
    loop = ClosedLoop(dynamics=dynamics, rig=rig, law=law, steps_per_sample=1, smooth=True)
    state = ca.SX.sym("state", len(loop.state_names))
    time = ca.SX.sym("time", len(loop.time_names))
    numbers = ca.SX.sym("numbers", len(loop.number_names))
    following = loop.substep(state, time, numbers)[0]
    pulses = loop.time_fields.read(time, loop.n).pulses_r
    moving = loop.moving_states()
    A = (ca.jacobian(following[moving], state[moving]) - ca.DM.eye(len(moving))) / step
    B = ca.jacobian(following[moving], pulses) / step
    log = loop.sample(state, time, numbers, [])[1]
    torque = loop.log_fields.read(log, loop.n).torque
    slope = ca.Function("slope", [time, state, numbers], [ca.jacobian(torque, pulses)])
    return loop, moving, slope, ca.Function("linear", [state, time, numbers], [A, B])
