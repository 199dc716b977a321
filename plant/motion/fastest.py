"""Time-optimal motion along a path under torque limits.

With v(s) the speed along the path and b = v^2, a = b'/2 and the time is the integral of ds /
sqrt(b). Torque is affine in a and b but for friction (`plant.motion.demand`): without viscous
friction the problem is convex. b is a cubic spline, positive, whose coefficients are found by Ipopt
with derivatives from casadi. A cubic spline has a continuous slope, and so is the acceleration
along the path. The given motion, uniformly scaled, is one such b, and the start.

The path parameter is the given motion's own time. Where that motion rests the new one does,
whatever b is there. Coulomb friction has at each point the sign of the path's direction there, so
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

from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.link import Limits
from plant.motion.demand import Demand, demand, shortest_duration
from plant.motion.reference import Motion, Reference, Scaled
from plant.motion.table import Table
from plant.parts.arguments import array, instance, known_options, whole
from plant.parts.fields import Floats

# Points per interval of the spline at which the torque is limited and the time integrated; and in
# the first and the last, where b is steep: along a motion that ends without acceleration it grows
# like 1 / s.
_INSIDE = 4
_AT_ENDS = 24

_NODES = 4  # points of the time law per interval of the spline

_REST = 1e-6  # a motion below this share of its peak speed is at rest

_AT_LIMIT = 1e-9  # distance [rad or m] by which rounding may carry a path over a limit

# bounds of b, in units of that of the uniform motion: a rest on the path then takes no time
_LEAST = 1e-8
_MOST = 1e8


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
        reverses; on the joint, of coupled motors on the shaft.
    limits : Limits, optional
        Of positions, joint speeds and efforts, as ``chain.limits`` of a model file has them;
        `share` of the efforts.
    intervals : int
        Of the spline; more come closer to the optimum, and switch the torque faster.
    uniform : bool
        Keep the time law of the reference, slowed by one factor: the shortest under the torque
        limits alone.

    Returns
    -------
    Scaled
        With continuous acceleration; at the ends it follows from curvature and speed of the path,
        zero if the reference is a `PointToPoint` or a `Spline`.

    Raises
    ------
    ValueError
        A path along which the drives cannot hold the arm, that meets no limit, that has corners, or
        that exceeds the limits of a joint's position.

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
    instance("reference", reference, Reference, "The order is arm, rig, reference.")
    if uniform:
        if (motor_speed, torque_rate, limits) != (None, None, None):
            raise ValueError(
                "uniform scaling is under torque limits alone; got other limits as well. Leave them"
                " out."
            )
        return reference.slowed(shortest_duration(arm, rig, reference, share) / reference.duration)
    if isinstance(reference, Table):
        raise ValueError(
            "reference must be smooth; a Table has corners. Use Spline(times=..., points=...)."
        )
    whole("intervals", intervals, "The default is 120.", least=4)
    if limits is not None:
        instance("limits", limits, Limits, "Pass chain.limits.")
        if limits.n != rig.n:
            raise ValueError(
                f"limits must have {rig.n} joints like the rig; got {limits.n}. Use those of its"
                " chain."
            )
        rig = dataclasses.replace(rig, drive=rig.drive.limited_to(limits.effort))
    speed_limit = np.full(rig.n, np.inf) if limits is None else limits.velocity
    shortest = shortest_duration(arm, rig, reference, share)
    fastest_motor = _bound("motor_speed", motor_speed, rig.n)
    steepest = _bound("torque_rate", torque_rate, rig.n)

    spline = _Spline(reference.duration, intervals)
    motion = Motion(*reference(spline.places))
    if limits is not None:
        require_inside(motion, limits, arm.dynamics.chain.joint_labels)
    needed = demand(arm, rig, motion)
    unit = (reference.duration / shortest) ** 2
    x = ca.SX.sym("x", spline.count)
    b = unit * (spline.matrix(0) @ x)
    a = unit / 2 * (spline.matrix(1) @ x)
    v = ca.sqrt(b + _LEAST * unit * 1e-3)  # whose slope is finite where the motion starts from rest
    allowed = share * rig.drive.torque_limit()
    limited = _limited(needed, spline.places, a, v, allowed, steepest, fastest_motor, speed_limit)
    problem = {"x": x, "f": ca.dot(spline.weights, 1 / v) / shortest, "g": limited}
    law = spline.law(reference, unit * _solved(problem, motion, intervals))
    fine = np.linspace(0.0, law.duration, 10 * len(law.times))
    qd = law(fine).qd
    too_fast = max(
        np.abs(rig.drive.motor_angle(qd) / fastest_motor).max(), np.abs(qd / speed_limit).max()
    )
    longer = max(shortest_duration(arm, rig, law, share=share) / law.duration, too_fast)
    return law.slowed(longer) if longer > 1 else law


def _solved(problem: dict[str, ca.SX], motion: Motion, intervals: int) -> Floats:
    """The best coefficients; those at an end are zero where the motion does not begin or end at
    rest.
    """
    ipopt: dict[str, Any] = {"print_level": 0, "sb": "yes", "max_iter": 500, "tol": 1e-7}
    solver = ca.nlpsol("fastest", "ipopt", problem, {"print_time": False, "ipopt": ipopt})
    least, most = (np.full(problem["x"].shape[0], bound) for bound in (_LEAST, _MOST))
    speed = np.linalg.norm(motion.qd, axis=1)
    for end in (0, -1):
        if speed[end] > _REST * speed.max():
            least[end] = most[end] = 0.0
    found = solver(x0=0.9, lbx=least, ubx=most, lbg=-1, ubg=1)
    if not solver.stats()["success"]:
        got = f"with {intervals} intervals none was found, {solver.stats()['return_status']}"
        raise ValueError(f"path must have a time law; {got}. Try fewer, or a smoother path.")
    return np.asarray(found["x"].full().ravel())


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
    """Constraints within ±1, over their bounds: torque, its rate, speeds of motors and joints
    (n, at N places).
    """
    drive = needed.rig.drive
    speeds = zip(needed.along, ca.vertsplit(v), strict=True)
    friction = [drive.friction(ca.DM(along) * speed) for along, speed in speeds]
    frictionless = needed.torque(a, v, 0.0)
    torque = frictionless + drive.coupling.shaft_torque(ca.horzcat(*friction)).T
    ends = frictionless[[0, -1], :]  # at rest, where Coulomb friction does not help to brake
    smooth = torque - needed.dry_friction()
    rate = (smooth[1:, :] - smooth[:-1, :]) * (v[1:] + v[:-1]) / (2 * np.diff(places))
    turning = drive.motor_angle(needed.along) * v
    pairs = (
        (torque, limit),
        (ends, limit),
        (rate, torque_rate),
        (turning, motor_speed),
        (needed.along * v, joint_speed),
    )
    shares = [
        value[:, i] / bound[i] for value, bound in pairs for i in np.flatnonzero(np.isfinite(bound))
    ]
    return ca.vertcat(*shares)


def require_inside(motion: Motion, limits: Limits, labels: list[str]) -> None:
    """Refuse a path that exceeds the limits of a joint's position."""
    over = np.maximum(motion.q - limits.upper, limits.lower - motion.q).max(axis=0)
    if over.max() > _AT_LIMIT:
        joint = int(over.argmax())
        raise ValueError(
            f"path must stay within the limits; {labels[joint]} exceeds [{limits.lower[joint]:.4g},"
            f" {limits.upper[joint]:.4g}] by {over[joint]:.3g}. Shorten the path."
        )


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
    """b(s) as a cubic spline on equal intervals: as matrices at Gauss points and ends, and as a
    time law.
    """

    def __init__(self, end: float, intervals: int) -> None:
        from scipy.interpolate import BSpline  # 0.2 s, for those who use it

        self.count, self.edges = intervals + 3, np.linspace(0.0, end, intervals + 1)
        knots = np.concatenate([[0.0] * 3, self.edges, [end] * 3])
        self._of: Any = lambda coefficients: BSpline(knots, coefficients, 3)
        orders = [_AT_ENDS] + [_INSIDE] * (intervals - 2) + [_AT_ENDS]
        rules = {order: np.polynomial.legendre.leggauss(order) for order in set(orders)}
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
        s = np.linspace(0.0, self.edges[-1], _NODES * (len(self.edges) - 1) + 1)
        # Within s = low + width x^2 (3 - 2 x): where b starts at zero, 1 / sqrt(b) is infinite, and
        # this removes it.
        node, weight = np.polynomial.legendre.leggauss(12)
        x = (1 + node) / 2
        low = s[:-1, None]
        width = np.diff(s)[:, None]
        lasting = (
            width * 3 * x * (1 - x) * weight / np.sqrt(b(low + width * x**2 * (3 - 2 * x)))
        ).sum(axis=1)
        times = np.concatenate([[0.0], np.cumsum(lasting)])
        speeds = np.sqrt(np.maximum(b(s), 0.0))
        return Scaled(
            path=path, times=times, places=s, speeds=speeds, accelerations=b.derivative()(s) / 2
        )
