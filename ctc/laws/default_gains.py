"""Default gains of computed torque: from the knowledge of the arm, and for the gears of its rig.

With friction identified and rigid gears the bandwidth follows from the uncertainty of an
acceleration. An unmodelled acceleration a [pulses/s^2] moves a joint by a / bandwidth^2 before the
disturbance observer has learnt it. That has to stay a share of a pulse, and finer counts are more
pulses.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error import Estimate, linear, regressor_along
from identification.results import doubts
from plant import Rig, part
from plant.analysis import SampledLoops
from plant.parts import Settings, instance


class Gains(NamedTuple):
    """Gains that go together.

    Bandwidth [rad/s], dead zone as a share of the cell, ratio of observer to regulator, factor of
    the boost, and time constant of the boost times the bandwidth.
    """

    bandwidth: float
    dead_zone: float
    observer_ratio: float = 1.3
    start_boost: float = 4.0
    start_time: float = 10.0


@part
class DefaultGainSettings(Settings):
    """Numbers that choose the default gains of `ComputedTorque.designed`.

    docs/background/computed_torque.md has the table of defaults, and docs/background/design.md the
    runs that chose them; numbers without such a run were chosen by hand.

    Parameters
    ----------
    arm : Gains
        For an arm whose accuracy is unknown.
    identified : Gains
        For an identification of f with a covariance.
    elastic : Gains
        For an identification of f and friction, on elastic gears.
    friction : Gains
        The same on rigid gears. Unmodelled gears of 60 Hz become unstable with a
        faster observer or a larger boost. The dead zone falls with the square root of more
        bandwidth.
    goals : Gains
        Above position servos. The bandwidth is what the law adds to the servo's own stiffness; see
        tests/benchmarks/servos.py --only so101.
    frames : Gains
        The same above drives that take MIT frames. Gears that the rig does not state become
        unstable with 60 rad/s at 15 Hz, and with 80 at 28 Hz; see tests/benchmarks/servos.py --only
        elastic.
    share : float
        Error [pulses] that one standard deviation of unmodelled acceleration may cause.
    margin : float
        Factor by which the bandwidth that `share` needs may exceed that of `friction`, which then
        stays: with a larger one unmodelled gears of 60 Hz become unstable.
    period : float
        Largest product of bandwidth and period. Chosen by hand.
    inner_period : float
        The same above an inner loop, whose own stiffness has no delay: 0.3 leaves twice the error
        where the servo's gain is 20 % off, and 0.6 rings where goals come a sample late; see
        tests/benchmarks/servos.py --only bandwidths,late.
    step : float
        Factor by which a bandwidth is reduced until it is stable. Chosen by hand.
    smallest : float
        Bandwidths above it are tried [rad/s]. Chosen by hand.
    samples : int
        Instants of the identified path at which the acceleration's uncertainty is evaluated.
    poses : int
        Poses of the identified path at which loops must be stable.
    predicted : tuple of float
        Stiffnesses, as shares of the stated one, with which a law that predicts its gears must be
        stable.
    spare : float
        Factor by which a law that takes its gears for rigid must be stable with more bandwidth.
    stiffer : tuple of float
        Stiffnesses, as shares of the stated one, with which such a law must be stable: a fast
        observer can be stable on soft gears, and unstable where they are a little stiffer.

    Raises
    ------
    ValueError
        A number that is negative or, where it must be positive, zero; a `step` above 0.99;
        stiffnesses without a number.

    See Also
    --------
    ctc.ComputedTorque

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, DefaultGainSettings
    >>> settings = DefaultGainSettings(period=0.1)
    >>> law = ComputedTorque.designed(puma560.arm(), puma560.rig(), gains=settings)
    >>> law.bandwidth * law.period <= 0.1
    True
    """

    may_be_zero = (
        "arm",
        "identified",
        "elastic",
        "friction",
        "goals",
        "frames",
    )  # a dead zone is often zero
    at_most = {"step": 0.99}  # noqa: RUF012  # declared as of the class; 1 would never end

    arm: Gains = Gains(360.0, 0.0)
    identified: Gains = Gains(145.0, 0.2)
    elastic: Gains = Gains(100.0, 0.4)
    friction: Gains = Gains(120.0, 0.45, 1.0, 2.7, 40.0)
    goals: Gains = Gains(120.0, 0.2, 1.3, 2.0, 10.0)
    frames: Gains = Gains(50.0, 0.2, 1.3, 2.0, 10.0)
    share: float = 0.28
    margin: float = 1.2
    period: float = 0.3
    inner_period: float = 0.45
    step: float = 0.8
    smallest: float = 5.0
    samples: int = 100
    poses: int = 3
    predicted: tuple[float, ...] = (0.9, 1.0, 1.15)
    spare: float = 1.4
    stiffer: tuple[float, ...] = (1.0, 1.44, 2.25, 4.0, 9.0, 25.0)

    def __post_init__(self) -> None:
        # They are read by name: a plain tuple would fail no sooner than a law is made.
        for name in self.may_be_zero:
            usual = "Change the usual ones by _replace."
            instance(f"{name} of DefaultGainSettings", getattr(self, name), Gains, usual)
        super().__post_init__()


SETTINGS = DefaultGainSettings()


def default_gains(
    source: Any,
    rig: Any,
    bandwidth: float | None,
    trial: Callable[..., Any],
    settings: DefaultGainSettings = SETTINGS,
) -> Gains:
    """Gains for an arm or an identification, with the bandwidth worked out where it is None.

    `rig` is that of the law, by default the identification's. `trial(rig, bandwidth=...)` returns a
    computed torque for the arm, whose loops must be stable on elastic gears. If they are so with no
    bandwidth, the gears are refused.
    """
    # Dead zone, ratio and boost go with the bandwidth that the knowledge allows, stated or not.
    gains = known_gains(source, rig, settings)
    if bandwidth is None:
        gains = gains._replace(bandwidth=_bandwidth(source, rig, gains.bandwidth, trial, settings))
    return gains


def known_gains(source: Any, rig: Any = None, settings: DefaultGainSettings = SETTINGS) -> Gains:
    """Gains from the knowledge of the arm alone, whatever the period and the gears allow."""
    if rig is None and isinstance(source, Estimate):
        rig = source.rig
    if isinstance(rig, Rig) and rig.inner is not None:
        return settings.goals if rig.inner.sends == "goal" else settings.frames
    # Without a covariance nothing says how far the model may be trusted.
    if not isinstance(source, Estimate) or source.covariance is None:
        return settings.arm
    # With friction among the unknowns its covariance counts, too.
    friction = ("drive.viscous", "drive.coulomb")
    if not any(name.startswith(friction) for name in source.unknown):
        return settings.identified
    if isinstance(rig, Rig) and rig.drive.elasticity is not None:
        return settings.elastic
    gains = settings.friction
    # The error of an unmodelled acceleration is a / bandwidth^2; solved for the bandwidth.
    needed = float(np.sqrt(uncertain_acceleration(source, settings.samples) / settings.share))
    # The covariance of an identification in doubt says nothing.
    if needed <= settings.margin * gains.bandwidth or doubts(source):
        return gains
    # More than an arm without a covariance gets would amplify rounding alone.
    bandwidth = min(needed, settings.arm.bandwidth)
    dead_zone = gains.dead_zone * np.sqrt(gains.bandwidth / bandwidth)
    return gains._replace(bandwidth=bandwidth, dead_zone=dead_zone)


def uncertain_acceleration(estimate: Estimate, samples: int) -> float:
    """Largest standard deviation of an acceleration on the identified path [pulses/s^2].

    It comes from that of f and friction, and is 0 where path or covariance are not known.
    """
    path = estimate.path
    if path is None or estimate.covariance is None:
        return 0.0
    arm = estimate.arm
    rig = estimate.rig
    motion = path(np.linspace(0, path.duration, samples, endpoint=False))
    names = linear(arm.dynamics, rig, estimate.unknown)
    regressor, _ = regressor_along(arm.dynamics, rig, names, motion)
    # The encoder converts each joint alone: columns of a unit matrix give its slopes.
    pulses = np.column_stack([rig.position_in_pulses(joint) for joint in np.eye(arm.n)])
    # Change of the accelerations [pulses/s^2] per change of each parameter, sample by sample.
    slopes = np.array(
        [pulses @ np.linalg.solve(arm.D(q), Y) for q, Y in zip(motion.q, regressor, strict=True)]
    )
    variance = np.einsum("tik,kl,til->ti", slopes, estimate.covariance_of(names), slopes)
    return float(np.sqrt(variance.max()))


def _bandwidth(
    source: Any,
    rig: Any,
    bandwidth: float,
    trial: Callable[..., Any],
    settings: DefaultGainSettings,
) -> float:
    """That bandwidth [rad/s], or a smaller one that the period and elastic gears allow."""
    identified = isinstance(source, Estimate)
    if identified and rig is None:
        rig = source.rig
    if not isinstance(rig, Rig):  # the law refuses it, with its other fields
        return bandwidth
    # A sample delays the regulator by its period; their product bounds the phase that is lost.
    most = settings.period if rig.inner is None else settings.inner_period
    bandwidth = min(bandwidth, most / rig.period)
    gears = rig.drive.elasticity
    if gears is None:
        return bandwidth
    arm = getattr(source, "arm", source)
    # Inertia changes with the pose, and stability with it.
    poses = np.zeros((1, rig.n))
    path = source.path if identified else None
    if path is not None:
        poses = path(np.linspace(0, path.duration, settings.poses, endpoint=False)).q
    if bandwidth <= settings.smallest:
        raise ValueError(
            f"bandwidth must be above {settings.smallest:g} rad/s to be tried on elastic gears;"
            f" gains and the period of {rig.period:g} s allow {bandwidth:.3g}. Sample faster, or"
            " give a bandwidth."
        )
    while bandwidth > settings.smallest:
        law = trial(rig, bandwidth=bandwidth)
        factors = settings.predicted
        # Without gains of its gears the law takes them for rigid, and needs more room.
        if law.gear_gains is None:
            law = trial(rig, bandwidth=settings.spare * bandwidth)
            factors = settings.stiffer
        loops = (SampledLoops(arm, rig, law, pose) for pose in poses)
        if all(_stable(loop, gears, factors) for loop in loops):
            return bandwidth
        bandwidth *= settings.step
    raise ValueError(
        "no bandwidth is stable on these elastic gears with something to spare; take what tune"
        " finds."
    )


def _stable(loops: SampledLoops, gears: Any, factors: tuple[float, ...]) -> bool:
    """Whether loops are stable with gears of these stiffnesses, as shares of the stated one."""
    for factor in factors:
        # The damping follows the square root of the stiffness: the same damping ratio.
        shares = (("stiffness", factor), ("damping", np.sqrt(factor)))
        numbers = {
            f"drive.elasticity.{name}[{i}]": share * value
            for name, share in shares
            for i, value in enumerate(getattr(gears, name))
        }
        if loops.unstable_pole(numbers) is not None:
            return False
    return True
