"""Optimal excitation: harmonics that minimise the largest variance of f, within limits.

The torque equation in f has one row per motor and sample, divided by the torque of one pulse of
tracking error. The inverse of its normal matrix bounds the variance of each f. Ipopt, with
derivatives from casadi, minimises the largest of them, each relative to the width of its range,
over the amplitudes of a sum of harmonics, within limits of position, speed, acceleration and
torque. Read `design_motion`, then `_Problem`.

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
from plant.mechanics import inverse, lumped_torque
from plant.parts import Floats, choice, frozen_settings, instance, known_options, real, whole
from plant.simulation import mapped


@frozen_settings
class ExcitationSettings:
    """Numbers that shape the search for an optimal excitation.

    Chosen by hand; ``tests/benchmarks/identification_study.py`` measures the errors of f on
    designed motions.

    Parameters
    ----------
    samples : int
        Least number of samples of a period, at which the equation is set up and the limits hold.
    samples_of_harmonic : int
        Least number of samples per period of the highest harmonic. With 16, the peak of a sum of
        harmonics exceeds its samples by a factor of 1 / cos(pi / 16) at most; `margin` covers it.
    sharpness : int
        Power of the mean that replaces the largest variance, whose derivative jumps.
    margin : float
        Share of the width of a limit that stays free at either end, because the motion goes a
        little further between the samples.
    torque : float
        Share of the amplifier's limit that the torque of the model, with viscous friction, may
        reach.
    slack : float
        Excess of a limit that the result may have [SI].
    harmonics, iterations, starts : int
        Defaults of `design_motion`.
    starts_of_many : int
        Default of its `starts` for an arm of many parameters, where a start takes long.
    many : int
        Number of parameters beyond which they are many.
    least_unit : float
        Least unit of an f without a range, as a share of the largest f: smaller ones need no better
        accuracy.
    full_error : float
        Error at which a loop without a stated law takes its largest torque [pulses].
    least_pulses : int
        Least motion of every motor [pulses].
    """

    # The problem that Ipopt solves.
    samples: int = 120
    samples_of_harmonic: int = 16
    sharpness: int = 4
    margin: float = 0.01
    torque: float = 0.8
    slack: float = 1e-3
    # Defaults of the arguments.
    harmonics: int = 5
    iterations: int = 200
    starts: int = 3
    starts_of_many: int = 1
    many: int = 20
    # Weights of the torque equation, and acceptance of a motion.
    least_unit: float = 1e-2
    full_error: float = 100.0
    least_pulses: int = 100


SETTINGS = ExcitationSettings()


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
    """Periodic motion from rest that excites the parameters of an arm, within its limits.

    ``design_motion(chain, rig)`` designs the motion of the initial experiment.

    Parameters
    ----------
    arm : Arm or Chain
        Known roughly, or as its model file says; its torques are kept below the amplifier's limit.
    rig : Rig
    law : Law, optional
        Of the position loop, without memory; it says which torque a pulse of error causes. By
        default that is the same share of the largest torque on all joints. Only for parameters.
    kind : {"parameters", "multisine"}
        What the motion is for: f, or the responses of `frequency_response`.
    period : float
        [s]; of a multisine the nearest whole number of samples.
    position : (n, 2) array_like, optional
        Lowest and highest angle of each joint [rad]; by default 90 % of the chain's range, or of a
        right angle to both sides where the joint turns without end. A multisine stays near a pose:
        its default is a tenth of that, around the middle.
    velocity, acceleration : (n,) array_like, optional
        Largest magnitudes [rad/s], [rad/s^2]; by default what the highest harmonic needs within the
        other limits, the velocity at most 90 % of the chain's.
    frequencies : (F,) array_like, optional
        Lines of a multisine [Hz], moved to the nearest multiples of 1 / period that share no factor
        with n. Only for a multisine.
    harmonics : int, optional
        Number of harmonics; by default 5. This and all options below are only for parameters.
    starts : int, optional
        Number of random motions from which the search begins; the best result counts. By default 3,
        with more than 20 parameters 1.
    seed : int, optional
        Of the random motions; by default 0.
    iterations : int, optional
        Largest number of iterations of Ipopt per start; by default 200.
    executor : optional
        Runs the starts in parallel: a `concurrent.futures.Executor`, a Dask ``Client``, or a
        function that makes one.

    Returns
    -------
    Harmonics, or tuple of n Harmonics
        The latter of a multisine, one per record: all joints move in each, differently in every
        one.

    Raises
    ------
    ValueError
        Bad input, limits in which no motion was found; for a multisine, a pose that the drives
        cannot hold.

    See Also
    --------
    identification.frequency_response, identification.pulse_budget, plant.visibility,
    plant.Harmonics

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
    # 1. Arguments; those of the other kind are refused.
    instance("rig", rig, Rig, "The order is arm, rig, law.")
    design_arm, rig = experiment_of(arm, rig)
    model = instance("arm", design_arm, Arm, "The order is arm, rig, law.")
    rig.require_fit(model.dynamics.chain)
    period = real("period", period, "Give seconds.", positive=True)
    # A law, for instance, has no influence on a multisine: an argument without effect is a mistake.
    search = {
        "law": law,
        "harmonics": harmonics,
        "starts": starts,
        "seed": seed,
        "iterations": iterations,
        "executor": executor,
    }
    options = {"parameters": search, "multisine": {"frequencies": frequencies}}
    other_kind = (
        "parameters" if choice("kind", kind, tuple(options)) == "multisine" else "multisine"
    )
    for name, value in options[other_kind].items():
        if value is not None:
            raise ValueError(
                f'{name} is for kind="{other_kind}"; got it for kind="{kind}". Leave one of them'
                " out."
            )
    if kind == "multisine":
        limits = position, velocity, acceleration
        return multisines(model, rig, period, frequencies, SETTINGS.torque, limits)
    if law is not None:
        instance("law", law, Law, "The order is arm, rig, law.")
    if harmonics is None:
        harmonics = SETTINGS.harmonics
    harmonics = whole("harmonics", harmonics, "Leave it out for the usual.")
    seed = 0 if seed is None else whole("seed", seed, "Leave it out for 0.", least=0)
    many = model.dynamics.p > SETTINGS.many
    # The cost has local optima; each start costs one solution.
    usual = SETTINGS.starts_of_many if many else SETTINGS.starts
    starts = usual if starts is None else whole("starts", starts, "Leave it out for the usual.")
    if iterations is None:
        iterations = SETTINGS.iterations
    iterations = whole("iterations", iterations, "Leave it out for the usual.")

    # 2. Optimise from random starts: one after the other in one problem, or each in its own.
    limits = motion_limits(model, period, harmonics, position, velocity, acceleration)
    experiment = model, rig, law, period, harmonics
    random = np.random.default_rng(seed)
    begins = list(_starts(random, starts, _rates(period, harmonics), *limits))
    if executor is None:
        ends = [_end(experiment, limits, iterations, begins)]
    else:
        run = functools.partial(_end, experiment, limits, iterations)
        ends = mapped(run, [[begin] for begin in begins], executor)
    valid = [end for end in ends if end is not None]
    if not valid:
        raise ValueError(
            f"limits must allow a motion; none of {starts} starts found one. Widen them."
        )
    _, motion = min(valid, key=lambda end: end[0])

    # 3. The friction and the inertia of a motor that hardly moves would remain unknown.
    path = motion(np.linspace(0, period, SETTINGS.samples))
    moved = np.ptp(rig.position_in_pulses(path.q), axis=0)
    if (moved < SETTINGS.least_pulses).any():
        label = model.dynamics.chain.joint_labels[int(moved.argmin())]
        raise ValueError(
            f"limits must allow {SETTINGS.least_pulses} pulses on every motor; that of {label}"
            f" moves by {moved.min():.0f}. Widen them."
        )
    return motion


def _rates(period: float, harmonics: int) -> Floats:
    """Angular frequencies (harmonics,) [rad/s]."""
    return np.asarray(2 * np.pi / period * np.arange(1, harmonics + 1), dtype=np.float64)


def _end(
    experiment: Any, limits: Any, iterations: int, starts: list[Any]
) -> tuple[float, Harmonics] | None:
    """Cost and motion of the best of these starts, or None; makes its own problem."""
    # casadi's problems cannot be sent to another process.
    problem = _Problem(*experiment)
    # The limits are part of the problem; each start only changes initial values.
    problem.limit(*limits)
    return problem.solved(starts, iterations)


class _Problem:
    """Ipopt problem: the largest variance of f as a function of the amplitudes."""

    def __init__(self, arm: Arm, rig: Rig, law: Law | None, period: float, harmonics: int) -> None:
        # 1. The motion at the samples of a period, linear in the amplitudes.
        self.period = period
        samples = max(SETTINGS.samples, SETTINGS.samples_of_harmonic * harmonics)
        order = np.arange(1, harmonics + 1)
        angle = 2 * np.pi / period * np.arange(samples)[:, None] * period / samples * order
        rate = _rates(period, harmonics)
        # Constant matrices: only the amplitudes are variables.
        c = np.cos(angle)
        s = np.sin(angle)
        n = arm.n
        p = arm.dynamics.p
        self.opti = ca.Opti()
        # A mean pose and the amplitudes of cosines and sines.
        offset = self.opti.variable(n)
        cosine = self.opti.variable(n, harmonics)
        sine = self.opti.variable(n, harmonics)
        self.amplitudes = offset, cosine, sine
        self.q = ca.repmat(offset, 1, samples) + cosine @ c.T + sine @ s.T
        self.qd = cosine @ (-s * rate).T + sine @ (c * rate).T
        self.qdd = cosine @ (-c * rate**2).T + sine @ (-s * rate**2).T

        # 2. The normal matrix of all samples, and the torque at each.
        information, tau = _equation(arm, rig, law)
        along = self.q, self.qd, self.qdd
        total = information.map(samples)(*along)
        self.torques = tau.map(samples)(*along)
        self.torque_limit = SETTINGS.torque * rig.drive.torque_limit()
        total = ca.reshape(ca.sum2(total), p, p)

        # 3. Its inverse has the variances on the diagonal. A little of the unit matrix keeps it
        # regular where a start does not excite an f. The logarithm takes the scale from the cost.
        matrix = ca.SX.sym("M", p, p)
        diagonal = ca.Function(
            "variance", [matrix], [inverse(ca.tril2symm(ca.tril(matrix))).diagonal]
        )
        variance = diagonal(total / samples + 1e-9 * ca.DM.eye(p))
        sharpness = SETTINGS.sharpness
        self.opti.minimize(ca.log(ca.sum1(variance**sharpness)) / sharpness)

    def limit(self, position: Floats, velocity: Floats, acceleration: Floats) -> None:
        """Keep motion and torque within limits at every sample; the arm starts from rest."""
        # A real arm can only join the motion at rest.
        self.opti.subject_to(self.qd[:, 0] == 0)
        for value, low, high in (
            (self.q, position[:, 0], position[:, 1]),
            (self.qd, -velocity, velocity),
            (self.qdd, -acceleration, acceleration),
            (self.torques, -self.torque_limit, self.torque_limit),
        ):
            # A torque without a limit gets no constraint.
            for i in np.flatnonzero(np.isfinite(high)).tolist():
                margin = SETTINGS.margin * (high[i] - low[i])
                self.opti.subject_to(
                    self.opti.bounded(low[i] + margin, value[i, :].T, high[i] - margin)
                )

    def solved(
        self, starts: Iterable[tuple[Floats, ...]], iterations: int
    ) -> tuple[float, Harmonics] | None:
        """Cost and motion of the best end that keeps the limits, from these starts; or None."""
        opti = self.opti
        options = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": 1e-4,
            "hessian_approximation": "limited-memory",
            # Ipopt also ends where the limits are kept and the cost has hardly changed for some
            # iterations, however far the dual variables are from their optimum.
            "acceptable_tol": 1e9,
            "acceptable_constr_viol_tol": 1e-4,
            "acceptable_compl_inf_tol": 1e-3,
            "acceptable_obj_change_tol": 1e-3,
            "acceptable_iter": 6,
        }
        opti.solver("ipopt", {"print_time": False, "error_on_fail": False}, options)
        best = None
        for start in starts:
            for amplitude, value in zip(self.amplitudes, start, strict=True):
                opti.set_initial(amplitude, value)
            try:
                # A limited number of iterations is no failure.
                solution = opti.solve_limited()
            except RuntimeError:  # this start leads nowhere
                continue
            # Ipopt also returns points that violate constraints: check them here.
            excess = ca.vertcat(ca.vec(opti.g - opti.ubg), ca.vec(opti.lbg - opti.g))
            cost = solution.value(opti.f)
            if np.max(solution.value(excess)) < SETTINGS.slack and (best is None or cost < best[0]):
                # casadi gives a single column as a vector.
                offset, cosine, sine = (
                    np.reshape(solution.value(x), x.shape) for x in self.amplitudes
                )
                best = (
                    cost,
                    Harmonics(period=self.period, offset=offset.ravel(), cosine=cosine, sine=sine),
                )
        return best


def _starts(
    random: np.random.Generator,
    starts: int,
    rate: Floats,
    position: Floats,
    velocity: Floats,
    acceleration: Floats,
) -> Iterator[tuple[Floats, ...]]:
    """Random amplitudes of motions within limits: offset (n,), cosine and sine (n, harmonics)."""
    # `reach`: amplitude of the lowest harmonic that all limits allow.
    middle = position.mean(axis=1)
    # A joint starts around the middle of its range.
    half = np.diff(position, axis=1).ravel() / 2
    reach = np.minimum(half, np.minimum(velocity / rate[0], acceleration / rate[0] ** 2))
    for _ in range(starts):
        # Amplitudes that fall with the square of the order have the same acceleration.
        share = random.normal(size=(2, len(middle), len(rate))) / (
            np.arange(1, len(rate) + 1) ** 2 * 3
        )
        # The speed at the beginning is the sum of rate times sine: project it out.
        share[1] -= np.outer(share[1] @ rate, rate) / (rate @ rate)
        yield middle, share[0] * reach[:, None], share[1] * reach[:, None]


def _equation(arm: Arm, rig: Rig, law: Law | None) -> tuple[ca.Function, ca.Function]:
    """Normal matrix of one sample, for f relative to the width of its range; and its torque."""
    n = arm.n
    dynamics = arm.dynamics
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    if dynamics.ranges is None:
        unit = np.maximum(np.abs(arm.f), SETTINGS.least_unit * np.abs(arm.f).max())
    else:
        # The range of a fixed f has no width: its unit is the widest one.
        unit = np.diff(dynamics.ranges, axis=1).ravel()
        unit = np.where(unit > 0, unit, unit.max())
    # A row in pulses has the same noise on every motor: that of rounding.
    per_pulse = ca.repmat(ca.DM(_torque_per_pulse(rig, law)), 1, dynamics.p)
    # Pulses and amplifiers' limits are those of motors, each of which turns one shaft.
    coupling = rig.drive.coupling
    # Row i: torque of shaft i; column j: f j in its unit.
    rows = coupling.shaft_torque(dynamics.Y(q, qd, qdd))
    scaled = rows * ca.repmat(ca.DM(unit).T, n, 1) / per_pulse
    arguments = [q, qd, qdd]
    names = ["q", "qd", "qdd"]
    # Shaft torque of the nominal arm along the motion, for the limits.
    moving, at_rest = lumped_torque(dynamics.chain, dynamics.lumping, q, qd, qdd, ca.SX(arm.f))
    # Coulomb friction jumps, so it is left out: the free share of the amplifier's limit is for it.
    speed = coupling.shaft(qd)
    friction = coupling.joint_torque(rig.drive.joint_viscous(speed) * speed)
    tau = coupling.shaft_torque(moving + at_rest + friction - rig.spring_torque(q))
    return (
        ca.Function("information", arguments, [ca.vec(scaled.T @ scaled)], names, ["M"]),
        ca.Function("tau", arguments, [tau], names, ["tau"]),
    )


def _torque_per_pulse(rig: Rig, law: Law | None) -> Floats:
    """Magnitude (n,) of the shaft torque by one pulse of error on every motor [N m].

    Raises
    ------
    ValueError
        A law whose torque does not follow from the error, or is zero at any error.
    """
    if law is None:
        limit = rig.drive.torque_limit()
        return np.where(np.isfinite(limit), limit, 1.0) / SETTINGS.full_error
    # A law that repeats a log does not read the error either.
    if law.replays or law.has_memory(rig.n):
        raise ValueError(
            f"law must be fast and without memory, like P; got {type(law).__name__}. Give such a"
            " law, or none."
        )
    # The law itself says how much torque an error of one pulse causes.
    block = law.block(rig)
    zero = np.zeros(rig.n)

    def torque(pulses: float) -> Any:
        error = zero + pulses
        step = block.step([], zero, zero, zero, error, zero, zero, rig.period, block.values)
        return step[0]

    # The difference removes a torque at no error, such as that of gravity compensation.
    change = (torque(1.0) - torque(0.0)).full().ravel()
    per_pulse = np.abs(rig.drive.coupling.shaft_torque(change))
    if not per_pulse.all():
        raise ValueError(
            "law must give every motor a torque against its error; that of"
            f" {rig.joint_labels[per_pulse.argmin()]} gets none. Give it a gain."
        )
    return per_pulse
