"""The arm along a reference: the torque that the model needs, and its answer to more, linearised;
what a log misses.

Source of the smoother: Bierman, Fixed interval smoothing with discrete measurements, Int. J.
Control 18 (1973): the modified Bryson-Frazier smoother.
"""

import dataclasses
import itertools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from plant import Arm, Reference, Rig
from plant.motion.link_reference import gear_torque, require_elastic, wound
from plant.parts.fields import Floats

_SLIDES = 30.0  # speed [pulses/s] from which on the model has Coulomb friction in full

# (omega dt)^2 of links on their gears up to which Runge-Kutta 4 follows them; beyond, gears are
# rigid
_FOLLOWED = 4.0

_HALVINGS = 3  # of a sample, for its transition matrix


@dataclasses.dataclass(frozen=True, eq=False)
class PathPlant:
    """N samples of the model along a reference: motion of the links, and the torque [N m] that it
    needs to the next.

    The transition (N, m + n, m + n) is of deviations, without Coulomb friction: angles and speeds
    (of motors, then links), and the torque (n) that is missing.
    """

    torque: Floats
    transition: Floats
    q: Floats
    qd: Floats
    qdd: Floats


def path_plant(arm: Arm, rig: Rig, reference: Reference, count: int) -> PathPlant:
    """The model along so many samples of a reference, which the encoders' side of the gears
    follows exactly.
    """
    if rig.drive.elasticity is not None:
        require_elastic("learn", rig)
        rig = _as_stiff(arm, rig, reference(np.zeros(1)).q[0])
    n = arm.n
    dt = rig.period
    drive = rig.drive
    x, u, accelerations = _equations(arm, rig)
    own = ca.jacobian(accelerations[:n], u)
    asked = ca.SX.sym("qdd", n)
    needed = ca.solve(own, asked - ca.substitute(accelerations[:n], u, ca.SX.zeros(n)))
    half = x.numel() // 2
    rate = ca.vertcat(x[half:], accelerations)
    moves = ca.Function("moves", [x, asked], [needed, accelerations[n:]])
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(rate, x), ca.jacobian(rate, u)])

    motion = reference(dt * np.arange(2 * count + 1) / 2)  # with the middles of the samples
    states = (
        _states(arm, rig, moves, motion, count)
        if half > n
        else np.hstack([motion.q[::2], motion.qd[::2]])
    )
    speed = drive.coupling.shaft(motion.qd[::2])
    slides = np.abs(drive.gear) * rig.encoder.position_in_pulses(speed) / _SLIDES
    dry = drive.joint_coulomb(speed) * np.clip(slides, -1, 1)
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
        torque=(whole[:-1] + whole[1:]) / 2,
        transition=_exponentials(grown * dt),
        q=states[:-1, links[0]],
        qd=states[:-1, links[1]],
        qdd=qdd[:-1],
    )


def _as_stiff(arm: Arm, rig: Rig, q: Floats) -> Rig:
    """The rig, with rigid gears where links swing too fast for a step of its period."""
    drive: Any = rig.drive
    links = drive.coupling.shaft_inertia(ca.DM(arm.D(q))).full() - np.diag(
        drive.reflected_inertia()
    )
    squares = np.linalg.eigvals(np.linalg.solve(links, np.diag(drive.elasticity.stiffness))).real
    if squares.max() * rig.period**2 < _FOLLOWED:
        return rig
    return dataclasses.replace(rig, drive=dataclasses.replace(drive, elasticity=None))


def _equations(arm: Arm, rig: Rig) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State, joint torque of the motors, and accelerations: of the joints, or of motors and
    links.
    """
    n = arm.n
    dynamics = arm.dynamics
    drive = rig.drive
    f = arm.f
    elastic: Any = drive.elasticity
    x = ca.SX.sym("x", 2 * n if elastic is None else 4 * n)
    u = ca.SX.sym("u", n)
    coupling = drive.coupling
    if elastic is None:
        q, qd = ca.vertsplit(x, n)
        pushed = u - coupling.joint_torque(drive.joint_viscous() * coupling.shaft(qd))
        return (
            x,
            u,
            ca.solve(dynamics.D(q, f), pushed - dynamics.h(q, qd, f) + rig.spring_torque(q)),
        )
    q_m, q, qd_m, qd = ca.vertsplit(x, n)
    bend = ca.SX.sym("bend", n)
    carried = elastic.stiffness * coupling.shaft(q_m - q) + elastic.damping * coupling.shaft(
        qd_m - qd
    )
    taken = gear_torque(dynamics, rig, q, qd, bend, f)
    links = ca.solve(ca.jacobian(taken, bend), carried - ca.substitute(taken, bend, ca.SX.zeros(n)))
    pushed = coupling.shaft_torque(u) - carried - drive.joint_viscous() * coupling.shaft(qd_m)
    return x, u, ca.vertcat(coupling.joint(pushed / drive.reflected_inertia()), links)


def _states(arm: Arm, rig: Rig, moves: ca.Function, motion: Any, count: int) -> Floats:
    """Motors on the reference, and links moved by them (count + 1, 4 n), by Runge-Kutta 4."""
    n = arm.n
    dt = rig.period
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
    part = matrices / 2**_HALVINGS
    one = np.eye(matrices.shape[1])
    found = one + part @ (one + part / 2 @ (one + part / 3 @ (one + part / 4)))
    for _ in range(_HALVINGS):
        found = found @ found
    return np.asarray(found)


_OMEGA = 100.0  # bandwidth of the estimate [rad/s]

# How long the count of a joint stands that sticks, and for how long its friction is taken to hold
# on [s].
_STANDS = 0.02
_MEMORY = 0.05


class Missing(NamedTuple):
    """Torque (N, n) that was missing [N m], which joints stood (N, n), mean normalised
    innovation.
    """

    torque: Floats
    stands: Floats
    innovation: float


def missing_torque(
    plant: PathPlant,
    rig: Rig,
    inertia: Floats,
    beyond: Floats,
    e: Floats,
    counts: Floats,
    moves: Any,
) -> Missing:
    """The torque that was missing along a path.

    `inertia` (n,) is that which each joint feels [kg m^2]; (N, n) are the applied torque `beyond`
    what the model needs, `e`, middle of the quantisation cell less the reference [rad], counts, and
    where the reference moves: there innovations count.
    """
    N, n = e.shape
    dt = rig.period
    m = plant.transition.shape[1] - n
    pulse = np.asarray(rig.to_angle(np.eye(n))).T
    R = pulse @ pulse.T / 12
    walk = (inertia * _OMEGA**3) ** 2 * np.diag(R) * dt
    least = round(_STANDS / dt)
    stands = standing(counts, least)
    for pairs in (counts // 2, (counts + 1) // 2):  # between two cells
        stands = np.where(moves, stands, np.maximum(stands, standing(pairs, least)))
    level = rig.drive.joint_coulomb(np.zeros(n)) ** 2 * _MEMORY / dt
    one = np.eye(m + n)
    H = np.eye(n, m + n)
    Q = np.zeros_like(one)
    Q[m:, m:] = np.diag(walk * dt)
    P = np.zeros_like(one)
    P[: m // 2, : m // 2] = np.kron(np.eye(m // 2 // n), 12 * R)
    P[m // 2 : m, m // 2 : m] = np.kron(np.eye(m // 2 // n), 12 * R * _OMEGA**2)
    P[m:, m:] = np.diag(walk)  # what it walks in 1 s
    z = np.zeros(m + n)
    total = 0.0
    kept = []
    for k in range(N):
        inverse = np.linalg.inv(P[:n, :n] + R)
        nu = e[k] - z[:n]
        total += float(nu**2 / np.diag(P[:n, :n] + R) @ moves[k])
        gain = P[:, :n] @ inverse
        kept.append((z, P, inverse, nu, gain))
        z = z + gain @ nu
        P = P - gain @ P[:n]
        step = plant.transition[k]
        push = step[:, m:].copy()
        push[m:] = 0.0
        z = step @ z + push @ beyond[k]
        P = step @ P @ step.T + Q + (push * (level * stands[k])) @ push.T
        P = (P + P.T) / 2
    torque = np.empty((N, n))
    adjoint = np.zeros(m + n)
    for k in range(N - 1, -1, -1):
        z, P, inverse, nu, gain = kept[k]
        after = plant.transition[k].T @ adjoint
        adjoint = after - H.T @ (gain.T @ after + inverse @ nu)
        # a torque that acts beside the motors' is missing with the other sign
        torque[k] = (P @ adjoint - z)[m:]
    return Missing(torque, stands, total / max(int(moves.sum()), 1))


def standing(counts: Floats, least: int) -> Floats:
    """Whether the count of each joint stood (N, n), for so many samples at least."""
    found = np.zeros(counts.shape)
    for column, stood in zip(counts.T, found.T, strict=True):
        edges = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
        for a, b in itertools.pairwise(edges):
            stood[a:b] = b - a >= least
    return found
