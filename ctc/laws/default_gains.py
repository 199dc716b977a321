"""Gains of a computed torque that is given none: by what is known of the arm, and for the gears of
its rig.

With friction identified, gears rigid, the bandwidth follows from how well an acceleration is known.
What the model lacks there, a [pulses/s^2], moves a joint by a / bandwidth^2 before the disturbance
observer knows it: that has to stay a share of a pulse, and finer counts are more pulses.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from identification import Identification
from identification.equation_error.regressor import linear, regressor_along
from identification.results.summary import doubts
from plant import Rig
from plant.analysis.sampled_loops import SampledLoops


class Gains(NamedTuple):
    """Bandwidth [rad/s], share of the cell, ratio of the observer, boost at the start, its time
    times the bandwidth.
    """

    bandwidth: float
    dead_zone: float
    observer_ratio: float = 1.3
    start_boost: float = 4.0
    start_time: float = 10.0


# By what is known: nothing but f; f with a covariance; friction as well, and gears; friction, on
# rigid gears: those of 60 Hz swing under a faster observer or a larger boost. More bandwidth takes
# a smaller dead zone.
_ARM = Gains(360.0, 0.0)
_IDENTIFIED = Gains(145.0, 0.2)
_GEARS = Gains(100.0, 0.4)
_FRICTION_TOO = Gains(120.0, 0.45, 1.0, 2.7, 40.0)

# Of a pulse, by which one standard deviation of what the model lacks may move a joint, its friction
# identified.
_SHARE = 0.28

# Excess of the bandwidth that this takes, up to which the least one stays: gears of 60 Hz swing
# under more.
_NEARLY = 1.2

_SAMPLED = 0.3  # bandwidth times period, at most

# by which bandwidths are lowered; the least tried [rad/s]
_SLOWER = 0.8
_SLOWEST = 5.0

_SAMPLES = 100  # of the identified path, along which an acceleration is uncertain

_POSES = 3  # of the identified path, at which loops have to be stable

# stiffness, in shares of the stated, with which a law that predicts its gears has to be stable
_OFF = 0.9, 1.0, 1.15

# Share of its bandwidth that another one is stable with, and stiffnesses: a fast observer can be
# stable on soft gears, but no longer where they are a little stiffer.
_SPARE = 1.4
_STIFFER = (1.0, 1.44, 2.25, 4.0, 9.0, 25.0)


def known_gains(found: Any, rig: Any = None) -> Gains:
    """By what is known of an arm, or by an identification; `rig` is the controller's, by default
    the identified one.
    """
    if not isinstance(found, Identification) or found.covariance is None:
        return _ARM
    if not any(name.startswith(("drive.viscous", "drive.coulomb")) for name in found.fit.unknown):
        return _IDENTIFIED
    if (
        isinstance(rig := found.rig if rig is None else rig, Rig)
        and rig.drive.elasticity is not None
    ):
        return _GEARS
    enough = float(np.sqrt(uncertain_acceleration(found) / _SHARE))
    # whose covariance says nothing
    if enough <= _NEARLY * _FRICTION_TOO.bandwidth or doubts(found):
        return _FRICTION_TOO
    bandwidth, least, share, *_ = min(enough, _ARM.bandwidth), *_FRICTION_TOO
    return _FRICTION_TOO._replace(bandwidth=bandwidth, dead_zone=share * np.sqrt(least / bandwidth))


def uncertain_acceleration(found: Identification) -> float:
    """Largest standard deviation that f and friction give an acceleration on the identified path
    [pulses/s^2]; or 0.
    """
    path = found.records[0].reference
    arm = found.arm
    if path is None or found.covariance is None:
        return 0.0
    motion = path(np.linspace(0, path.duration, _SAMPLES, endpoint=False))
    names = linear(arm.dynamics, found.rig, found.fit.unknown)
    regressor, _ = regressor_along(arm.dynamics, found.rig, names, motion)
    pulses = np.column_stack([found.rig.position_in_pulses(joint) for joint in np.eye(arm.n)])
    lacking = np.array(
        [pulses @ np.linalg.solve(arm.D(q), Y) for q, Y in zip(motion.q, regressor, strict=True)]
    )
    return float(
        np.sqrt(np.einsum("tik,kl,til->ti", lacking, found.fit.covariance_of(names), lacking).max())
    )


def default_bandwidth(found: Any, rig: Rig | None, law: Callable[[Rig, float], Any]) -> float:
    """That of what is known [rad/s], or what the rig allows: for its period, and stable on its
    elastic gears.

    `rig`: of the law; by default the identification's. `law`: (rig, bandwidth) -> the computed
    torque for the identified arm. Gears on which none is stable are refused.
    """
    bandwidth = known_gains(found, rig).bandwidth
    if isinstance(found, Identification) and rig is None:
        rig = found.rig
    if not isinstance(rig, Rig):  # refused with the other fields
        return bandwidth
    bandwidth = min(bandwidth, _SAMPLED / rig.period)
    gears = rig.drive.elasticity
    if gears is None:
        return bandwidth
    arm = getattr(found, "arm", found)
    poses = np.zeros((1, rig.n))
    if isinstance(found, Identification) and found.records[0].reference is not None:
        path = found.records[0].reference
        poses = path(np.linspace(0, path.duration, _POSES, endpoint=False)).q
    while bandwidth > _SLOWEST:
        predicts = law(rig, bandwidth).gear_gains is not None
        each = law(rig, bandwidth if predicts else _SPARE * bandwidth)
        loops = (SampledLoops(arm, rig, each, pose) for pose in poses)
        if all(_stable(loop, gears, _OFF if predicts else _STIFFER) for loop in loops):
            return bandwidth
        bandwidth *= _SLOWER
    raise ValueError(
        "no bandwidth is stable on these elastic gears with something to spare; take what tune"
        " finds."
    )


def _stable(loops: SampledLoops, gears: Any, factors: tuple[float, ...]) -> bool:
    """Whether loops are stable with gears of these stiffnesses, in shares of the stated, and
    damping to match.
    """
    numbers = (
        {
            f"drive.elasticity.{name}[{i}]": share * value
            for name, share in (("stiffness", factor), ("damping", np.sqrt(factor)))
            for i, value in enumerate(getattr(gears, name))
        }
        for factor in factors
    )
    return all(loops.unstable_pole(each) is None for each in numbers)
