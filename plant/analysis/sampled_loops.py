"""The loops of all joints under a sampled law, linearised about an arm held at a pose.

The matrices come from the law's own equations and the simulator's own sub-step. The encoder does
not round, and the amplifier is below its limit. Viscous friction acts; dry friction is left out,
since it is constant while a joint slides one way.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.laws import Block, Law
from plant.machine import Rig, smooth_rig
from plant.mechanics import Arm
from plant.parts import array, instance
from plant.simulation import ClosedLoop

# Sub-steps per sample. `simulate` describes this number as nearly converged, so that the matrices
# are those of the sampled arm, not of a coarse integration.
_SUB_STEPS = 16

# A constant state, such as parameters at rest, has the eigenvalue 1. Rounding moves this eigenvalue
# out of the unit circle by less than this number.
KEPT = 1e-9

Matrix = NDArray[np.float64]


class SampledLoops:
    """Linearised loops of all joints, under a law with a period, about a pose (n,) at rest [rad].

    The pose is zeros by default. ``names`` are the names of the numbers of the closed loop;
    `matrices` can give these numbers other values. ``period`` is the period of the law [s].
    """

    def __init__(self, arm: Arm, rig: Rig, law: Law, pose: ArrayLike | None = None) -> None:
        instance("rig", rig, Rig, "Pass the rig that the law drives.")
        rig.require_fit(arm.dynamics.chain)
        n = rig.n
        # For a linear loop, the encoder does not round, the arm has no dry friction, and the law
        # compensates none.
        rig = smooth_rig(rig)
        law = law.sliding()
        if pose is None:
            pose = np.zeros(n)
        q_r = array("pose", pose, (n,), advice="Give one angle per joint [rad].")
        block = law.block(rig)
        if block.period is None:
            kind = type(law).__name__
            raise ValueError(
                f"law must have a period; {kind} has none. Give it one, or use plant.linearise."
            )
        self.period = block.period
        self.rig = rig
        self._q, law_state, self._torque, pulses = held(arm, rig, law, block, q_r)

        # 1. The arm: the derivative of one sub-step by what moves and by the torque. A step of the
        # law has several sub-steps under one torque.
        loop = ClosedLoop(
            dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=_SUB_STEPS, smooth=True
        )
        state = ca.SX.sym("state", len(loop.state_names))
        numbers = ca.SX.sym("numbers", len(loop.number_names))
        self.names = loop.number_names
        self._loop = loop
        self._values = loop.sliding_values(arm.f)
        following = loop.substep(state, loop.time_with(), numbers)[0]
        moving = loop.moving_states()
        self._moving = moving
        places = loop.state_fields.at(n)
        rows = [*moving, *(places["torque"] if block.sent is None else places["sent"])]
        # The frame sent last moves the arm, or the torque applied last if the law sends no frames.
        # The Jacobian keeps the rows and columns of this input beside those of the motion.
        jacobian = ca.jacobian(following, state)[rows, rows]
        self._slope = ca.Function("slope", [state, numbers], [jacobian])

        # 2. The law: the derivative of the torque that it commands now, and of its next state.
        s = ca.SX.sym("own", len(law_state))
        t = ca.SX.sym("torque", n)
        p = ca.SX.sym("pulses", n)
        step = ca.vertcat(
            *block.step(s, q_r, 0, 0, rig.counts(q_r), p, t, block.period, block.values)
        )
        slopes = ca.Function("law", [s, t, p], [ca.jacobian(step, x) for x in (s, t, p)])
        self._law = [slope.full() for slope in slopes(law_state, self._torque, pulses)]
        # An inner loop moves the arm by the frame that the torque becomes.
        self._sent = None
        self._by_torque = np.eye(n)
        if block.sent is not None:
            frame = block.sent(q_r, 0, 0, pulses, t, block.values)
            sent = ca.Function("sent", [t], [frame, ca.jacobian(frame, t)])(self._torque)
            self._sent, self._by_torque = (matrix.full() for matrix in sent)

    def matrices(self, numbers: Mapping[str, float] | None = None) -> tuple[Matrix, Matrix, Matrix]:
        """A (k, k), B (k, n), C (n, k), from the counts that the law reads to positions [pulses].

        The k states are q, qd (with elastic gears the motors', then the links'), currents that lag,
        the states of the law, and the torque applied last. A + B C closes all loops. `numbers`
        gives the plant other values by name (see ``names``); the law keeps its own.
        """
        loop = self._loop
        n = self.rig.n
        m = len(self._moving)
        # The law keeps the numbers that it was made with: only the plant differs.
        values = self._values.copy()
        for name, value in (numbers or {}).items():
            values[self.names.index(name)] = value

        # 1. The arm at rest under the holding torque, over one period of the law.
        at_rest = loop.initial_state(self._q, np.zeros(n), values)
        places = loop.state_fields.at(n)
        at_rest[places["torque"]] = self._torque
        if places["driven"]:
            at_rest[places["driven"]] = self._torque
        if self._sent is not None:
            at_rest[places["sent"]] = self._sent[:, 0]
            # The memory of the inner loop at rest is the one that a step leaves.
            after = loop.substep(at_rest, loop.time_with(), values)[0].full()[:, 0]
            at_rest[places["inner"]] = after[places["inner"]]
        moved = np.linalg.matrix_power(self._slope(at_rest, values).full(), loop.steps_per_law)[:m]
        by_torque = moved[:, m:] @ self._by_torque

        # 2. The arm together with the law. The first n rows of the law give the torque, which acts
        # on the arm; the other rows give the next state of the law. The torque applied last is a
        # state of its own, since the law may depend on it.
        law_by_state, law_by_torque, law_by_pulses = self._law
        law = np.hstack([np.zeros((len(law_by_state), m)), law_by_state, law_by_torque])
        A = np.vstack([by_torque @ law[:n], law[n:], law[:n]])
        A[:m, :m] += moved[:, :m]
        B = np.vstack([by_torque @ law_by_pulses[:n], law_by_pulses[n:], law_by_pulses[:n]])

        # 3. The measured positions.
        C = np.zeros((n, len(A)))
        measured = places["link" if self.rig.encoder.side == "link" else "q"]
        begin = self._moving.index(measured.start)
        C[:, begin : begin + n] = self.rig.position_in_pulses(np.eye(n)).T
        return A, B, C

    def unstable_pole(self, numbers: Mapping[str, float] | None = None) -> complex | None:
        """The pole [1/s] that grows fastest with all loops closed; None where they are stable."""
        # Counts are fed back to the law: u = C x.
        A, B, C = self.matrices(numbers)
        poles = np.linalg.eigvals(A + B @ C)
        largest = poles[np.argmax(np.abs(poles))]
        if abs(largest) <= 1 + KEPT:
            return None
        return complex(np.log(complex(largest)) / self.period)


def held(
    arm: Arm, rig: Rig, law: Law, block: Block, pose: Matrix
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Equilibrium of the arm under the law with a reference at rest at a pose (n,) [rad].

    Returns q, the state of the law, torque and pulses. By Newton's method: the commanded torque
    carries the arm, and the law's state stays.
    """
    n = rig.n
    q = ca.SX.sym("q", n)
    s = ca.SX.sym("own", len(block.initial))
    weight = arm.dynamics.h(q, ca.SX.zeros(n), arm.f) - rig.spring_torque(q)
    torque = weight + rig.drive.friction(ca.SX.zeros(n))
    # An inner loop bears a part of the weight, in proportion to the distance of the arm from the
    # pose.
    inner = law.rig_of_frames(rig).inner
    if inner is not None:
        coupling = rig.drive.coupling
        torque = torque - coupling.joint_torque(inner.stiffness_of(rig) * coupling.shaft(pose - q))
    counts = rig.counts(pose)
    pulses = rig.position_in_pulses(q)
    commanded, following = block.step(
        s, pose, 0, 0, counts, pulses, torque, block.period or 0.0, block.values
    )
    x = ca.vertcat(q, s)
    residual = ca.vertcat(commanded - torque, following - s)
    newton = ca.Function("newton", [x], [residual, ca.jacobian(residual, x), torque, following])
    point = np.concatenate([pose, block.initial])
    # A law may treat its first samples differently, as a flag in its state tells. Two steps pass
    # these samples.
    for _ in range(2):
        point[n:] = newton(point)[-1].full().ravel()
    for _ in range(50):
        error, slope = (matrix.full() for matrix in newton(point)[:2])
        # By least squares, since a state that only integrates leaves the Jacobian singular.
        change = np.linalg.lstsq(slope, error[:, 0], rcond=None)[0]
        point = point - change
        if np.abs(change).max() <= 1e-10 * (1 + np.abs(point).max()):
            break
    error, _, torque, _ = (matrix.full().ravel() for matrix in newton(point))
    if not np.abs(error).max() <= 1e-6 * (1 + np.abs(torque).max()):
        raise ValueError(
            f"{type(law).__name__} must hold the arm at rest at {pose}; it cannot. Give another"
            " pose."
        )
    return point[:n], point[n:], torque, rig.position_in_pulses(point[:n])
