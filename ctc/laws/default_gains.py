"""Gains of a computed torque that is given none: by what is known of the arm, and for the gears of its rig."""

from collections.abc import Callable
from typing import Any

import numpy as np

from identification import Identification
from plant import Law, Rig
from plant.analysis.sampled_loops import SampledLoops

_ARM, _IDENTIFIED, _FRICTION_TOO = (360.0, 0.0), (145.0, 0.2), (100.0, 0.2)
"""Bandwidth [rad/s] and dead zone by what is known: nothing but f; f with a covariance; friction as well."""

_SAMPLED = 0.3
"""Bandwidth times period, at most."""

_SPARE, _SLOWER, _SLOWEST = 1.4, 0.8, 5.0
"""Share of the bandwidth that a stable one has to spare; by which others are lowered; the least tried [rad/s]."""

_STIFFER = 1.0, 1.2, 1.5, 2.0, 3.0, 5.0
"""Resonances, in shares of the stated, at which it has to be stable: a fast observer can be stable on soft gears, but
no longer where they are a little stiffer."""


def known_gains(found: Any) -> tuple[float, float]:
    """Bandwidth [rad/s] and dead zone by what is known of an arm, or by an identification."""
    if not isinstance(found, Identification) or found.covariance is None:
        return _ARM
    friction = any(name.startswith(("drive.viscous", "drive.coulomb")) for name in found.fit.unknown)
    return _FRICTION_TOO if friction else _IDENTIFIED


def default_bandwidth(found: Any, rig: Rig | None, law: Callable[[Rig, float], Law]) -> float:
    """That of what is known [rad/s], or what the rig allows: for its period, and stable on its elastic gears.

    Parameters
    ----------
    found : Identification or Arm
    rig : Rig or None
        Of the law; by default the identification's.
    law : callable
        (rig, bandwidth) -> the law for the identified arm.

    Raises
    ------
    ValueError
        Gears on which none is stable.
    """
    bandwidth, _ = known_gains(found)
    if isinstance(found, Identification) and rig is None:
        rig = found.rig
    if not isinstance(rig, Rig):  # refused with the other fields
        return bandwidth
    bandwidth = min(bandwidth, _SAMPLED / rig.period)
    gears = rig.drive.elasticity
    if not isinstance(found, Identification) or gears is None:
        return bandwidth
    pose = np.zeros(rig.n) if found.records[0].reference is None else found.records[0].reference(np.zeros(1)).q[0]
    while bandwidth > _SLOWEST:
        loops = SampledLoops(found.arm, rig, law(rig, _SPARE * bandwidth), pose)
        stiffer = (
            {
                f"drive.elasticity.{name}[{i}]": value * factor**power
                for name, power in (("stiffness", 2), ("damping", 1))
                for i, value in enumerate(getattr(gears, name))
            }
            for factor in _STIFFER
        )
        if all(loops.unstable_pole(numbers) is None for numbers in stiffer):
            return bandwidth
        bandwidth *= _SLOWER
    raise ValueError("no bandwidth is stable on these elastic gears with 40 % to spare; take what tune finds.")
