"""The arm linearised along a reference, and the torque that a log shows to be missing there.

Source of the smoother: Bierman, Fixed interval smoothing with discrete measurements, Int. J.
Control 18 (1973): the modified Bryson-Frazier smoother.
"""

import dataclasses
import itertools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ctc.laws.computed_torque_settings import SETTINGS as OF_CONTROLLER
from ctc.learning.settings import SETTINGS, LearnSettings
from plant import Arm, Reference, Rig
from plant.motion import gear_torque, require_elastic, wound
from plant.parts import Floats


@dataclasses.dataclass(frozen=True, eq=False)
class PathPlant:
    """N samples of the model along a reference: motion of the links, and torque needed [N m].

    `transition` (N, m + n, m + n) takes deviations from one sample to the next: of m angles and
    speeds (of rigid joints, or of motors, then links), and of the n missing torques. It is without
    Coulomb friction.
    """

    torque: Floats
    transition: Floats
    q: Floats
    qd: Floats
    qdd: Floats


def path_plant(
    arm: Arm, rig: Rig, reference: Reference, count: int, settings: LearnSettings = SETTINGS
) -> PathPlant:
    """The model along `count` samples of a reference that the encoders follow exactly."""
    if rig.drive.elasticity is not None:
        require_elastic("learn", rig)
        rig = _as_stiff(arm, rig, reference(np.zeros(1)).q[0], settings.elastic_limit)
    n = arm.n
    dt = rig.period
    drive = rig.drive

    # 1. The torque that a motion of the encoders' side needs, and the slopes of the equations.
    # Accelerations are linear in the torque, so that one linear solve gives the needed torque.
    x, u, accelerations = _equations(arm, rig)
    mobility = ca.jacobian(accelerations[:n], u)
    qdd = ca.SX.sym("qdd", n)
    needed = ca.solve(mobility, qdd - ca.substitute(accelerations[:n], u, ca.SX.zeros(n)))
    half = x.numel() // 2
    rate = ca.vertcat(x[half:], accelerations)
    moves = ca.Function("moves", [x, qdd], [needed, accelerations[n:]])
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(rate, x), ca.jacobian(rate, u)])

    # 2. The states along the reference, on elastic gears with those of the links.
    motion = reference(dt * np.arange(2 * count + 1) / 2)  # with the middles of the samples
    # On elastic gears the reference fixes the motors alone; the links follow from the equations.
    elastic = half > n
    if elastic:
        states = _states(arm, rig, moves, motion, count)
    else:
        states = np.hstack([motion.q[::2], motion.qd[::2]])

    # 3. The torque. The equations have viscous friction already. Coulomb friction and offset are
    # added as in the default controller: in proportion at low speed, raised by the gears' load.
    smooth, link_qdd = moves.map(count + 1)(states.T, motion.qdd[::2].T)
    torque = smooth.full().T
    speed = drive.coupling.shaft(motion.qd[::2])
    viscous = drive.coupling.joint_torque(drive.joint_viscous(speed) * speed)
    load = torque - viscous - drive.rotor_torque(motion.qdd[::2])
    pulses = np.abs(drive.gear) * rig.encoder.position_in_pulses(speed)
    slides = pulses / OF_CONTROLLER.sliding_speed
    dry = drive.loaded(drive.joint_coulomb(speed), load) * np.clip(slides, -1, 1)
    torque = torque + drive.coupling.joint_torque(dry + drive.joint_offset())

    # 4. Transition matrices of deviations and missing torque, which stays within a sample.
    # Matrices at the beginning of each sample; those of the last instant are not needed.
    A, B = (slope.full() for slope in slopes.map(count)(states[:-1].T, torque[:-1].T))
    m = 2 * half
    # One exponential of the extended matrix [[A, B], [0, 0]] gives both exp(A dt) and the response
    # to a torque that stays constant within the sample.
    grown = np.zeros((count, m + n, m + n))
    grown[:, :m, :m] = A.reshape(m, count, m).transpose(1, 0, 2)
    grown[:, :m, m:] = B.reshape(m, count, n).transpose(1, 0, 2)
    # The applied torque of a sample is compared with the mean of the needed torque at both ends.
    return PathPlant(
        torque=(torque[:-1] + torque[1:]) / 2,
        transition=exponentials(grown * dt, settings.halvings),
        q=states[:-1, half - n : half],
        qd=states[:-1, m - n : m],
        qdd=(link_qdd.full().T if elastic else motion.qdd[::2])[:-1],
    )


def _as_stiff(arm: Arm, rig: Rig, q: Floats, limit: float) -> Rig:
    """The rig; with rigid gears if its links swing too fast for a step of its period."""
    drive: Any = rig.drive
    # The squared frequencies of the links on their gears, with the motors held fast.
    links = drive.coupling.shaft_inertia(ca.DM(arm.D(q))).full() - np.diag(
        drive.reflected_inertia()
    )
    squares = np.linalg.eigvals(np.linalg.solve(links, np.diag(drive.elasticity.stiffness))).real
    if squares.max() * rig.period**2 < limit:
        return rig
    return dataclasses.replace(rig, drive=dataclasses.replace(drive, elasticity=None))


def _equations(arm: Arm, rig: Rig) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State, joint torque of the motors, and accelerations: of joints, or of motors and links."""
    n = arm.n
    dynamics = arm.dynamics
    drive = rig.drive
    f = arm.f
    elastic: Any = drive.elasticity
    x = ca.SX.sym("x", 2 * n if elastic is None else 4 * n)
    u = ca.SX.sym("u", n)
    coupling = drive.coupling
    # Coulomb friction is left out, since its step in the slope would dominate the linear model near
    # standstill. Its torque is added along the reference by the caller.
    if elastic is None:
        q, qd = ca.vertsplit(x, n)
        speed = coupling.shaft(qd)
        pushed = u - coupling.joint_torque(drive.joint_viscous(speed) * speed)
        accelerating = pushed - dynamics.h(q, qd, f) + rig.spring_torque(q)
        return x, u, ca.solve(dynamics.D(q, f), accelerating)
    q_m, q, qd_m, qd = ca.vertsplit(x, n)
    bend = ca.SX.sym("bend", n)
    carried = elastic.stiffness * coupling.shaft(q_m - q) + elastic.damping * coupling.shaft(
        qd_m - qd
    )
    # The torque that a gear carries is linear in the acceleration of its link: its slope is the
    # links' inertia, its value at zero acceleration their load.
    taken = gear_torque(dynamics, rig, q, qd, bend, f)
    links = ca.solve(ca.jacobian(taken, bend), carried - ca.substitute(taken, bend, ca.SX.zeros(n)))
    speed = coupling.shaft(qd_m)
    pushed = coupling.shaft_torque(u) - carried - drive.joint_viscous(speed) * speed
    return x, u, ca.vertcat(coupling.joint(pushed / drive.reflected_inertia()), links)


def _states(arm: Arm, rig: Rig, moves: ca.Function, motion: Any, count: int) -> Floats:
    """Motors on the reference, and links moved by them (count + 1, 4 n), by Runge-Kutta 4."""
    n = arm.n
    dt = rig.period
    q, qd, bend = (ca.SX.sym(name, n) for name in ("q", "qd", "bend"))
    deflection = wound(rig.drive, gear_torque(arm.dynamics, rig, q, qd, bend, arm.f))
    wind = ca.Function("wind", [q, qd, bend], [deflection])
    # The arm starts at rest on the reference, with gears wound by gravity: otherwise the links
    # would swing from the first sample on.
    rest = np.zeros(n)
    begin = np.append(motion.q[0] - wind(motion.q[0], rest, rest).full().ravel(), motion.qd[0])
    z, motors = ca.SX.sym("z", 2 * n), ca.SX.sym("motors", 2 * n, 3)

    def slope(z: ca.SX, motor: ca.SX) -> ca.SX:
        state = ca.vertcat(motor[:n], z[:n], motor[n:], z[n:])
        return ca.vertcat(z[n:], moves(state, ca.SX.zeros(n))[1])

    a = slope(z, motors[:, 0])
    b = slope(z + dt / 2 * a, motors[:, 1])
    c = slope(z + dt / 2 * b, motors[:, 1])
    d = slope(z + dt * c, motors[:, 2])
    step = ca.Function("step", [z, motors], [z + dt / 6 * (a + 2 * b + 2 * c + d)])
    # Runge-Kutta needs the motors at the beginning, the middle and the end of each sample.
    driven = np.hstack([motion.q, motion.qd])
    rows = np.stack([driven[:-2:2], driven[1::2], driven[2::2]], axis=2)
    columns = rows.transpose(1, 0, 2).reshape(2 * n, -1)
    links = step.mapaccum(count)(begin, columns).full().T
    links = np.vstack([begin, links])
    return np.hstack([motion.q[::2], links[:, :n], motion.qd[::2], links[:, n:]])


def exponentials(matrices: Floats, halvings: int) -> Floats:
    """Exponentials of matrices (N, m, m), by Taylor's series of fourth order."""
    # Division by 2^halvings makes the matrices small enough for the series; squaring undoes it.
    part = matrices / 2**halvings
    one = np.eye(matrices.shape[1])
    power = one + part @ (one + part / 2 @ (one + part / 3 @ (one + part / 4)))
    for _ in range(halvings):
        power = power @ power
    return power


class Missing(NamedTuple):
    """Missing torque (N, n) [N m], 1 where a joint stood (N, n), mean normalised innovation."""

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
    settings: LearnSettings,
) -> Missing:
    """The torque that was missing along a path, by a Kalman filter and a smoother back over it.

    `inertia` (n,) is what each joint feels [kg m^2]. The others are (N, n): `beyond` is the applied
    torque less the model's [N m], `e` the middle of the quantisation cell less the reference [rad],
    `counts` the measured ones. `moves` tells where the reference moves; only there innovations
    count.
    """
    N, n = e.shape
    dt = rig.period
    m = plant.transition.shape[1] - n
    half = m // 2
    omega = settings.smoother_bandwidth

    # 1. Noises: rounding of counts, uniform in a cell; a random walk of the missing torque that
    # places the filter's bandwidth; and dry friction, which is unknown while a joint stands.
    # A pulse of each shaft as angles of the joints: coupled joints have correlated rounding.
    pulse = np.asarray(rig.to_angle(np.eye(n))).T
    R = pulse @ pulse.T / 12
    walk = (inertia * omega**3) ** 2 * np.diag(R) * dt
    samples = round(settings.standing_time / dt)
    stands = standing(counts, samples)
    # A joint at the edge of two cells stands, too, although its count flips.
    for pairs in (counts // 2, (counts + 1) // 2):
        stands = np.where(moves, stands, np.maximum(stands, standing(pairs, samples)))
    level = rig.drive.joint_coulomb() ** 2 * settings.standing_memory / dt
    one = np.eye(m + n)
    Q = np.zeros_like(one)
    Q[m:, m:] = np.diag(walk * dt)
    P = np.zeros_like(one)
    # At the start, an angle has a standard deviation of a pulse, whose square is 12 R; a speed has
    # omega times as much.
    angles = np.kron(np.eye(half // n), 12 * R)
    P[:half, :half] = angles
    P[half:m, half:m] = angles * omega**2
    P[m:, m:] = np.diag(walk)  # as far as it walks in 1 s

    # 2. Forward: correct by the count, then predict.
    z = np.zeros(m + n)
    total = 0.0
    steps = []
    for k in range(N):
        S = P[:n, :n] + R
        inverse = np.linalg.inv(S)
        nu = e[k] - z[:n]
        total += float(nu**2 / np.diag(S) @ moves[k])
        gain = P[:, :n] @ inverse
        steps.append((z, P, inverse, nu, gain))
        z = z + gain @ nu
        # A random walk is not pushed by a torque: `push` acts on angles and speeds alone.
        P = P - gain @ P[:n]
        step = plant.transition[k]
        push = step[:, m:].copy()
        push[m:] = 0.0
        z = step @ z + push @ beyond[k]
        P = step @ P @ step.T + Q + (push * (level * stands[k])) @ push.T
        P = (P + P.T) / 2  # against rounding, over thousands of steps

    # 3. Backward: the adjoint carries to each sample what later counts say of it.
    torque = np.empty((N, n))
    adjoint = np.zeros(m + n)
    for k in range(N - 1, -1, -1):
        z, P, inverse, nu, gain = steps[k]
        adjoint = plant.transition[k].T @ adjoint
        # Counts measure the first n numbers of the state alone.
        adjoint[:n] -= gain.T @ adjoint + inverse @ nu
        # The smoothed state is z - P adjoint. It holds the torque that acts beside the motors'; the
        # torque that the motors must add is its negative.
        torque[k] = (P @ adjoint - z)[m:]
    return Missing(torque, stands, total / max(int(moves.sum()), 1))


def standing(counts: Floats, samples: int) -> Floats:
    """1 where the count of a joint stayed the same for at least so many samples, else 0 (N, n)."""
    # A single sample does not show that a count stayed: a long period may exceed the time asked.
    samples = max(samples, 2)
    stands = np.zeros(counts.shape)
    for column, result in zip(counts.T, stands.T, strict=True):
        changes = np.flatnonzero(np.diff(column)) + 1
        edges = np.concatenate([[0], changes, [len(column)]])
        for begin, end in itertools.pairwise(edges):
            result[begin:end] = end - begin >= samples
    return stands
