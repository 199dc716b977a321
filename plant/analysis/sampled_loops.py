"""The loops of all joints under a sampled law, linearised about an arm held at a pose.

By the law's own equations and the simulator's own sub-step. The encoder does not round, the joint
slides one way (viscous friction acts, dry friction does not), and the amplifier is below its limit.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.laws.law import Block, Law
from plant.machine.rig import Rig, smooth_rig
from plant.mechanics.arm import Arm
from plant.parts.arguments import array, instance
from plant.simulation.closed_loop import ClosedLoop

_SUB_STEPS = 16

# What the states of a moving arm begin with; they come before all others but friction and torque.
_MOVING = "q[", "qd[", "link", "driven"

# by how much rounding may put the eigenvalue 1 of a constant state, such as parameters at rest,
# outside 1
KEPT = 1e-9

Matrix = NDArray[np.float64]


class SampledLoops:
    """The linearised loops of all joints about a pose (n,) at rest [rad], zeros by default, under a
    law with a period.

    Ready for other numbers of the rig; ``names`` are the numbers of the closed loop, ``period`` is
    the law's [s].
    """

    def __init__(self, arm: Arm, rig: Rig, law: Law, pose: ArrayLike | None = None) -> None:
        instance("rig", rig, Rig, "Pass the rig that the law drives.")
        n = rig.n
        rig = smooth_rig(rig)
        law = law.sliding()
        at = array(
            "pose",
            np.zeros(n) if pose is None else pose,
            (n,),
            advice="Give one angle per joint [rad].",
        )
        block = law.block(rig)
        if block.period is None:
            kind = type(law).__name__
            raise ValueError(
                f"law must have a period; {kind} has none. Give it one, or use plant.linearise."
            )
        self.period = block.period
        self.rig = rig
        self._q, own, self._torque, pulses = held(arm, rig, law, block, at)

        # The arm, from one step of the law to the next: so many sub-steps under one torque.
        loop = ClosedLoop(
            dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=_SUB_STEPS, smooth=True
        )
        state = ca.SX.sym("state", len(loop.state_names))
        numbers = ca.SX.sym("numbers", len(loop.number_names))
        row = np.append(np.zeros(4 * n), loop.h)
        self.names = loop.number_names
        self._loop = loop
        self._values = loop.sliding_values(arm.f)
        following = loop.substep(state, row, numbers)[0]
        kept = [i for i, name in enumerate(loop.state_names) if name.startswith(_MOVING)]
        self._moving = len(kept)
        kept += range(3 * n, 4 * n)
        self._slope = ca.Function(
            "slope", [state, numbers], [ca.jacobian(following, state)[kept, kept]]
        )

        # The law: the torque that it commands now, and its next state.
        s = ca.SX.sym("own", len(own))
        t = ca.SX.sym("torque", n)
        p = ca.SX.sym("pulses", n)
        step = ca.vertcat(
            *block.step(s, at, 0, 0, rig.counts(at), p, t, block.period, block.values)
        )
        slopes = ca.Function("law", [s, t, p], [ca.jacobian(step, x) for x in (s, t, p)])
        self._law = [each.full() for each in slopes(own, self._torque, pulses)]

    def matrices(self, numbers: Mapping[str, float] | None = None) -> tuple[Matrix, Matrix, Matrix]:
        """A (m, m), B (m, n), C (n, m) from the counts that the law reads to the positions, in
        pulses.

        States: q, qd (with elastic gears the motors', then the links'), currents that lag, the
        law's, and the torque applied last. All loops are closed by A + B C. With other numbers of
        the rig, by name, the law stays.
        """
        loop = self._loop
        n = self.rig.n
        m = self._moving
        values = self._values.copy()
        for name, value in (numbers or {}).items():
            values[self.names.index(name)] = value
        at_rest = loop.initial_state(self._q, np.zeros(n), values)
        at_rest[3 * n : 4 * n] = self._torque
        if "driven" in loop.giving:
            at_rest[[i for i, name in enumerate(loop.state_names) if name.startswith("driven")]] = (
                self._torque
            )
        moved = np.linalg.matrix_power(self._slope(at_rest, values).full(), loop.steps_per_law)[:m]
        by_own, by_torque, by_pulses = self._law
        remembered = np.hstack([np.zeros((len(by_own), m)), by_own, by_torque])
        A = np.vstack([moved[:, m:] @ remembered[:n], remembered[n:], remembered[:n]])
        A[:m, :m] += moved[:, :m]
        B = np.vstack([moved[:, m:] @ by_pulses[:n], by_pulses[n:], by_pulses[:n]])
        C = np.zeros((n, len(A)))
        first = 2 * n if self.rig.encoder.side == "link" else 0
        C[:, first : first + n] = self.rig.position_in_pulses(np.eye(n)).T
        return A, B, C

    def unstable_pole(self, numbers: Mapping[str, float] | None = None) -> complex | None:
        """The pole [1/s] that grows fastest with all loops closed; None where they are stable."""
        A, B, C = self.matrices(numbers)
        poles = np.linalg.eigvals(A + B @ C)
        fastest = poles[np.argmax(np.abs(poles))]
        return complex(np.log(complex(fastest)) / self.period) if abs(fastest) > 1 + KEPT else None


def held(
    arm: Arm, rig: Rig, law: Law, block: Block, pose: Matrix
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Where the arm comes to rest under the law with a reference at rest: q, the law's state,
    torque, and pulses.

    By Newton's method: the commanded torque carries the arm, and the law's state stays.
    """
    n = rig.n
    q = ca.SX.sym("q", n)
    s = ca.SX.sym("own", len(block.initial))
    weight = arm.dynamics.h(q, ca.SX.zeros(n), arm.f) - rig.spring_torque(q)
    torque = weight + rig.drive.friction(ca.SX.zeros(n))
    counts = rig.counts(pose)
    pulses = rig.position_in_pulses(q)
    commanded, following = block.step(
        s, pose, 0, 0, counts, pulses, torque, block.period or 0.0, block.values
    )
    x = ca.vertcat(q, s)
    rest = ca.vertcat(commanded - torque, following - s)
    newton = ca.Function("newton", [x], [rest, ca.jacobian(rest, x), torque, following])
    point = np.concatenate([pose, block.initial])
    for _ in range(2):  # the first samples, of which a state may say that they are
        point[n:] = newton(point)[-1].full().ravel()
    for _ in range(50):
        left, slope = (each.full() for each in newton(point)[:2])
        change = np.linalg.lstsq(slope, left[:, 0], rcond=None)[0]
        point = point - change
        if np.abs(change).max() <= 1e-10 * (1 + np.abs(point).max()):
            break
    left, _, torque, _ = (each.full().ravel() for each in newton(point))
    if not np.abs(left).max() <= 1e-6 * (1 + np.abs(torque).max()):
        raise ValueError(
            f"{type(law).__name__} must hold the arm at rest at {pose}; it cannot. Give another"
            " pose."
        )
    return point[:n], point[n:], torque, rig.position_in_pulses(point[:n])
