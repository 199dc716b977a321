"""Loop transfer function of each joint under a sampled law, linearised, with sampling, delay and observer.

About an arm held at a pose, by the law's own equations and the simulator's own sub-step. The loop of a joint is opened
where its encoder is read, all other loops stay closed: input are the counts that the law reads, output is minus the
position, in pulses, so that the sensitivity function is 1 / (1 + L). The encoder does not round, the joint slides one
way (viscous friction acts, dry friction does not), and the amplifier is below its limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification import Identification
from plant import Arm, Block, Law, Rig
from plant.machine.friction_step import DRY_FRICTION
from plant.machine.rig import smooth_rig
from plant.parts.arguments import array, instance, known_options
from plant.parts.deprecation import old_order
from plant.simulation.closed_loop import ClosedLoop

if TYPE_CHECKING:
    from control import StateSpace

__all__ = ["error_loop", "open_loops"]

_SUB_STEPS = 16

_MOVING = "q[", "qd[", "link", "driven"
"""What the states of a moving arm begin with; they come before all others but friction and torque."""

Matrix = NDArray[np.float64]


@old_order("law", "rig", first=Law, new="error_loop(arm, rig, law)", arm=None)
@known_options
def error_loop(
    arm: Arm | Identification | None, rig: Rig, law: Law, *, joint: int = 0, pose: ArrayLike | None = None
) -> StateSpace:
    """Loop transfer function L of one joint, the loops of the others closed.

    Parameters
    ----------
    arm : Arm, Identification or None
        What is controlled; None for the law's own, as if f were known.
    rig : Rig
    law : Law
        With a period, such as `ComputedTorque`.
    joint : int
        Counted from 0.
    pose : (n,) array_like, optional
        q at rest [rad]; zeros by default.

    Returns
    -------
    control.StateSpace
        Discrete; from the counts that the law reads to minus the position, both in pulses.

    Raises
    ------
    ValueError
        A law without a period, a joint that is not there, an arm that the law cannot hold at the pose.
    """
    import control

    A, B, C, dt = open_loops(arm, rig, law, pose)
    if not isinstance(joint, (int, np.integer)) or not 0 <= joint < rig.n:
        raise ValueError(f"joint must be a whole number from 0 to {rig.n - 1}; got {joint!r}. Joints count from 0.")
    A, b, c = opened(A, B, C, joint)
    name = f"loop of {controlled(arm, law).dynamics.chain.joint_labels[joint]}"
    return control.StateSpace(A, b, -c, 0, dt, inputs=[f"pulses[{joint}]"], outputs=[f"position[{joint}]"], name=name)


def controlled(arm: Arm | Identification | None, law: Law) -> Arm:
    """The arm itself, that of an identification, or of None that of the law."""
    given: Any = arm.arm if isinstance(arm, Identification) else getattr(law, "arm", None) if arm is None else arm
    instance("arm", given, Arm, "Pass the arm that is controlled, an identification, or None for the law's own.")
    return given


def opened(A: Matrix, B: Matrix, C: Matrix, joint: int) -> tuple[Matrix, Matrix, Matrix]:
    """Matrices of one open loop, the others closed: A (m, m), b (m, 1), c (1, m)."""
    others = [i for i in range(len(C)) if i != joint]
    return A + B[:, others] @ C[others], B[:, [joint]], C[[joint]]


def open_loops(
    arm: Arm | Identification | None, rig: Rig, law: Law, pose: ArrayLike | None = None
) -> tuple[Matrix, Matrix, Matrix, float]:
    """Matrices A (m, m), B (m, n), C (n, m) from the counts read to the positions, in pulses, and the period [s].

    States: q, qd (with elastic gears the motors', then the links'), currents that lag, the law's, and the torque
    applied last. All loops are closed by A + B C.
    """
    instance("law", law, Law, "Give a law, such as ComputedTorque(arm, rig).")
    instance("rig", rig, Rig, "Pass the rig that the law drives.")
    arm = controlled(arm, law)
    n, rig = rig.n, smooth_rig(rig)
    at = array("pose", np.zeros(n) if pose is None else pose, (n,), advice="Give one angle per joint [rad].")
    block = law.block(rig)
    if block.period is None:
        raise ValueError(f"law must have a period; {type(law).__name__} has none. Give it one, or use plant.linearise.")
    q, own, torque, pulses = held(arm, rig, law, block, at)

    # The arm, from one step of the law to the next: so many sub-steps under one torque.
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=_SUB_STEPS, smooth=True)
    state, row = ca.SX.sym("state", len(loop.state_names)), np.append(np.zeros(4 * n), loop.h)
    numbers = loop.number_values(arm.f)
    for i, name in enumerate(loop.number_names):
        if name.startswith(DRY_FRICTION):
            numbers[i] = 0.0
    at_rest = loop.initial_state(q, np.zeros(n), numbers)
    at_rest[3 * n : 4 * n] = torque
    if "driven" in loop.giving:
        at_rest[[i for i, name in enumerate(loop.state_names) if name.startswith("driven")]] = torque
    slope = ca.Function("slope", [state], [ca.jacobian(loop.substep(state, row, numbers)[0], state)])(at_rest).full()
    kept = [i for i, name in enumerate(loop.state_names) if name.startswith(_MOVING)]
    m, kept = len(kept), kept + list(range(3 * n, 4 * n))
    moved = np.linalg.matrix_power(slope[np.ix_(kept, kept)], loop.steps_per_law)[:m]

    # The law: the torque that it commands now, and its next state.
    s, t, p = ca.SX.sym("own", len(own)), ca.SX.sym("torque", n), ca.SX.sym("pulses", n)
    step = ca.vertcat(*block.step(s, at, 0, 0, rig.counts(at), p, t, block.period, block.values))
    slopes = ca.Function("law", [s, t, p], [ca.jacobian(step, x) for x in (s, t, p)])(own, torque, pulses)
    by_own, by_torque, by_pulses = (each.full() for each in slopes)

    remembered = np.hstack([np.zeros((n + len(own), m)), by_own, by_torque])
    arm_and_law = moved[:, :m], moved[:, m:]
    A = np.vstack([arm_and_law[1] @ remembered[:n], remembered[n:], remembered[:n]])
    A[:m, :m] += arm_and_law[0]
    B = np.vstack([arm_and_law[1] @ by_pulses[:n], by_pulses[n:], by_pulses[:n]])
    C, first = np.zeros((n, len(A))), 2 * n if rig.encoder.side == "link" else 0
    C[:, first : first + n] = rig.position_in_pulses(np.eye(n)).T
    return A, B, C, block.period


def held(arm: Arm, rig: Rig, law: Law, block: Block, pose: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Where the arm comes to rest under the law with a reference at rest: q, the law's state, torque, and pulses.

    By Newton's method: the commanded torque carries the arm, and the law's state stays.
    """
    n = rig.n
    q, s = ca.SX.sym("q", n), ca.SX.sym("own", len(block.initial))
    torque = arm.dynamics.h(q, ca.SX.zeros(n), arm.f) + rig.drive.friction(ca.SX.zeros(n))
    counts, pulses = rig.counts(pose), rig.position_in_pulses(q)
    commanded, following = block.step(s, pose, 0, 0, counts, pulses, torque, block.period or 0.0, block.values)
    x, rest = ca.vertcat(q, s), ca.vertcat(commanded - torque, following - s)
    newton = ca.Function("newton", [x], [rest, ca.jacobian(rest, x), torque])
    point = np.concatenate([pose, block.initial])
    for _ in range(50):
        left, slope, _ = (each.full() for each in newton(point))
        change = np.linalg.lstsq(slope, left[:, 0], rcond=None)[0]
        point = point - change
        if np.abs(change).max() <= 1e-10 * (1 + np.abs(point).max()):
            break
    left, _, torque = (each.full().ravel() for each in newton(point))
    if not np.abs(left).max() <= 1e-6 * (1 + np.abs(torque).max()):
        raise ValueError(f"{type(law).__name__} must hold the arm at rest at {pose}; it cannot. Give another pose.")
    return point[:n], point[n:], torque, rig.position_in_pulses(point[:n])
