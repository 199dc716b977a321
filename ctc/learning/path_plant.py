"""The arm along a reference: the torque that the model needs, and its answer to more, linearised."""

import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from plant import Arm, Reference, Rig
from plant.motion.link_reference import gear_torque, require_elastic, wound
from plant.parts.fields import Floats

_SLIDES = 30.0
"""Speed [pulses/s] from which on the model has Coulomb friction in full."""

_FOLLOWED = 4.0
"""(omega dt)^2 of links on their gears up to which Runge-Kutta 4 follows them; beyond, gears are rigid."""

_HALVINGS = 3
"""Of a sample, for its transition matrix."""


@dataclasses.dataclass(frozen=True, eq=False)
class PathPlant:
    """N samples of the model along a reference, without Coulomb friction in its deviations.

    Attributes
    ----------
    torque : (N, n) numpy.ndarray
        That the model needs from each sample to the next, friction included [N m].
    transition : (N, m + n, m + n) numpy.ndarray
        Of deviations: angles and speeds (of motors, then links), and the torque (n) that is missing.
    q, qd, qdd : (N, n) numpy.ndarray
        Motion of the links.
    """

    torque: Floats
    transition: Floats
    q: Floats
    qd: Floats
    qdd: Floats


def path_plant(arm: Arm, rig: Rig, reference: Reference, count: int) -> PathPlant:
    """The model along so many samples of a reference, which the encoders' side of the gears follows exactly."""
    if rig.drive.elasticity is not None:
        require_elastic("learn", rig)
        rig = _as_stiff(arm, rig, reference(np.zeros(1)).q[0])
    n, dt, drive = arm.n, rig.period, rig.drive
    x, u, accelerations = _equations(arm, rig)
    own = ca.jacobian(accelerations[:n], u)
    asked = ca.SX.sym("qdd", n)
    needed = ca.solve(own, asked - ca.substitute(accelerations[:n], u, ca.SX.zeros(n)))
    half = x.numel() // 2
    rate = ca.vertcat(x[half:], accelerations)
    moves = ca.Function("moves", [x, asked], [needed, accelerations[n:]])
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(rate, x), ca.jacobian(rate, u)])

    motion = reference(dt * np.arange(2 * count + 1) / 2)  # with the middles of the samples
    states = _states(arm, rig, moves, motion, count) if half > n else np.hstack([motion.q[::2], motion.qd[::2]])
    speed = drive.coupling.shaft(motion.qd[::2])
    dry = drive.joint_coulomb(speed) * np.clip(
        np.abs(drive.gear) * rig.encoder.position_in_pulses(speed) / _SLIDES, -1, 1
    )
    viscous_less, bends = moves.map(count + 1)(states.T, motion.qdd[::2].T)
    whole = viscous_less.full().T + drive.coupling.joint_torque(dry + drive.joint_offset())
    A, B = (np.asarray(each.full()) for each in slopes.map(count)(states[:-1].T, whole[:-1].T))
    m = 2 * half
    grown = np.zeros((count, m + n, m + n))
    grown[:, :m, :m] = A.reshape(m, count, m).transpose(1, 0, 2)
    grown[:, :m, m:] = B.reshape(m, count, n).transpose(1, 0, 2)
    links = slice(half - n, half), slice(m - n, m)
    qdd = bends.full().T if half > n else motion.qdd[::2]
    return PathPlant(
        torque=(whole[:-1] + whole[1:]) / 2, transition=_exponentials(grown * dt), q=states[:-1, links[0]],
        qd=states[:-1, links[1]], qdd=qdd[:-1],
    )  # fmt: skip


def _as_stiff(arm: Arm, rig: Rig, q: Floats) -> Rig:
    """The rig, with rigid gears where links swing too fast for a step of its period."""
    drive: Any = rig.drive
    links = drive.coupling.shaft_inertia(ca.DM(arm.D(q))).full() - np.diag(drive.reflected_inertia())
    squares = np.linalg.eigvals(np.linalg.solve(links, np.diag(drive.elasticity.stiffness))).real
    if squares.max() * rig.period**2 < _FOLLOWED:
        return rig
    return dataclasses.replace(rig, drive=dataclasses.replace(drive, elasticity=None))


def _equations(arm: Arm, rig: Rig) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State, joint torque of the motors, and accelerations: of the joints, or of motors and links."""
    n, dynamics, drive, f = arm.n, arm.dynamics, rig.drive, arm.f
    elastic: Any = drive.elasticity
    x, u = ca.SX.sym("x", 2 * n if elastic is None else 4 * n), ca.SX.sym("u", n)
    coupling = drive.coupling
    if elastic is None:
        q, qd = ca.vertsplit(x, n)
        pushed = u - coupling.joint_torque(drive.joint_viscous() * coupling.shaft(qd))
        return x, u, ca.solve(dynamics.D(q, f), pushed - dynamics.h(q, qd, f) + rig.spring_torque(q))
    q_m, q, qd_m, qd = ca.vertsplit(x, n)
    bend = ca.SX.sym("bend", n)
    carried = elastic.stiffness * coupling.shaft(q_m - q) + elastic.damping * coupling.shaft(qd_m - qd)
    taken = gear_torque(dynamics, rig, q, qd, bend, f)
    links = ca.solve(ca.jacobian(taken, bend), carried - ca.substitute(taken, bend, ca.SX.zeros(n)))
    pushed = coupling.shaft_torque(u) - carried - drive.joint_viscous() * coupling.shaft(qd_m)
    return x, u, ca.vertcat(coupling.joint(pushed / drive.reflected_inertia()), links)


def _states(arm: Arm, rig: Rig, moves: ca.Function, motion: Any, count: int) -> Floats:
    """Motors on the reference, and links moved by them (count + 1, 4 n), by Runge-Kutta 4."""
    n, dt = arm.n, rig.period
    q, qd, bend = (ca.SX.sym(name, n) for name in ("q", "qd", "bend"))
    deflection = wound(rig.drive, gear_torque(arm.dynamics, rig, q, qd, bend, arm.f))
    wind = ca.Function("wind", [q, qd, bend], [deflection])
    begin = motion.q[0] - wind(motion.q[0], np.zeros(n), np.zeros(n)).full().ravel()
    z, motors = ca.SX.sym("z", 2 * n), ca.SX.sym("motors", 2 * n, 3)

    def slope(z: ca.SX, motor: ca.SX) -> ca.SX:
        state = ca.vertcat(motor[:n], z[:n], motor[n:], z[n:])
        return ca.vertcat(z[n:], moves(state, ca.SX.zeros(n))[1])

    a = slope(z, motors[:, 0])
    b = slope(z + dt / 2 * a, motors[:, 1])
    c = slope(z + dt / 2 * b, motors[:, 1])
    d = slope(z + dt * c, motors[:, 2])
    step = ca.Function("step", [z, motors], [z + dt / 6 * (a + 2 * b + 2 * c + d)])
    driven = np.hstack([motion.q, motion.qd])
    rows = np.stack([driven[:-2:2], driven[1::2], driven[2::2]], axis=2)
    columns = rows.transpose(1, 0, 2).reshape(2 * n, -1)
    links = step.mapaccum(count)(np.append(begin, motion.qd[0]), columns).full().T
    links = np.vstack([np.append(begin, motion.qd[0]), links])
    return np.hstack([motion.q[::2], links[:, :n], motion.qd[::2], links[:, n:]])


def _exponentials(matrices: Floats) -> Floats:
    """Exponentials of matrices (N, m, m): Taylor's fourth order of a part, squared up."""
    part, one = matrices / 2**_HALVINGS, np.eye(matrices.shape[1])
    found = one + part @ (one + part / 2 @ (one + part / 3 @ (one + part / 4)))
    for _ in range(_HALVINGS):
        found = found @ found
    return np.asarray(found)
