"""Time-optimal motion along a path under torque limits.

With v(s) the speed along the path and b = v^2, a = b'/2 and the time is the integral of ds /
sqrt(b). Torque is affine in a and b but for friction (`plant.motion.demand`): without viscous
friction the problem is convex. b is a cubic spline, positive, whose coefficients are found by Ipopt
with derivatives from casadi. The slope of a cubic spline is continuous; therefore the acceleration
along the path is, too. The given motion, uniformly scaled, is one such b, and the start.

The path parameter is the given motion's own time. Where the given motion rests, the new one rests
too, for any b. Coulomb friction has at each point the sign of the path's direction there, so
the limit holds on both sides of a reversal. Between the points, and within Ipopt's tolerance, the
torque may be a little too large: the result is evaluated on a finer grid, and uniformly scaled
until the limit holds everywhere.

Source: D. Verscheure et al., Time-optimal path tracking for robots: a convex optimization approach,
IEEE Transactions on Automatic Control 54 (2009).
"""

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.machine import Rig
from plant.mechanics import Arm, Limits
from plant.motion.demand import Demand, demand, sampled_demand, shortest_duration
from plant.motion.reference import Motion, Reference, Scaled
from plant.parts import Floats, array, frozen_settings, instance, known_options, whole


@frozen_settings
class FastestSettings:
    """Numbers of the search for a time law, chosen by hand.

    Parameters
    ----------
    points : int
        Gauss points per interval of the spline, at which the torque is limited and the time
        integrated.
    points_at_ends : int
        Gauss points in the two intervals at the ends, where b is steep: along a motion that ends
        without acceleration it grows like 1 / s.
    nodes : int
        Points of the resulting time law per interval of the spline.
    rest : float
        Share of the peak speed below which a motion is at rest.
    tolerance : float
        Distance [rad or m] by which rounding may carry a path over a limit.
    smallest, largest : float
        Bounds of b, in units of that of the uniform motion; the smallest is so small that a rest on
        the path takes no time.
    """

    points: int = 4
    points_at_ends: int = 24
    nodes: int = 4
    rest: float = 1e-6
    tolerance: float = 1e-9
    smallest: float = 1e-8
    largest: float = 1e8


SETTINGS = FastestSettings()


@known_options
def fastest(
    arm: Arm,
    rig: Rig,
    reference: Reference,
    *,
    share: float = 0.9,
    motor_speed: ArrayLike | None = None,
    torque_rate: ArrayLike | None = None,
    limits: Limits | None = None,
    intervals: int = 120,
    uniform: bool = False,
) -> Scaled:
    """Time-optimal motion along the path of a reference under the amplifiers' limits.

    Parameters
    ----------
    arm : Arm
        As identified, ``found.arm``.
    rig : Rig
        As identified, ``found.rig``, with its friction and its limits.
    reference : Reference
        The path, as a smooth motion along it (no `Table`). One that moves at its ends becomes one
        from rest to rest.
    share : float
        Share of the amplifiers' limits that the motion may take; the rest is for feedback.
    motor_speed : (n,) array_like, optional
        Largest motor speeds [rad/s]; inf where there is no bound.
    torque_rate : (n,) array_like, optional
        Largest rate of the torque [N m/s] without Coulomb friction, which jumps where a joint
        reverses; on the joint, of coupled motors on the shaft. It is held at the points of the
        search; between them it may be a few per cent larger.
    limits : Limits, optional
        Of positions, joint speeds and efforts, as ``chain.limits`` of a model file has them;
        `share` of the efforts. Those of coupled motors' joints must be inf.
    intervals : int
        Of the spline; more come closer to the optimum, and switch the torque faster.
    uniform : bool
        Keep the time law of the reference, slowed by one factor: the shortest under the torque
        limits alone.

    Returns
    -------
    Scaled
        With continuous acceleration; at the ends it follows from curvature and speed of the path,
        zero if the reference is a `PointToPoint`, or a `Spline` at rest at its ends.

    Raises
    ------
    ValueError
        A path along which the drives cannot hold the arm, that meets no limit, that has corners,
        that exceeds the limits of a joint's position, or along which a joint moves whose limit of
        speed is zero.

    See Also
    --------
    plant.Reference, plant.PointToPoint

    Examples
    --------
    >>> from plant import PointToPoint, fastest, puma560
    >>> path = PointToPoint(start=(0, 0), goal=(1, 0.5), duration=2.0)
    >>> quick = fastest(puma560.arm(), puma560.rig(), path)
    >>> quick.duration < path.duration
    True
    """
    for name, value, kind in (("arm", arm, Arm), ("rig", rig, Rig)):
        instance(name, value, kind, "The order is arm, rig, reference.")
    instance("reference", reference, Reference, "The order is arm, rig, reference.")
    # Without a search: one factor for the whole motion.
    if uniform:
        if any(limit is not None for limit in (motor_speed, torque_rate, limits)):
            raise ValueError(
                "uniform scaling is under torque limits alone; got other limits as well. Leave them"
                " out."
            )
        return reference.slowed(shortest_duration(arm, rig, reference, share) / reference.duration)
    if reference.corners:
        raise ValueError(
            "reference must be smooth; the path of a Table has corners. Use Spline(times=...,"
            " points=...)."
        )
    whole("intervals", intervals, "The default is 120.", least=4)

    # 1. The limits. Those of the efforts join the amplifiers', so that `share` is of both.
    labels = arm.dynamics.chain.joint_labels
    if limits is not None:
        rig = within_efforts(rig, limits, labels)
    # The uniform motion is the start of the search, and its unit of time.
    shortest = shortest_duration(arm, rig, reference, share)
    fastest_motor = _bound("motor_speed", motor_speed, rig.n)
    steepest = _bound("torque_rate", torque_rate, rig.n)

    # 2. Time, constraints and objective by the coefficients x of b, in units of the uniform motion.
    spline = _Spline(reference.duration, intervals)
    motion = Motion(*reference(spline.places))
    speed_limit = np.full(rig.n, np.inf)
    if limits is not None:
        require_inside(motion, limits, labels)
        speed_limit = speed_limits(motion, limits, labels)
    needed = demand(arm, rig, motion)
    unit = (reference.duration / shortest) ** 2
    x = ca.SX.sym("x", spline.count)
    # b = v^2 is linear in x, and so is the acceleration a = b' / 2.
    b = unit * (spline.matrix(0) @ x)
    a = unit / 2 * (spline.matrix(1) @ x)
    # The slope of the root stays finite where the motion starts from rest.
    v = ca.sqrt(b + SETTINGS.smallest * unit * 1e-3)
    allowed = share * rig.drive.torque_limit()
    limited = _limited(needed, spline.places, a, v, allowed, steepest, fastest_motor, speed_limit)
    problem = {"x": x, "f": ca.dot(spline.weights, 1 / v) / shortest, "g": limited}
    # The solver works with b of about one; `unit` restores that of the given motion.
    law = spline.law(reference, unit * _solved(problem, motion, intervals))

    # 3. Between the points the result may exceed a limit a little: slow it down until it does not.
    # Ten instants per point of the law.
    qd = law(np.linspace(0.0, law.duration, 10 * len(law.times))).qd
    too_fast = max(
        np.abs(rig.drive.motor_angle(qd) / fastest_motor).max(), np.abs(qd / speed_limit).max()
    )
    factor = max(shortest_duration(arm, rig, law, share=share) / law.duration, too_fast)
    law = law.slowed(factor) if factor > 1 else law
    # Between the points of the search the path may pass a limit.
    if limits is not None:
        require_inside(Motion(*sampled_demand(arm, rig, law)[1]), limits, labels)
    return law


def _solved(problem: dict[str, ca.SX], motion: Motion, intervals: int) -> Floats:
    """The optimal coefficients of b.

    The coefficient of an end at which the given motion moves is zero, so that the new motion rests
    there.
    """
    ipopt = {"print_level": 0, "sb": "yes", "max_iter": 500, "tol": 1e-7}
    # Ipopt gets exact first and second derivatives from casadi.
    solver = ca.nlpsol("fastest", "ipopt", problem, {"print_time": False, "ipopt": ipopt})
    count = problem["x"].shape[0]
    smallest = np.full(count, SETTINGS.smallest)
    largest = np.full(count, SETTINGS.largest)
    speed = np.linalg.norm(motion.qd, axis=1)
    for end in (0, -1):
        if speed[end] > SETTINGS.rest * speed.max():
            smallest[end] = 0.0
            largest[end] = 0.0
    # The uniform motion has b = 1; a tenth below it the start is inside all constraints.
    solution = solver(x0=0.9, lbx=smallest, ubx=largest, lbg=-1, ubg=1)
    if not solver.stats()["success"]:
        status = solver.stats()["return_status"]
        raise ValueError(
            f"path must have a time law; with {intervals} intervals none was found, {status}. Try"
            " fewer, or a smoother path."
        )
    return solution["x"].full().ravel()


def _limited(
    needed: Demand,
    places: Floats,
    a: ca.SX,
    v: ca.SX,
    limit: Floats,
    torque_rate: Floats,
    motor_speed: Floats,
    joint_speed: Floats,
) -> ca.SX:
    """Constraints over their bounds, within ±1: torque, its rate, speeds of motors and joints.

    Each (n,) at N places.
    """
    drive = needed.rig.drive
    speeds = zip(needed.along, ca.vertsplit(v), strict=True)
    friction = [drive.friction(ca.DM(along) * speed) for along, speed in speeds]
    frictionless = needed.torque(a, v, 0.0)
    torque = frictionless + drive.coupling.shaft_torque(ca.horzcat(*friction)).T
    # At rest Coulomb friction does not help to brake.
    ends = frictionless[[0, -1], :]
    # The torque's rate in time is its slope along the path times the speed.
    smooth = torque - needed.dry_friction()
    rate = (smooth[1:, :] - smooth[:-1, :]) * (v[1:] + v[:-1]) / (2 * np.diff(places))
    motor_rate = drive.motor_angle(needed.along) * v
    pairs = (
        (torque, limit),
        (ends, limit),
        (rate, torque_rate),
        (motor_rate, motor_speed),
        (needed.along * v, joint_speed),
    )
    shares = []
    for value, bound in pairs:
        # A joint without a bound gives no constraint.
        shares += [value[:, i] / bound[i] for i in np.flatnonzero(np.isfinite(bound))]
    return ca.vertcat(*shares)


def require_inside(motion: Motion, limits: Limits, labels: list[str]) -> None:
    """Refuse a path that exceeds the limits of a joint's position."""
    over = np.maximum(motion.q - limits.upper, limits.lower - motion.q).max(axis=0)
    if over.max() > SETTINGS.tolerance:
        joint = int(over.argmax())
        raise ValueError(
            f"path must stay within the limits; {labels[joint]} exceeds [{limits.lower[joint]:.4g},"
            f" {limits.upper[joint]:.4g}] by {over[joint]:.3g}. Shorten the path."
        )


def within_efforts(rig: Rig, limits: Limits, labels: list[str]) -> Rig:
    """A rig whose amplifiers give no more than the efforts of the joints."""
    if instance("limits", limits, Limits, "Pass chain.limits.").n != rig.n:
        raise ValueError(
            f"limits must have {rig.n} joints like the rig; got {limits.n}. Use those of its chain."
        )
    # The torque of a joint is that of its shaft alone, unless it turns another shaft, too.
    alone = (rig.drive.coupling.shaft(np.eye(rig.n)) == np.eye(rig.n)).all(axis=1)
    for joint in np.flatnonzero((limits.effort == 0) | (np.isfinite(limits.effort) & ~alone)):
        rule = "positive" if alone[joint] else "inf where motors are coupled"
        raise ValueError(
            f"limits.effort must be {rule}; got {limits.effort[joint]:.4g} at {labels[joint]}."
            " Give inf there, and the limit of the amplifier by Drive(current_limit=...)."
        )
    return dataclasses.replace(rig, drive=rig.drive.limited_to(limits.effort))


def speed_limits(motion: Motion, limits: Limits, labels: list[str]) -> Floats:
    """Limits (n,) of the joints' speeds along a path; a joint that may not move must not."""
    still = limits.velocity == 0
    moves = np.ptp(motion.q, axis=0) > SETTINGS.tolerance
    for joint in np.flatnonzero(still & moves):
        raise ValueError(
            f"path must leave joints with a limits.velocity of 0 where they are; {labels[joint]}"
            f" moves by {np.ptp(motion.q[:, joint]):.3g}. Correct the path, or the limit."
        )
    # What stands still needs no limit.
    return np.where(still, np.inf, limits.velocity)


def _bound(name: str, value: ArrayLike | None, n: int) -> Floats:
    if value is None:
        return np.full(n, np.inf)
    bound = array(name, value, (n,), advice="Give one per joint.", finite=False)
    if not (bound > 0).all():
        raise ValueError(
            f"{name} must be positive; got {bound}. It is a magnitude, inf where there is no bound."
        )
    return bound


class _Spline:
    """b(s) as a cubic spline on equal intervals: matrices at Gauss points, and the time law."""

    def __init__(self, end: float, intervals: int) -> None:
        from scipy.interpolate import BSpline  # 0.2 s, for those who use it

        self.count = intervals + 3
        self.edges = np.linspace(0.0, end, intervals + 1)
        # Clamped at both ends: the end coefficients are the values there.
        knots = np.concatenate([[0.0] * 3, self.edges, [end] * 3])
        self._of: Any = lambda coefficients: BSpline(knots, coefficients, 3)
        ends = [SETTINGS.points_at_ends]
        # More points where b is steep.
        orders = ends + [SETTINGS.points] * (intervals - 2) + ends
        rules = {order: np.polynomial.legendre.leggauss(order) for order in set(orders)}
        # Gauss-Legendre quadrature on each interval.
        half = end / intervals / 2
        inside = [
            low + half * (1 + rules[order][0])
            for low, order in zip(self.edges[:-1], orders, strict=True)
        ]
        self.places = np.concatenate([[0.0], *inside, [end]])
        self.weights = np.concatenate([[0.0], *(half * rules[order][1] for order in orders), [0.0]])

    def matrix(self, derivative: int) -> ca.DM:
        """Values (N, count) of the splines, or of their derivatives, at `places`."""
        return ca.sparsify(ca.DM(self._of(np.eye(self.count)).derivative(derivative)(self.places)))

    def law(self, path: Reference, coefficients: Floats) -> Scaled:
        """The time law of a path with these coefficients of b."""
        b = self._of(coefficients)
        s = np.linspace(0.0, self.edges[-1], SETTINGS.nodes * (len(self.edges) - 1) + 1)
        # The time between two points is the integral of 1 / sqrt(b), which is infinite where b
        # starts at zero. The substitution s = low + width x^2 (3 - 2 x) removes the pole.
        node, weight = np.polynomial.legendre.leggauss(12)
        x = (1 + node) / 2
        low = s[:-1, None]
        width = np.diff(s)[:, None]
        places = low + width * x**2 * (3 - 2 * x)
        intervals = (width * 3 * x * (1 - x) * weight / np.sqrt(b(places))).sum(axis=1)
        times = np.concatenate([[0.0], np.cumsum(intervals)])
        # Rounding may leave b a little below zero where it begins at zero.
        speeds = np.sqrt(np.maximum(b(s), 0.0))
        return Scaled(
            path=path, times=times, places=s, speeds=speeds, accelerations=b.derivative()(s) / 2
        )
