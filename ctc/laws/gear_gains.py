"""Gains of computed torque on elastic gears: filter and regulator by the inertia of each joint."""

import functools
from typing import Any

import casadi as ca
import numpy as np

from ctc.laws.gears import GAINS, POWERS, Deviation, ElasticGears, Springs
from ctc.laws.observer import DRIFT
from plant import Arm, Dynamics, Rig
from plant.parts import Floats

# (omega dt)^2 of motors against their links, at the median pose, above which gears are taken for
# rigid: a filter of this period cannot follow them. Chosen by hand.
_FOLLOWED = 1.0

# Random poses that give the range of a joint's inertia. Chosen by hand; another number is another
# table of gains.
_POSES = 200

# Doublings of the horizon of a Riccati equation: 2^20 samples, far beyond any time constant here.
_DOUBLINGS = 20


def gear_gains(
    arm: Arm, rig: Rig, bandwidth: float, observer: float, softness: float
) -> Floats | None:
    """Table of `ElasticGears`, or None where the model takes gears for rigid.

    That is so for gears without elasticity, too stiff for the period, whose rotors are all of D,
    and above an inner loop.

    Gains of each joint alone, with the inertia 1 / (D^-1)_jj that it feels at a pose: Kalman filter
    and linear-quadratic regulator of motor, link and their speeds, the filter with a disturbance
    torque on the motor. Noise of the torque, on both, and cost are those for which rigid gears give
    the bandwidths [rad/s]. `softness` is that of `ElasticGears`.
    """
    n = arm.n
    dt = rig.period
    drive = rig.drive
    rotors = drive.reflected_inertia()
    elasticity = _followed(rig)
    if elasticity is None:
        return None
    # Gains must serve every pose, so the range of each joint's inertia is sampled.
    D = _inertias(arm, rig)
    # Where D does not exceed the rotors there are no links to predict; few such poses are rounding,
    # many are no elastic arm.
    D = D[np.linalg.eigvalsh(D - np.diag(rotors)).min(axis=1) > 0]
    if len(D) < _POSES / 2:
        return None
    # of motors against their links
    mobility = np.linalg.inv(D - np.diag(rotors)) + np.diag(1 / rotors)
    # Squared angular frequencies of all gears at a pose: the eigenvalues of stiffness times
    # mobility.
    swings = np.linalg.eigvals(elasticity.stiffness[:, None] * mobility).real
    if np.median(swings.max(axis=1)) * dt**2 > _FOLLOWED:
        return None
    # The inertia that a joint feels, as a share: rotor inertia over 1 / (D^-1)_jj.
    shares = rotors * np.diagonal(np.linalg.inv(D), axis1=1, axis2=2)
    low = shares.min(axis=0)
    high = shares.max(axis=0)
    middle = (high + low) / 2
    # The inertia of a joint may not change at all; a range needs a width, to divide by.
    half = np.maximum(high - low, 0.1 * (1 - high)) / 2
    # Chebyshev's nodes, at which the interpolating polynomials are exact.
    nodes = np.cos(np.pi * (np.arange(POWERS) + 0.5) / POWERS)
    one_joint = one_joint_model(softness)
    fits = np.empty((GAINS, POWERS, n))
    for j in range(n):
        gains = []
        for inertia in rotors[j] / (middle[j] + half[j] * nodes):
            numbers = elasticity.stiffness[j], elasticity.damping[j], drive.joint_viscous()[j], dt
            A, B = (matrix.full() for matrix in one_joint(rotors[j], inertia, *numbers))
            gains.append(joint_gains(A, B * inertia, dt, bandwidth, observer))
        fits[:, :, j] = np.linalg.solve(np.vander(nodes, POWERS), np.array(gains)).T
    return np.concatenate([middle, half, fits.ravel()])


def _followed(rig: Rig) -> Any:
    """Elasticity of the gears, or None where counts do not determine the motion of the links."""
    elasticity: Any = rig.drive.elasticity
    # An inner loop holds the motors by itself; the law above it takes gears for rigid.
    if elasticity is None or rig.encoder.side == "link" or rig.inner is not None:
        return None
    return elasticity if elasticity.backlash is None or not elasticity.backlash.any() else None


def _inertias(arm: Arm, rig: Rig) -> Floats:
    """D (poses, n, n) on the shafts, at poses all over."""
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.n))
    n = arm.n
    columns = _inertia(arm.dynamics, rig.drive.coupling).map(_POSES)(poses.T, arm.f).full()
    return columns.reshape(n, _POSES, n).transpose(1, 0, 2)


@functools.lru_cache(maxsize=32)
def _inertia(dynamics: Dynamics, coupling: Any) -> ca.Function:
    q = ca.SX.sym("q", dynamics.n)
    f = ca.SX.sym("f", dynamics.p)
    return ca.Function("inertia", [q, f], [ca.densify(coupling.shaft_inertia(dynamics.D(q, f)))])


@functools.cache
def one_joint_model(softness: float) -> ca.Function:
    """(rotor, D, stiffness, damping, viscous friction, dt) -> A (4, 4) and B (4, 2) of a joint.

    A maps its deviation over a sample, B the torques that push motor and link.
    """
    names = "rotor", "D", "stiffness", "damping", "viscous", "dt"
    numbers = rotor, D, stiffness, damping, viscous, dt = [ca.SX.sym(name) for name in names]
    x = ca.SX.sym("x", 4)
    push = ca.SX.sym("push", 2)
    e, rate, e_l, rate_l = ca.vertsplit(x)
    pushed = Deviation(e, rate, e_l, rate_l - dt * push[1] / (D - rotor))
    springs = Springs(stiffness, damping)
    gears = ElasticGears(D, dt * viscous, rotor, springs, softness=softness)
    after, _ = gears.moved(pushed, push[0] + viscous * rate, lambda *_: ca.SX(0), dt)
    return ca.Function(
        "joint",
        numbers,
        [ca.densify(ca.jacobian(ca.vertcat(*after), source)) for source in (x, push)],
    )


def joint_gains(A: Floats, B: Floats, dt: float, bandwidth: float, observer: float) -> Floats:
    """Gains (9,) of a joint, with torques in units of its inertia and count noise of variance 1."""
    # Change of each state within a sample: so scaled, Riccati's equation is well conditioned.
    units = np.array([1, 1 / dt, 1, 1 / dt, 1 / dt**2])
    A = A * units[:4] / units[:4, None]
    B = B * units[4] / units[:4, None]
    grown = np.eye(5)
    noises = np.zeros((5, 5))
    # The fifth state is the disturbance torque, which acts as a torque of the feedback would.
    grown[:4, :4], grown[:4, 4] = A, -B[:, 0]
    step = observer * dt
    noises[:4, :4], noises[4, 4] = step**4 * B @ B.T, (DRIFT * step) ** 6
    covariance = _riccati(grown.T, np.eye(5)[:, :1], noises)
    torque = B[:, :1]
    cost = _riccati(A, torque, np.diag([(bandwidth * dt) ** 4, 0, 0, 0]))
    regulator = np.linalg.solve(1 + torque.T @ cost @ torque, torque.T @ cost @ A).ravel()
    return np.append(
        covariance[:, 0] / (covariance[0, 0] + 1) * units, -regulator * units[4] / units[:4]
    )


def _riccati(A: Floats, B: Floats, Q: Floats) -> Floats:
    """P = A' (P - P B (1 + B' P B)^-1 B' P) A + Q, by doubling.

    Doubling stays accurate for stiff gears, for which scipy's solver fails.
    """
    G = B @ B.T
    P = Q
    for _ in range(_DOUBLINGS):
        turned = np.linalg.solve(np.eye(len(A)) + G @ P, np.hstack([A, G]))
        onward = turned[:, : len(A)]
        beside = turned[:, len(A) :]
        A, G, P = A @ onward, G + A @ beside @ A.T, P + A.T @ P @ onward
    return P
