"""Optimal excitation: harmonics that minimise the largest variance of the parameters, within
limits.

The torque equation in f has one row per joint and sample, weighted by the torque of one pulse of
tracking error. The inverse of its normal matrix bounds the variance of each f; the largest of them,
each relative to the width of its range, is minimised over the amplitudes of a sum of harmonics,
within limits of position, speed, acceleration and torque, by Ipopt with derivatives from casadi.

Source: J. Swevers et al., Optimal robot excitation and identification, IEEE Transactions on
Robotics and Automation 13 (1997), for sums of harmonics.
"""

import functools
from collections.abc import Iterable, Iterator
from typing import Any, Literal, overload

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.planning.multisine import experiment_of, motion_limits, multisines
from plant import Arm, Chain, Harmonics, Law, Rig
from plant.mechanics.newton_euler import lumped_torque
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import choice, instance, known_options, real, whole
from plant.parts.fields import Floats
from plant.simulation.executors import mapped

_SAMPLES = 120  # of a period, at which the equation is set up and the limits hold
_SHARPNESS = 4  # power of the mean that stands for the largest variance
# share of a limit's width that is kept free: between the samples the motion goes a little further
_MARGIN = 0.01
_MANY = 20  # parameters above which one start is the usual
_LEAST_UNIT = 1e-2  # of the largest parameter: as far as any other one is worth to be known
_FULL = 100.0  # pulses of error at which a loop without a law takes its largest torque
_LEAST_PULSES = 100  # by which every motor has to move, at least
_SLACK = 1e-3  # by how much a limit may be exceeded [SI]
# Where Ipopt ends, too: the limits are kept, and the objective has hardly changed for some
# iterations.
_SETTLED = {
    "acceptable_tol": 1e9,
    "acceptable_constr_viol_tol": 1e-4,
    "acceptable_compl_inf_tol": 1e-3,
    "acceptable_obj_change_tol": 1e-3,
    "acceptable_iter": 6,
}
_TORQUE = 0.8  # share of the amplifier's limit that the model's torque and friction may take


@overload
def design_motion(
    arm: Arm | Chain,
    rig: Rig,
    law: Law | None = None,
    *,
    kind: Literal["parameters"] = "parameters",
    **options: Any,
) -> Harmonics: ...
@overload
def design_motion(
    arm: Arm | Chain,
    rig: Rig,
    law: Law | None = None,
    *,
    kind: Literal["multisine"],
    **options: Any,
) -> tuple[Harmonics, ...]: ...
@known_options  # type: ignore[misc]  # the overloads name what differs
def design_motion(
    arm: Arm | Chain,
    rig: Rig,
    law: Law | None = None,
    *,
    kind: str = "parameters",
    period: float = 6.0,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    frequencies: ArrayLike | None = None,
    harmonics: int | None = None,
    starts: int | None = None,
    seed: int | None = None,
    iterations: int | None = None,
    executor: Any = None,
) -> Harmonics | tuple[Harmonics, ...]:
    """Harmonics from rest that excite the parameters of an arm; ``design_motion(chain, rig)`` for a
    first experiment.

    Parameters
    ----------
    arm : Arm or Chain
        Known roughly, or as its model file says; its torques are kept below the amplifier's limit.
    rig : Rig
    law : Law, optional
        Of the position loop, without memory; gives the torque of a pulse. By default all joints
        have errors of the same share of their largest torque. Of parameters.
    kind : {"parameters", "multisine"}
        What is to be found: f, or the responses of `frequency_response`. Options below that say so
        are of one kind.
    period : float
        [s]; of a multisine the nearest whole number of samples.
    position : (n, 2) array_like, optional
        Lowest and highest angle of each joint [rad]; by default 90 % of the chain's limits, or
        within a right angle; of a multisine, which stays near a pose, a tenth of that around its
        middle.
    velocity, acceleration : (n,) array_like, optional
        Largest magnitudes [rad/s], [rad/s^2]; by default 90 % of the chain's limits, and what the
        harmonics need.
    frequencies : (F,) array_like, optional
        Of a multisine: its lines [Hz], moved to the nearest multiples of 1 / period that share no
        factor with n.
    harmonics : int, optional
        Of parameters, as all below; 5.
    starts : int, optional
        Random motions from which the search begins, of which the best end counts; 3, of many
        parameters 1.
    seed : int, optional
    iterations : int, optional
        Of Ipopt, per start, at most; 200.
    executor : optional
        Where the starts are followed, side by side: a `concurrent.futures.Executor`, a Dask
        ``Client``, or a function that makes one.

    Returns
    -------
    Harmonics, or tuple of n Harmonics
        The latter of a multisine, one per record: all joints move in each, and none as in another
        one.

    Raises
    ------
    ValueError
        Bad input, limits in which no motion was found, a pose that the drives cannot hold.

    See Also
    --------
    identification.frequency_response, identification.pulse_budget, plant.visibility, plant.Harmonics

    Examples
    --------
    >>> from plant import puma560
    >>> from identification import design_motion
    >>> path = design_motion(
    ...     puma560.arm(), puma560.rig(), puma560.p_law(), period=4.0, position=((-1, 1), (-1, 1)),
    ...     velocity=(2, 2), acceleration=(8, 8), harmonics=2, starts=1, iterations=20,
    ... )
    >>> path.n, path.period
    (2, 4.0)
    """
    instance("rig", rig, Rig, "The order is arm, rig, law.")
    known, rig = experiment_of(arm, rig)
    model: Arm = instance("arm", known, Arm, "The order is arm, rig, law.")
    period = real("period", period, "Give seconds.", positive=True)
    search = {
        "law": law,
        "harmonics": harmonics,
        "starts": starts,
        "seed": seed,
        "iterations": iterations,
    }
    own = {"parameters": search | {"executor": executor}, "multisine": {"frequencies": frequencies}}
    other = "parameters" if choice("kind", kind, tuple(own)) == "multisine" else "multisine"
    for name in (name for name, value in own[other].items() if value is not None):
        raise ValueError(
            f'{name} is for kind="{other}"; got it for kind="{kind}". Leave one of them out.'
        )
    if kind == "multisine":
        return multisines(
            model, rig, period, frequencies, _TORQUE, (position, velocity, acceleration)
        )
    usual = 1 if model.dynamics.p > _MANY else 3
    harmonics = 5 if harmonics is None else harmonics
    starts = usual if starts is None else whole("starts", starts, "Leave it out for the usual.")
    iterations = (
        200
        if iterations is None
        else whole("iterations", iterations, "Leave it out for the usual.")
    )
    limits = motion_limits(model, period, harmonics, position, velocity, acceleration)
    of_problem = model, rig, law, period, harmonics
    begins = list(
        _starts(np.random.default_rng(seed or 0), starts, _rates(period, harmonics), *limits)
    )
    if executor is None:
        found = [_end(of_problem, limits, iterations, begins)]
    else:
        found = mapped(
            functools.partial(_end, of_problem, limits, iterations),
            [[each] for each in begins],
            executor,
        )
    _, motion = min(
        (end for end in found if end is not None), key=lambda end: end[0], default=(None, None)
    )
    if motion is None:
        raise ValueError(
            f"limits must allow a motion; none of {starts} starts found one. Widen them."
        )
    moved = np.ptp(rig.position_in_pulses(motion(np.linspace(0, period, _SAMPLES)).q), axis=0)
    if (moved < _LEAST_PULSES).any():
        label = model.dynamics.chain.joint_labels[int(moved.argmin())]
        raise ValueError(
            f"limits must allow {_LEAST_PULSES} pulses on every motor; that of {label} moves by"
            f" {moved.min():.0f}. Widen them."
        )
    return motion


def _rates(period: float, harmonics: int) -> Floats:
    """Angular frequency of each harmonic [rad/s]."""
    return np.asarray(2 * np.pi / period * np.arange(1, harmonics + 1), dtype=np.float64)


def _end(
    of_problem: Any, limits: Any, iterations: int, starts: list[Any]
) -> tuple[float, Harmonics] | None:
    """The best end of these starts, in a problem of its own."""
    problem = _Problem(*of_problem)
    problem.limit(*limits)
    return problem.solved(starts, iterations)


class _Problem:
    """The largest variance of f as a function of the amplitudes, for Ipopt."""

    def __init__(self, arm: Arm, rig: Rig, law: Law | None, period: float, harmonics: int) -> None:
        self.period, order = period, np.arange(1, harmonics + 1)
        angle = 2 * np.pi / period * np.arange(_SAMPLES)[:, None] * period / _SAMPLES * order
        rate = _rates(period, harmonics)
        c = np.cos(angle)
        s = np.sin(angle)
        n = arm.n
        p = arm.dynamics.p
        self.opti = ca.Opti()
        offset = self.opti.variable(n)
        cosine = self.opti.variable(n, harmonics)
        sine = self.opti.variable(n, harmonics)
        self.amplitudes = offset, cosine, sine
        self.q = ca.repmat(offset, 1, _SAMPLES) + cosine @ c.T + sine @ s.T
        self.qd = cosine @ (-s * rate).T + sine @ (c * rate).T
        self.qdd = cosine @ (-c * rate**2).T + sine @ (-s * rate**2).T
        information, tau = _equation(arm, rig, law)
        along = self.q, self.qd, self.qdd
        total = information.map(_SAMPLES)(*along)
        self.torques = tau.map(_SAMPLES)(*along)
        self.torque_limit = _TORQUE * rig.drive.torque_limit()
        total = ca.reshape(ca.sum2(total), p, p)
        matrix = ca.SX.sym("M", p, p)
        diagonal = ca.Function(
            "variance", [matrix], [inverse(ca.tril2symm(ca.tril(matrix))).diagonal]
        )
        variance = diagonal(total / _SAMPLES + 1e-9 * ca.DM.eye(p))
        self.opti.minimize(ca.log(ca.sum1(variance**_SHARPNESS)) / _SHARPNESS)

    def limit(self, position: Floats, velocity: Floats, acceleration: Floats) -> None:
        """Keep motion and torque within limits at every sample; the arm is at rest where it
        begins.
        """
        self.opti.subject_to(self.qd[:, 0] == 0)
        for value, low, high in (
            (self.q, position[:, 0], position[:, 1]),
            (self.qd, -velocity, velocity),
            (self.qdd, -acceleration, acceleration),
            (self.torques, -self.torque_limit, self.torque_limit),
        ):
            for i in np.flatnonzero(np.isfinite(high)).tolist():
                margin = _MARGIN * (high[i] - low[i])
                self.opti.subject_to(
                    self.opti.bounded(low[i] + margin, value[i, :].T, high[i] - margin)
                )

    def solved(
        self, starts: Iterable[tuple[Floats, ...]], iterations: int
    ) -> tuple[float, Harmonics] | None:
        """Cost and motion of the best end from these starts that keeps the limits."""
        opti = self.opti
        quiet = {"print_time": False, "error_on_fail": False}
        settings = {"print_level": 0, "sb": "yes", "max_iter": iterations, "tol": 1e-4}
        opti.solver(
            "ipopt", quiet, settings | _SETTLED | {"hessian_approximation": "limited-memory"}
        )
        best: tuple[Any, ...] | None = None
        for start in starts:
            for amplitude, value in zip(self.amplitudes, start, strict=True):
                opti.set_initial(amplitude, value)
            try:
                found = opti.solve_limited()
            except RuntimeError:  # this start leads nowhere
                continue
            excess = ca.vertcat(ca.vec(opti.g - opti.ubg), ca.vec(opti.lbg - opti.g))
            if np.max(found.value(excess)) < _SLACK and (
                best is None or found.value(opti.f) < best[0]
            ):
                best = (
                    found.value(opti.f),
                    *(np.reshape(found.value(x), x.shape) for x in self.amplitudes),
                )
        if best is None:
            return None
        return best[0], Harmonics(
            period=self.period, offset=best[1].ravel(), cosine=best[2], sine=best[3]
        )


def _starts(
    random: np.random.Generator,
    starts: int,
    rate: Floats,
    position: Floats,
    velocity: Floats,
    acceleration: Floats,
) -> Iterator[tuple[Floats, ...]]:
    """Random amplitudes: offset (n,), cosine and sine (n, harmonics)."""
    middle = position.mean(axis=1)
    half = np.diff(position, axis=1).ravel() / 2
    reach = np.minimum(half, np.minimum(velocity / rate[0], acceleration / rate[0] ** 2))
    for _ in range(starts):
        share = random.normal(size=(2, len(middle), len(rate))) / (
            np.arange(1, len(rate) + 1) ** 2 * 3
        )
        share[1] -= np.outer(share[1] @ rate, rate) / (rate @ rate)  # at rest at the beginning
        yield middle, share[0] * reach[:, None], share[1] * reach[:, None]


def _equation(arm: Arm, rig: Rig, law: Law | None) -> tuple[ca.Function, ca.Function]:
    """What one sample adds to the normal matrix, f relative to the width of its range; and its
    torque.
    """
    n = arm.n
    dynamics = arm.dynamics
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    if dynamics.ranges is None:
        unit = np.maximum(np.abs(arm.f), _LEAST_UNIT * np.abs(arm.f).max())
    else:
        unit = np.diff(dynamics.ranges, axis=1).ravel()
        unit = np.where(unit > 0, unit, unit.max())
    per_pulse = ca.repmat(ca.DM(_torque_per_pulse(rig, law)), 1, dynamics.p)
    scaled = dynamics.Y(q, qd, qdd) * ca.repmat(ca.DM(unit).T, n, 1) / per_pulse
    arguments = [q, qd, qdd]
    names = ["q", "qd", "qdd"]
    moving, at_rest = lumped_torque(dynamics.chain, dynamics.lumping, q, qd, qdd, ca.SX(arm.f))
    tau = moving + at_rest + rig.drive.joint_viscous() * qd - rig.spring_torque(q)
    return (
        ca.Function("information", arguments, [ca.vec(scaled.T @ scaled)], names, ["M"]),
        ca.Function("tau", arguments, [tau], names, ["tau"]),
    )


def _torque_per_pulse(rig: Rig, law: Law | None) -> Floats:
    """Joint torque [N m] (n,) that one pulse of error on every motor makes, magnitude; without a
    law its share.
    """
    if law is None:
        limit = rig.drive.torque_limit()
        return np.where(np.isfinite(limit), limit, 1.0) / _FULL
    if law.has_memory(rig.n):
        raise ValueError(
            f"law must be fast and without memory, like P; got {type(law).__name__}. Give that of"
            " the log."
        )
    block = law.block(rig)
    zero = np.zeros(rig.n)
    without, with_error = (
        block.step([], zero, zero, zero, zero + e, zero, zero, rig.period, block.values)[0]
        for e in (0.0, 1.0)
    )
    return np.abs((with_error - without).full().ravel())
